//! Where weights are found when nobody says.

use std::path::{Path, PathBuf};

use where2act_model::Modality;

use crate::Error;

/// The weights folder for a kind of input.
///
/// `given` is a weights folder itself (then it is returned as it is) or a folder with `rgb` and `cloud` in it.
/// Without it, `weights` is looked for in the working directory, beside the executable and up to two folders above it (where
/// `cargo run` finds the workspace's), and in the workspace this crate was built from, if that is still there. A program that
/// is moved elsewhere is better built with `bundled-weights`.
///
/// # Errors
/// [`Error::NoWeights`] lists where it was looked for.
pub fn find_weights(given: Option<&Path>, modality: Modality) -> Result<PathBuf, Error> {
    let name = match modality {
        Modality::Rgb => "rgb",
        Modality::Cloud => "cloud",
    };
    let is_weights = |folder: &Path| folder.join("config.json").is_file();
    let looked_at: Vec<PathBuf> = match given {
        Some(folder) if is_weights(folder) => return Ok(folder.to_owned()),
        Some(folder) => vec![folder.join(name)],
        None => roots().into_iter().map(|root| root.join("weights").join(name)).collect(),
    };
    match looked_at.iter().find(|folder| is_weights(folder)) {
        Some(folder) => Ok(folder.clone()),
        None => Err(Error::NoWeights { looked_at }),
    }
}

fn roots() -> Vec<PathBuf> {
    let mut roots = vec![PathBuf::new()];
    if let Ok(executable) = std::env::current_exe() {
        // target/debug/predict: the workspace is three levels up.
        roots.extend(executable.ancestors().skip(1).take(3).map(Path::to_path_buf));
    }
    roots.push(PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../..")));
    roots
}

/// `config.json` and `model.safetensors` of the default weights, from the workspace at build time.
#[cfg(feature = "bundled-weights")]
pub(crate) fn bundled(modality: Modality) -> (&'static str, [&'static [u8]; 2]) {
    macro_rules! folder {
        ($name:literal) => {
            (
                concat!("bundled ", $name),
                [
                    include_bytes!(concat!("../../../weights/", $name, "/config.json")),
                    include_bytes!(concat!("../../../weights/", $name, "/model.safetensors")),
                ],
            )
        };
    }
    match modality {
        Modality::Rgb => folder!("rgb"),
        Modality::Cloud => folder!("cloud"),
    }
}
