//! What a data set is made of.

use std::ops::Range;
use std::path::{Path, PathBuf};

use rand::{Rng, RngExt};
use serde::{Deserialize, Serialize};
use where2act_core::shard::RGB_SIDE;
use where2act_core::{Category, Primitive, Seed, Split};

use super::CollectError;
use crate::object::{ObjectError, category_of, urdf_in};
use crate::render::Held;
use crate::trial::Mode;

/// Variations that scenes draw from.
const VARIATIONS: u64 = 1_000_000;

/// Everything that decides a data set but the number of its scenes: same recipe, same scenes, bit for bit.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Recipe {
    /// Root of all randomness.
    pub seed: Seed,
    /// Which objects are drawn from.
    pub objects: ObjectSet,
    /// What is tried; trials take turns.
    pub primitives: Vec<Primitive>,
    /// Trials in every scene.
    pub trials: usize,
    /// Share of trials by the guided policy; the others are random.
    pub guided: f64,
    /// Cameras from a wide range instead of the published one, in half of the scenes.
    pub wide: bool,
    /// Share of the scenes whose camera zooms in on the object: [`crate::render::close_up`].
    #[serde(default, skip_serializing_if = "is_zero")]
    pub close: f64,
    /// How cameras are held: straight at the object and upright, if nothing is said.
    #[serde(default, skip_serializing_if = "Held::straight")]
    pub held: Held,
    /// Random light, paint, background and sensor instead of the published look, in three scenes of four.
    pub randomise: bool,
    /// Share of the scenes whose object is in other proportions and perhaps turned: [`crate::object::Object::varied`].
    #[serde(default, skip_serializing_if = "is_zero")]
    pub varied: f64,
    /// Every physics step at 500 Hz instead of the fast mode.
    pub faithful: bool,
    /// Side of the pictures that are kept, pixels: 448, as it is rendered, or what divides it.
    #[serde(default = "published_side", skip_serializing_if = "is_published_side")]
    pub picture_side: usize,
}

impl Default for Recipe {
    /// Published exploration on generated objects of the training categories, half of it guided.
    fn default() -> Self {
        Self {
            seed: Seed(0),
            objects: ObjectSet::training(),
            primitives: Primitive::ALL.to_vec(),
            trials: 48,
            guided: 0.5,
            wide: false,
            close: 0.0,
            held: Held::default(),
            randomise: false,
            varied: 0.0,
            faithful: false,
            picture_side: RGB_SIDE,
        }
    }
}

impl Recipe {
    /// How trials are simulated.
    #[must_use]
    pub fn mode(&self) -> Mode {
        if self.faithful { Mode::Faithful } else { Mode::Fast }
    }

    /// Name of an object for scene `index`, a variation in some scenes.
    pub(super) fn draw(&self, index: u64, rng: &mut impl Rng) -> Option<String> {
        let name = self.objects.draw(index, rng)?;
        let varied = self.varied > 0.0 && rng.random_bool(self.varied.min(1.0));
        Some(if varied { format!("{name}~{}", rng.random_range(0..VARIATIONS)) } else { name })
    }

    /// Seed of a scene.
    #[must_use]
    pub fn scene_seed(&self, index: u64) -> Seed {
        self.seed.child("scene", index)
    }
}

fn published_side() -> usize {
    RGB_SIDE
}

#[expect(clippy::trivially_copy_pass_by_ref, reason = "as serde calls it")]
fn is_published_side(side: &usize) -> bool {
    *side == RGB_SIDE
}

#[expect(clippy::trivially_copy_pass_by_ref, reason = "as serde calls it")]
fn is_zero(share: &f64) -> bool {
    *share == 0.0
}

/// A set of objects to draw from.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ObjectSet {
    /// Generated objects; scenes take turns over the categories.
    Procedural {
        /// Which categories.
        categories: Vec<Category>,
        /// Seeds of the objects of every category: disjoint ranges are disjoint objects.
        seeds: Range<u64>,
    },
    /// Folders of a PartNet-Mobility-like data set; scenes take turns over the objects.
    Folder {
        /// The folder that holds `<Category>/<id>` or `<id>`, each with its URDF file.
        root: PathBuf,
        /// The objects, as `<Category>/<id>` or `<id>`.
        names: Vec<String>,
    },
}

impl ObjectSet {
    /// Seeds of the objects that training draws from unless said otherwise.
    pub const TRAINING_SEEDS: Range<u64> = 0..1000;
    /// Seeds of objects kept for judging: training never sees them.
    pub const TEST_SEEDS: Range<u64> = 1_000_000..1_000_100;

    /// Generated objects of the training categories.
    #[must_use]
    pub fn training() -> Self {
        Self::training_of(Self::TRAINING_SEEDS)
    }

    /// Generated objects of the training categories, with these seeds.
    #[must_use]
    pub fn training_of(seeds: Range<u64>) -> Self {
        Self::Procedural { categories: categories_of(Split::Train), seeds }
    }

    /// The objects in a folder, of `categories` if that is not empty: `<Category>/<id>`, and `<id>` alone as PartNet-Mobility
    /// comes, whose `meta.json` names the category. Folders in which [`urdf_in`] finds no object are left out, and the log
    /// says so. The folder is remembered by its whole name: scenes can be made again from whatever folder a program runs in.
    ///
    /// # Errors
    /// If the folder cannot be read or holds no such object.
    pub fn folder(root: &Path, categories: &[Category]) -> Result<Self, CollectError> {
        let absolute = |source| CollectError::Io { path: root.to_owned(), source };
        let root = &std::path::absolute(root).map_err(absolute)?;
        let read = |path: &Path| {
            let io = |source| CollectError::Io { path: path.to_owned(), source };
            let mut names = Vec::new();
            for entry in std::fs::read_dir(path).map_err(io)? {
                names.push(entry.map_err(io)?.file_name().to_string_lossy().into_owned());
            }
            names.sort();
            Ok::<_, CollectError>(names)
        };
        let wanted = |category: Option<Category>| {
            categories.is_empty() || category.is_some_and(|c| categories.contains(&c))
        };
        let mut names = Vec::new();
        for folder in read(root)? {
            let path = root.join(&folder);
            if !path.is_dir() {
                continue;
            }
            match urdf_in(&path) {
                Ok(urdf) => {
                    if wanted(category_of(&urdf)) {
                        names.push(folder);
                    }
                    continue;
                }
                Err(error @ ObjectError::AmbiguousFolder { found: 1.., .. }) => {
                    tracing::warn!("{error}, left out");
                    continue;
                }
                Err(_) => {}
            }
            if !wanted(folder.parse().ok()) {
                continue;
            }
            for id in read(&path)? {
                let object = path.join(&id);
                if !object.is_dir() {
                    continue;
                }
                match urdf_in(&object) {
                    Ok(_) => names.push(format!("{folder}/{id}")),
                    Err(error) => tracing::warn!("{error}, left out"),
                }
            }
        }
        if names.is_empty() {
            return Err(CollectError::NoObjects { path: root.to_owned() });
        }
        Ok(Self::Folder { root: root.to_owned(), names })
    }

    /// Whose turn it is in scene `index`: a category of generated objects, or one object of the folder.
    #[must_use]
    pub fn turn(&self, index: u64) -> Option<String> {
        let of = |count: usize| (index % count.max(1) as u64) as usize;
        match self {
            Self::Procedural { categories, .. } => {
                categories.get(of(categories.len())).map(ToString::to_string)
            }
            Self::Folder { names, .. } => names.get(of(names.len())).cloned(),
        }
    }

    /// Name of an object for a scene: a random one of the category whose turn it is, or the object itself. An object
    /// of a folder keeps its scene however often it is drawn: one that seldom comes to rest is not passed over for
    /// one that always does.
    fn draw(&self, index: u64, rng: &mut impl Rng) -> Option<String> {
        let turn = self.turn(index)?;
        match self {
            Self::Procedural { seeds, .. } => {
                (!seeds.is_empty()).then(|| format!("{turn}:{}", rng.random_range(seeds.clone())))
            }
            Self::Folder { .. } => Some(turn),
        }
    }

    /// What [`crate::object::open`] takes for an object of this set.
    pub(super) fn spec(&self, name: &str) -> String {
        match self {
            Self::Procedural { .. } => name.to_owned(),
            Self::Folder { root, .. } => root.join(name).to_string_lossy().into_owned(),
        }
    }
}

/// Categories of a split.
#[must_use]
pub fn categories_of(split: Split) -> Vec<Category> {
    Category::ALL.into_iter().filter(|c| c.split() == split).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn objects_of_a_folder_take_turns_and_keep_their_scenes() {
        let names = ["Box/1", "Box/2", "Door/1"].map(String::from).to_vec();
        let set = ObjectSet::Folder { root: PathBuf::new(), names: names.clone() };
        for index in 0..9 {
            for seed in 0..20 {
                let drawn = set.draw(index, &mut Seed(seed).rng());
                assert_eq!(drawn.as_ref(), names.get(index as usize % 3), "scene {index}");
            }
        }
        let none = ObjectSet::Folder { root: PathBuf::new(), names: Vec::new() };
        assert_eq!(none.draw(3, &mut Seed(0).rng()), None);
    }

    #[test]
    fn a_folder_with_its_urdf_is_an_object_whatever_the_name_of_the_file() {
        let folder = tempfile::tempdir().unwrap();
        let files =
            ["Box/1/mobility.urdf", "Box/1/old.urdf", "Box/2/box.urdf", "Box/4/a.urdf", "Box/4/b.urdf"];
        for file in files.iter().chain(&["Box/3/readme", "Box/index", "Door/1/mobility.urdf"]) {
            let path = folder.path().join(file);
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(path, "").unwrap();
        }
        let names = |categories: &[Category]| match ObjectSet::folder(folder.path(), categories).unwrap() {
            ObjectSet::Folder { names, .. } => names,
            other => panic!("{other:?}"),
        };
        assert_eq!(names(&[]), ["Box/1", "Box/2", "Door/1"]);
        assert_eq!(names(&[Category::Box]), ["Box/1", "Box/2"]);
    }

    #[test]
    fn a_folder_is_remembered_by_its_whole_name() {
        let folder = tempfile::tempdir_in(".").unwrap();
        std::fs::create_dir_all(folder.path().join("Box/1")).unwrap();
        std::fs::write(folder.path().join("Box/1/mobility.urdf"), "").unwrap();
        let relative = Path::new(folder.path().file_name().unwrap());
        match ObjectSet::folder(relative, &[]).unwrap() {
            ObjectSet::Folder { root, .. } => {
                assert!(root.is_absolute() && root.ends_with(relative), "{root:?}");
            }
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn objects_without_folders_of_their_categories_say_what_they_are() {
        let folder = tempfile::tempdir().unwrap();
        for (file, text) in [
            ("148/mobility.urdf", ""),
            ("148/meta.json", r#"{"model_cat": "Faucet"}"#),
            ("149/mobility.urdf", ""),
            ("150/a.urdf", ""),
            ("150/b.urdf", ""),
        ] {
            let path = folder.path().join(file);
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(path, text).unwrap();
        }
        let names = |categories: &[Category]| match ObjectSet::folder(folder.path(), categories).unwrap() {
            ObjectSet::Folder { names, .. } => names,
            other => panic!("{other:?}"),
        };
        assert_eq!(names(&[]), ["148", "149"]);
        assert_eq!(names(&[Category::Faucet]), ["148"]);
        ObjectSet::folder(folder.path(), &[Category::Door]).expect_err("no doors");
    }

    #[test]
    fn as_many_scenes_as_wanted_show_a_variation() {
        let draw = |varied: f64| {
            let recipe = Recipe { varied, ..Recipe::default() };
            (0..400).filter_map(|i| recipe.draw(i, &mut recipe.scene_seed(i).rng())).collect::<Vec<_>>()
        };
        let (none, some) = (draw(0.0), draw(0.3));
        assert!(draw(2.0).iter().all(|name| name.contains('~')));
        assert!(none.iter().all(|name| !name.contains('~')));
        let varied = some.iter().filter(|name| name.contains('~')).count();
        assert!((80..160).contains(&varied), "{varied} of 400");
        // The objects are the same ones.
        assert!(some.iter().zip(&none).all(|(a, b)| crate::object::unvaried(a).0 == b));
    }

    #[test]
    fn categories_take_turns_with_random_objects() {
        let categories = vec![Category::Faucet, Category::Door];
        let set = ObjectSet::Procedural { categories, seeds: 5..8 };
        for (index, category) in [(0, "Faucet"), (1, "Door"), (2, "Faucet")] {
            let mut names: Vec<_> =
                (0..50).filter_map(|seed| set.draw(index, &mut Seed(seed).rng())).collect();
            names.sort();
            names.dedup();
            assert_eq!(names, [5, 6, 7].map(|seed| format!("{category}:{seed}")));
            assert_eq!(set.turn(index).as_deref(), Some(category));
        }
    }
}
