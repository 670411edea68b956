//! Pixels worth trying.

use nalgebra::Point3;
use rand::{Rng, RngExt};
use where2act_core::Pixel;

use crate::render::View;

/// How far around a pixel discontinuities are looked for, in pixels of the 448 picture: about 3 cm at 5 m.
const REACH: i64 = 4;
/// Distance from the plane of a pixel's surface that counts as another surface, metres.
const STEP: f32 = 0.01;
/// Cosine between normals below which a surface bends.
const BEND: f32 = 0.8;

/// The movable pixels of a view.
pub(super) struct Places {
    all: Vec<Pixel>,
    /// By link: all its pixels, and those near an edge, a bend or a handle.
    links: Vec<(Vec<Pixel>, Vec<Pixel>)>,
}

impl Places {
    pub(super) fn new(view: &View) -> Option<Self> {
        let all = view.movable_pixels();
        let last = all.iter().filter_map(|&p| view.link_at(p)).max()?;
        let mut links = vec![(Vec::new(), Vec::new()); last + 1];
        for &pixel in &all {
            let Some(link) = view.link_at(pixel) else { continue };
            links[link].0.push(pixel);
            if is_special(view, pixel) {
                links[link].1.push(pixel);
            }
        }
        links.retain(|(pixels, _)| !pixels.is_empty());
        Some(Self { all, links })
    }

    /// A uniform movable pixel.
    pub(super) fn any(&self, rng: &mut impl Rng) -> Pixel {
        self.all[rng.random_range(0..self.all.len())]
    }

    /// A pixel of a uniformly chosen link; with `special`, near an edge, a bend or a handle if there is one.
    pub(super) fn of_some_link(&self, special: bool, rng: &mut impl Rng) -> Pixel {
        let (pixels, edges) = &self.links[rng.random_range(0..self.links.len())];
        let from = if special && !edges.is_empty() { edges } else { pixels };
        from[rng.random_range(0..from.len())]
    }
}

/// Whether the surface ends, bends or has something in front of or behind it near a pixel.
fn is_special(view: &View, pixel: Pixel) -> bool {
    let size = view.camera.size;
    let at = size.index(pixel);
    let (Some(point), Some(normal)) = (view.point_in_world(pixel), view.normal_in_world(pixel)) else {
        return false;
    };
    let differs = |du: i64, dv: i64| {
        let (u, v) = (i64::from(pixel.u) + du, i64::from(pixel.v) + dv);
        if u < 0 || v < 0 || u >= size.width as i64 || v >= size.height as i64 {
            return true;
        }
        let other = Pixel { u: u as u32, v: v as u32 };
        let there = size.index(other);
        if view.link[there] != view.link[at] || view.normals_in_world[there].dot(&normal) < BEND {
            return true;
        }
        let p = view.point_in_world(other).unwrap_or_else(Point3::origin);
        normal.dot(&(p - point)).abs() > STEP
    };
    [(REACH, 0), (-REACH, 0), (0, REACH), (0, -REACH), (2, 2), (-2, 2), (2, -2), (-2, -2)]
        .into_iter()
        .any(|(du, dv)| differs(du, dv))
}
