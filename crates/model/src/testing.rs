//! What tests of several modules share.

use std::collections::BTreeMap;
use std::path::PathBuf;

use burn::module::{Module, ModuleVisitor, Param};
use burn::optim::GradientsParams;
use burn::tensor::{Device, Tensor, TensorData};

use crate::weights::Tensors;
use crate::weights::names::Path;

/// A file under `tests/fixtures` of the repository.
pub(crate) fn fixture(name: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../tests/fixtures").join(name)
}

pub(crate) fn tensor<const D: usize>(file: &Tensors, name: &str, device: &Device) -> Tensor<D> {
    let stored = &file.by_name[name];
    Tensor::from_data(TensorData::new(stored.values.clone(), stored.shape.clone()), device)
}

pub(crate) fn values<const D: usize>(tensor: Tensor<D>) -> Vec<f32> {
    tensor.into_data().try_to_vec::<f32>().unwrap()
}

/// The largest difference between two lists of equal length.
pub(crate) fn furthest(a: &[f32], b: &[f32]) -> f32 {
    assert_eq!(a.len(), b.len());
    let difference =
        |(a, b): (&f32, &f32)| if a.is_finite() && b.is_finite() { (a - b).abs() } else { f32::INFINITY };
    a.iter().zip(b).map(difference).fold(0.0, f32::max)
}

/// Gradients by the plain names of their parameters, in burn's layout.
pub(crate) fn named_gradients(
    module: &impl Module,
    gradients: &GradientsParams,
) -> BTreeMap<String, Vec<f32>> {
    struct Visitor<'a> {
        path: Path,
        gradients: &'a GradientsParams,
        found: BTreeMap<String, Vec<f32>>,
    }
    impl ModuleVisitor for Visitor<'_> {
        fn enter_module(&mut self, name: &str, container: &str) {
            self.path.enter(name, container);
        }

        fn exit_module(&mut self, _: &str, _: &str) {
            self.path.leave();
        }

        fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
            if let Some(gradient) = self.gradients.get::<D>(param.id) {
                self.found.insert(self.path.name(), values(gradient));
            }
        }
    }
    let mut visitor = Visitor { path: Path::default(), gradients, found: BTreeMap::new() };
    module.visit(&mut visitor);
    visitor.found
}

/// The backends this build has.
#[cfg_attr(feature = "ndarray", expect(deprecated, reason = "selectable until burn drops it"))]
pub(crate) fn devices() -> Vec<Device> {
    vec![
        Device::flex(),
        #[cfg(feature = "ndarray")]
        Device::ndarray(),
    ]
}
