//! What PartNet-Mobility folders say beside the URDF.

use std::collections::HashMap;
use std::path::Path;

use serde::Deserialize;
use tracing::warn;
use where2act_core::Category;

use super::mesh::read_limited;

/// The largest of these files that is read, 16 MiB; those of PartNet-Mobility have kilobytes.
const MAX_BYTES: u64 = 16 << 20;

/// Names of an object and of its parts.
pub(super) struct Annotations {
    /// `StorageFurniture/45746`, or the file's name outside of such a folder.
    pub(super) name: String,
    /// `meta.json` decides; without it, the name of the parent folder.
    pub(super) category: Option<Category>,
    /// Part names by URDF link, from `semantics.txt`.
    pub(super) labels: HashMap<String, String>,
}

#[derive(Deserialize)]
struct Meta {
    model_cat: String,
}

/// The category of the object with this URDF file, if its folder tells: by `meta.json`, or by the name of the folder around it.
#[must_use]
pub fn category_of(urdf: &Path) -> Option<Category> {
    annotations(urdf).category
}

/// Reads what there is; nothing of it has to be there.
pub(super) fn annotations(urdf: &Path) -> Annotations {
    // "." and "..", and links, have no names of their own.
    let urdf = urdf.canonicalize().unwrap_or_else(|_| urdf.to_owned());
    let folder = urdf.parent();
    let name_of = |path: Option<&Path>| {
        path.and_then(Path::file_name).map(|n| n.to_string_lossy().into_owned()).unwrap_or_default()
    };
    let parent = name_of(folder.and_then(Path::parent));
    let read = |name: &str| folder.and_then(|f| read_limited(&f.join(name), MAX_BYTES).ok());
    let meta = read("meta.json");
    let model_cat = meta.and_then(|bytes| match serde_json::from_slice::<Meta>(&bytes) {
        Ok(meta) => Some(meta.model_cat),
        Err(e) => {
            warn!("{}: meta.json is not used: {e}", urdf.display());
            None
        }
    });
    let category = model_cat.as_ref().unwrap_or(&parent).parse().ok();
    let name = if urdf.file_name().is_some_and(|n| n == "mobility.urdf") {
        let group = category.map_or(parent, |c: Category| c.name().to_owned());
        format!("{group}/{}", name_of(folder))
    } else {
        urdf.file_stem().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default()
    };
    let semantics = read("semantics.txt").unwrap_or_default();
    Annotations { name, category, labels: labels(&String::from_utf8_lossy(&semantics)) }
}

/// Lines of `link_0 hinge rotation_door`.
fn labels(semantics: &str) -> HashMap<String, String> {
    let label = |line: &str| {
        let mut words = line.split_whitespace();
        Some((words.next()?.to_owned(), words.nth(1)?.to_owned()))
    };
    semantics.lines().filter_map(label).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn labels_are_the_third_word() {
        let found = labels("link_0 hinge rotation_door\r\nlink_1 heavy furniture_body\n\nlink_2 odd\n");
        assert_eq!(found.len(), 2);
        assert_eq!(found["link_0"], "rotation_door");
    }
}
