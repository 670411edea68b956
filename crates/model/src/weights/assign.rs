//! Between a network's parameters and tensors by name.

use std::collections::{BTreeMap, BTreeSet};

use burn::module::{Module, ModuleMapper, ModuleVisitor, Param};
use burn::tensor::Tensor;

use super::names::Path;
use super::widen::widened;
use super::{StoredTensor, Tensors, WeightsError};
use crate::init::replace;
use crate::network::Network;

impl Network {
    /// All parameters and running statistics by their plain names, as PyTorch lays them out.
    #[must_use]
    pub fn tensors(&self) -> Tensors {
        let mut collect = Collect { path: Path::default(), found: BTreeMap::new() };
        // A snapshot: it includes what the last training step added to the running statistics.
        self.valid().visit(&mut collect);
        Tensors { path: Default::default(), by_name: collect.found }
    }

    /// This network with the parameters of `tensors`, which must be exactly its own.
    ///
    /// # Errors
    /// [`WeightsError::Missing`], [`WeightsError::Shape`] or [`WeightsError::Unknown`] with the first tensor that
    /// does not fit.
    pub fn with_tensors(self, tensors: &Tensors) -> Result<Self, WeightsError> {
        self.assign(tensors, |_| true)
    }

    /// This network with the parameters of another one. Blocks that it lacks stay as they are, and so does the actionability
    /// if its hidden layer has another size there. The other one's backbone may be narrower: this network then says what it
    /// says (Net2Net, Chen et al., 2016), and its further channels are as they were, but nothing heeds them yet.
    ///
    /// # Errors
    /// As [`Self::with_tensors`], but for missing tensors.
    pub fn with_tensors_of(self, other: &Self) -> Result<Self, WeightsError> {
        let mut tensors = other.tensors();
        if other.config().hidden_of_actionability() != self.config().hidden_of_actionability() {
            tensors.by_name.retain(|name, _| !name.starts_with("heads.actionability."));
        }
        if other.config().width < self.config().width {
            tensors = widened(&tensors, other.config(), &self.tensors(), self.config());
        }
        self.assign(&tensors, |_| false)
    }

    /// This network with the parameters of `tensors`; those that are not `needed` may be missing and stay.
    pub(crate) fn assign(
        self,
        tensors: &Tensors,
        needed: impl Fn(&str) -> bool,
    ) -> Result<Self, WeightsError> {
        let mut assign =
            Assign { path: Path::default(), tensors, needed, used: BTreeSet::new(), error: None };
        // burn shares running statistics between clones, and keeps their last update apart: load into a snapshot.
        let trains = self.device().is_autodiff();
        let network = self.valid().map(&mut assign);
        if let Some(error) = assign.error {
            return Err(error);
        }
        for (name, tensor) in &tensors.by_name {
            if !assign.used.contains(name) {
                let (path, found) = (tensors.path.clone(), tensor.shape.clone());
                return Err(WeightsError::Unknown { path, name: name.clone(), found });
            }
        }
        Ok(if trains { network.train() } else { network })
    }
}

struct Collect {
    path: Path,
    found: BTreeMap<String, StoredTensor>,
}

impl ModuleVisitor for Collect {
    fn enter_module(&mut self, name: &str, container: &str) {
        self.path.enter(name, container);
    }

    fn exit_module(&mut self, _: &str, _: &str) {
        self.path.leave();
    }

    fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
        let data = param.val().into_data().convert::<f32>();
        let mut shape = param.lazy_shape().to_vec();
        let mut values = data.try_to_vec::<f32>().unwrap_or_default();
        if self.path.is_transposed() {
            values = transposed(&values, [shape[0], shape[1]]);
            shape.reverse();
        }
        self.found.insert(self.path.name(), StoredTensor { shape, values });
    }
}

struct Assign<'a, F> {
    path: Path,
    tensors: &'a Tensors,
    needed: F,
    used: BTreeSet<String>,
    error: Option<WeightsError>,
}

impl<F: Fn(&str) -> bool> ModuleMapper for Assign<'_, F> {
    fn enter_module(&mut self, name: &str, container: &str) {
        self.path.enter(name, container);
    }

    fn exit_module(&mut self, _: &str, _: &str) {
        self.path.leave();
    }

    fn map_float<const D: usize>(&mut self, param: Param<Tensor<D>>) -> Param<Tensor<D>> {
        if self.error.is_some() {
            return param;
        }
        let name = self.path.name();
        let mut expected = param.lazy_shape().to_vec();
        if self.path.is_transposed() {
            expected.reverse();
        }
        let path = self.tensors.path.clone();
        match self.tensors.by_name.get(&name) {
            None if (self.needed)(&name) => self.error = Some(WeightsError::Missing { path, name, expected }),
            None => {}
            Some(tensor) if tensor.shape != expected => {
                self.error = Some(WeightsError::Shape { path, name, expected, found: tensor.shape.clone() });
            }
            Some(tensor) => {
                self.used.insert(name);
                let values = match self.path.is_transposed() {
                    true => transposed(&tensor.values, [expected[0], expected[1]]),
                    false => tensor.values.clone(),
                };
                return param.map(|old| replace(&old, values));
            }
        }
        param
    }
}

/// `[rows, columns]` -> `[columns, rows]`
fn transposed(values: &[f32], [rows, columns]: [usize; 2]) -> Vec<f32> {
    (0..rows * columns).map(|i| values[(i % rows) * columns + i / rows]).collect()
}
