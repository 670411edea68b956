//! Washing machines that load from the front or from above.

use std::f32::consts::TAU;

use nalgebra::Vector3;

use super::builder::{Builder, Mat, Motion, ROOT, front, top};
use super::carcass::{Carcass, Feet, feet, fitted};
use super::cells::Rect;
use super::controls;
use super::finish;
use super::handle::{HandleKind, Handles};
use super::lathe::{dome, lathe, revolve};
use super::panel::tub;
use super::solid::{bevelled, cuboid, plate_with_hole};
use super::sweep::{Section, arc, sweep};

pub(super) fn build(b: &mut Builder) {
    let [w, d, h] = fitted(b.dice.real(0.9, 1.1), b.dice.real(0.75, 1.1), b.dice.real(1.15, 1.5), 0.93);
    let shell = b.draw(finish::appliance);
    let rubber = b.draw(finish::dark);
    let lift = b.dice.real(0.02, 0.05);
    feet(b, Feet::Round, (-d / 2.0, d / 2.0), (-w / 2.0, w / 2.0), lift, rubber);
    let outside = Rect { y: (-w / 2.0, w / 2.0), z: (lift, h) };
    if b.dice.chance(0.65) { front_loader(b, outside, d, shell) } else { top_loader(b, outside, d, shell) }
}

fn front_loader(b: &mut Builder, outside: Rect, d: f32, shell: Mat) {
    let (w, h) = (outside.width(), outside.height());
    let board = 0.03;
    let x = -d / 2.0;
    let strip = h * b.dice.real(0.14, 0.2);
    let below = b.dice.chance(0.12);
    // The panel with the controls is a solid block over (rarely under) the front plate.
    let rows =
        if below { outside.rows(&[strip, h - strip], 0.0) } else { outside.rows(&[h - strip, strip], 0.0) };
    let (plate, panel) = if below { (rows[1], rows[0]) } else { (rows[0], rows[1]) };
    let thick = 0.035;
    Carcass { x: (x + thick, d / 2.0), outside, board }.build(b, shell, shell);
    let face = if b.dice.chance(0.6) { shell } else { b.draw(finish::appliance) };
    b.add(ROOT, face, bevelled([x, panel.y.0, panel.z.0], [x + thick, panel.y.1, panel.z.1], 0.006));
    let radius = b.dice.real(0.3, 0.4) * w.min(plate.height());
    let [cy, cz] = plate.centre();
    let up = b.dice.real(-0.02, 0.06) * h;
    let half = [plate.width() / 2.0, plate.height() / 2.0];
    let hole = plate_with_hole(half, [0.0, up], radius, -thick, 0.0);
    b.add(ROOT, shell, hole.at(&front([x, cy, cz])));
    let dark = b.draw(finish::steel);
    let depth = d * 0.7;
    b.add(ROOT, dark, revolve(&[[radius, -depth], [radius, -thick]]).at(&front([x, cy, cz + up])));
    door(b, [x - 0.003, cy, cz + up], radius, face);
    let split = b.dice.real(0.25, 0.35);
    let parts = panel.columns(&[1.0 - split, split], 0.0);
    if b.dice.chance(0.7) {
        soap_drawer(b, parts[1].grown(-0.02), x, face);
    }
    controls::panel(b, parts[0], x);
    if !below && b.dice.chance(0.3) {
        // A flap over the filter.
        let size = 0.1;
        let place = [x, outside.y.0 + 0.14, outside.z.0 + 0.1];
        b.add(
            ROOT,
            face,
            cuboid([-size * 0.7, -size / 2.0, 0.0], [size * 0.7, size / 2.0, 0.004])
                .untouchable()
                .at(&front(place)),
        );
    }
}

/// A round door: a ring, a bowl of glass, and a grip at the free side.
fn door(b: &mut Builder, at: [f32; 3], hole: f32, face: Mat) {
    let r = hole * b.dice.real(1.12, 1.3);
    let side = if b.dice.chance(0.75) { 1.0 } else { -1.0 };
    let thick = b.dice.real(0.03, 0.07);
    // Hinged on the front plane of the ring, at its side.
    let hinge = [at[0] - thick, at[1] + side * r, at[2]];
    let open = b.dice.pick(&[1.571, 2.0, 2.6]);
    let link =
        b.link(ROOT, "door", Motion::Hinge { at: hinge, axis: [0.0, 0.0, -side], limits: (0.0, open) });
    let glass = b.draw(finish::glass);
    let trim = if b.dice.chance(0.5) { b.draw(finish::fitting) } else { b.draw(finish::appliance) };
    let inner = r * b.dice.real(0.6, 0.75);
    let place = front(at);
    let ring = revolve(&[
        [inner, 0.0],
        [r, 0.0],
        [r, thick * 0.6],
        [r * 0.94, thick],
        [inner, thick * 0.8],
        [inner, 0.0],
    ]);
    b.add(link, trim, ring.at(&place));
    let mut bowl = vec![[inner, 0.005]];
    bowl.extend(dome(inner, thick * 0.6, thick * 0.3));
    b.add(link, glass, lathe(&bowl).untouchable().at(&place));
    // One hull for ring and bowl.
    b.add(
        link,
        face,
        super::solid::Solid { pieces: lathe(&[[r, 0.0], [r * 0.95, thick]]).pieces, ..Default::default() }
            .at(&place),
    );
    let grip = b.dice.count(0, 2);
    if grip == 0 {
        // A bow along the rim.
        let reach = r * 0.85;
        let (from, to) = if side > 0.0 { (-0.45, 0.45) } else { (TAU / 2.0 - 0.45, TAU / 2.0 + 0.45) };
        let path = arc([0.0, 0.0, thick + 0.045], [Vector3::x(), Vector3::y()], [reach; 2], (from, to));
        let bar = b.dice.real(0.018, 0.035);
        b.add(link, trim, sweep(&path, Section::Round(bar / 2.0), Vector3::z()).at(&place));
        for p in [path[0], path[path.len() - 1]] {
            let post = [[p.x, p.y, thick * 0.7].into(), p];
            b.add(link, trim, sweep(&post, Section::Round(bar * 0.45), Vector3::x()).at(&place));
        }
    } else if grip == 1 {
        let kind = b.dice.pick(&[HandleKind::Loop, HandleKind::Bar, HandleKind::Lip]);
        let handles = Handles::of_kind(b, kind);
        let spot = [at[0] - thick * 0.9, at[1] - side * (r + inner) / 2.0, at[2]];
        b.put(link, handles.make(r * 0.7, 0.08).at(&front(spot)));
    } else {
        // A lip that stands over the rim.
        let y = at[1] - side * r;
        let (low, high) = (
            [at[0] - thick, y - side * 0.03, at[2] - 0.07],
            [at[0] - thick * 0.4, y + side * 0.04, at[2] + 0.07],
        );
        b.add(link, trim, bevelled(low, high, 0.005));
    }
}

/// A drawer for detergent in the panel.
fn soap_drawer(b: &mut Builder, rect: Rect, x: f32, face: Mat) {
    let motion = Motion::Slide { axis: [-1.0, 0.0, 0.0], limits: (0.0, b.dice.real(0.15, 0.3)) };
    let link = b.link(ROOT, "drawer", motion);
    let [y, z] = rect.centre();
    b.add(link, face, bevelled([x - 0.025, rect.y.0, rect.z.0], [x - 0.001, rect.y.1, rect.z.1], 0.006));
    let tray = rect.grown(-0.025);
    let pale = b.mat(finish::plain([0.85, 0.88, 0.9], 0.3, 25.0));
    b.add(link, pale, cuboid([x, tray.y.0, tray.z.0], [x + 0.25, tray.y.1, tray.z.0 + tray.height() * 0.6]));
    if b.dice.chance(0.6) {
        let kind = b.dice.pick(&[HandleKind::Lip, HandleKind::Loop, HandleKind::Cup]);
        let handles = Handles::of_kind(b, kind);
        b.put(link, handles.make_across(rect.width() * 0.9, rect.height()).at(&front([x - 0.025, y, z])));
    }
}

fn top_loader(b: &mut Builder, outside: Rect, d: f32, shell: Mat) {
    let w = outside.width();
    let console = b.dice.real(0.15, 0.24);
    let rim = outside.z.1 - console;
    let back = b.dice.real(0.12, 0.2) * d;
    let height = rim - outside.z.0;
    b.add(ROOT, shell, tub([w / 2.0, d / 2.0], height, 0.05).at(&top([0.0, 0.0, outside.z.0])));
    let face = if b.dice.chance(0.5) { shell } else { b.draw(finish::appliance) };
    let x = d / 2.0 - back;
    b.add(ROOT, face, bevelled([x, -w / 2.0, rim], [d / 2.0, w / 2.0, outside.z.1], 0.015));
    controls::panel(b, Rect { y: outside.y, z: (rim + 0.06, outside.z.1) }, x);
    let steel = b.draw(finish::steel);
    let drum = 0.4 * w.min(d);
    b.add(ROOT, steel, revolve(&[[drum, outside.z.0 + 0.08], [drum, rim - 0.06]]));
    let lid_mat = if b.dice.chance(0.4) { b.draw(finish::glass) } else { shell };
    let (t, open) = (b.dice.real(0.02, 0.05), b.dice.real(1.2, 1.57));
    let at = [x - 0.03, 0.0, rim + 0.003];
    let lid = b.link(ROOT, "lid", Motion::Hinge { at, axis: [0.0, 1.0, 0.0], limits: (0.0, open) });
    let inset = b.dice.real(0.0, 0.04);
    let (low, high) = ([inset - d / 2.0, inset - w / 2.0, at[2]], [at[0], w / 2.0 - inset, at[2] + t]);
    b.add(lid, lid_mat, bevelled(low, high, t * 0.2));
    if b.dice.chance(0.6) {
        let lip = [[low[0] - 0.05, -0.12, at[2] + t * 0.3], [low[0] + 0.01, 0.12, at[2] + t * 0.3 + 0.02]];
        b.add(lid, face, bevelled(lip[0], lip[1], 0.005));
    }
}
