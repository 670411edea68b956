//! From a scene's number to a settled object before a camera.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, PoisonError};

use nalgebra::{Isometry3, Point3};
use rand::RngExt;
use where2act_core::Seed;
use where2act_core::shard::{Freedom, SceneInfo};

use super::{CollectError, ObjectSet, Recipe};
use crate::object::{self, JointKind, Object};
use crate::render::{Look, View, close_up, render, sample_camera, visible_bounds};
use crate::scene::{Scene, SettledScene};

/// Objects, poses and cameras tried before a scene is given up.
const ATTEMPTS: u64 = 40;
/// Start poses tried with one object.
const POSES_PER_OBJECT: u64 = 4;
/// Cameras tried with one settled scene.
const CAMERAS: u64 = 6;
/// Share of the scenes that keep the published look although the recipe randomises it.
const PUBLISHED_LOOKS: f64 = 0.25;
/// Share of the scenes that keep the published camera although the recipe widens it.
const PUBLISHED_CAMERAS: f64 = 0.5;
/// Movable pixels a view must show: of 200,704. Views from behind show none.
const MIN_MOVABLE_PIXELS: usize = 64;
/// Objects kept in memory.
const KEPT_OBJECTS: usize = 24;

/// A settled scene and a view of it, ready for trials.
#[derive(Clone)]
pub struct ScenePrep {
    /// Who it is; together with the recipe enough to make it again.
    pub info: SceneInfo,
    /// The object at rest.
    pub settled: SettledScene,
    /// What the camera sees.
    pub view: View,
}

/// Prepares the scenes of a recipe. Shared between threads.
pub struct Preparer {
    recipe: Recipe,
    recent: Mutex<VecDeque<(String, Arc<Object>)>>,
}

impl Preparer {
    /// For a recipe.
    #[must_use]
    pub fn new(recipe: Recipe) -> Self {
        Self { recipe, recent: Mutex::default() }
    }

    /// The recipe.
    #[must_use]
    pub fn recipe(&self) -> &Recipe {
        &self.recipe
    }

    /// Makes scene `index`: draws objects and start poses until one settles and a camera sees its movable parts.
    /// `None` if none of many attempts does. All attempts with a folder stay with the object whose turn it is, see
    /// [`ObjectSet::turn`].
    ///
    /// Real objects can fail them all, as they do in the published procedure, which drops such scenes too: flaps of a
    /// carton that share a corner press on each other, flaps of paper swing for longer than settling may take, and
    /// wheels with a centre 2 mm off their axle creep (PartNet-Mobility's `Box/100154`, `Box/100162`,
    /// `TrashCan/11361`).
    ///
    /// # Errors
    /// If an object cannot be loaded.
    pub fn prepare(&self, index: u64) -> Result<Option<ScenePrep>, CollectError> {
        let scene_seed = self.recipe.scene_seed(index);
        for attempt in 0..ATTEMPTS {
            let object_seed = scene_seed.child("object", attempt / POSES_PER_OBJECT);
            let Some(name) = self.recipe.draw(index, &mut object_seed.rng()) else { return Ok(None) };
            let object = self.object(&name)?;
            let seed = scene_seed.child("attempt", attempt);
            let scene = Scene::sample(Arc::clone(&object), &mut seed.child("pose", 0).rng());
            let Ok(settled) = scene.settle() else { continue };
            let Some(view) = self.look_at(&settled, seed) else { continue };
            let (q, category) = (settled.q().to_vec(), object.category);
            let freedoms = freedoms(&settled, &view.camera.camera_from_world());
            let info = SceneInfo { index, seed, object: name, category, q, freedoms };
            return Ok(Some(ScenePrep { info, settled, view }));
        }
        Ok(None)
    }

    /// Makes a prepared scene again from its info, without settling: the same to the last bit.
    ///
    /// # Errors
    /// If the object cannot be loaded, or the info does not belong to this recipe.
    pub fn restore(&self, info: &SceneInfo) -> Result<ScenePrep, CollectError> {
        let foreign = || CollectError::Foreign { scene: info.index, object: info.object.clone() };
        let object = self.object(&info.object)?;
        if info.q.len() + 1 != object.links.len() {
            return Err(foreign());
        }
        let settled = Scene { object, q: info.q.clone() }.assume_settled().map_err(|_| foreign())?;
        let view = self.look_at(&settled, info.seed).ok_or_else(foreign)?;
        Ok(ScenePrep { info: info.clone(), settled, view })
    }

    /// The first of some random views that shows enough of the movable parts.
    fn look_at(&self, settled: &SettledScene, seed: Seed) -> Option<View> {
        let poses = settled.world_from_links();
        let (min, max) = visible_bounds(settled.object(), &poses);
        let centre: Point3<f32> = nalgebra::center(&min, &max);
        let mut coins = seed.child("published", 0).rng();
        let randomise = !coins.random_bool(PUBLISHED_LOOKS) && self.recipe.randomise;
        let wide = !coins.random_bool(PUBLISHED_CAMERAS) && self.recipe.wide;
        let close = self.recipe.close > 0.0 && coins.random_bool(self.recipe.close.min(1.0));
        let look = if randomise { Look::random(&mut seed.child("look", 0).rng()) } else { Look::default() };
        (0..CAMERAS).find_map(|n| {
            let rng = &mut seed.child("camera", n).rng();
            let mut camera = sample_camera(centre, rng, wide);
            if close {
                camera = close_up(&camera, settled.object(), &poses, rng);
            }
            if !self.recipe.held.straight() {
                camera = self.recipe.held.hold(&camera, &centre);
            }
            let view = render(settled.object(), &poses, &camera, &look);
            (view.link.iter().filter(|&&l| l > 1).count() >= MIN_MOVABLE_PIXELS).then_some(view)
        })
    }

    /// Whether any object of the recipe can be loaded; asks until one can.
    pub(super) fn any_loads(&self) -> bool {
        match &self.recipe.objects {
            ObjectSet::Procedural { .. } => true,
            ObjectSet::Folder { names, .. } => names.iter().any(|name| self.object(name).is_ok()),
        }
    }

    /// An object of the recipe, loaded or generated once in a while.
    ///
    /// # Errors
    /// If it cannot be loaded.
    pub fn object(&self, name: &str) -> Result<Arc<Object>, CollectError> {
        let recent = || self.recent.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((_, object)) = recent().iter().find(|(known, _)| known == name) {
            return Ok(Arc::clone(object));
        }
        let object = Arc::new(object::open(&self.recipe.objects.spec(name))?);
        let mut recent = recent();
        recent.push_front((name.to_owned(), Arc::clone(&object)));
        recent.truncate(KEPT_OBJECTS);
        Ok(object)
    }
}

/// How every movable link can move, seen from a camera.
fn freedoms(settled: &SettledScene, camera_from_world: &Isometry3<f32>) -> Vec<Freedom> {
    let (object, q, poses) = (settled.object(), settled.q(), settled.world_from_links());
    let of_link = |link: usize| {
        let joint = object.joint(link);
        let camera_from_link = camera_from_world * poses[link];
        let (low, high) = joint.limits;
        Freedom {
            turns: joint.kind != JointKind::Prismatic,
            axis: camera_from_link * joint.axis,
            point: camera_from_link * Point3::origin(),
            room: [(q[link - 1] - low).max(0.0), (high - q[link - 1]).max(0.0)],
        }
    };
    object.movable().map(of_link).collect()
}
