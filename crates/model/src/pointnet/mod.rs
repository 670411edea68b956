//! PointNet++ with single-scale grouping (Qi et al., 2017) for scans.

mod abstraction;
mod hierarchy;
mod mlp;
mod propagation;
mod surroundings;

use burn::module::Module;
use burn::tensor::{Device, Int, Tensor, TensorData};

pub use abstraction::Abstraction;
pub use hierarchy::{Grouping, Hierarchy, Interpolation, LEVELS, Level, SURROUNDINGS};
pub use mlp::{MlpLayer, PointMlp};
pub use propagation::Propagation;
pub use surroundings::Surroundings;

/// Channels of the input points: their coordinates once more.
pub(crate) const INPUT_CHANNELS: usize = 3;

/// Sizes of the shared MLPs, without their inputs.
pub(crate) struct Sizes {
    /// Of the four steps down, the finest first.
    pub(crate) down: [[usize; 3]; 4],
    /// Of the four steps up, the finest first.
    pub(crate) up: [Vec<usize>; 4],
    /// Of what looks at surroundings, of a point or of a hand; not in the published network.
    pub(crate) around: [usize; 3],
}

impl Sizes {
    /// The sizes of width 1, which are the published ones, times the width.
    pub(crate) fn new(width: f32) -> Self {
        let times = |size: usize| (size as f32 * width).round() as usize;
        let down = [[32, 32, 64], [64, 64, 128], [128, 128, 256], [256, 256, 512]];
        let up: [&[usize]; 4] = [&[128, 128, 128], &[256, 128], &[256, 256], &[256, 256]];
        Self {
            down: down.map(|sizes| sizes.map(times)),
            up: up.map(|sizes| sizes.iter().copied().map(times).collect()),
            around: [32, 32, 64].map(times),
        }
    }

    /// Channels beside the points of every level: the input's, then what each step down says.
    pub(crate) fn levels(&self) -> [usize; 5] {
        let [a, b, c, d] = self.down.map(|[.., last]| last);
        [INPUT_CHANNELS, a, b, c, d]
    }

    /// Channels of what the step up from level `level + 1` to `level` interpolates.
    pub(crate) fn below(&self, level: usize) -> usize {
        self.up.get(level + 1).and_then(|sizes| sizes.last().copied()).unwrap_or(self.levels()[4])
    }

    /// Channels of the last step up.
    pub(crate) fn finest(&self) -> usize {
        self.up[0][self.up[0].len() - 1]
    }
}

/// PointNet++ and a last layer to the features.
#[derive(Module, Debug)]
pub struct PointNet2 {
    /// Four steps down: sample, group, describe.
    pub abstraction: Vec<Abstraction>,
    /// What is around each point in the full scan; not in the published network.
    pub surroundings: Option<Surroundings>,
    /// Four steps up, the finest first.
    pub propagation: Vec<Propagation>,
    /// `[channels of the last step up, features]`, batch-norm, ReLU.
    pub head: MlpLayer,
}

impl PointNet2 {
    /// A network with all weights zero.
    #[must_use]
    pub fn new(width: f32, features: usize, with_surroundings: bool, device: &Device) -> Self {
        let sizes = Sizes::new(width);
        let channels = sizes.levels();
        let surroundings =
            with_surroundings.then(|| Surroundings::new(SURROUNDINGS.len(), &sizes.around, device));
        let around = surroundings.as_ref().map_or(0, Surroundings::channels);
        let abstraction = (0..4).map(|i| Abstraction::new(channels[i], &sizes.down[i], device)).collect();
        let propagation = (0..4)
            .map(|i| {
                let skip = channels[i] + if i == 0 { around } else { 0 };
                Propagation::new(sizes.below(i), skip, &sizes.up[i], device)
            })
            .collect();
        Self { abstraction, surroundings, propagation, head: MlpLayer::new(sizes.finest(), features, device) }
    }

    /// Features of every point, with the points themselves as the full scan.
    ///
    /// # Shapes
    /// - `points`: `[b, n, 3]`, prepared as [`crate::preprocess`] does
    /// - output: `[b, n, features]`
    #[must_use]
    pub fn forward(&self, points: Tensor<3>) -> Tensor<3> {
        let [b, n, _] = points.dims();
        let device = points.device();
        let data = points.into_data().convert::<f32>();
        let points: &[f32] = data.as_slice().unwrap_or_default();
        let mut hierarchy = Hierarchy::new(points, b);
        if self.surroundings.is_some() {
            let scans: Vec<&[f32]> = points.chunks_exact((3 * n).max(1)).collect();
            hierarchy = hierarchy.with_surroundings(&scans);
        }
        let rows = self.forward_rows(&hierarchy, &device);
        let [_, features] = rows.dims();
        rows.reshape([b, n, features])
    }

    /// Features at every target of clouds whose neighbourhoods are known already: they do not depend on the weights
    /// and can be prepared on another thread.
    ///
    /// # Shapes
    /// output: `[targets, features]`, cloud by cloud; without targets `[b * n, features]`
    #[must_use]
    pub fn forward_rows(&self, hierarchy: &Hierarchy, device: &Device) -> Tensor<2> {
        let points_of =
            |xyz: &[f32]| Tensor::<2>::from_data(TensorData::new(xyz.to_vec(), [xyz.len() / 3, 3]), device);
        let mut levels = vec![points_of(hierarchy.points())];
        for (step, grouping) in self.abstraction.iter().zip(hierarchy.groupings()) {
            let features = step.forward(&levels[levels.len() - 1], grouping, device);
            levels.push(features);
        }
        let mut features = levels.pop();
        let targets = points_of(hierarchy.targets());
        levels[0] = match &self.surroundings {
            Some(surroundings) => {
                let [n, _] = targets.dims();
                Tensor::cat(vec![targets, surroundings.forward(hierarchy.surroundings(), n, device)], 1)
            }
            None => targets,
        };
        for (step, interpolation) in self.propagation.iter().zip(hierarchy.interpolations()).rev() {
            if let (Some(coarse), Some(skip)) = (features.take(), levels.pop()) {
                features = Some(step.forward(coarse, skip, interpolation));
            }
        }
        let [inputs, _] = self.head.linear.weight.dims();
        let nothing = || Tensor::zeros([hierarchy.targets().len() / 3, inputs], device);
        self.head.forward(features.unwrap_or_else(nothing))
    }
}

/// Row numbers on a device.
pub(crate) fn rows(indices: Vec<i64>, device: &Device) -> Tensor<1, Int> {
    let n = indices.len();
    Tensor::from_data(TensorData::new(indices, [n]), device)
}
