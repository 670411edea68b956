//! The part of a network that looks, behind one call.

use std::ops::Deref;

use burn::tensor::{Device, Tensor, TensorData};
use where2act_kernels::Isa;
use where2act_model::preprocess::CloudInput;
use where2act_model::{Engine, EngineError, Features, Hierarchy, LinearLayer, ModelConfig, Network};

use crate::Error;

/// What computes the backbone.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Backend {
    /// Kernels of this project: the fastest.
    #[default]
    Fast,
    /// The same with convolutions that multiply in bf16 and add in f32, for processors that have it in AVX-512. Networks for
    /// scans have no convolutions and stay in f32.
    Bf16,
    /// burn on its flex backend.
    Flex,
    /// burn on its ndarray backend: slower, for comparison.
    #[cfg(feature = "ndarray")]
    Ndarray,
}

impl Backend {
    /// burn's device for it.
    #[cfg_attr(feature = "ndarray", expect(deprecated, reason = "for comparison as long as burn has it"))]
    pub(crate) fn device(self) -> Device {
        match self {
            Self::Fast | Self::Bf16 | Self::Flex => Device::flex(),
            #[cfg(feature = "ndarray")]
            Self::Ndarray => Device::ndarray(),
        }
    }
}

/// A prepared input.
pub(crate) enum NetworkInput {
    /// `[3, side, side]`.
    Picture { values: Vec<f32>, side: usize },
    /// Points and the scan they are from.
    Cloud(CloudInput),
}

/// A network's backbone, loaded.
pub(crate) enum Backbone {
    Fast(Box<Engine>),
    Burn(Box<Network>, Device),
}

/// Features of every pixel or point, `[n, features]`, or what the last layer would make them of.
pub(crate) enum Rows<'a> {
    Fast(Features<'a>),
    Burn(Vec<f32>),
}

impl Deref for Rows<'_> {
    type Target = [f32];

    fn deref(&self) -> &[f32] {
        match self {
            Self::Fast(features) => features,
            Self::Burn(features) => features,
        }
    }
}

impl Backbone {
    /// The backbone, and its last layer if that is left to the heads.
    pub(crate) fn new(network: Network, backend: Backend) -> Result<(Self, Option<LinearLayer>), Error> {
        let isa = match backend {
            Backend::Fast => Isa::best(),
            Backend::Bf16 => Isa::bf16().ok_or(EngineError::NoBf16).map_err(failed)?,
            _ => return Ok((Self::Burn(Box::new(network), backend.device()), None)),
        };
        let (engine, last) = Engine::open(isa, &network).map_err(failed)?;
        Ok((Self::Fast(Box::new(engine)), last))
    }

    pub(crate) fn features(&self, input: &NetworkInput, config: &ModelConfig) -> Result<Rows<'_>, Error> {
        match (self, input) {
            (Self::Fast(engine), NetworkInput::Picture { values, side }) => {
                engine.features_rgb(values, [1, *side, *side]).map(Rows::Fast).map_err(failed)
            }
            (Self::Burn(network, device), NetworkInput::Picture { values, side }) => {
                let data = TensorData::new(values.clone(), [1, 3, *side, *side]);
                plain(network.features_rgb(Tensor::<4>::from_data(data, device)))
            }
            (_, NetworkInput::Cloud(cloud)) => self.features_of(&cloud.whole_hierarchy(config)),
        }
    }

    /// Features of the targets of prepared clouds.
    pub(crate) fn features_of(&self, hierarchy: &Hierarchy) -> Result<Rows<'_>, Error> {
        match self {
            Self::Fast(engine) => engine.features_cloud(hierarchy).map(Rows::Fast).map_err(failed),
            Self::Burn(network, _) => plain(network.features_of(hierarchy)),
        }
    }
}

fn plain<const D: usize>(features: Tensor<D>) -> Result<Rows<'static>, Error> {
    features.into_data().try_into_vec().map(Rows::Burn).map_err(|e| Error::Network(format!("{e:?}")))
}

fn failed(error: impl std::fmt::Display) -> Error {
    Error::Network(error.to_string())
}
