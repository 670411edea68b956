//! A folder that describes itself: `config.json`, `model.safetensors`, `card.md`, `SHA256SUMS`.

use std::fs;
use std::path::{Path, PathBuf};

use burn::tensor::Device;
use where2act_core::{sha256_hex, write_together};

use super::{Precision, Tensors, WeightsError};
use crate::config::ModelConfig;
use crate::network::Network;

/// What the network is.
pub const CONFIG_FILE: &str = "config.json";
/// Its parameters.
pub const WEIGHTS_FILE: &str = "model.safetensors";
/// Where it comes from and how well it does, for people.
pub const CARD_FILE: &str = "card.md";
/// SHA-256 of the three others, in the format of `sha256sum --check`.
pub const SUMS_FILE: &str = "SHA256SUMS";

/// A network from a weights folder.
#[derive(Clone, Debug)]
pub struct Weights {
    /// The network, ready for prediction.
    pub network: Network,
    /// SHA-256 of `model.safetensors`.
    pub sha256: String,
}

impl Weights {
    /// Loads a weights folder and verifies its checksums.
    ///
    /// # Errors
    /// [`WeightsError`] names the file and, where one is at fault, the tensor.
    pub fn load(folder: &Path, device: &Device) -> Result<Self, WeightsError> {
        let sums = read_sums(folder)?;
        let config_path = folder.join(CONFIG_FILE);
        let config = read(&config_path)?;
        check(&sums, CONFIG_FILE, &config_path, &config)?;
        let config: ModelConfig = serde_json::from_slice(&config)
            .map_err(|source| WeightsError::Json { path: config_path, source })?;
        let path = folder.join(WEIGHTS_FILE);
        let bytes = read(&path)?;
        // Tensors first: a truncated or foreign file gets the error that says what is wrong with it.
        let tensors = Tensors::from_bytes(&path, &bytes)?;
        let network = Network::zeros(&config, device).with_tensors(&tensors)?;
        let sha256 = check(&sums, WEIGHTS_FILE, &path, &bytes)?;
        Ok(Self { network, sha256 })
    }

    /// From the contents of `config.json` and `model.safetensors`, e.g. of weights built into a program.
    ///
    /// # Errors
    /// As [`Self::load`].
    pub fn from_bytes(config: &[u8], weights: &[u8], device: &Device) -> Result<Self, WeightsError> {
        let config: ModelConfig = serde_json::from_slice(config)
            .map_err(|source| WeightsError::Json { path: CONFIG_FILE.into(), source })?;
        let tensors = Tensors::from_bytes(Path::new(WEIGHTS_FILE), weights)?;
        let network = Network::zeros(&config, device).with_tensors(&tensors)?;
        Ok(Self { network, sha256: sha256_hex(weights) })
    }
}

/// Saves a network as a weights folder, `SHA256SUMS` last; weights that are there are replaced when the new ones are written
/// ([`write_together`]). Returns the SHA-256 of `model.safetensors`.
///
/// # Errors
/// [`WeightsError::Io`]; [`WeightsError::NotFinite`] if a parameter cannot be stored in this precision.
pub fn save_weights(
    folder: &Path,
    network: &Network,
    card: &str,
    precision: Precision,
) -> Result<String, WeightsError> {
    let mut tensors = network.tensors();
    tensors.path = folder.join(WEIGHTS_FILE);
    let weights = tensors.to_bytes(precision)?;
    let config_path = folder.join(CONFIG_FILE);
    let mut config = serde_json::to_vec_pretty(network.config())
        .map_err(|source| WeightsError::Json { path: config_path, source })?;
    config.push(b'\n');
    let files = [(CONFIG_FILE, config.as_slice()), (WEIGHTS_FILE, &weights), (CARD_FILE, card.as_bytes())];
    let sums: String = files.map(|(name, bytes)| format!("{}  {name}\n", sha256_hex(bytes))).concat();
    let paths = [CONFIG_FILE, WEIGHTS_FILE, CARD_FILE, SUMS_FILE].map(|name| folder.join(name));
    let contents = files.map(|(_, bytes)| bytes).into_iter().chain([sums.as_bytes()]);
    let files: Vec<(&Path, &[u8])> = paths.iter().map(PathBuf::as_path).zip(contents).collect();
    write_together(&files).map_err(|(path, source)| WeightsError::Io { path, source })?;
    Ok(sha256_hex(&weights))
}

/// Checks every file that `SHA256SUMS` lists.
///
/// # Errors
/// [`WeightsError::NoWeights`] without `SHA256SUMS`, [`WeightsError::Checksum`] for the first that differs,
/// [`WeightsError::Io`] for the first that is missing.
pub fn verify_weights(folder: &Path) -> Result<(), WeightsError> {
    let sums = read_sums(folder)?;
    for (_, name) in &sums {
        let path = folder.join(name);
        check(&sums, name, &path, &read(&path)?)?;
    }
    Ok(())
}

fn read(path: &Path) -> Result<Vec<u8>, WeightsError> {
    fs::read(path).map_err(|source| WeightsError::Io { path: path.to_owned(), source })
}

/// Pairs (sum, file name).
fn read_sums(folder: &Path) -> Result<Vec<(String, String)>, WeightsError> {
    let path = folder.join(SUMS_FILE);
    if !path.exists() {
        return Err(WeightsError::NoWeights { path });
    }
    let text = String::from_utf8_lossy(&read(&path)?).into_owned();
    let sums = text.lines().filter(|line| !line.trim().is_empty()).map(|line| {
        let (sum, name) = line.split_once(char::is_whitespace).unwrap_or((line, ""));
        let name = name.trim_start_matches([' ', '*']);
        let plain = !name.is_empty() && Path::new(name).components().count() == 1 && !name.starts_with('.');
        match plain && sum.len() == 64 && sum.bytes().all(|b| b.is_ascii_hexdigit()) {
            true => Ok((sum.to_ascii_lowercase(), name.to_owned())),
            false => Err(line.to_owned()),
        }
    });
    sums.collect::<Result<Vec<_>, _>>().map_err(|line| WeightsError::Format {
        path,
        why: format!("line {line:?}, expected 64 hexadecimal digits, two spaces and a file name"),
    })
}

/// The sum of `bytes`, if it is the one that stands for `name`.
fn check(sums: &[(String, String)], name: &str, path: &Path, bytes: &[u8]) -> Result<String, WeightsError> {
    let found = sha256_hex(bytes);
    match sums.iter().find(|(_, listed)| listed == name) {
        Some((expected, _)) if *expected == found => Ok(found),
        Some((expected, _)) => {
            Err(WeightsError::Checksum { path: path.to_owned(), expected: expected.clone(), found })
        }
        None => Err(WeightsError::Format {
            path: path.with_file_name(SUMS_FILE),
            why: format!("no line for {name}"),
        }),
    }
}
