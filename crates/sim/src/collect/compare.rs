//! Whether a data set that is there is of the same recipe.

use std::path::Path;

use serde_json::Value;
use where2act_core::shard::Manifest;

use super::CollectError;
use crate::render::Held;

/// Compares manifests and names the first difference. Of the recipe that was found, only what this version knows counts.
pub(super) fn refuse_other(path: &Path, found: &Manifest, expected: &Manifest) -> Result<(), CollectError> {
    let number = |n: u64| Value::from(n);
    let version = |m: &Manifest| Value::from(m.version.as_str());
    for (field, found, expected) in [
        ("scenes", number(found.scenes), number(expected.scenes)),
        ("scenes per shard", number(found.scenes_per_shard), number(expected.scenes_per_shard)),
        ("version", version(found), version(expected)),
        ("recipe", complete(&found.recipe), complete(&expected.recipe)),
    ] {
        if let Some((field, found, expected)) = difference(field.to_owned(), &found, &expected) {
            return Err(CollectError::OtherRecipe { path: path.to_owned(), field, found, expected });
        }
    }
    Ok(())
}

/// A recipe with the full name of the folder its objects come from, as `set` and `./set` are one, and with what goes without
/// saying.
fn complete(recipe: &Value) -> Value {
    let mut recipe = recipe.clone();
    if let Some(fields) = recipe.as_object_mut() {
        for share in ["varied", "close"] {
            fields.entry(share).or_insert(Value::from(0.0));
        }
        fields.entry("held").or_insert_with(|| serde_json::to_value(Held::default()).unwrap_or_default());
    }
    if let Some(Value::String(root)) = recipe.pointer_mut("/objects/folder/root")
        && let Ok(whole) = Path::new(root.as_str()).canonicalize()
    {
        *root = whole.to_string_lossy().into_owned();
    }
    recipe
}

/// The first leaf in which two values differ, such as `recipe.objects.folder.names[17]`, and what it is in each.
fn difference(field: String, found: &Value, expected: &Value) -> Option<(String, String, String)> {
    match (found, expected) {
        _ if found == expected => None,
        (Value::Object(a), Value::Object(b)) if a.keys().any(|key| b.contains_key(key)) => {
            b.iter().find_map(|(key, expected)| {
                difference(format!("{field}.{key}"), a.get(key).unwrap_or(&Value::Null), expected)
            })
        }
        (Value::Array(a), Value::Array(b)) if a.len() == b.len() => {
            let mut pairs = a.iter().zip(b).enumerate();
            pairs.find_map(|(i, (found, expected))| difference(format!("{field}[{i}]"), found, expected))
        }
        (Value::Array(a), Value::Array(b)) => {
            Some((format!("number of {field}"), a.len().to_string(), b.len().to_string()))
        }
        // Variants of an enumeration differ by their only key.
        _ => Some((field, brief(found), brief(expected))),
    }
}

/// A value in few words.
fn brief(value: &Value) -> String {
    match value {
        Value::Object(fields) if !fields.is_empty() => fields.keys().cloned().collect::<Vec<_>>().join(", "),
        Value::Array(values) => format!("{} values", values.len()),
        leaf => leaf.to_string(),
    }
}

#[cfg(test)]
mod tests {
    use where2act_core::Seed;
    use where2act_core::shard::FORMAT;

    use super::*;
    use crate::collect::{ObjectSet, Recipe};

    fn manifest(objects: &ObjectSet, guided: f64) -> Manifest {
        let recipe = Recipe { objects: objects.clone(), guided, ..Recipe::default() };
        let (version, recipe) = ("1".to_owned(), serde_json::to_value(recipe).unwrap());
        Manifest { format: FORMAT, version, seed: Seed(0), scenes: 4, scenes_per_shard: 2, recipe }
    }

    fn folder(root: &Path, names: usize, odd: &str) -> ObjectSet {
        let mut names: Vec<String> = (0..names).map(|i| format!("Box/{i}")).collect();
        names[17] = odd.to_owned();
        ObjectSet::Folder { root: root.to_owned(), names }
    }

    #[test]
    fn the_first_leaf_that_differs_is_named() {
        let set = |names, odd| folder(Path::new("set"), names, odd);
        let ours = manifest(&set(20, "Box/17"), 0.5);
        let other_scenes = Manifest { scenes: 5, ..ours.clone() };
        let mut varied = ours.clone();
        varied.recipe["varied"] = Value::from(1.0);
        let mut close = ours.clone();
        close.recipe["close"] = Value::from(1.0);
        let mut held = ours.clone();
        held.recipe["held"] = serde_json::json!({ "roll": 15.0, "beside": 0.0 });
        for (found, difference) in [
            (
                manifest(&set(20, "Box/x"), 0.5),
                "recipe.objects.folder.names[17] \"Box/x\", expected \"Box/17\"",
            ),
            (manifest(&set(19, "Box/17"), 0.5), "number of recipe.objects.folder.names 19, expected 20"),
            (manifest(&ObjectSet::training(), 0.5), "recipe.objects procedural, expected folder"),
            (manifest(&set(20, "Box/17"), 0.25), "recipe.guided 0.25, expected 0.5"),
            (other_scenes, "scenes 5, expected 4"),
            (varied, "recipe.varied 1.0, expected 0.0"),
            (close, "recipe.close 1.0, expected 0.0"),
            (held, "recipe.held.roll 15.0, expected 0.0"),
        ] {
            let error = refuse_other(Path::new("m"), &found, &ours).expect_err(difference).to_string();
            assert_eq!(error, format!("m: made with {difference}"));
        }
        refuse_other(Path::new("m"), &ours, &ours).unwrap();
    }

    #[test]
    fn a_folder_is_the_same_under_every_name() {
        let set = tempfile::tempdir().unwrap();
        std::fs::create_dir(set.path().join("inner")).unwrap();
        let other_way = set.path().join("inner/..");
        let (ours, found) = (folder(set.path(), 20, "Box/17"), folder(&other_way, 20, "Box/17"));
        refuse_other(Path::new("m"), &manifest(&found, 0.5), &manifest(&ours, 0.5)).unwrap();
        let inner = manifest(&folder(&set.path().join("inner"), 20, "Box/17"), 0.5);
        let error = refuse_other(Path::new("m"), &inner, &manifest(&ours, 0.5)).expect_err("another folder");
        assert!(error.to_string().contains("objects.folder.root"), "{error}");
    }
}
