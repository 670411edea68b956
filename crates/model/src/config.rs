//! What a network is: the one description that is validated, stored beside the weights and needed to run them.

use serde::de::Error;
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use where2act_core::Primitive;

/// What a network looks at.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Modality {
    /// A picture, through the U-Net.
    Rgb,
    /// Points of a partial scan, through PointNet++.
    Cloud,
}

/// Numbers of the preprocessing, the same in training and prediction, where alone there are masks.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Preprocessing {
    /// Side of the square picture the U-Net sees, pixels; a multiple of 32. Published: 224.
    pub image_side: usize,
    /// Subtracted from colours in [0, 1], per channel. Default: the mean ImageNet encoders are trained with.
    pub image_mean: [f32; 3],
    /// Divides colours after that. Default: the deviation ImageNet encoders are trained with.
    pub image_std: [f32; 3],
    /// Whether pixels outside a mask, and the bars of the letterbox, are painted white as in the published pictures.
    pub white_background: bool,
    /// If there is a mask, the network sees the square around it, larger than the mask's larger extent by this factor, and not the
    /// whole picture. The published network always sees the whole one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub close_up: Option<f32>,
    /// Random foreground points that furthest point sampling chooses from. Published: 30,000.
    pub scan_candidates: usize,
    /// Smallest and largest robust radius of the clouds seen in training, in network units (metres there). A cloud
    /// inside this range keeps its metres; one outside is scaled to the nearer end. Objects in training fit a unit
    /// sphere; training replaces the default by what it saw.
    pub scan_radius: [f32; 2],
}

impl Default for Preprocessing {
    fn default() -> Self {
        Self {
            image_side: 224,
            image_mean: [0.485, 0.456, 0.406],
            image_std: [0.229, 0.224, 0.225],
            white_background: true,
            close_up: None,
            scan_candidates: 30_000,
            scan_radius: [0.4, 1.0],
        }
    }
}

/// Everything that decides the shapes of a network's parameters and what is fed to it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
// What is derived becomes functions of the type's own, behind the traits that check: see `impl Deserialize` below.
#[serde(remote = "Self", deny_unknown_fields)]
pub struct ModelConfig {
    /// Version of this description.
    pub schema: Schema,
    /// Name for people, e.g. in predictions.
    pub name: String,
    /// What the network looks at.
    pub modality: Modality,
    /// One output of every head per primitive, in this order. A list of one is the published network.
    pub primitives: Vec<Primitive>,
    /// Channels of the backbone relative to the published ones, ResNet-18's 64, 128, 256 and 512 or PointNet++'s: 1 is the
    /// paper's, 0.5 a compact one.
    #[serde(default = "one")]
    pub width: f32,
    /// Numbers per pixel or point that the backbone hands to the heads. Published: 128.
    pub features: usize,
    /// Size of the one hidden layer of every head. Published: 128.
    pub hidden: usize,
    /// Another size for that of the actionability, which runs at every pixel or point instead of at candidates only.
    /// Published: none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub actionability_hidden: Option<usize>,
    /// Numbers of the proposal's random code z. Published: 10.
    pub latent: usize,
    /// Points of a cloud. Published: 10,000. Ignored for pictures.
    pub points: usize,
    /// Whether every point is also described by its nearest surroundings in the full scan, some centimetres: where a
    /// finger fits. Not in the published network. Ignored for pictures.
    #[serde(default)]
    pub surroundings: bool,
    /// Directions that the score head predicts at each pixel or point, to see how well a hand is aligned with them.
    /// Published: none.
    #[serde(default)]
    pub alignments: usize,
    /// Whether the proposals that the score likes best are scored once more, from the scan as the hand would see it. Not in
    /// the published network. Ignored for pictures.
    #[serde(default)]
    pub second_look: bool,
    /// How much a score's logit differs between a hand that wants a point to go where it can and one that wants it to go
    /// where it cannot, if the features are asked for the ways of points at all ([`crate::MotionHead`]); 0 asks without
    /// consequence. Published: none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub ways: Option<f32>,
    /// How inputs are prepared.
    #[serde(default)]
    pub preprocessing: Preprocessing,
}

/// A configuration that describes no network.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("model configuration: {field} is {found}, expected {expected}")]
pub struct ConfigError {
    field: &'static str,
    found: String,
    expected: &'static str,
}

impl ModelConfig {
    /// Whether there is a [second look](Self::second_look): scans only.
    #[must_use]
    pub fn looks_twice(&self) -> bool {
        self.second_look && self.modality == Modality::Cloud
    }

    /// The published network for a kind of input, with one output per primitive in the list.
    #[must_use]
    pub fn new(modality: Modality, primitives: &[Primitive]) -> Self {
        Self {
            schema: Schema::V1,
            name: match modality {
                Modality::Rgb => "where2act-rgb".to_owned(),
                Modality::Cloud => "where2act-cloud".to_owned(),
            },
            modality,
            primitives: primitives.to_vec(),
            width: 1.0,
            features: 128,
            hidden: 128,
            actionability_hidden: None,
            latent: 10,
            points: 10_000,
            surroundings: false,
            alignments: 0,
            second_look: false,
            ways: None,
            preprocessing: Preprocessing::default(),
        }
    }

    /// The same with another width of the backbone.
    #[must_use]
    pub fn with_width(self, width: f32) -> Self {
        Self { width, ..self }
    }

    /// The same with another number of points.
    #[must_use]
    pub fn with_points(self, points: usize) -> Self {
        Self { points, ..self }
    }

    /// Which output of the heads belongs to a primitive.
    #[must_use]
    pub fn output_of(&self, primitive: Primitive) -> Option<usize> {
        self.primitives.iter().position(|p| *p == primitive)
    }

    /// Size of the actionability's hidden layer.
    #[must_use]
    pub fn hidden_of_actionability(&self) -> usize {
        self.actionability_hidden.unwrap_or(self.hidden)
    }

    /// Channels of the U-Net's four levels: 64, 128, 256, 512 times the width.
    #[must_use]
    pub fn channels(&self) -> [usize; 4] {
        [1.0f32, 2.0, 4.0, 8.0].map(|m| (64.0 * self.width * m).round() as usize)
    }

    /// Checks every number.
    ///
    /// # Errors
    /// The first field that is out of range.
    pub fn validate(&self) -> Result<(), ConfigError> {
        let check = |ok: bool, field, found: String, expected| match ok {
            true => Ok(()),
            false => Err(ConfigError { field, found, expected }),
        };
        let small = |n: usize| (1..=4096).contains(&n);
        let mut seen = self.primitives.clone();
        seen.sort_unstable();
        seen.dedup();
        let distinct = !seen.is_empty() && seen.len() == self.primitives.len();
        let names: Vec<_> = self.primitives.iter().map(|p| p.name()).collect();
        check(distinct, "primitives", format!("{names:?}"), "at least one, each once")?;
        check((0.05..=4.0).contains(&self.width), "width", self.width.to_string(), "a number in [0.05, 4]")?;
        check(small(self.features), "features", self.features.to_string(), "a number in 1..=4096")?;
        check(small(self.hidden), "hidden", self.hidden.to_string(), "a number in 1..=4096")?;
        let own = self.hidden_of_actionability();
        check(small(own), "actionability_hidden", own.to_string(), "a number in 1..=4096")?;
        check(small(self.latent), "latent", self.latent.to_string(), "a number in 1..=4096")?;
        let few = self.alignments <= 1024;
        check(few, "alignments", self.alignments.to_string(), "a number up to 1024")?;
        let ways = self.ways.unwrap_or(0.0);
        check((0.0..=100.0).contains(&ways), "ways", ways.to_string(), "a number in [0, 100]")?;
        let enough = (16..=1_000_000).contains(&self.points);
        check(enough, "points", self.points.to_string(), "a number in 16..=1000000")?;
        let p = &self.preprocessing;
        let side = p.image_side > 0 && p.image_side <= 4096 && p.image_side.is_multiple_of(32);
        check(side, "image_side", p.image_side.to_string(), "a multiple of 32, at most 4096")?;
        let finite = p.image_mean.iter().all(|x| x.is_finite());
        check(finite, "image_mean", format!("{:?}", p.image_mean), "finite numbers")?;
        let positive = p.image_std.iter().all(|x| x.is_finite() && *x > 1e-6);
        check(positive, "image_std", format!("{:?}", p.image_std), "numbers above 0")?;
        let margin = p.close_up.unwrap_or(1.0);
        check((1.0..=10.0).contains(&margin), "close_up", margin.to_string(), "a number in [1, 10]")?;
        let candidates = (1..=10_000_000).contains(&p.scan_candidates);
        check(candidates, "scan_candidates", p.scan_candidates.to_string(), "a number in 1..=10000000")?;
        let [low, high] = p.scan_radius;
        let range = low > 1e-6 && low <= high && high.is_finite();
        check(range, "scan_radius", format!("{:?}", p.scan_radius), "two numbers above 0, the smaller first")
    }
}

/// Version of a [`ModelConfig`] in a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Schema {
    /// The only one there is.
    #[serde(rename = "where2act.model/1")]
    V1,
}

fn one() -> f32 {
    1.0
}

impl Serialize for ModelConfig {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        Self::serialize(self, serializer)
    }
}

impl<'de> Deserialize<'de> for ModelConfig {
    /// Fails for a configuration that describes no network.
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let config = Self::deserialize(deserializer)?;
        config.validate().map_err(D::Error::custom)?;
        Ok(config)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_round_trips_and_a_wrong_one_says_what_is_wrong() {
        let config = ModelConfig::new(Modality::Rgb, &Primitive::ALL).with_width(0.5);
        let text = serde_json::to_string_pretty(&config).unwrap();
        assert_eq!(serde_json::from_str::<ModelConfig>(&text).unwrap(), config);
        for (from, to, named) in [
            ("\"width\": 0.5", "\"width\": -1.0", "width is -1"),
            ("\"features\": 128", "\"features\": 0", "features is 0"),
            ("\"pushing-up\"", "\"pushing\"", "each once"),
            ("\"hidden\": 128", "\"hidden\": 128, \"actionability_hidden\": 0", "actionability_hidden is 0"),
            ("\"image_side\": 224", "\"image_side\": 225", "image_side is 225"),
            ("\"image_side\": 224", "\"image_side\": 224, \"close_up\": 0.5", "close_up is 0.5"),
            ("model/1", "model/2", "where2act.model/1"),
            ("\"latent\"", "\"latnet\"", "latnet"),
            ("\"hidden\": 128", "\"hidden\": 128, \"ways\": -1.0", "ways is -1"),
        ] {
            let wrong = text.replace(from, to);
            assert_ne!(wrong, text, "{from}");
            let error = serde_json::from_str::<ModelConfig>(&wrong).unwrap_err().to_string();
            assert!(error.contains(named), "{error}");
        }
    }
}
