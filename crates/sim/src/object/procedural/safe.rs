//! Safes: a thick door with a dial, a wheel, a lever or keys.

use std::f32::consts::{PI, TAU};

use nalgebra::{Point3, Vector3};

use super::builder::{Builder, Group, LinkId, Mat, Motion, ROOT, front, shifted, turned};
use super::carcass::{Carcass, Feet, feet, fitted};
use super::cells::{Rect, Side};
use super::controls::cap;
use super::finish;
use super::handle::{HandleKind, Handles, dial, lever};
use super::lathe::lathe;
use super::solid::{bevelled, cuboid, ngon, prism};
use super::sweep::{Section, arc, sweep};

pub(super) fn build(b: &mut Builder) {
    let [w, d, h] = fitted(b.dice.real(0.8, 1.3), b.dice.real(0.7, 1.1), b.dice.real(0.8, 1.5), 0.93);
    let body = match b.dice.count(0, 2) {
        0 => b.draw(finish::steel),
        1 => b.draw(finish::painted),
        _ => b.mat(finish::plain([0.2, 0.22, 0.24], 0.3, 25.0)),
    };
    let face = if b.dice.chance(0.6) { body } else { b.draw(finish::appliance) };
    let metal = b.draw(finish::fitting);
    let standing = b.dice.pick(&[Feet::None, Feet::Round, Feet::Wheels, Feet::Square]);
    let lift = if standing == Feet::None { 0.0 } else { b.dice.real(0.03, 0.09) };
    feet(b, standing, (-d / 2.0, d / 2.0), (-w / 2.0, w / 2.0), lift, metal);
    let wall = b.dice.real(0.05, 0.12);
    let outside = Rect { y: (-w / 2.0, w / 2.0), z: (lift, h) };
    let carcass = Carcass { x: (-d / 2.0, d / 2.0), outside, board: wall };
    carcass.build(b, body, body);
    if b.dice.chance(0.5) {
        let o = carcass.opening();
        let z = o.z.0 + o.height() * b.dice.real(0.3, 0.6);
        b.add(ROOT, body, cuboid([-d / 2.0 + 0.15, o.y.0, z], [d / 2.0, o.y.1, z + 0.02]));
    }
    // The door fills the opening, or lies over the front.
    let thick = b.dice.real(0.05, 0.13);
    let inset = b.dice.chance(0.6);
    let rect = if inset { carcass.opening().grown(-0.004) } else { outside.grown(-0.015) };
    let proud = b.dice.real(0.0, 0.03);
    let face_x = if inset { -d / 2.0 - proud } else { -d / 2.0 - 0.003 - thick };
    let side = if b.dice.chance(0.65) { Side::Left } else { Side::Right };
    let (hinge, sign) = if side == Side::Left { (rect.y.1, -1.0) } else { (rect.y.0, 1.0) };
    let open = b.dice.pick(&[1.571, 1.571, 2.1, 2.6]);
    let at = [face_x, hinge, 0.0];
    let door = b.link(ROOT, "door", Motion::Hinge { at, axis: [0.0, 0.0, sign], limits: (0.0, open) });
    let bevel = b.dice.real(0.002, 0.015);
    let (low, high) = ([face_x, rect.y.0, rect.z.0], [face_x + thick, rect.y.1, rect.z.1]);
    b.add(door, face, bevelled(low, high, bevel));
    if b.dice.chance(0.4) {
        let r = rect.grown(-0.06);
        b.add(door, body, bevelled([face_x - 0.012, r.y.0, r.z.0], [face_x, r.y.1, r.z.1], 0.006));
        locks(b, door, rect, face_x - 0.012, sign, metal);
    } else {
        locks(b, door, rect, face_x, sign, metal);
    }
    if b.dice.chance(0.6) {
        let knuckle = prism(&ngon(0.025, 10), -0.07, 0.07, 1.0);
        for share in [0.2, 0.8] {
            let z = rect.z.0 + rect.height() * share;
            b.add(ROOT, metal, knuckle.clone().untouchable().at(&shifted([face_x, hinge - sign * 0.01, z])));
        }
    }
}

/// What opens it: one or two of dial, wheel, lever, keypad, handle.
fn locks(b: &mut Builder, door: LinkId, rect: Rect, x: f32, sign: f32, metal: Mat) {
    let [y, z] = rect.centre();
    let (w, h) = (rect.width(), rect.height());
    // Towards the free edge.
    let at = |right: f32, up: f32| [x - 0.002, y + sign * right * w, z + up * h];
    let dark = b.draw(finish::dark);
    match b.dice.count(0, 4) {
        0 => {
            turning_dial(b, door, at(0.0, 0.15), metal, dark);
            bar_lever(b, door, at(0.1, -0.12), sign, metal);
        }
        1 => {
            wheel(b, door, at(0.0, 0.0), w.min(h), metal);
            if b.dice.chance(0.5) {
                turning_dial(b, door, at(0.0, 0.33), metal, dark);
            }
        }
        2 => {
            keypad(b, door, at(-0.05, 0.2), w.min(h), dark);
            bar_lever(b, door, at(0.15, -0.15), sign, metal);
        }
        3 => {
            keypad(b, door, at(-0.1, 0.05), w.min(h), dark);
            turning_dial(b, door, at(0.24, 0.05), metal, dark);
        }
        _ => {
            turning_dial(b, door, at(0.0, 0.1), metal, dark);
            let kind = b.dice.pick(&[HandleKind::Bar, HandleKind::Loop, HandleKind::Bow]);
            let handles = Handles::of_kind(b, kind);
            b.put(door, handles.make(h * 0.5, 0.1).at(&front(at(0.36, 0.0))));
        }
    }
}

fn turning_dial(b: &mut Builder, door: LinkId, at: [f32; 3], mat: Mat, dark: Mat) {
    let radius = b.dice.real(0.045, 0.12);
    b.add(door, dark, lathe(&[[radius * 1.2, 0.0], [radius * 1.2, 0.006]]).untouchable().at(&front(at)));
    let pivot = [at[0] - 0.008, at[1], at[2]];
    let link = b.link(door, "knob", Motion::Spin { at: pivot, axis: [-1.0, 0.0, 0.0] });
    let knob = dial(&mut b.dice, radius, mat, dark);
    b.put(link, knob.at(&front(pivot)));
}

fn bar_lever(b: &mut Builder, door: LinkId, at: [f32; 3], sign: f32, mat: Mat) {
    let (length, thick, gap) = (b.dice.real(0.12, 0.25), b.dice.real(0.025, 0.045), b.dice.real(0.035, 0.06));
    let limits = if sign > 0.0 { (0.0, 1.2) } else { (-1.2, 0.0) };
    let link = b.link(door, "handle", Motion::Hinge { at, axis: [1.0, 0.0, 0.0], limits });
    let flip = if sign > 0.0 { 0.0 } else { PI };
    let handle = lever(&mut b.dice, length, thick, gap, mat);
    b.put(link, handle.at(&(front(at) * turned(flip))));
}

/// A hand wheel, with a rim or bare spokes with balls.
fn wheel(b: &mut Builder, door: LinkId, at: [f32; 3], room: f32, mat: Mat) {
    let link = b.link(door, "wheel", Motion::Spin { at, axis: [-1.0, 0.0, 0.0] });
    let radius = room * b.dice.real(0.13, 0.18);
    let (z, r) = (b.dice.real(0.05, 0.09), b.dice.real(0.009, 0.018));
    let mut group = Group::default();
    group.add(
        mat,
        lathe(&[[r * 3.5, 0.0], [r * 2.0, 0.015], [r * 2.0, z], [r * 2.6, z], [r * 2.2, z + r * 2.0]]),
    );
    let spokes = b.dice.count(3, 5);
    let rim = b.dice.chance(0.6);
    for i in 0..spokes {
        let bar = [[0.0, 0.0, z].into(), Point3::new(radius, 0.0, z)];
        let place = turned(TAU * i as f32 / spokes as f32);
        group.add(mat, sweep(&bar, Section::Round(r), Vector3::z()).at(&place));
        if !rim {
            let ball = super::handle::knob(0, r * 2.0, 0.0).at(&shifted([radius, 0.0, z - r * 2.0]));
            group.add(mat, ball.at(&place));
        }
    }
    if rim {
        let path = arc([0.0, 0.0, z], [Vector3::x(), Vector3::y()], [radius; 2], (0.0, TAU));
        group.add(mat, sweep(&path, Section::Round(r * 1.2), Vector3::z()));
    }
    b.put(link, group.at(&front(at)));
}

/// Keys in a dark field; they can be pressed.
fn keypad(b: &mut Builder, door: LinkId, at: [f32; 3], room: f32, dark: Mat) {
    let (w, h) = (room * 0.13, room * b.dice.real(0.13, 0.18));
    b.add(door, dark, bevelled([-w, -h, 0.0], [w, h, 0.008], 0.003).at(&front(at)));
    let mat = b.draw(finish::plastic);
    let area = Rect { y: (at[1] - w, at[1] + w), z: (at[2] - h, at[2] + h) }.grown(-0.02);
    let rows = b.dice.count(3, 4);
    for (i, row) in area.rows(&vec![1.0; rows], 0.008).into_iter().enumerate() {
        for cell in row.columns(&[1.0; 3], 0.008) {
            let [y, z] = cell.centre();
            let x = at[0] - 0.009;
            let link = if i == 0 {
                b.link(door, "button", Motion::Slide { axis: [1.0, 0.0, 0.0], limits: (0.0, 0.01) })
            } else {
                door
            };
            b.put(link, cap(mat, cell, false, 0.012).at(&front([x, y, z])));
        }
    }
}
