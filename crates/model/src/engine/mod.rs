//! Prediction on kernels of our own: the same numbers as [`Network`] gives, several times sooner.
//!
//! [`Engine::compile`] folds batch-norms and packs the weights once. Afterwards any number of threads may share the
//! engine: each call borrows memory from a pool that grows to the number of calls at the same time.

mod cloud;
mod fold;
mod linear;
#[cfg(test)]
mod tests;

use std::ops::Deref;
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use where2act_kernels::unet::{UNet, UNetMemory};
use where2act_kernels::{AlignedBuf, Isa, ShapeError};

use crate::network::{Backbone, Network};
use crate::pointnet::Hierarchy;
pub use cloud::SurroundingsEngine;
use cloud::{CloudEngine, CloudMemory};
pub use linear::LinearLayer;

/// Why a network cannot be compiled, or an input not be taken.
#[derive(Debug, thiserror::Error)]
pub enum EngineError {
    /// A size that does not fit.
    #[error("{0}")]
    Shape(#[from] ShapeError),
    /// A network for one kind of input was given the other.
    #[error("expected {expected}, found {found}")]
    Modality {
        /// What the network takes.
        expected: &'static str,
        /// What it was given.
        found: &'static str,
    },
    /// Arithmetic that this processor does not have.
    #[error(
        "precision: expected f32, found bf16, which needs AVX-512 with bf16: this processor lacks it, or WHERE2ACT_ISA \
         forbids it"
    )]
    NoBf16,
}

/// A network compiled for prediction.
pub struct Engine {
    backbone: Compiled,
    isa: Isa,
    memory: Mutex<Vec<UNetMemory>>,
    cloud_memory: Mutex<Vec<CloudMemory>>,
    outputs: Mutex<Vec<AlignedBuf>>,
}

enum Compiled {
    Rgb(Box<UNet>),
    Cloud(CloudEngine),
}

/// Features, pixel by pixel or point by point. Their memory returns to the engine when they are dropped.
pub struct Features<'a> {
    values: AlignedBuf,
    home: &'a Mutex<Vec<AlignedBuf>>,
}

impl Deref for Features<'_> {
    type Target = [f32];
    fn deref(&self) -> &[f32] {
        &self.values
    }
}

impl Drop for Features<'_> {
    fn drop(&mut self) {
        give(self.home, std::mem::take(&mut self.values));
    }
}

/// Something from a pool, or a new one.
fn take<T: Default>(pool: &Mutex<Vec<T>>) -> T {
    pool.lock().unwrap_or_else(PoisonError::into_inner).pop().unwrap_or_default()
}

fn give<T>(pool: &Mutex<Vec<T>>, item: T) {
    pool.lock().unwrap_or_else(PoisonError::into_inner).push(item);
}

impl Engine {
    /// Compiles a network for the best instruction set of this CPU.
    ///
    /// # Errors
    /// For pictures, when the number of features is not a multiple of 16.
    pub fn compile(network: &Network) -> Result<Self, EngineError> {
        Self::compile_for(Isa::best(), network)
    }

    /// [`Self::compile`] for a chosen instruction set. Of those with bf16 only networks for pictures make use.
    ///
    /// # Errors
    /// As [`Self::compile`].
    pub fn compile_for(isa: Isa, network: &Network) -> Result<Self, EngineError> {
        Self::compile_layers(isa, network, false).map(|(engine, _)| engine)
    }

    /// [`Self::compile_for`], but without the linear layer at the end if there are fewer numbers before it than after it: for
    /// a caller that goes on with linear layers ([`LinearLayer::after`]), on the fewer numbers.
    ///
    /// # Errors
    /// As [`Self::compile`].
    pub fn open(isa: Isa, network: &Network) -> Result<(Self, Option<LinearLayer>), EngineError> {
        Self::compile_layers(isa, network, true)
    }

    fn compile_layers(
        isa: Isa,
        network: &Network,
        open: bool,
    ) -> Result<(Self, Option<LinearLayer>), EngineError> {
        let mut last = None;
        let isa = if matches!(network.backbone, Backbone::PointNet2(_)) { isa.exact() } else { isa };
        let side = network.config().preprocessing.image_side;
        let backbone = match &network.backbone {
            Backbone::UNet(unet) => {
                let misfit = EngineError::Modality { expected: "a U-Net", found: "another network" };
                let mut layers = fold::unet(unet).ok_or(misfit)?;
                last = if open { fold::take_head(&mut layers) } else { None };
                Compiled::Rgb(Box::new(UNet::new(isa, &layers, side)?))
            }
            Backbone::PointNet2(net) => Compiled::Cloud(CloudEngine::new(isa, net)?),
        };
        let engine = Self {
            backbone,
            isa,
            memory: Mutex::default(),
            cloud_memory: Mutex::default(),
            outputs: Mutex::default(),
        };
        Ok((engine, last))
    }

    /// The instruction set it was compiled for.
    #[must_use]
    pub fn isa(&self) -> Isa {
        self.isa
    }

    /// Values per pixel or point.
    #[must_use]
    pub fn features(&self) -> usize {
        match &self.backbone {
            Compiled::Rgb(unet) => unet.features(),
            Compiled::Cloud(net) => net.features(),
        }
    }

    /// Features of every pixel, row by row.
    ///
    /// # Shapes
    /// `images` `[b, 3, height, width]`, prepared as [`crate::preprocess`] does, height and width multiples of 32
    /// -> `[b, height * width, features]`
    ///
    /// # Errors
    /// When the sizes do not fit, or the network is one for clouds.
    pub fn features_rgb(&self, images: &[f32], shape: [usize; 3]) -> Result<Features<'_>, EngineError> {
        let Compiled::Rgb(unet) = &self.backbone else {
            return Err(EngineError::Modality { expected: "clouds", found: "pictures" });
        };
        let [b, height, width] = shape;
        // Checked here so that wrong sizes do not allocate.
        ShapeError::check("values of the pictures", b * 3 * height * width, images.len())?;
        let mut features = self.take_features(b * height * width * unet.features());
        let mut memory = take(&self.memory);
        let result = unet.run(images, shape, &mut features.values, &mut memory);
        give(&self.memory, memory);
        result?;
        Ok(features)
    }

    /// The time of each stage of [`Self::features_rgb`].
    ///
    /// # Errors
    /// As [`Self::features_rgb`].
    pub fn stages_rgb(
        &self,
        images: &[f32],
        shape: [usize; 3],
    ) -> Result<Vec<(&'static str, Duration)>, EngineError> {
        let Compiled::Rgb(unet) = &self.backbone else {
            return Err(EngineError::Modality { expected: "clouds", found: "pictures" });
        };
        let mut features = self.features_rgb(images, shape)?;
        let mut memory = take(&self.memory);
        memory.keep_times();
        unet.run(images, shape, &mut features.values, &mut memory)?;
        Ok(memory.take_times())
    }

    /// Features of every target of clouds of equal size: of every point, unless the hierarchy has others.
    ///
    /// # Shapes
    /// `[targets, features]`, cloud by cloud
    ///
    /// # Errors
    /// When the network is one for pictures.
    pub fn features_cloud(&self, clouds: &Hierarchy) -> Result<Features<'_>, EngineError> {
        let Compiled::Cloud(net) = &self.backbone else {
            return Err(EngineError::Modality { expected: "pictures", found: "clouds" });
        };
        let mut features = self.take_features(clouds.targets().len() / 3 * net.features());
        let mut memory = take(&self.cloud_memory);
        let result = net.run(clouds, &mut features.values, &mut memory);
        give(&self.cloud_memory, memory);
        result?;
        Ok(features)
    }

    fn take_features(&self, len: usize) -> Features<'_> {
        let mut values = take(&self.outputs);
        values.resize(len);
        Features { values, home: &self.outputs }
    }
}
