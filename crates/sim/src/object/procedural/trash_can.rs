//! Bins: pedal bins, swing lids, wheelie bins, baskets with lids.

use nalgebra::Vector3;

use super::builder::{Builder, Mat, Motion, ROOT, frame, front, shifted, top};
use super::finish;
use super::handle::{HandleKind, Handles, knob};
use super::lathe::{dome, lathe, vessel};
use super::panel::tub;
use super::solid::{Solid, bevelled, cuboid};
use super::sweep::{Section, sweep};
use crate::object::ConvexPiece;

pub(super) fn build(b: &mut Builder) {
    let mat = match b.dice.count(0, 3) {
        0 => b.draw(finish::steel),
        1 => b.draw(finish::woven),
        _ => b.draw(finish::plastic),
    };
    let other = if b.dice.chance(0.5) { mat } else { b.draw(finish::plastic) };
    match b.dice.weighted(&[(3.0, 0), (2.0, 1), (2.5, 2), (1.5, 3), (1.0, 4)]) {
        0 => round_bin(b, mat, other),
        1 => swing_bin(b, mat, other),
        2 => wheelie(b, mat, other),
        3 => post_bin(b, mat, other),
        _ => twin(b, mat, other),
    }
}

/// Five walls that lean outwards: sizes at the bottom are `taper` of those at the top. Hollow, open above.
fn tapered_tub(w: f32, d: f32, h: f32, taper: f32, wall: f32) -> Solid {
    let mut solid = tub([w / 2.0, d / 2.0], h, wall);
    let squeeze = |z: f32| taper + (1.0 - taper) * (z / h);
    let pinch = |p: &mut nalgebra::Point3<f32>| {
        let k = squeeze(p.z);
        (p.x, p.y) = (p.x * k, p.y * k);
    };
    solid.mesh.positions.iter_mut().for_each(pinch);
    let points = |piece: &mut ConvexPiece| piece.points.iter_mut().for_each(pinch);
    solid.pieces.iter_mut().for_each(points);
    solid
}

/// A round bin: lid on a hinge at the back (often with a pedal), or one that lifts off.
fn round_bin(b: &mut Builder, mat: Mat, other: Mat) {
    let (r, h) = (b.dice.real(0.4, 0.6), b.dice.real(1.0, 1.6));
    let foot = r * b.dice.real(0.75, 1.0);
    b.add(ROOT, mat, vessel(&[[foot, 0.0], [r, h]], 0.025, Some(0.03), 12));
    let z = h + 0.003;
    let lifts = b.dice.chance(0.3);
    let pedal = !lifts && b.dice.chance(0.7);
    let lid = if lifts {
        let travel = b.dice.real(0.2, 0.5);
        b.link(ROOT, "lid", Motion::Slide { axis: [0.0, 0.0, 1.0], limits: (0.0, travel) })
    } else {
        let open = b.dice.real(1.2, 1.6);
        b.link(ROOT, "lid", Motion::Hinge { at: [r, 0.0, z], axis: [0.0, 1.0, 0.0], limits: (0.0, open) })
    };
    let height = r * b.dice.real(0.05, 0.4);
    let brim = r * b.dice.real(1.0, 1.06);
    let mut profile = vec![[brim, 0.0], [brim, 0.03]];
    profile.extend(dome(brim * 0.98, 0.03, height));
    b.add(lid, other, lathe(&profile).at(&shifted([0.0, 0.0, z])));
    if lifts || b.dice.chance(0.3) {
        let (shape, radius) = (b.dice.count(0, 4), b.dice.real(0.03, 0.05));
        b.add(lid, other, knob(shape, radius, 0.04).at(&shifted([0.0, 0.0, z + height + 0.02])));
    }
    if pedal {
        add_pedal(b, -foot);
    }
}

/// A foot pedal in front of x, to be pressed down.
fn add_pedal(b: &mut Builder, x: f32) {
    let metal = b.draw(finish::fitting);
    let (w, length) = (b.dice.real(0.06, 0.14), b.dice.real(0.1, 0.18));
    let z = 0.09;
    let at = [x + 0.02, 0.0, z];
    let motion = Motion::Hinge { at, axis: [0.0, 1.0, 0.0], limits: (-0.35, 0.0) };
    let pedal = b.link(ROOT, "foot_pad", motion);
    b.add(pedal, metal, bevelled([x - length, -w, z - 0.015], [x - 0.004, w, z + 0.015], 0.006));
}

/// A bin whose lid tips around its middle.
fn swing_bin(b: &mut Builder, mat: Mat, other: Mat) {
    let (w, d, h) = (b.dice.real(0.6, 0.9), b.dice.real(0.5, 0.8), b.dice.real(0.9, 1.3));
    let taper = b.dice.real(0.75, 1.0);
    b.add(ROOT, mat, tapered_tub(w, d, h, taper, 0.025).at(&top([0.0; 3])));
    // A hood with an opening in its sloped front.
    let hood = b.dice.real(0.3, 0.5);
    let (x, y) = (d / 2.0, w / 2.0);
    let side = 0.03;
    for s in [-1.0, 1.0] {
        b.add(ROOT, other, cuboid([-x, s * y, h], [x, s * (y - side), h + hood]));
    }
    b.add(ROOT, other, cuboid([x - side, side - y, h], [x, y - side, h + hood]));
    b.add(ROOT, other, cuboid([-x, -y, h + hood], [x, y, h + hood + 0.03]));
    let pivot = h + hood * 0.75;
    let at = [-x + 0.04, 0.0, pivot];
    let swing = b.dice.real(0.6, 1.2);
    // Heavier below its pivot: it hangs closed.
    let flap = b.link(ROOT, "lid", Motion::Hinge { at, axis: [0.0, 1.0, 0.0], limits: (-swing, swing) });
    let (low, high) = (h + 0.01, h + hood - 0.01);
    b.add(
        flap,
        mat,
        bevelled([-x + 0.03, side + 0.006 - y, low], [-x + 0.05, y - side - 0.006, high], 0.004),
    );
}

/// A wheelie bin.
fn wheelie(b: &mut Builder, mat: Mat, other: Mat) {
    let (w, d, h) = (b.dice.real(0.7, 0.95), b.dice.real(0.75, 1.0), b.dice.real(1.2, 1.5));
    let taper = b.dice.real(0.72, 0.95);
    let lift = 0.06;
    b.add(ROOT, mat, tapered_tub(w, d, h - lift, taper, 0.03).at(&top([0.0, 0.0, lift])));
    let (x, y) = (d / 2.0, w / 2.0);
    let open = b.dice.real(1.57, 2.6);
    let z = h + 0.004;
    let lid =
        b.link(ROOT, "lid", Motion::Hinge { at: [x, 0.0, z], axis: [0.0, 1.0, 0.0], limits: (0.0, open) });
    let (thick, over) = (b.dice.real(0.03, 0.08), b.dice.real(0.02, 0.06));
    b.add(lid, other, bevelled([-x - over, -y - 0.02, z], [x, y + 0.02, z + thick], thick * 0.3));
    if b.dice.chance(0.5) {
        b.add(lid, other, bevelled([-x - over - 0.06, -y * 0.4, z], [-x - over, y * 0.4, z + 0.025], 0.008));
    }
    // The bar to pull it by.
    let bar = [[x + 0.09, -y * 0.8, h - 0.06].into(), [x + 0.09, y * 0.8, h - 0.06].into()];
    b.add(ROOT, mat, sweep(&bar, Section::Round(0.02), Vector3::z()));
    for s in [-0.75, 0.75] {
        b.add(ROOT, mat, cuboid([x - 0.02, s * y - 0.015, h - 0.075], [x + 0.09, s * y + 0.015, h - 0.045]));
    }
    if b.dice.chance(0.8) {
        let rubber = b.draw(finish::dark);
        let radius = b.dice.real(0.09, 0.15);
        let place = taper * y + 0.012;
        for s in [-1.0, 1.0] {
            let at = [x * taper - radius * 0.3, s * place, radius];
            let wheel = b.link(ROOT, "wheel", Motion::Spin { at, axis: [0.0, 1.0, 0.0] });
            let tyre = lathe(&[[radius, 0.0], [radius, 0.05], [radius * 0.8, 0.06]]);
            b.add(wheel, rubber, tyre.at(&frame(at, Vector3::x() * -s, Vector3::z())));
        }
    }
}

/// An outdoor bin: a closed body with a flap over its opening, and a door below.
fn post_bin(b: &mut Builder, mat: Mat, other: Mat) {
    let (w, d, h) = (b.dice.real(0.6, 0.9), b.dice.real(0.55, 0.85), b.dice.real(1.2, 1.6));
    let (x, y, wall) = (d / 2.0, w / 2.0, 0.035);
    let slot = (h * 0.68, h * 0.86);
    b.add(ROOT, mat, cuboid([-x, -y, 0.0], [x, -y + wall, h]));
    b.add(ROOT, mat, cuboid([-x, y - wall, 0.0], [x, y, h]));
    b.add(ROOT, mat, cuboid([x - wall, wall - y, 0.0], [x, y - wall, h]));
    b.add(ROOT, mat, cuboid([-x, wall - y, 0.0], [x - wall, y - wall, wall]));
    b.add(ROOT, mat, cuboid([-x, wall - y, slot.1], [-x + wall, y - wall, h]));
    b.add(ROOT, mat, cuboid([-x, wall - y, slot.0 - 0.1], [-x + wall, y - wall, slot.0]));
    let over = b.dice.real(0.0, 0.06);
    b.add(ROOT, other, bevelled([-x - over, -y - over, h], [x + over, y + over, h + 0.05], 0.02));
    let gap = 0.006;
    let swing = b.dice.real(0.7, 1.3);
    let at = [-x + 0.01, 0.0, slot.1 - gap];
    // Pushed inwards.
    let flap = b.link(ROOT, "lid", Motion::Hinge { at, axis: [0.0, 1.0, 0.0], limits: (-swing, 0.0) });
    let (low, high) = ([-x, wall + gap - y, slot.0 + gap], [-x + 0.02, y - wall - gap, slot.1 - gap]);
    b.add(flap, other, bevelled(low, high, 0.004));
    let (low, high) =
        ([-x - 0.004, wall + gap - y, wall + gap], [-x + 0.022, y - wall - gap, slot.0 - 0.1 - gap]);
    let side = b.dice.sign();
    let hinge = [-x - 0.004, side * (y - wall - gap), 0.0];
    let door =
        b.link(ROOT, "door", Motion::Hinge { at: hinge, axis: [0.0, 0.0, -side], limits: (0.0, 1.571) });
    b.add(door, mat, bevelled(low, high, 0.004));
    let kind = b.dice.pick(&[HandleKind::Knob, HandleKind::Loop, HandleKind::Bow]);
    let handles = Handles::of_kind(b, kind);
    let place = front([-x - 0.004, -side * (y - wall - 0.08), h * 0.4]);
    b.put(door, handles.make(0.3, 0.1).at(&place));
}

/// A bin in two halves, each with its lid and perhaps a pedal.
fn twin(b: &mut Builder, mat: Mat, other: Mat) {
    let (w, d, h) = (b.dice.real(1.0, 1.3), b.dice.real(0.55, 0.8), b.dice.real(0.9, 1.2));
    let (x, y) = (d / 2.0, w / 2.0);
    b.add(ROOT, mat, tub([y, x], h, 0.025).at(&top([0.0; 3])));
    b.add(ROOT, mat, cuboid([-x, -0.0125, 0.0], [x, 0.0125, h]));
    let (t, open) = (b.dice.real(0.02, 0.05), b.dice.real(1.2, 1.6));
    let z = h + 0.004;
    let colours = [other, b.draw(finish::plastic)];
    for (side, colour) in [-1.0, 1.0].into_iter().zip(colours) {
        let middle = side * y / 2.0;
        let motion = Motion::Hinge { at: [x, middle, z], axis: [0.0, 1.0, 0.0], limits: (0.0, open) };
        let lid = b.link(ROOT, "lid", motion);
        let (low, high) = ([-x - 0.02, side * 0.006, z], [x, side * (y + 0.01), z + t]);
        b.add(lid, colour, bevelled(low, high, t * 0.3));
        let lip = cuboid([-x - 0.07, middle - 0.1, z], [-x - 0.02, middle + 0.1, z + 0.02]);
        b.add(lid, colour, lip);
    }
}
