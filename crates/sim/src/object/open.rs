//! From what a user types to an object.

use std::fs;
use std::path::{Path, PathBuf};

use where2act_core::{Category, Seed};

use super::error::ObjectError;
use super::{Object, cache, load, procedural};

/// Loads the object that `spec` names: a URDF file, a folder with `mobility.urdf` (or one other `.urdf` file), or
/// `CATEGORY:SEED` for a generated one; with `~N` at its end, variation N of that ([`Object::varied`]).
///
/// Textures that are missing are logged and replaced by the colour. Convex pieces of meshes are kept in the folder
/// `$WHERE2ACT_CACHE`, or `where2act` in the user's cache folder; nowhere if the variable is empty.
///
/// # Errors
/// Whatever else is wrong with the files, see [`ObjectError`].
pub fn open(spec: &str) -> Result<Object, ObjectError> {
    open_with_cache(spec, cache::default_folder().as_deref())
}

/// [`open`], with the folder to keep convex pieces in; `None` computes them anew.
///
/// # Errors
/// As [`open`]. A cache that cannot be read or written is no error.
pub fn open_with_cache(spec: &str, cache: Option<&Path>) -> Result<Object, ObjectError> {
    let path = Path::new(spec);
    if path.is_dir() {
        return load::load(&urdf_in(path)?, cache);
    }
    if path.is_file() {
        return load::load(path, cache);
    }
    if let (of, Some(number)) = unvaried(spec) {
        let object = open_with_cache(of, cache)?;
        let varied = object.varied(&mut Seed(number).rng());
        return Ok(Object { name: format!("{}~{number}", object.name), ..varied });
    }
    let looks_generated = |name: &str| !name.is_empty() && name.chars().all(char::is_alphanumeric);
    let Some((name, seed)) = spec.split_once(':').filter(|(name, _)| looks_generated(name)) else {
        return Err(ObjectError::NotFound { spec: spec.to_owned() });
    };
    let category: Category = name.parse()?;
    let seed: u64 =
        seed.parse().map_err(|_| ObjectError::BadSeed { spec: spec.to_owned(), found: seed.to_owned() })?;
    Ok(procedural::generate(category, Seed(seed)))
}

/// What an object is a variation of, and its number: `Door:17~3` is `Door:17` and 3.
#[must_use]
pub fn unvaried(spec: &str) -> (&str, Option<u64>) {
    let varied = spec.rsplit_once('~').and_then(|(of, number)| Some((of, Some(number.parse().ok()?))));
    varied.unwrap_or((spec, None))
}

/// The URDF file of an object's folder.
///
/// # Errors
/// If there is no `mobility.urdf` and not exactly one other `.urdf` file.
pub fn urdf_in(folder: &Path) -> Result<PathBuf, ObjectError> {
    let mobility = folder.join("mobility.urdf");
    if mobility.is_file() {
        return Ok(mobility);
    }
    let entries = fs::read_dir(folder).map_err(|e| ObjectError::read(folder, e))?;
    let is_urdf = |p: &PathBuf| p.extension().is_some_and(|e| e.eq_ignore_ascii_case("urdf")) && p.is_file();
    let mut found: Vec<PathBuf> = entries.filter_map(|e| Some(e.ok()?.path())).filter(is_urdf).collect();
    match (found.len(), found.pop()) {
        (1, Some(path)) => Ok(path),
        (found, _) => Err(ObjectError::AmbiguousFolder { path: folder.to_owned(), found }),
    }
}
