//! Weights under the names of others: the published PyTorch checkpoints of the network for scans, and torchvision's
//! ResNet-18.

use std::fs;
use std::path::Path;

use burn::store::pytorch_reader::{DType, PytorchReader};
use half::{bf16, f16};

use super::{StoredTensor, Tensors, WeightsError};
use crate::network::{Backbone, Network};

/// Where the file keeps its parameters, if not at the top.
const TOP_LEVEL_KEYS: [&str; 3] = ["state_dict", "model_state_dict", "model"];

/// Whether these are the first bytes of something that `torch.save` wrote: a zip archive, or a pickle of old. A safetensors file,
/// whose header's length may look like a pickle, begins its header behind it.
pub(super) fn is_pytorch(bytes: &[u8]) -> bool {
    let pickled = bytes.starts_with(&[0x80, 0x02]) && bytes.get(8) != Some(&b'{');
    bytes.starts_with(b"PK\x03\x04") || pickled
}

/// Reads PyTorch's own format. Nothing in the file is executed.
pub(super) fn read_pytorch(path: &Path) -> Result<Tensors, WeightsError> {
    let format = |why: String| WeightsError::Format { path: path.to_owned(), why };
    let reader = PytorchReader::new(path).map_err(|e| format(format!("no readable PyTorch file: {e}")))?;
    let length =
        fs::metadata(path).map_err(|source| WeightsError::Io { path: path.to_owned(), source })?.len();
    let mut all = Tensors { path: path.to_owned(), ..Tensors::default() };
    for (name, tensor) in reader.tensors() {
        if name.ends_with("num_batches_tracked") {
            continue;
        }
        // A view may repeat a number without end.
        if tensor.byte_len() as u64 > length {
            let (found, shape) = (tensor.byte_len(), tensor.shape());
            return Err(format(format!(
                "tensor {name} {shape:?} takes {found} bytes, the whole file has {length}"
            )));
        }
        let bytes = tensor.read().map_err(|e| format(e.to_string()))?;
        let values = match tensor.dtype() {
            DType::F32 => {
                bytes.chunks_exact(4).map(|b| f32::from_ne_bytes([b[0], b[1], b[2], b[3]])).collect()
            }
            DType::F16 => bytes.chunks_exact(2).map(|b| f16::from_ne_bytes([b[0], b[1]]).to_f32()).collect(),
            DType::BF16 => {
                bytes.chunks_exact(2).map(|b| bf16::from_ne_bytes([b[0], b[1]]).to_f32()).collect()
            }
            other => {
                return Err(format(format!("tensor {name} has type {other:?}, expected F32, F16 or BF16")));
            }
        };
        let prefixed = TOP_LEVEL_KEYS.iter().find_map(|key| name.strip_prefix(key)?.strip_prefix('.'));
        let name = prefixed.unwrap_or(name).to_owned();
        all.insert(name, StoredTensor { shape: tensor.shape().to_vec(), values })?;
    }
    Ok(all)
}

impl Network {
    /// This network with the parameters of a published checkpoint for scans (`pointnet2.SA_modules...`, `critic`,
    /// `actor`, `action_score`), as safetensors or PyTorch's own format. The proposals' encoder, which the published
    /// network does not have, stays as it is.
    ///
    /// # Errors
    /// [`WeightsError`] with our name of the first tensor that does not fit.
    pub fn with_published(self, path: &Path) -> Result<Self, WeightsError> {
        if !matches!(self.backbone, Backbone::PointNet2(_)) {
            let why = "published checkpoints can be loaded into a network for clouds only";
            return Err(WeightsError::Foreign { path: path.to_owned(), why });
        }
        let tensors = renamed(Tensors::read(path)?, published_name)?;
        self.assign(&tensors, |name| !name.starts_with("heads.proposal.encoder."))
    }

    /// This network with the encoder of a ResNet-18 under torchvision's names (`conv1.weight`, `layer1.0.bn1.bias`, ...),
    /// as safetensors or PyTorch's own format. The classifier is ignored, everything else stays.
    ///
    /// # Errors
    /// [`WeightsError`] with our name of the first tensor that does not fit.
    pub fn with_resnet18(self, path: &Path) -> Result<Self, WeightsError> {
        if !matches!(self.backbone, Backbone::UNet(_)) {
            let why = "a ResNet-18 can be loaded into a network for pictures only";
            return Err(WeightsError::Foreign { path: path.to_owned(), why });
        }
        let tensors = renamed(Tensors::read(path)?, |name| {
            (!name.starts_with("fc.")).then(|| format!("backbone.encoder.{name}"))
        })?;
        self.assign(&tensors, |name| name.starts_with("backbone.encoder."))
    }
}

/// The tensors under new names; those without are dropped.
fn renamed(tensors: Tensors, name: impl Fn(&str) -> Option<String>) -> Result<Tensors, WeightsError> {
    let mut all = Tensors { path: tensors.path, ..Tensors::default() };
    for (old, mut tensor) in tensors.by_name {
        let Some(new) = name(&old) else { continue };
        if new.contains(".linear.") {
            // Published as convolutions of size 1.
            while tensor.shape.len() > 2 && tensor.shape.last() == Some(&1) {
                tensor.shape.pop();
            }
        }
        all.insert(new, tensor)?;
    }
    Ok(all)
}

/// Our name of a published parameter; other names stay, and will be reported as foreign.
fn published_name(name: &str) -> Option<String> {
    let parts: Vec<&str> = name.split('.').collect();
    // Convolution, batch-norm and activation alternate: number 3 j is the j-th convolution, 3 j + 1 its batch-norm.
    let layer = |number: &str| {
        let n: usize = number.parse().ok()?;
        Some((n / 3, *["linear", "norm"].get(n % 3)?))
    };
    let ours = match parts.as_slice() {
        ["pointnet2", "SA_modules", i, "mlps", "0", n, rest] => {
            layer(n).map(|(j, kind)| format!("backbone.abstraction.{i}.mlp.layers.{j}.{kind}.{rest}"))
        }
        ["pointnet2", "FP_modules", i, "mlp", n, rest] => {
            layer(n).map(|(j, kind)| format!("backbone.propagation.{i}.mlp.layers.{j}.{kind}.{rest}"))
        }
        ["pointnet2", "fc_layer", n, rest] => {
            layer(n).map(|(_, kind)| format!("backbone.head.{kind}.{rest}"))
        }
        ["critic", mlp, rest] => Some(format!("heads.score.{mlp}.{rest}")),
        ["actor", mlp, rest] => Some(format!("heads.proposal.decoder.{mlp}.{rest}")),
        ["action_score", mlp, rest] => Some(format!("heads.actionability.{mlp}.{rest}")),
        _ => None,
    };
    Some(ours.unwrap_or_else(|| name.to_owned()))
}
