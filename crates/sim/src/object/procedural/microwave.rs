//! Microwave ovens.

use super::builder::{Builder, LinkId, Mat, Motion, ROOT, shifted};
use super::carcass::{Carcass, Feet, feet, fitted};
use super::cells::{Fronts, Rect, Side};
use super::controls;
use super::finish;
use super::handle::{HandleKind, Handles};
use super::lathe::lathe;
use super::panel::Panels;
use super::solid::{bevelled, cuboid};

pub(super) fn build(b: &mut Builder) {
    let ratio = [b.dice.real(1.4, 2.1), b.dice.real(0.9, 1.6), b.dice.real(0.85, 1.15)];
    let [w, d, h] = fitted(ratio[0], ratio[1], ratio[2], 0.94);
    let shell = b.draw(finish::appliance);
    let face = if b.dice.chance(0.5) { shell } else { b.draw(finish::appliance) };
    let inside = b.draw(finish::appliance);
    let glass = b.draw(finish::glass);
    let foot = b.dice.real(0.015, 0.05);
    let rubber = b.draw(finish::dark);
    feet(b, Feet::Round, (-d / 2.0, d / 2.0), (-w / 2.0, w / 2.0), foot, rubber);
    let thickness = b.dice.real(0.04, 0.1);
    let wall = b.dice.real(0.03, 0.07);
    let whole = Rect { y: (-w / 2.0, w / 2.0), z: (foot, h) };
    let plane = -d / 2.0 + thickness;

    // The controls take a strip at the right (rarely left, or below the door).
    let strip = w * b.dice.real(0.18, 0.3);
    let (cavity, panel, hinge) = match b.dice.weighted(&[(7.0, 0), (1.0, 1), (1.5, 2), (1.0, 3)]) {
        0 => {
            let at = whole.y.0 + strip;
            (Rect { y: (at, whole.y.1), ..whole }, Some(Rect { y: (whole.y.0, at), ..whole }), Side::Left)
        }
        1 => {
            let at = whole.y.1 - strip;
            (Rect { y: (whole.y.0, at), ..whole }, Some(Rect { y: (at, whole.y.1), ..whole }), Side::Right)
        }
        2 => {
            let at = whole.z.0 + h * b.dice.real(0.14, 0.22);
            (Rect { z: (at, whole.z.1), ..whole }, Some(Rect { z: (whole.z.0, at), ..whole }), Side::Bottom)
        }
        _ => (whole, None, if b.dice.chance(0.8) { Side::Left } else { Side::Bottom }),
    };
    Carcass { x: (plane, d / 2.0), outside: cavity, board: wall }.build(b, shell, inside);
    if let Some(panel) = panel {
        let bevel = b.dice.real(0.0, 0.01);
        let low = [-d / 2.0, panel.y.0, panel.z.0];
        b.add(ROOT, face, bevelled(low, [plane, panel.y.1, panel.z.1], bevel));
        b.add(ROOT, shell, cuboid([plane, panel.y.0, panel.z.0], [d / 2.0, panel.y.1, panel.z.1]));
        controls::panel(b, panel, -d / 2.0);
    }
    door(b, cavity, plane, thickness, hinge, [face, glass]);
    if b.dice.chance(0.35) {
        turntable(b, cavity, (plane, d / 2.0), wall);
    }
    if b.dice.chance(0.4) {
        vents(b, whole, d, rubber);
    }
}

/// A door with a window in a broad frame.
fn door(b: &mut Builder, cavity: Rect, plane: f32, thickness: f32, hinge: Side, mats: [Mat; 2]) -> LinkId {
    let [face, glass] = mats;
    let kind = b.dice.weighted(&[
        (4.0, HandleKind::Bar),
        (2.0, HandleKind::Bow),
        (2.0, HandleKind::Loop),
        (1.0, HandleKind::Lip),
        (2.0, HandleKind::None),
    ]);
    let handles = Handles::of_kind(b, kind);
    let rail = b.dice.real(0.07, 0.17);
    let window = b.dice.chance(0.9);
    let panels = if window {
        Panels::glazed(face, glass, thickness, rail, (1, 1))
    } else {
        Panels::flat(face, thickness, 0.01)
    };
    let fronts = Fronts {
        panels,
        handles,
        inside: face,
        plane: plane - 0.003,
        depth: 0.3,
        board: 0.03,
        gap: 0.004,
        handle_height: 0.0,
    };
    fronts.door(b, ROOT, cavity.grown(-0.004), hinge)
}

/// A glass plate that turns.
fn turntable(b: &mut Builder, cavity: Rect, x: (f32, f32), wall: f32) {
    let radius = 0.42 * (cavity.width() - 2.0 * wall).min(x.1 - x.0 - wall);
    let at = [(x.0 + x.1 - wall) / 2.0, cavity.centre()[0], cavity.z.0 + wall + 0.006];
    let plate = b.link(ROOT, "tray", Motion::Spin { at, axis: [0.0, 0.0, 1.0] });
    let glass = b.draw(finish::glass);
    b.add(plate, glass, lathe(&[[radius * 0.9, 0.0], [radius, 0.015], [radius, 0.02]]).at(&shifted(at)));
}

/// Slits on the side.
fn vents(b: &mut Builder, whole: Rect, depth: f32, mat: Mat) {
    let count = b.dice.count(4, 9);
    let side = b.dice.sign();
    for i in 0..count {
        let x = depth * (0.1 + 0.03 * i as f32);
        let y = side * whole.width() / 2.0;
        let z = whole.centre()[1];
        let slit = cuboid([x, y - 0.002, z - 0.1], [x + 0.012, y + 0.002, z + 0.1]);
        b.add(ROOT, mat, slit.untouchable());
    }
}
