//! Folders survive the disk; whatever is wrong with one is named.

use std::fs;

use burn::tensor::{Device, Tensor};
use where2act_core::{Primitive, Seed};

use super::*;
use crate::config::{Modality, ModelConfig};
use crate::heads::HAND_VIEWS;
use crate::network::{Input, Network};
use crate::pointnet::Grouping;

fn small() -> ModelConfig {
    ModelConfig::new(Modality::Rgb, &Primitive::ALL[..2]).with_width(0.0625)
}

fn network(seed: u64) -> Network {
    Network::new(&small(), Seed(seed), &Device::flex())
}

#[test]
fn a_folder_survives_the_disk_in_both_precisions() {
    let folder = tempfile::tempdir().unwrap();
    let original = network(1);
    for precision in [Precision::F32, Precision::F16] {
        let sha256 = save_weights(folder.path(), &original, "# card\n", precision).unwrap();
        verify_weights(folder.path()).unwrap();
        let loaded = Weights::load(folder.path(), &Device::flex()).unwrap();
        assert_eq!(loaded.sha256, sha256);
        assert_eq!(loaded.network.config(), original.config());
        let (a, b) = (original.tensors(), loaded.network.tensors());
        assert_eq!(a.by_name.keys().collect::<Vec<_>>(), b.by_name.keys().collect::<Vec<_>>());
        for (name, a) in &a.by_name {
            let b = &b.by_name[name];
            assert_eq!(a.shape, b.shape);
            match precision {
                Precision::F32 => assert_eq!(a.values, b.values, "{name}"),
                Precision::F16 => {
                    let near = |(a, b): (&f32, &f32)| (a - b).abs() <= 5e-4 * a.abs() + 1e-7;
                    assert!(a.values.iter().zip(&b.values).all(near), "{name}");
                }
            }
        }
    }
}

/// Running statistics and all else that are not what they were drawn as.
fn trained(config: &ModelConfig) -> Network {
    let network = Network::new(config, Seed(1), &Device::flex());
    let mut tensors = network.tensors();
    for (n, tensor) in tensors.by_name.values_mut().enumerate() {
        for (i, x) in tensor.values.iter_mut().enumerate() {
            *x += 0.05 * (1.0 + ((i + n) as f32).sin());
        }
    }
    network.with_tensors(&tensors).unwrap()
}

#[test]
fn a_wider_network_says_what_the_narrower_one_says() {
    let device = Device::flex();
    let random = |shape: [usize; 3]| {
        let values = (0..shape.iter().product()).map(|i: usize| (i as f32 * 1.7).sin()).collect::<Vec<_>>();
        Tensor::<3>::from_data(burn::tensor::TensorData::new(values, shape), &device)
    };
    let near = |a: Tensor<3>, b: Tensor<3>| {
        let [a, b] = [a, b].map(|x| x.into_data().try_to_vec::<f32>().unwrap());
        let scale = a.iter().fold(0.0f32, |max, x| max.max(x.abs()));
        assert!(scale > 1e-3);
        assert!(a.iter().zip(&b).all(|(a, b)| (a - b).abs() < 1e-4 * scale));
    };
    let of_scans = |surroundings| ModelConfig {
        surroundings,
        second_look: true,
        alignments: 3,
        ..ModelConfig::new(Modality::Cloud, &Primitive::ALL[..2]).with_width(0.25)
    };
    for config in [small(), of_scans(false), of_scans(true)] {
        let narrow = trained(&config);
        let wider = config.clone().with_width(1.5 * config.width);
        let fresh = Network::new(&wider, Seed(2), &device);
        let wide = fresh.clone().with_tensors_of(&narrow).unwrap();
        match config.modality {
            Modality::Rgb => {
                let pictures = random([3, 64, 64]).reshape([1, 3, 64, 64]);
                near(narrow.features_rgb(pictures.clone()), wide.features_rgb(pictures));
            }
            Modality::Cloud => {
                let points = random([2, 300, 3]) * 0.3;
                near(narrow.features_cloud(points.clone()), wide.features_cloud(points));
                let around = HAND_VIEWS.map(|view| Grouping {
                    rows: (0..2 * view.points as i64).collect(),
                    offsets: (0..6 * view.points).map(|i| 0.05 * (i as f32).cos()).collect(),
                    neighbours: view.points,
                });
                let [narrow, wide] = [&narrow, &wide].map(|network| {
                    let look = network.heads.second_look.as_ref().unwrap();
                    let [features, hands] =
                        [config.features, 6 + config.alignments].map(|n| random([1, 2, n]).squeeze());
                    look.forward(features, hands, &around).unsqueeze()
                });
                near(narrow, wide);
            }
        }
        // New channels are as they were drawn: neither zeros nor copies.
        let (drawn, wide) = (fresh.tensors(), wide.tensors());
        for (name, tensor) in narrow.tensors().by_name {
            let (drawn, wide) = (&drawn.by_name[&name], &wide.by_name[&name]);
            assert_eq!(drawn.shape, wide.shape);
            let row = wide.values.len() / wide.shape[0];
            let new = tensor.shape[0] * row..;
            assert_eq!(drawn.values[new.clone()], wide.values[new], "{name}");
        }
        assert!(matches!(narrow.with_tensors_of(&fresh), Err(WeightsError::Shape { .. })));
    }
}

#[test]
fn names_are_plain_and_weights_depend_on_the_seed_alone() {
    let tensors = network(1).tensors();
    for (name, shape) in [
        ("backbone.encoder.conv1.weight", vec![4, 3, 7, 7]),
        ("backbone.encoder.layer2.0.downsample.0.weight", vec![8, 4, 1, 1]),
        ("backbone.encoder.layer2.0.downsample.1.running_var", vec![8]),
        ("backbone.decoder.blocks.4.bn2.bias", vec![4]),
        ("heads.score.mlp1.weight", vec![128, 134]),
        ("heads.proposal.decoder.mlp2.weight", vec![12, 128]),
        ("heads.proposal.encoder.log_variance.bias", vec![20]),
    ] {
        assert_eq!(tensors.by_name[name].shape, shape, "{name}");
    }
    assert_eq!(tensors, network(1).tensors());
    assert_ne!(tensors, network(2).tensors());
}

#[test]
fn what_training_adds_to_running_statistics_is_saved_and_loading_leaves_clones_alone() {
    let device = Device::flex().autodiff();
    let network = Network::new(&small(), Seed(1), &device);
    let fresh = network.tensors();
    let images = Tensor::ones([2, 3, 32, 32], &device);
    let _ = network.features_at(Input::Images(images), &[(0, 0)]);
    let name = "backbone.encoder.bn1.running_mean";
    let trained = network.tensors();
    let learned = |tensors: &Tensors| tensors.by_name[name].values.iter().any(|x| *x != 0.0);
    assert!(!learned(&fresh) && learned(&trained));

    let back = network.clone().with_tensors(&fresh).unwrap();
    assert_eq!(back.tensors(), fresh);
    assert_eq!(network.tensors(), trained);
    assert!(back.device().is_autodiff() && back.heads.score.mlp2.weight.is_require_grad());
}

/// What loading says after `damage` was done to `model.safetensors`.
fn after(damage: impl Fn(&mut Tensors)) -> String {
    let folder = tempfile::tempdir().unwrap();
    save_weights(folder.path(), &network(1), "", Precision::F32).unwrap();
    let path = folder.path().join(WEIGHTS_FILE);
    let mut tensors = Tensors::read(&path).unwrap();
    damage(&mut tensors);
    tensors.write(&path, Precision::F32).unwrap();
    Weights::load(folder.path(), &Device::flex()).unwrap_err().to_string()
}

#[test]
fn wrong_tensors_are_named() {
    let name = "heads.score.mlp1.weight";
    let missing = after(|t| drop(t.by_name.remove(name)));
    assert!(
        missing.contains("tensor heads.score.mlp1.weight is missing, expected shape [128, 134]"),
        "{missing}"
    );
    let shape = after(|t| {
        let tensor = t.by_name.get_mut(name).unwrap();
        tensor.shape = vec![134, 128];
    });
    assert!(shape.contains("heads.score.mlp1.weight has shape [134, 128], expected [128, 134]"), "{shape}");
    let foreign = after(|t| {
        let tensor = t.by_name[name].clone();
        t.by_name.insert("classifier.weight".to_owned(), tensor);
    });
    assert!(
        foreign.contains("tensor classifier.weight of shape [128, 134] belongs to another network"),
        "{foreign}"
    );
    let other = after(|t| t.by_name.get_mut(name).unwrap().values[0] += 1.0);
    assert!(other.contains("SHA-256"), "{other}");
}

#[test]
fn damaged_files_are_named() {
    let folder = tempfile::tempdir().unwrap();
    save_weights(folder.path(), &network(1), "", Precision::F16).unwrap();
    let path = folder.path().join(WEIGHTS_FILE);
    let whole = fs::read(&path).unwrap();
    let load = || Weights::load(folder.path(), &Device::flex()).unwrap_err().to_string();
    for length in [0, 4, 100, whole.len() / 2, whole.len() - 1] {
        fs::write(&path, &whole[..length]).unwrap();
        let error = load();
        assert!(error.contains(WEIGHTS_FILE) && error.contains("no complete safetensors file"), "{error}");
    }
    fs::write(&path, b"{\"hello\": 1, \"this\": \"is no file of tensors\"}").unwrap();
    assert!(load().contains("no complete safetensors file"));
    fs::write(&path, &whole).unwrap();
    fs::write(folder.path().join(CARD_FILE), "changed").unwrap();
    assert!(verify_weights(folder.path()).unwrap_err().to_string().contains(CARD_FILE));
    fs::write(folder.path().join(SUMS_FILE), "nonsense").unwrap();
    assert!(load().contains("nonsense"));
    fs::remove_file(folder.path().join(SUMS_FILE)).unwrap();
    assert!(load().contains(SUMS_FILE));
}

#[test]
fn numbers_that_do_not_fit_are_not_stored() {
    let mut tensors = network(1).tensors();
    let name = "backbone.encoder.bn1.running_var";
    tensors.by_name.get_mut(name).unwrap().values[0] = 1e5;
    let error = tensors.to_bytes(Precision::F16).unwrap_err().to_string();
    assert!(error.contains(name), "{error}");
    assert!(tensors.to_bytes(Precision::F32).is_ok());
    tensors.by_name.get_mut(name).unwrap().values[0] = f32::NAN;
    assert!(tensors.to_bytes(Precision::F32).is_err());
}

#[cfg(feature = "import")]
#[test]
fn imports_say_what_does_not_fit() {
    use crate::testing::fixture;
    let device = Device::flex();
    let published = fixture("where2act_3d/weights.safetensors");
    let cloud = |primitives| Network::new(&ModelConfig::new(Modality::Cloud, primitives), Seed(1), &device);
    let error = cloud(&Primitive::ALL).with_published(&published).unwrap_err().to_string();
    assert!(
        error.contains("heads.actionability.mlp2.weight has shape [1, 128], expected [6, 128]"),
        "{error}"
    );
    let error = network(1).with_published(&published).unwrap_err().to_string();
    assert!(error.contains("for clouds only"), "{error}");
    let error = network(1).with_resnet18(&published).unwrap_err().to_string();
    assert!(error.contains("backbone.encoder.conv1.weight is missing"), "{error}");
    let error = network(1).with_resnet18(&fixture("unet/resnet18.pth")).unwrap_err().to_string();
    assert!(error.contains("conv1.weight has shape [8, 3, 7, 7], expected [4, 3, 7, 7]"), "{error}");
}
