//! A network that cannot learn eight scenes by heart cannot learn anything: all three losses together, through the
//! whole network, to near zero.
#![cfg(feature = "train")]

use burn::optim::{AdamConfig, GradientsParams};
use burn::tensor::{Device, Distribution, Tensor, TensorData};
use nalgebra::{Rotation3, Vector3};
use rand::RngExt;
use where2act_core::{Orientation6, Primitive, Seed};
use where2act_model::losses::{
    binary_cross_entropy, geodesic_distance, kl_divergence, squared_error, weighted_mean,
};
use where2act_model::{Choice, Hierarchy, Input, LEVELS, Level, Modality, ModelConfig, Network, to_axes};

/// Eight scenes with trials that have nothing to do with what is seen: they can only be learned by heart.
struct Scenes {
    queries: Vec<(usize, usize)>,
    choice: Choice,
    orientations: Tensor<2>,
    success: Tensor<1>,
    actionability: Tensor<1>,
}

impl Scenes {
    fn random(trials: usize, places: usize, outputs: usize, device: &Device) -> Self {
        let mut rng = Seed(5).rng();
        let count = 8 * trials;
        let queries = (0..count).map(|i| (i / trials, rng.random_range(0..places))).collect();
        let outputs_of: Vec<usize> = (0..count).map(|_| rng.random_range(0..outputs)).collect();
        let orientations: Vec<f32> = (0..count)
            .flat_map(|_| {
                let axis = Vector3::new(rng.random::<f32>(), rng.random(), rng.random());
                Orientation6::from_rotation(&Rotation3::new(axis * 2.0)).0
            })
            .collect();
        let row = |v: Vec<f32>| Tensor::from_data(TensorData::new(v, [count]), device);
        Self {
            queries,
            choice: Choice::new(&outputs_of, outputs, device),
            orientations: Tensor::from_data(TensorData::new(orientations, [count, 6]), device),
            success: row((0..count).map(|_| f32::from(u8::from(rng.random::<bool>()))).collect()),
            actionability: row((0..count).map(|_| rng.random::<f32>()).collect()),
        }
    }
}

/// Trains until every loss is near zero, for at most `steps` steps, and says how many it took.
fn learn(config: &ModelConfig, input: Input<'_>, scenes: &Scenes, steps: usize, device: &Device) -> usize {
    let mut network = Network::new(config, Seed(1), device);
    let mut adam = AdamConfig::new().init();
    let mut last = Vec::new();
    for step in 0..steps {
        let features = network.features_at(input.clone(), &scenes.queries);
        let heads = &network.heads;
        let scores = heads.score.forward(features.clone(), scenes.orientations.clone());
        let score = binary_cross_entropy(scenes.choice.pick(scores), scenes.success.clone()).mean();
        let code = heads.proposal.encode(features.clone(), scenes.orientations.clone(), &scenes.choice);
        let normal = Tensor::random(code.mean.dims(), Distribution::Normal(0.0, 0.1), device);
        let raw = heads.proposal.decode(features.clone(), code.sample(normal));
        let proposed = to_axes(scenes.choice.pick_rows(raw));
        let angle = geodesic_distance(proposed, scenes.orientations.clone());
        let angle = weighted_mean(angle, scenes.success.clone());
        let kl = kl_divergence(&code).mean();
        let actionable = scenes.choice.pick(heads.actionability.forward(features));
        let actionability = squared_error(actionable, scenes.actionability.clone()).mean();
        let loss = score.clone() + angle.clone() + kl * 1e-4 + actionability.clone() * 10.0;

        last = [score, angle, actionability].map(|t| t.into_scalar::<f32>()).to_vec();
        if last[0] < 0.03 && last[1] < 0.15 && last[2] < 1e-3 {
            return step;
        }
        let gradients = GradientsParams::from_grads(loss.backward(), &network);
        network = adam.step(3e-3, network, gradients);
    }
    panic!("after {steps} steps: score, angle, actionability = {last:?}");
}

#[test]
fn eight_pictures_by_heart() {
    let device = Device::flex().autodiff();
    let config = ModelConfig::new(Modality::Rgb, &Primitive::ALL).with_width(0.125);
    let scenes = Scenes::random(8, 32 * 32, 6, &device);
    let mut rng = Seed(6).rng();
    let images: Vec<f32> = (0..8 * 3 * 32 * 32).map(|_| rng.random_range(-2.0..2.0)).collect();
    let images = Tensor::from_data(TensorData::new(images, [8, 3, 32, 32]), &device);
    let steps = learn(&config, Input::Images(images), &scenes, 400, &device);
    assert!(steps > 10, "{steps} steps are too few to be true");
}

#[test]
fn eight_scans_by_heart() {
    let device = Device::flex().autodiff();
    let config = ModelConfig::new(Modality::Cloud, &Primitive::ALL).with_points(256);
    let scenes = Scenes::random(8, 256, 6, &device);
    let mut rng = Seed(6).rng();
    let points: Vec<f32> = (0..8 * 256 * 3).map(|_| rng.random_range(-0.6..0.6)).collect();
    // A sixteenth of the published centres, and so of the work.
    let levels = LEVELS.map(|level| Level {
        centres: level.centres.div_ceil(16),
        radius: 2.0 * level.radius,
        ..level
    });
    let hierarchy = Hierarchy::with_levels(&points, 8, levels);
    let steps = learn(&config, Input::Clouds(&hierarchy), &scenes, 400, &device);
    assert!(steps > 10, "{steps} steps are too few to be true");
}
