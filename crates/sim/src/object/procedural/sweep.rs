//! Bars and tubes along a path.

use std::f32::consts::TAU;

use nalgebra::{Point3, Vector3};

use super::solid::Solid;
use crate::object::ConvexPiece;

/// What is swept along a path.
#[derive(Clone, Copy, Debug)]
pub(super) enum Section {
    /// A circle of this radius.
    Round(f32),
    /// A rectangle: its size along the side direction of the path, and across.
    Flat(f32, f32),
}

/// How much a path may turn within one convex piece, radians.
const TURN: f32 = 0.5;

/// A bar of constant section along a path. `side` is roughly the direction of the section's first axis.
pub(super) fn sweep(path: &[Point3<f32>], section: Section, side: Vector3<f32>) -> Solid {
    tapered(path, section, side, |_| 1.0)
}

/// A bar whose section is scaled along the path; `scale` takes the share of the path in [0, 1].
pub(super) fn tapered(
    path: &[Point3<f32>],
    section: Section,
    side: Vector3<f32>,
    scale: impl Fn(f32) -> f32,
) -> Solid {
    let frames = frames(path, side);
    let lengths: Vec<f32> = std::iter::once(0.0)
        .chain(path.windows(2).scan(0.0, |sum, p| {
            *sum += (p[1] - p[0]).norm();
            Some(*sum)
        }))
        .collect();
    let total = lengths[lengths.len() - 1].max(1e-9);
    let ring = |i: usize, sides: usize| {
        let k = scale(lengths[i] / total);
        let (u, v) = frames[i];
        outline(section, sides)
            .into_iter()
            .map(move |(p, n)| (u * (p[0] * k) + v * (p[1] * k), u * n[0] + v * n[1]))
    };
    let mut solid = Solid::default();
    let mut rings: Vec<Vec<u32>> = Vec::new();
    for i in 0..path.len() {
        let mut around = 0.0;
        let mut last: Option<Vector3<f32>> = None;
        let points: Vec<_> = ring(i, 14).collect();
        rings.push(
            points
                .into_iter()
                .map(|(offset, normal)| {
                    around += last.map_or(0.0, |l| (offset - l).norm());
                    last = Some(offset);
                    solid.vertex((path[i] + offset, normal, [around, lengths[i]]))
                })
                .collect(),
        );
    }
    for pair in rings.windows(2) {
        for k in 0..pair[0].len() - 1 {
            solid.triangle(pair[0][k], pair[0][k + 1], pair[1][k + 1]);
            solid.triangle(pair[0][k], pair[1][k + 1], pair[1][k]);
        }
    }
    let n = path.len();
    for (end, next) in [(0, 1), (n - 1, n - 2)] {
        let points: Vec<_> = ring(end, 14).map(|(offset, _)| path[end] + offset).collect();
        let uvs: Vec<_> = points.iter().map(|p| [p.x, p.z]).collect();
        solid.polygon(&points, (path[end] - path[next]).normalize(), &uvs);
    }
    let mut start = 0;
    for i in 1..n {
        let turned = i + 1 < n && {
            let heading = |k: usize| (path[k + 1] - path[k]).normalize();
            heading(start).angle(&heading(i)) > TURN
        };
        if turned || i + 1 == n {
            let points = (start..=i).flat_map(|k| ring(k, 8).map(move |(offset, _)| path[k] + offset));
            solid.pieces.push(ConvexPiece { points: points.collect() });
            start = i;
        }
    }
    solid
}

/// Points and normals around a section, the first repeated at the end.
fn outline(section: Section, sides: usize) -> Vec<([f32; 2], [f32; 2])> {
    match section {
        Section::Round(radius) => (0..=sides)
            .map(|k| {
                let (s, c) = (TAU * k as f32 / sides as f32).sin_cos();
                ([radius * c, radius * s], [c, s])
            })
            .collect(),
        Section::Flat(width, height) => {
            let (w, h) = (width / 2.0, height / 2.0);
            let mut points = Vec::with_capacity(8);
            for (normal, a, b) in [
                ([1.0, 0.0], [w, -h], [w, h]),
                ([0.0, 1.0], [w, h], [-w, h]),
                ([-1.0, 0.0], [-w, h], [-w, -h]),
                ([0.0, -1.0], [-w, -h], [w, -h]),
            ] {
                points.push((a, normal));
                points.push((b, normal));
            }
            points
        }
    }
}

/// The two axes of the section at every point of the path, carried along without twist.
fn frames(path: &[Point3<f32>], side: Vector3<f32>) -> Vec<(Vector3<f32>, Vector3<f32>)> {
    let n = path.len();
    let mut u = side;
    (0..n)
        .map(|i| {
            let tangent = (path[(i + 1).min(n - 1)] - path[i.saturating_sub(1)]).normalize();
            let across = u - tangent * u.dot(&tangent);
            u = across.try_normalize(1e-4).unwrap_or_else(|| {
                let other = if tangent.z.abs() < 0.9 { Vector3::z() } else { Vector3::x() };
                tangent.cross(&other).normalize()
            });
            (u, tangent.cross(&u))
        })
        .collect()
}

/// A path through these points with its corners rounded.
pub(super) fn rounded(points: &[[f32; 3]], radius: f32) -> Vec<Point3<f32>> {
    let points: Vec<_> = points.iter().map(|&p| Point3::from(p)).collect();
    let n = points.len();
    let mut path = vec![points[0]];
    for i in 1..n - 1 {
        let (before, after) = (points[i - 1] - points[i], points[i + 1] - points[i]);
        let cut = radius.min(before.norm() * 0.45).min(after.norm() * 0.45);
        let (a, b) = (points[i] + before.normalize() * cut, points[i] + after.normalize() * cut);
        for step in 0..=4 {
            let t = step as f32 / 4.0;
            let (p, q) = (a + (points[i] - a) * t, points[i] + (b - points[i]) * t);
            path.push(p + (q - p) * t);
        }
    }
    path.push(points[n - 1]);
    path
}

/// An arc around `centre` from angle `from` to `to`, in the plane of two unit axes, with radii along each.
pub(super) fn arc(
    centre: [f32; 3],
    axes: [Vector3<f32>; 2],
    radii: [f32; 2],
    (from, to): (f32, f32),
) -> Vec<Point3<f32>> {
    let steps = ((to - from).abs() / 0.26).ceil().max(3.0) as usize;
    (0..=steps)
        .map(|i| {
            let (s, c) = (from + (to - from) * i as f32 / steps as f32).sin_cos();
            Point3::from(centre) + axes[0] * (radii[0] * c) + axes[1] * (radii[1] * s)
        })
        .collect()
}
