//! Kettles and teapots.

use std::f32::consts::PI;

use nalgebra::{Point3, Vector3};

use super::builder::{Builder, Mat, Motion, ROOT, shifted};
use super::finish;
use super::handle::knob;
use super::lathe::{dome, lathe, smooth, vessel};
use super::sweep::{Section, arc, rounded, sweep, tapered};

pub(super) fn build(b: &mut Builder) {
    let mat = match b.dice.count(0, 3) {
        0 => b.draw(finish::steel),
        1 => b.draw(finish::plastic),
        _ => b.draw(finish::enamel),
    };
    let grip = match b.dice.count(0, 2) {
        0 => b.draw(finish::wood),
        1 => b.draw(finish::dark),
        _ => b.draw(finish::plastic),
    };
    let lid_mat = if b.dice.chance(0.6) { mat } else { grip };
    let (r, h) = (b.dice.real(0.42, 0.6), b.dice.real(0.5, 1.0));
    let neck = r * b.dice.real(0.5, 0.85);
    let profile = match b.dice.count(0, 3) {
        0 => smooth(&[[r * 0.7, 0.0], [r, h * 0.35], [r * 0.95, h * 0.6], [neck, h]]),
        1 => vec![[r, 0.0], [r * 0.97, h * 0.5], [neck.max(r * 0.7), h]],
        2 => smooth(&[[r * 0.9, 0.0], [r, h * 0.15], [r * 0.8, h * 0.6], [neck, h]]),
        _ => smooth(&[[r * 0.6, 0.0], [r * 0.95, h * 0.3], [r * 0.95, h * 0.7], [neck * 0.9, h]]),
    };
    let rim = profile[profile.len() - 1][0];
    let wall = 0.03;
    b.add(ROOT, mat, vessel(&profile, wall, Some(0.03), 10));
    if b.dice.chance(0.35) {
        // The heating base of an electric kettle.
        b.add(ROOT, grip, lathe(&[[r * 1.02, -0.08], [r * 0.98, -0.005]]));
    }
    spout(b, mat, &profile, h);
    let top = lid(b, lid_mat, grip, rim, h);
    if b.dice.chance(0.5) { over(b, grip, mat, r, [h, top, rim]) } else { beside(b, grip, r, h) }
}

/// Radius of a profile at a height.
fn radius_at(profile: &[[f32; 2]], z: f32) -> f32 {
    profile.windows(2).find(|p| p[0][1] <= z && z <= p[1][1]).map_or(profile[0][0], |p| {
        p[0][0] + (p[1][0] - p[0][0]) * (z - p[0][1]) / (p[1][1] - p[0][1]).max(1e-6)
    })
}

/// A spout towards +y or -y, a long swan's neck or a short beak.
fn spout(b: &mut Builder, mat: Mat, profile: &[[f32; 2]], h: f32) {
    let z = h * b.dice.real(0.3, 0.6);
    let start = radius_at(profile, z) - 0.05;
    let (out, up) = (b.dice.real(0.25, 0.5), b.dice.real(0.2, 0.55) * h);
    let r = b.dice.real(0.06, 0.12);
    let path: Vec<Point3<f32>> = if b.dice.chance(0.6) {
        rounded(
            &[
                [0.0, -start, z],
                [0.0, -start - out * 0.6, z + up * 0.3],
                [0.0, -start - out * 0.7, z + up * 0.9],
                [0.0, -start - out, z + up],
            ],
            0.2,
        )
    } else {
        vec![[0.0, -start, z].into(), [0.0, -start - out * 0.6, z + up].into()]
    };
    let thin = b.dice.real(0.4, 0.7);
    b.add(ROOT, mat, tapered(&path, Section::Round(r), Vector3::x(), |s| 1.0 + (thin - 1.0) * s));
}

/// A lid that lifts, or hangs on a hinge at the handle's side. Returns its highest z.
fn lid(b: &mut Builder, mat: Mat, grip: Mat, rim: f32, h: f32) -> f32 {
    let z = h + 0.003;
    let hinged = b.dice.chance(0.45);
    let link = if hinged {
        let open = b.dice.real(1.2, 1.75);
        b.link(ROOT, "lid", Motion::Hinge { at: [0.0, rim, z], axis: [-1.0, 0.0, 0.0], limits: (0.0, open) })
    } else {
        let lift = b.dice.real(0.2, 0.5);
        b.link(ROOT, "lid", Motion::Slide { axis: [0.0, 0.0, 1.0], limits: (0.0, lift) })
    };
    let height = rim * b.dice.real(0.08, 0.4);
    let mut profile = vec![[rim, 0.0]];
    profile.extend(dome(rim, 0.015, height));
    b.add(link, mat, lathe(&profile).at(&shifted([0.0, 0.0, z])));
    let (shape, radius, gap) = (b.dice.count(0, 5), b.dice.real(0.028, 0.055), b.dice.real(0.02, 0.05));
    b.add(link, grip, knob(shape, radius, gap).at(&shifted([0.0, 0.0, z + height + 0.01])));
    z + height + 0.01 + gap + 2.0 * radius
}

/// A handle over the top, fixed or folding.
fn over(b: &mut Builder, grip: Mat, mat: Mat, r: f32, [h, top, rim]: [f32; 3]) {
    let rise = (h + b.dice.real(0.35, 0.6)).max(top + 0.08);
    let thick = b.dice.real(0.03, 0.06);
    let width = (r * b.dice.real(0.75, 0.95)).max(rim + 0.05 + thick);
    let base = h * 0.8;
    let link = if b.dice.chance(0.4) {
        let range = b.dice.real(0.8, 1.4);
        let motion = Motion::Hinge { at: [0.0, 0.0, base], axis: [0.0, 1.0, 0.0], limits: (-range, range) };
        b.link(ROOT, "handle", motion)
    } else {
        ROOT
    };
    let path = if b.dice.chance(0.5) {
        arc([0.0, 0.0, base], [Vector3::y(), Vector3::z()], [width + 0.04, rise - base], (0.0, PI))
    } else {
        let y = width + 0.02;
        rounded(&[[0.0, -y, base], [0.0, -y * 0.9, rise], [0.0, y * 0.9, rise], [0.0, y, base]], 0.15)
    };
    let section =
        if b.dice.chance(0.5) { Section::Round(thick / 2.0) } else { Section::Flat(thick, thick * 0.5) };
    b.add(link, grip, sweep(&path, section, Vector3::x()));
    for side in [-1.0, 1.0] {
        let lug = super::solid::cuboid(
            [-0.025, side * (width - 0.1), base - 0.04],
            [0.025, side * (width + 0.0), base + 0.03],
        );
        b.add(ROOT, mat, lug);
    }
}

/// A handle at the side, opposite to the spout.
fn beside(b: &mut Builder, grip: Mat, r: f32, h: f32) {
    let thick = b.dice.real(0.035, 0.07);
    let out = r + b.dice.real(0.15, 0.3);
    let (low, high) = (h * b.dice.real(0.12, 0.3), h * b.dice.real(0.78, 0.92));
    let near = r * 0.8;
    let path = if b.dice.chance(0.5) {
        rounded(&[[0.0, near, low], [0.0, out, low], [0.0, out, high], [0.0, near * 0.9, high]], 0.12)
    } else {
        let middle = (low + high) / 2.0;
        arc(
            [0.0, near * 0.95, middle],
            [Vector3::y(), Vector3::z()],
            [out - near, high - middle],
            (-PI / 2.0, PI / 2.0),
        )
    };
    let section =
        if b.dice.chance(0.6) { Section::Round(thick / 2.0) } else { Section::Flat(thick, thick * 0.6) };
    b.add(ROOT, grip, sweep(&path, section, Vector3::x()));
}
