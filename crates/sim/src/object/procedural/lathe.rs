//! Round bodies: solids of revolution and hollow vessels around the z axis.

use std::f32::consts::TAU;

use nalgebra::{Point3, Vector3};

use super::solid::Solid;
use crate::object::ConvexPiece;

/// Sides of the hull of a round piece.
const HULL_SIDES: usize = 12;

/// A solid of revolution under a profile of (radius, height), from its bottom to its top. Each stretch of the profile
/// that bulges outwards is one convex piece.
pub(super) fn lathe(profile: &[[f32; 2]]) -> Solid {
    let mut closed = Vec::with_capacity(profile.len() + 2);
    closed.push([0.0, profile[0][1]]);
    closed.extend_from_slice(profile);
    closed.push([0.0, profile[profile.len() - 1][1]]);
    closed.dedup_by(|a, b| (a[0] - b[0]).abs() + (a[1] - b[1]).abs() < 1e-6);
    let mut solid = revolve(&closed);
    let heading = |i: usize| {
        let (a, b) = (closed[i], closed[i + 1]);
        (b[1] - a[1]).atan2(b[0] - a[0])
    };
    let mut start = 0;
    for i in 1..closed.len() {
        let last = i + 1 == closed.len();
        if last || heading(i) < heading(i - 1) - 0.02 {
            solid.pieces.extend(round_hull(&closed[start..=i]));
            start = i;
        }
    }
    solid
}

/// The hull of a stretch of a profile, unless it is flat.
fn round_hull(profile: &[[f32; 2]]) -> Option<ConvexPiece> {
    let height = |pick: fn(f32, f32) -> f32, from: f32| profile.iter().map(|p| p[1]).fold(from, pick);
    if height(f32::max, f32::MIN) - height(f32::min, f32::MAX) < 1e-4 {
        return None;
    }
    let mut points = Vec::new();
    for &[r, z] in profile {
        if r < 1e-5 {
            points.push(Point3::new(0.0, 0.0, z));
        } else {
            points.extend(circle(HULL_SIDES).map(|[c, s]| Point3::new(r * c, r * s, z)));
        }
    }
    Some(ConvexPiece { points })
}

/// Cosines and sines around the circle.
fn circle(sides: usize) -> impl Iterator<Item = [f32; 2]> {
    (0..sides).map(move |i| (TAU * i as f32 / sides as f32).sin_cos()).map(|(s, c)| [c, s])
}

/// The surface of revolution of a profile, without pieces. Seen with the profile running upwards, outside is away
/// from the axis. Corners of less than 35 degrees are shaded smoothly.
pub(super) fn revolve(profile: &[[f32; 2]]) -> Solid {
    let mut solid = Solid::default();
    let widest = profile.iter().map(|p| p[0]).fold(0.0, f32::max);
    let sides = if widest > 0.2 {
        36
    } else if widest > 0.06 {
        24
    } else {
        16
    };
    let outward = |i: usize| {
        let d = [profile[i + 1][0] - profile[i][0], profile[i + 1][1] - profile[i][1]];
        let length = d[0].hypot(d[1]).max(1e-9);
        [d[1] / length, -d[0] / length]
    };
    let blend = |i: usize, other: usize| {
        let (a, b) = (outward(i), outward(other));
        if a[0] * b[0] + a[1] * b[1] < 0.82 {
            return a;
        }
        let sum = [a[0] + b[0], a[1] + b[1]];
        let length = sum[0].hypot(sum[1]);
        [sum[0] / length, sum[1] / length]
    };
    let segments = profile.len() - 1;
    let mut along = 0.0;
    for i in 0..segments {
        let length = (profile[i + 1][0] - profile[i][0]).hypot(profile[i + 1][1] - profile[i][1]);
        let ends = [
            (profile[i], blend(i, i.saturating_sub(1)), along),
            (profile[i + 1], blend(i, (i + 1).min(segments - 1)), along + length),
        ];
        along += length;
        let first = solid.mesh.positions.len() as u32;
        for k in 0..=sides {
            let angle = TAU * k as f32 / sides as f32;
            let (s, c) = angle.sin_cos();
            for ([r, z], [nr, nz], v) in ends {
                solid.vertex((
                    Point3::new(r * c, r * s, z),
                    Vector3::new(nr * c, nr * s, nz),
                    [angle * widest, v],
                ));
            }
        }
        for k in 0..sides as u32 {
            let a = first + 2 * k;
            solid.triangle(a, a + 2, a + 3);
            solid.triangle(a, a + 3, a + 1);
        }
    }
    solid
}

/// A hollow vessel: outer profile of (radius, height) from the bottom to the rim, this wall, a floor of this
/// thickness if any. Its wall is made of `slabs` flat slabs for each of `bands` stretches of the profile.
pub(super) fn vessel(profile: &[[f32; 2]], wall: f32, floor: Option<f32>, slabs: usize) -> Solid {
    let bottom = profile[0];
    let rim = profile[profile.len() - 1];
    let mut outline = Vec::new();
    if floor.is_some() {
        outline.push([0.0, bottom[1]]);
    }
    outline.extend_from_slice(profile);
    outline.extend(profile.iter().rev().map(|p| [(p[0] - wall).max(1e-3), p[1]]));
    if let Some(thickness) = floor {
        let start = outline.len() - 1;
        outline[start][1] = (bottom[1] + thickness).min(rim[1]);
        outline.push([0.0, bottom[1] + thickness]);
    } else {
        outline.push(profile[0]);
    }
    let mut solid = revolve(&outline);
    for band in bands(profile).windows(2) {
        let (low, high) = (band[0], band[1]);
        for k in 0..slabs {
            let mut points = Vec::with_capacity(8);
            for step in [k, k + 1] {
                let (s, c) = (TAU * step as f32 / slabs as f32).sin_cos();
                for [r, z] in [low, high] {
                    points.push(Point3::new(r * c, r * s, z));
                    points.push(Point3::new((r - wall) * c, (r - wall) * s, z));
                }
            }
            solid.pieces.push(ConvexPiece { points });
        }
    }
    if let Some(thickness) = floor {
        let top = bottom[1] + thickness;
        solid.pieces.extend(round_hull(&[[bottom[0], bottom[1]], [bottom[0], top]]));
    }
    solid
}

/// The profile with the points left out that a straight wall would pass within 1 cm.
fn bands(profile: &[[f32; 2]]) -> Vec<[f32; 2]> {
    let mut kept = vec![profile[0]];
    let mut from = 0;
    for to in 2..profile.len() {
        let (a, b) = (profile[from], profile[to]);
        let (dr, dz) = (b[0] - a[0], b[1] - a[1]);
        let length = dr.hypot(dz).max(1e-9);
        let straight = profile[from + 1..to]
            .iter()
            .all(|p| ((p[0] - a[0]) * dz - (p[1] - a[1]) * dr).abs() / length < 0.01);
        if !straight {
            from = to - 1;
            kept.push(profile[from]);
        }
    }
    kept.push(profile[profile.len() - 1]);
    kept.retain({
        let mut last: Option<[f32; 2]> = None;
        move |p| {
            let far = last.is_none_or(|l| (p[1] - l[1]).abs() > 1e-3);
            if far {
                last = Some(*p);
            }
            far
        }
    });
    kept
}

/// A profile that runs smoothly through a few (radius, height) points (Catmull-Rom), as turned or blown shapes do.
pub(super) fn smooth(points: &[[f32; 2]]) -> Vec<[f32; 2]> {
    let n = points.len();
    let steps = 5;
    let mut out = Vec::with_capacity((n - 1) * steps + 1);
    for i in 0..n - 1 {
        let (p0, p1, p2, p3) =
            (points[i.saturating_sub(1)], points[i], points[i + 1], points[(i + 2).min(n - 1)]);
        for step in 0..steps {
            let t = step as f32 / steps as f32;
            out.push([0, 1].map(|k| {
                let (a, b, c, d) = (p0[k], p1[k], p2[k], p3[k]);
                0.5 * (2.0 * b
                    + (c - a) * t
                    + (2.0 * a - 5.0 * b + 4.0 * c - d) * t * t
                    + (3.0 * b - a - 3.0 * c + d) * t * t * t)
            }));
        }
    }
    out.push(points[n - 1]);
    out
}

/// The upper half of a ball flattened to this height, on a base of this radius.
pub(super) fn dome(radius: f32, base: f32, height: f32) -> Vec<[f32; 2]> {
    (0..=6)
        .map(|i| {
            let (s, c) = (std::f32::consts::FRAC_PI_2 * i as f32 / 6.0).sin_cos();
            [radius * c, base + height * s]
        })
        .collect()
}
