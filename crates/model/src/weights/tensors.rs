//! Tensors by name, in and out of safetensors.

use std::collections::{BTreeMap, HashMap};
use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};

use half::{bf16, f16};
use safetensors::tensor::{Dtype, SafeTensors, TensorView};
use where2act_core::write_whole;

use super::WeightsError;

/// Numbers of one parameter, as PyTorch lays them out.
#[derive(Clone, Debug, PartialEq)]
pub struct StoredTensor {
    /// Extents, outermost first.
    pub shape: Vec<usize>,
    /// Row-major.
    pub values: Vec<f32>,
}

/// Parameters by name.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Tensors {
    /// The file they come from, for errors; empty if from memory.
    pub path: PathBuf,
    /// In the order of their names.
    pub by_name: BTreeMap<String, StoredTensor>,
}

/// How weights are stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Precision {
    /// 16 bits: half the size; relative rounding of 5e-4.
    F16,
    /// 32 bits: exact.
    F32,
}

impl Tensors {
    /// Reads a safetensors file; with feature `import` also PyTorch's own format, told apart by their first bytes.
    ///
    /// # Errors
    /// [`WeightsError::Io`], [`WeightsError::Format`], [`WeightsError::NotFinite`].
    pub fn read(path: &Path) -> Result<Self, WeightsError> {
        let bytes = fs::read(path).map_err(|source| WeightsError::Io { path: path.to_owned(), source })?;
        #[cfg(feature = "import")]
        if super::import::is_pytorch(&bytes) {
            return super::import::read_pytorch(path);
        }
        Self::from_bytes(path, &bytes)
    }

    /// Reads the bytes of a safetensors file; `path` is for errors.
    ///
    /// # Errors
    /// As [`Self::read`].
    pub fn from_bytes(path: &Path, bytes: &[u8]) -> Result<Self, WeightsError> {
        let format = |why: String| WeightsError::Format { path: path.to_owned(), why };
        let file = SafeTensors::deserialize(bytes)
            .map_err(|e| format(format!("no complete safetensors file ({} bytes): {e}", bytes.len())))?;
        let mut all = Self { path: path.to_owned(), by_name: BTreeMap::new() };
        for (name, view) in file.tensors() {
            let data = view.data();
            let values = match view.dtype() {
                Dtype::F32 => {
                    data.chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect()
                }
                Dtype::F16 => {
                    data.chunks_exact(2).map(|b| f16::from_le_bytes([b[0], b[1]]).to_f32()).collect()
                }
                Dtype::BF16 => {
                    data.chunks_exact(2).map(|b| bf16::from_le_bytes([b[0], b[1]]).to_f32()).collect()
                }
                // PyTorch counts batches in integers; nothing here needs them.
                Dtype::I64 if name.ends_with("num_batches_tracked") => continue,
                other => {
                    return Err(format(format!(
                        "tensor {name} has type {other:?}, expected F32, F16 or BF16"
                    )));
                }
            };
            all.insert(name, StoredTensor { shape: view.shape().to_vec(), values })?;
        }
        Ok(all)
    }

    pub(super) fn insert(&mut self, name: String, tensor: StoredTensor) -> Result<(), WeightsError> {
        if tensor.values.iter().any(|x| !x.is_finite()) {
            return Err(WeightsError::NotFinite { path: self.path.clone(), name });
        }
        self.by_name.insert(name, tensor);
        Ok(())
    }

    /// The bytes of a safetensors file.
    ///
    /// # Errors
    /// [`WeightsError::NotFinite`] if a number has no counterpart in this precision.
    pub fn to_bytes(&self, precision: Precision) -> Result<Vec<u8>, WeightsError> {
        let not_finite =
            |name: &str| WeightsError::NotFinite { path: self.path.clone(), name: name.to_owned() };
        let mut raw = Vec::with_capacity(self.by_name.len());
        for (name, tensor) in &self.by_name {
            let bytes: Vec<u8> = match precision {
                Precision::F32 => tensor.values.iter().flat_map(|x| x.to_le_bytes()).collect(),
                Precision::F16 => {
                    tensor.values.iter().flat_map(|x| f16::from_f32(*x).to_le_bytes()).collect()
                }
            };
            let fits = |x: &f32| match precision {
                Precision::F32 => x.is_finite(),
                Precision::F16 => f16::from_f32(*x).is_finite(),
            };
            if !tensor.values.iter().all(fits) {
                return Err(not_finite(name));
            }
            raw.push((name, &tensor.shape, bytes));
        }
        let dtype = match precision {
            Precision::F32 => Dtype::F32,
            Precision::F16 => Dtype::F16,
        };
        let format = |e: safetensors::SafeTensorError| WeightsError::Format {
            path: self.path.clone(),
            why: e.to_string(),
        };
        let views = raw
            .iter()
            .map(|(name, shape, bytes)| {
                Ok((name, TensorView::new(dtype, shape.to_vec(), bytes).map_err(format)?))
            })
            .collect::<Result<Vec<_>, WeightsError>>()?;
        let metadata = HashMap::from([("format".to_owned(), "pt".to_owned())]);
        safetensors::serialize(views, Some(metadata)).map_err(format)
    }

    /// Writes a safetensors file, whole or not at all.
    ///
    /// # Errors
    /// [`WeightsError::Io`], [`WeightsError::NotFinite`].
    pub fn write(&self, path: &Path, precision: Precision) -> Result<(), WeightsError> {
        let bytes = self.to_bytes(precision)?;
        write_whole(path, |w| w.write_all(&bytes))
            .map_err(|source| WeightsError::Io { path: path.to_owned(), source })
    }
}
