//! Rotations, and the halves that heads are split into.

use burn::optim::GradientsParams;
use burn::tensor::{Device, Distribution, Tensor, TensorData};
use nalgebra::{Matrix3, Point3, Vector3};
use proptest::prelude::*;
use where2act_core::{Grasp, Orientation6, Primitive, Seed, orthonormal_frame};

use super::{Choice, rotation_matrix, to_axes};
use crate::config::{Modality, ModelConfig};
use crate::network::Network;
use crate::testing::{devices, furthest, named_gradients, values};

fn rows(raw: &[[f32; 6]], device: &Device) -> Tensor<2> {
    Tensor::from_data(TensorData::new(raw.concat(), [raw.len(), 6]), device)
}

fn any_direction() -> impl Strategy<Value = [f32; 3]> {
    let finite = proptest::num::f32::POSITIVE
        | proptest::num::f32::NEGATIVE
        | proptest::num::f32::NORMAL
        | proptest::num::f32::SUBNORMAL
        | proptest::num::f32::ZERO;
    prop_oneof![
        prop::array::uniform3(-2.0f32..2.0),
        prop::array::uniform3(finite),
        Just([0.0; 3]),
        Just([0.0, 0.0, -3.0]),
        (0.0f32..3e-6).prop_map(|x| [x, 0.0, 0.0]),
    ]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn any_six_numbers_are_a_rotation_with_finite_gradients(
        a in any_direction(), f in any_direction(), s in -2.0f32..2.0,
    ) {
        let parallel = a.map(|x| if (x * s).is_finite() { x * s } else { x });
        for (approach, forward) in [(a, f), (a, parallel), (a, a), (f, [0.0; 3])] {
            let device = Device::flex().autodiff();
            let raw: [f32; 6] = [approach, forward].concat().try_into().unwrap();
            let raw = rows(&[raw], &device).require_grad();
            let axes = to_axes(raw.clone());
            let m = values(rotation_matrix(axes.clone()));
            let m = Matrix3::from_row_slice(&m);
            prop_assert!((m.transpose() * m - Matrix3::identity()).amax() < 1e-5, "{m}");
            prop_assert!((m.determinant() - 1.0).abs() < 1e-5);
            // The same frame as the scalar code, wherever that is not decided by rounding.
            let (z, x) = (Vector3::from(approach), Vector3::from(forward));
            let across = z.try_normalize(1e-3).zip(x.try_normalize(1e-3)).map_or(0.0, |(z, x)| z.cross(&x).norm());
            if across > 0.1 {
                let expected = orthonormal_frame(z, x);
                prop_assert!((m - expected.matrix()).amax() < 1e-4, "{m} {expected}");
            }
            let weights = rows(&[[0.3, -1.0, 0.5, 2.0, 0.1, -0.7]], &device);
            let gradients = (axes * weights).sum().backward();
            let gradient = values(raw.grad(&gradients).unwrap());
            prop_assert!(gradient.iter().all(|g| g.is_finite()), "{gradient:?}");
        }
    }
}

#[test]
fn rotations_of_both_backends_and_of_the_core_are_the_same() {
    let raw = [
        [0.1, 0.2, 0.3, 0.5, -0.2, 0.9],
        [0.0; 6],
        [1.0, 0.0, 0.0, 2.0, 0.0, 0.0],
        [0.0, 0.0, -5.0, 0.0, 0.0, 0.0],
        [0.0, 0.0, 0.0, 0.0, 1.0, 0.0],
    ];
    for device in devices() {
        let axes = values(to_axes(rows(&raw, &device)));
        for (raw, axes) in raw.iter().zip(axes.chunks_exact(6)) {
            let expected = Orientation6::from_rotation(&Orientation6(*raw).to_rotation());
            assert!(furthest(axes, &expected.0) < 1e-5, "{raw:?}: {axes:?}, {expected:?}");
        }
    }
}

#[test]
fn halves_make_the_whole_and_each_primitive_has_its_own_output() {
    let device = Device::flex();
    let mut config = ModelConfig::new(Modality::Cloud, &Primitive::ALL);
    config.alignments = 3;
    let heads = Network::new(&config, Seed(3), &device).heads;
    let random = |shape: [usize; 2]| Tensor::<2>::random(shape, Distribution::Normal(0.0, 1.0), &device);
    let (features, orientations, z) = (random([5, 128]), to_axes(random([5, 6])), random([5, 10]));

    let whole = heads.score.forward(features.clone(), orientations.clone());
    assert_eq!(whole.dims(), [5, 6]);
    // Each feature with all orientations at once.
    let feature = heads.score.feature_half(features.clone()).reshape([5, 1, 128]);
    let all = orientations.clone().unsqueeze_dim::<3>(0).expand([5, 5, 6]);
    let hands = heads.score.hand_half(heads.score.hands(features.clone(), all)).reshape([5, 5, 128]);
    let every = heads.score.from_halves(feature + hands);
    let diagonal: Vec<f32> = values(every).chunks_exact(6).step_by(6).flatten().copied().collect();
    assert!(furthest(&diagonal, &values(whole.clone())) < 1e-5);

    let positions = [0, 5, 3, 3, 1];
    let choice = Choice::new(&positions, 6, &device);
    let all = values(whole.clone());
    let picked: Vec<f32> = positions.iter().enumerate().map(|(i, p)| all[6 * i + p]).collect();
    assert_eq!(values(choice.pick(whole)), picked);
    let proposals = heads.proposal.decode(features.clone(), z);
    assert_eq!(proposals.dims(), [5, 6, 6]);
    let all = values(proposals.clone());
    let picked: Vec<f32> =
        positions.iter().enumerate().flat_map(|(i, p)| all[36 * i + 6 * p..][..6].to_vec()).collect();
    assert_eq!(values(choice.pick_rows(proposals)), picked);
    assert_eq!(heads.proposal.encode(features.clone(), orientations, &choice).mean.dims(), [5, 10]);
    assert_eq!(heads.actionability.forward(features).dims(), [5, 6]);
}

#[test]
fn a_hand_gains_where_its_point_can_go() {
    let mut config = ModelConfig::new(Modality::Cloud, &Primitive::ALL);
    config.ways = Some(3.0);
    for device in devices() {
        let heads = Network::new(&config, Seed(3), &device).heads;
        let motion = heads.motion.clone().unwrap();
        let random = |shape: [usize; 2]| Tensor::<2>::random(shape, Distribution::Normal(0.0, 1.0), &device);
        let (features, axes) = (random([2, 128]), to_axes(random([6, 6])));
        let ways: Vec<Vector3<f32>> = values(motion.ways(features.clone()))
            .as_chunks::<3>()
            .0
            .iter()
            .map(|way| Vector3::from(*way))
            .collect();
        let hands = axes.clone().reshape([2, 3, 6]);
        let gained = values(motion.gain(features.clone(), hands.clone()));
        let mut expected = Vec::new();
        for (hand, axes) in values(axes).as_chunks::<6>().0.iter().enumerate() {
            let grasp = Grasp { point: Point3::origin(), rotation: Orientation6(*axes).to_rotation() };
            for primitive in Primitive::ALL {
                let wanted = primitive.intended_direction(&grasp);
                let reach =
                    ways[hand / 3 * 2..][..2].iter().map(|way| way.dot(&wanted)).fold(f32::MIN, f32::max);
                expected.push(3.0 * (reach - 0.5));
            }
        }
        assert!(furthest(&gained, &expected) < 1e-4, "{gained:?}, {expected:?}");
        let logits = Tensor::<2>::ones([6, 6], &device);
        let sum = values(heads.with_ways(logits, features, hands));
        expected.iter_mut().for_each(|gain| *gain += 1.0);
        assert!(furthest(&sum, &expected) < 1e-4);
    }
}

#[test]
fn only_the_chosen_output_learns() {
    let device = Device::flex().autodiff();
    let config = ModelConfig::new(Modality::Cloud, &Primitive::ALL[..3]);
    let head = Network::new(&config, Seed(3), &device).heads.actionability;
    let features = Tensor::<2>::ones([2, 128], &device);
    let loss = Choice::new(&[1, 1], 3, &device).pick(head.forward(features)).sum();
    let gradients = named_gradients(&head, &GradientsParams::from_grads(loss.backward(), &head));
    assert_eq!(gradients["mlp2.bias"], [0.0, 2.0, 0.0]);
}
