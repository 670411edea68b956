//! One predictor, whoever asks and whatever computes.

use where2act_core::{Observation, Prediction, Primitive, Seed};
use where2act_infer::{Backend, Options};
use where2act_kernels::Isa;
use where2act_model::Modality;

use crate::{ball, picture, predictor, predictor_on, untimed};

#[test]
fn eight_threads_share_one_predictor_and_agree() {
    fn shareable<T: Send + Sync>(_: &T) {}
    for (modality, observation) in [
        (Modality::Rgb, picture(200, 150)),
        (Modality::Cloud, Observation::Cloud { points: ball(5000, 0.5, 2.0) }),
    ] {
        let predictor = predictor(modality);
        shareable(&predictor);
        let options = Options::default();
        let expected = untimed(predictor.predict(&observation, &options).unwrap());
        let answers: Vec<Prediction> = std::thread::scope(|scope| {
            let threads: Vec<_> = (0..8)
                .map(|_| scope.spawn(|| untimed(predictor.predict(&observation, &options).unwrap())))
                .collect();
            threads.into_iter().map(|t| t.join().unwrap()).collect()
        });
        assert!(answers.iter().all(|a| *a == expected));
        let batch =
            predictor.predict_batch(&[observation.clone(), picture(0, 0), observation.clone()], &options);
        assert_eq!(untimed(batch[0].as_ref().unwrap().clone()), expected);
        assert!(batch[1].is_err());
        assert_eq!(untimed(batch[2].as_ref().unwrap().clone()), expected);
        for threads in [1, 3] {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            assert_eq!(
                untimed(pool.install(|| predictor.predict(&observation, &options)).unwrap()),
                expected
            );
        }
    }
}

/// Threads that ask different things must not see each other's buffers.
#[test]
fn eight_threads_with_different_inputs_get_their_own_answers() {
    for modality in [Modality::Rgb, Modality::Cloud] {
        let predictor = predictor(modality);
        let observations: Vec<Observation> = (0..8)
            .map(|i| match modality {
                Modality::Rgb => picture(100 + 31 * i, 230 - 17 * i),
                Modality::Cloud => {
                    Observation::Cloud { points: ball(1500 + 700 * i, 0.3 + 0.05 * i as f32, 2.0) }
                }
            })
            .collect();
        let options = |i: usize| Options { seed: Seed(i as u64), ..Options::default() };
        let answer = |i: usize| untimed(predictor.predict(&observations[i], &options(i)).unwrap());
        let expected: Vec<Prediction> = (0..8).map(answer).collect();
        assert!((1..8).all(|i| expected[i].primitives != expected[0].primitives));
        std::thread::scope(|scope| {
            for i in 0..8 {
                let (answer, expected) = (&answer, &expected);
                // Every thread begins with another input, so that the threads never go in step.
                scope.spawn(move || {
                    for j in (0..8).map(|j| (i + j) % 8) {
                        assert!(answer(j) == expected[j], "thread {i}, input {j}");
                    }
                });
            }
        });
    }
}

#[test]
fn the_engine_and_burn_agree() {
    let observation = picture(200, 150);
    let maps = |backend| {
        let predictor = predictor_on(Modality::Rgb, backend);
        predictor.predict_dense(&observation, &Options::default()).unwrap().maps.dense(Primitive::Pulling)
    };
    let (fast, burn) = (maps(Backend::Fast), maps(Backend::Flex));
    let apart = |other: &[f32]| {
        assert_eq!(fast.len(), other.len());
        let apart = fast.iter().zip(other).map(|(a, b)| (a - b).abs());
        // `max` alone would pass over what is no number.
        apart.fold(0.0f32, |most, d| if d.is_nan() { f32::INFINITY } else { most.max(d) })
    };
    assert!(apart(&burn) < 1e-4, "{}", apart(&burn));
    if Isa::bf16().is_some() {
        let near = apart(&maps(Backend::Bf16));
        assert!(near > 1e-5 && near < 2e-2, "{near}");
    }
}

/// What is built in is what lies in `weights/`, and it answers as if it had been loaded from there.
#[cfg(feature = "bundled-weights")]
#[test]
fn bundled_weights_are_those_of_the_workspace() {
    use where2act_infer::Predictor;

    let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../weights");
    for (name, modality, observation) in [
        ("rgb", Modality::Rgb, picture(200, 150)),
        ("cloud", Modality::Cloud, Observation::Cloud { points: ball(5000, 0.5, 2.0) }),
    ] {
        let bundled = Predictor::bundled(modality, Backend::default()).unwrap();
        let loaded = Predictor::load(&folder.join(name)).unwrap();
        assert_eq!(bundled.model(), loaded.model());
        let answer = |p: &Predictor| untimed(p.predict(&observation, &Options::default()).unwrap());
        assert_eq!(answer(&bundled), answer(&loaded));
    }
}
