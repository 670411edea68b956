//! The whole network: a backbone that looks and heads that answer.

use burn::module::Module;
use burn::tensor::{Device, Tensor};
use where2act_core::Seed;

use crate::config::{Modality, ModelConfig};
use crate::heads::Heads;
use crate::init::draw_weights;
use crate::pointnet::{Hierarchy, PointNet2};
use crate::unet::UNet;

/// What looks.
#[derive(Module, Debug)]
#[expect(clippy::large_enum_variant, reason = "one per network")]
pub enum Backbone {
    /// At pictures.
    UNet(UNet),
    /// At scans.
    PointNet2(PointNet2),
}

/// A Where2Act network. [`Module::train`] and [`Module::valid`] switch between training and prediction; on a plain
/// device it predicts.
#[derive(Module, Debug)]
pub struct Network {
    /// What looks.
    pub backbone: Backbone,
    /// What answers.
    pub heads: Heads,
    /// What both are.
    #[module(skip)]
    config: ModelConfig,
}

/// A batch of prepared inputs. The network's modality decides which of the two it takes.
#[derive(Clone, Debug)]
#[expect(clippy::large_enum_variant, reason = "one per batch, passed by value like the tensor itself")]
pub enum Input<'a> {
    /// `[b, 3, side, side]`, normalised as [`crate::preprocess::ImageInput`] does.
    Images(Tensor<4>),
    /// Clouds of equal size and their neighbourhoods.
    Clouds(&'a Hierarchy),
}

impl Network {
    /// A network with random weights that depend on the seed and nothing else.
    #[must_use]
    pub fn new(config: &ModelConfig, seed: Seed, device: &Device) -> Self {
        draw_weights(Self::zeros(config, device), seed)
    }

    /// A network whose weights wait to be loaded.
    pub(crate) fn zeros(config: &ModelConfig, device: &Device) -> Self {
        let backbone = match config.modality {
            Modality::Rgb => Backbone::UNet(UNet::new(config.channels(), config.features, device)),
            Modality::Cloud => Backbone::PointNet2(PointNet2::new(
                config.width,
                config.features,
                config.surroundings,
                device,
            )),
        };
        Self { backbone, heads: Heads::new(config, device), config: config.clone() }
    }

    /// What this network is.
    #[must_use]
    pub fn config(&self) -> &ModelConfig {
        &self.config
    }

    /// The same network with every score's logit moved: by one number per primitive. Which of two proposals of a
    /// primitive is the better one does not change, where the score passes 0.5 does.
    #[must_use]
    pub fn shift_scores(mut self, by: &[f32]) -> Self {
        let shift = Tensor::<1>::from_floats(by, &self.device());
        // Whoever speaks last is moved.
        let last = match &mut self.heads.second_look {
            Some(second_look) => &mut second_look.mlp2,
            None => &mut self.heads.score.mlp2,
        };
        last.bias = last.bias.take().map(|bias| bias.map(|logits| logits + shift));
        self
    }

    /// Where its parameters are.
    #[must_use]
    pub fn device(&self) -> Device {
        self.heads.actionability.mlp1.weight.val().device()
    }

    /// Features of every pixel.
    ///
    /// # Shapes
    /// `[b, 3, side, side]` -> `[b, side * side, features]`, row by row
    ///
    /// # Panics
    /// If this is a network for clouds, as its config says.
    #[must_use]
    pub fn features_rgb(&self, images: Tensor<4>) -> Tensor<3> {
        match &self.backbone {
            Backbone::UNet(unet) => unet.forward(images),
            Backbone::PointNet2(_) => panic!("a network for clouds was given pictures"),
        }
    }

    /// Features of every point.
    ///
    /// # Shapes
    /// `[b, n, 3]` -> `[b, n, features]`
    ///
    /// # Panics
    /// If this is a network for pictures, as its config says.
    #[must_use]
    pub fn features_cloud(&self, points: Tensor<3>) -> Tensor<3> {
        match &self.backbone {
            Backbone::PointNet2(pointnet) => pointnet.forward(points),
            Backbone::UNet(_) => panic!("a network for pictures was given clouds"),
        }
    }

    /// Features of every point, or every target, of clouds whose neighbourhoods are known.
    ///
    /// # Shapes
    /// -> `[targets, features]`, cloud by cloud
    ///
    /// # Panics
    /// If this is a network for pictures, as its config says.
    #[must_use]
    pub fn features_of(&self, hierarchy: &Hierarchy) -> Tensor<2> {
        match &self.backbone {
            Backbone::PointNet2(pointnet) => pointnet.forward_rows(hierarchy, &self.device()),
            Backbone::UNet(_) => panic!("a network for pictures was given clouds"),
        }
    }

    /// Features at queries only, which is all that training needs: one forward pass, many trials per view.
    ///
    /// # Shapes
    /// - `queries`: q pairs (view in the batch, row-major pixel, or index of the hierarchy's target)
    /// - output: `[q, features]`
    ///
    /// # Panics
    /// If the input is not of this network's modality.
    #[must_use]
    pub fn features_at(&self, input: Input<'_>, queries: &[(usize, usize)]) -> Tensor<2> {
        match (&self.backbone, input) {
            (Backbone::UNet(unet), Input::Images(images)) => unet.forward_at(images, queries),
            (Backbone::PointNet2(pointnet), Input::Clouds(hierarchy)) => {
                let features = pointnet.forward_rows(hierarchy, &self.device());
                let wanted = queries.iter().map(|&(view, target)| hierarchy.row(view, target) as i64);
                features.select(0, crate::pointnet::rows(wanted.collect(), &self.device()))
            }
            (Backbone::UNet(_), Input::Clouds(_)) => panic!("a network for pictures was given clouds"),
            (Backbone::PointNet2(_), Input::Images(_)) => panic!("a network for clouds was given pictures"),
        }
    }
}
