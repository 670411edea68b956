//! Buckets and kitchen pots.

use std::f32::consts::PI;

use nalgebra::{Point3, Vector3};

use super::builder::{Builder, Mat, Motion, ROOT, shifted, turned};
use super::finish;
use super::handle::knob;
use super::lathe::{dome, lathe, revolve, vessel};
use super::solid::bevelled;
use super::sweep::{Section, arc, rounded, sweep, tapered};

/// A bucket with a bail.
pub(super) fn bucket(b: &mut Builder) {
    let mat = match b.dice.count(0, 3) {
        0 => b.draw(finish::steel),
        1 => b.draw(finish::wood),
        _ => b.draw(finish::plastic),
    };
    let wire = b.draw(finish::fitting);
    let (r, h) = (b.dice.real(0.5, 0.75), b.dice.real(0.75, 1.35));
    let foot = r * b.dice.real(0.65, 0.95);
    let wall = b.dice.real(0.015, 0.035);
    b.add(ROOT, mat, vessel(&[[foot, 0.0], [r, h]], wall, Some(0.03), 12));
    let rim = b.dice.real(0.01, 0.03);
    if b.dice.chance(0.7) {
        let ring = revolve(&[[r, h - rim], [r + rim, h - rim], [r + rim, h], [r, h]]);
        b.add(ROOT, mat, ring);
    }
    if b.dice.chance(0.35) {
        let z = h * b.dice.real(0.3, 0.6);
        let at = foot + (r - foot) * z / h;
        b.add(
            ROOT,
            wire,
            revolve(&[[at, z], [at + 0.015, z + 0.005], [at + 0.02, z + 0.04], [at, z + 0.045]]),
        );
    }
    // The bail hangs between two ears, upright or lying over the rim.
    let pivot = h - b.dice.real(0.04, 0.12);
    let width = r + rim + 0.02;
    let ear_mat = if b.dice.chance(0.5) { wire } else { mat };
    for side in [-1.0, 1.0] {
        let ear = bevelled(
            [-0.04, side * (r - wall), pivot - 0.05],
            [0.04, side * (width - 0.006), pivot + 0.05],
            0.008,
        );
        b.add(ROOT, ear_mat, ear);
    }
    let rise = width * b.dice.real(0.75, 1.1);
    let lying = b.dice.chance(0.4);
    let (tilt, limits) = if lying { (1.25, (-2.5, 0.0)) } else { (0.0, (-1.3, 1.3)) };
    let at = [0.0, 0.0, pivot];
    let bail = b.link(ROOT, "handle", Motion::Hinge { at, axis: [0.0, 1.0, 0.0], limits });
    let up = Vector3::new(f32::sin(tilt), 0.0, f32::cos(tilt));
    let thick = b.dice.real(0.018, 0.04);
    let path = arc(at, [Vector3::y(), up], [width + thick, rise], (0.0, PI));
    b.add(bail, wire, sweep(&path, Section::Round(thick / 2.0), up.cross(&Vector3::y())));
    if b.dice.chance(0.6) {
        let sleeve = b.draw(finish::plastic);
        let path = arc(at, [Vector3::y(), up], [width + thick, rise], (PI * 0.4, PI * 0.6));
        b.add(bail, sleeve, sweep(&path, Section::Round(thick * 0.9), up.cross(&Vector3::y())));
    }
}

/// A pot or pan with a lid.
pub(super) fn pot(b: &mut Builder) {
    let mat = match b.dice.count(0, 2) {
        0 => b.draw(finish::steel),
        1 => b.draw(finish::enamel),
        _ => b.draw(finish::fitting),
    };
    let grip = match b.dice.count(0, 3) {
        0 => b.draw(finish::wood),
        1 => mat,
        _ => b.draw(finish::dark),
    };
    let r = b.dice.real(0.5, 0.7);
    let h = r * b.dice.weighted(&[(1.0, 0.4), (2.0, 0.8), (2.0, 1.2), (1.0, 1.7)]) * b.dice.real(0.85, 1.15);
    let foot = r * b.dice.real(0.8, 1.0);
    let wall = b.dice.real(0.015, 0.035);
    let profile = if b.dice.chance(0.4) {
        vec![[foot * 0.85, 0.0], [r, h * 0.3], [r, h]]
    } else {
        vec![[foot, 0.0], [r, h]]
    };
    b.add(ROOT, mat, vessel(&profile, wall, Some(0.03), 12));
    let z = h * b.dice.real(0.65, 0.92);
    let thick = b.dice.real(0.025, 0.05);
    if b.dice.chance(0.3) {
        // One long handle, and sometimes a small one opposite.
        let length = b.dice.real(0.6, 1.0);
        let rise = b.dice.real(0.0, 0.2);
        let path = rounded(
            &[[0.0, -r + 0.02, z], [0.0, -r - length * 0.4, z + rise * 0.7], [0.0, -r - length, z + rise]],
            0.2,
        );
        let section = Section::Flat(thick * 1.6, thick * 0.8);
        b.add(ROOT, grip, tapered(&path, section, Vector3::x(), |s| 0.7 + 0.3 * s));
        if b.dice.chance(0.4) {
            loop_handle(b, grip, 1.0, r, z, thick);
        }
    } else {
        for side in [-1.0, 1.0] {
            loop_handle(b, grip, side, r, z, thick);
        }
    }
    let lid_mat = match b.dice.count(0, 3) {
        0 | 1 => mat,
        2 => b.draw(finish::glass),
        _ => b.draw(finish::enamel),
    };
    let rim = r * b.dice.real(1.0, 1.03);
    lid(b, lid_mat, grip, rim, h);
}

/// A loop at the side of a pot.
fn loop_handle(b: &mut Builder, mat: Mat, side: f32, r: f32, z: f32, thick: f32) {
    // Both handles alike: drawn from the pot's proportions.
    let (half, out) = (r * 0.3, 0.06 + thick + 0.1 * (z - 0.4).clamp(0.0, 0.5));
    let path = rounded(
        &[[-half, r * 0.93, z], [-half, r + out, z], [half, r + out, z], [half, r * 0.93, z]],
        out * 0.7,
    );
    let turn = if side > 0.0 { 0.0 } else { PI };
    b.add(ROOT, mat, sweep(&path, Section::Round(thick / 2.0), Vector3::z()).at(&turned(turn)));
}

/// A lid that lifts, with a knob or a bow on it.
fn lid(b: &mut Builder, mat: Mat, grip: Mat, rim: f32, h: f32) {
    let travel = b.dice.real(0.2, 0.7);
    let link = b.link(ROOT, "lid", Motion::Slide { axis: [0.0, 0.0, 1.0], limits: (0.0, travel) });
    let z = h + 0.004;
    let height = rim * b.dice.real(0.04, 0.35);
    let mut profile = vec![[rim * 1.02, 0.0], [rim * 1.02, 0.015]];
    profile.extend(dome(rim * 0.98, 0.018, height));
    b.add(link, mat, lathe(&profile).at(&shifted([0.0, 0.0, z])));
    let top = z + 0.016 + height;
    if b.dice.chance(0.65) {
        let (shape, radius, gap) = (b.dice.count(0, 5), b.dice.real(0.028, 0.06), b.dice.real(0.025, 0.06));
        b.add(link, grip, knob(shape, radius, gap).at(&shifted([0.0, 0.0, top])));
    } else {
        let (half, out, thick) = (b.dice.real(0.08, 0.18), b.dice.real(0.06, 0.1), b.dice.real(0.02, 0.04));
        let low = top - height * (half / rim) * (half / rim) - 0.01;
        let path: Vec<Point3<f32>> = rounded(
            &[
                [0.0, -half, low],
                [0.0, -half * 0.9, top + out],
                [0.0, half * 0.9, top + out],
                [0.0, half, low],
            ],
            0.04,
        );
        let turn = b.dice.real(0.0, PI);
        b.add(
            link,
            grip,
            sweep(&path, Section::Flat(thick * 1.4, thick * 0.8), Vector3::x()).at(&turned(turn)),
        );
    }
}
