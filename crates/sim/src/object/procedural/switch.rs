//! Wall switches: rockers, toggles, buttons, dials, sliders.

use super::builder::{Builder, LinkId, Mat, Motion, ROOT, front};
use super::cells::Rect;
use super::controls::cap;
use super::finish;
use super::handle::dial;
use super::lathe::{dome, lathe};
use super::panel::ring;
use super::solid::{bevelled, cuboid, prism, rounded_rectangle};
use super::sweep::{Section, tapered};

#[derive(Clone, Copy, PartialEq, Eq)]
enum Kind {
    Rocker,
    Toggle,
    Button,
    Dial,
    Slider,
    /// A big handle at the side of a box.
    Knife,
}

pub(super) fn build(b: &mut Builder) {
    let kind = b.dice.weighted(&[
        (4.0, Kind::Rocker),
        (3.0, Kind::Toggle),
        (1.0, Kind::Button),
        (1.0, Kind::Dial),
        (1.0, Kind::Slider),
        (0.8, Kind::Knife),
    ]);
    let plate = match b.dice.count(0, 2) {
        0 => b.mat(finish::plain([0.93, 0.92, 0.88], 0.3, 30.0)),
        1 => b.draw(finish::plastic),
        _ => b.draw(finish::steel),
    };
    let part = if b.dice.chance(0.5) { plate } else { b.draw(finish::plastic) };
    let t = b.dice.real(0.05, 0.2);
    if kind == Kind::Knife {
        knife(b, plate, part);
        return;
    }
    let gangs = b.dice.weighted(&[(3.0, 1), (3.0, 2), (1.5, 3), (0.7, 4)]);
    let upright = b.dice.chance(0.25);
    let (cell_w, cell_h) = (b.dice.real(0.45, 0.75), b.dice.real(0.9, 1.1));
    let (w, h) =
        if upright { (1.0, cell_w * gangs as f32 + 0.2) } else { (cell_w * gangs as f32 + 0.2, cell_h) };
    let k = 1.85 / w.hypot(h);
    let (w, h) = (w * k, h * k);
    let radius = b.dice.pick(&[0.0, 0.04, 0.1]);
    let outline = rounded_rectangle(w, h, radius);
    let taper = b.dice.real(0.94, 1.0);
    b.add(ROOT, plate, prism(&outline, 0.0, t, taper).at(&front([0.0; 3])));
    if b.dice.chance(0.5) {
        screws(b, w, h, t);
    }
    let margin = b.dice.real(0.1, 0.2) * w.min(h);
    let all = Rect { y: (-w / 2.0, w / 2.0), z: (-h / 2.0, h / 2.0) }.grown(-margin);
    let shares = vec![1.0; gangs];
    let gap = b.dice.real(0.02, 0.1);
    let cells = if upright { all.rows(&shares, gap) } else { all.columns(&shares, gap) };
    let mixed = b.dice.chance(0.2);
    for cell in cells {
        let kind =
            if mixed { b.dice.pick(&[Kind::Rocker, Kind::Toggle, Kind::Dial, Kind::Button]) } else { kind };
        gang(b, kind, cell, -t, [plate, part]);
    }
}

fn screws(b: &mut Builder, w: f32, h: f32, t: f32) {
    let metal = b.draw(finish::fitting);
    let head = lathe(&[[0.025, t], [0.02, t + 0.008]]).untouchable();
    let places =
        if w > h { [[-w * 0.44, 0.0], [w * 0.44, 0.0]] } else { [[0.0, -h * 0.44], [0.0, h * 0.44]] };
    for [x, y] in places {
        b.add(ROOT, metal, head.clone().at(&front([0.0, x, y])));
    }
}

/// One switch over a cell of the plate, whose surface is at `x`.
fn gang(b: &mut Builder, kind: Kind, cell: Rect, x: f32, [plate, part]: [Mat; 2]) {
    let [y, z] = cell.centre();
    let (w, h) = (cell.width(), cell.height());
    let at = [x, y, z];
    match kind {
        Kind::Rocker => rocker(b, cell, x, [plate, part]),
        Kind::Toggle => toggle(b, cell, x, [plate, part]),
        Kind::Button => {
            let height = b.dice.real(0.03, 0.12);
            let round = b.dice.chance(0.5);
            let cell = cell.grown(-0.15 * w.min(h));
            let link =
                b.link(ROOT, "button", Motion::Slide { axis: [1.0, 0.0, 0.0], limits: (0.0, height * 0.6) });
            b.put(link, cap(part, cell, round, height).at(&front([x - 0.003, y, z])));
        }
        Kind::Dial => {
            let radius = 0.42 * w.min(h) * b.dice.real(0.5, 1.0);
            let at = [x - 0.003, y, z];
            let link = b.link(ROOT, "knob", Motion::Spin { at, axis: [-1.0, 0.0, 0.0] });
            let mark = b.draw(finish::dark);
            let knob = dial(&mut b.dice, radius, part, mark);
            b.put(link, knob.at(&front(at)));
        }
        Kind::Slider | Kind::Knife => {
            let run = h * 0.3;
            let dark = b.draw(finish::dark);
            let slot = cuboid([-0.015, -h * 0.42, 0.0], [0.015, h * 0.42, 0.004]).untouchable();
            b.add(ROOT, dark, slot.at(&front(at)));
            let start = [x - 0.003, y, z - run];
            let link =
                b.link(ROOT, "slider", Motion::Slide { axis: [0.0, 0.0, 1.0], limits: (0.0, 2.0 * run) });
            let (kw, kh) = ((w * 0.35).min(0.08), b.dice.real(0.03, 0.07));
            let out = b.dice.real(0.05, 0.11);
            b.add(link, part, bevelled([-kw, -kh / 2.0, 0.0], [kw, kh / 2.0, out], 0.008).at(&front(start)));
        }
    }
}

/// A paddle that tips around its middle (or its edge), in a bezel.
fn rocker(b: &mut Builder, cell: Rect, x: f32, [plate, part]: [Mat; 2]) {
    let [y, z] = cell.centre();
    let (w, h) = (cell.width() / 2.0, cell.height() / 2.0);
    let swing = b.dice.real(0.12, 0.3);
    let (rise, bow) = (h * (swing / 2.0).tan(), b.dice.real(0.0, 0.05));
    if b.dice.chance(0.5) {
        let bezel = ring([w + 0.02, h + 0.02], 0.016, 0.0, 0.02);
        b.add(ROOT, plate, bezel.at(&front([x, y, z])));
    }
    // Tipped so that q = 0 is one rest and `swing` the other: its two halves make an obtuse angle.
    let up = b.dice.chance(0.5);
    let limits = if up { (0.0, swing) } else { (-swing, 0.0) };
    let pivot = [x - 0.01, y, z];
    let link = b.link(ROOT, "switch", Motion::Hinge { at: pivot, axis: [0.0, 1.0, 0.0], limits });
    let tip = rise + 0.04 + bow;
    let lower = if up { 1.0 } else { -1.0 };
    // The side view, from the back corner around: x of the outline runs up, y outwards.
    let side = [
        [-h, 0.0],
        [h, 0.0],
        [h, 0.02 + tip * 0.5 * (1.0 + lower)],
        [0.0, 0.03 + bow],
        [-h, 0.02 + tip * 0.5 * (1.0 - lower)],
    ];
    let low = [side[0], [0.0, 0.0], side[3], side[4]];
    let high = [[0.0, 0.0], side[1], side[2], side[3]];
    let wedge = prism(&low, -w + 0.004, w - 0.004, 1.0).with(prism(&high, -w + 0.004, w - 0.004, 1.0));
    let place = super::builder::frame(pivot, nalgebra::Vector3::z(), -nalgebra::Vector3::x());
    b.add(link, part, wedge.at(&place));
}

/// A small lever that stands out.
fn toggle(b: &mut Builder, cell: Rect, x: f32, [plate, part]: [Mat; 2]) {
    let [y, z] = cell.centre();
    let length = b.dice.real(0.16, 0.4);
    let thick = b.dice.real(0.03, 0.075);
    let swing = b.dice.real(0.3, 0.6);
    b.add(
        ROOT,
        plate,
        bevelled([-thick, -thick * 2.2, 0.0], [thick, thick * 2.2, 0.02], 0.005).at(&front([x, y, z])),
    );
    let up = b.dice.chance(0.5);
    // q = 0 is one rest: the lever points up or down by `swing`.
    let (tilt, limits) = if up { (swing, (-2.0 * swing, 0.0)) } else { (-swing, (0.0, 2.0 * swing)) };
    let pivot = [x - 0.01, y, z];
    // Turning around +y takes -x (outwards) to +z (up).
    let link = b.link(ROOT, "switch", Motion::Hinge { at: pivot, axis: [0.0, 1.0, 0.0], limits });
    let tip = [0.0, length * tilt.sin(), length * tilt.cos()];
    let path = [[0.0; 3].into(), [0.0, tip[1] / 2.0, tip[2] / 2.0].into(), tip.into()];
    let section =
        if b.dice.chance(0.5) { Section::Round(thick / 2.0) } else { Section::Flat(thick, thick * 0.7) };
    let end = b.dice.real(0.7, 1.4);
    let lever = tapered(&path, section, nalgebra::Vector3::x(), |s| 1.0 + (end - 1.0) * s);
    b.add(link, part, lever.at(&front(pivot)));
}

/// An isolator: a box with a handle at its side.
fn knife(b: &mut Builder, body: Mat, part: Mat) {
    let (w, h, t) = (b.dice.real(0.6, 0.9), b.dice.real(0.9, 1.4), b.dice.real(0.3, 0.5));
    b.add(ROOT, body, bevelled([-t, -w / 2.0, -h / 2.0], [0.0, w / 2.0, h / 2.0], 0.03));
    let label = finish::label(&mut b.dice, w * 0.5);
    let label = b.mat(label);
    b.add_as_mapped(ROOT, label, super::carton::sticker(w * 0.5).at(&front([-t, 0.0, 0.1])));
    let side = b.dice.sign();
    let pivot = [-t * 0.6, side * (w / 2.0 + 0.02), h * b.dice.real(-0.1, 0.2)];
    let swing = b.dice.real(0.9, 1.5);
    let link: LinkId =
        b.link(ROOT, "switch", Motion::Hinge { at: pivot, axis: [0.0, 1.0, 0.0], limits: (-swing, 0.0) });
    let thick = b.dice.real(0.035, 0.07);
    let outwards = super::builder::frame(pivot, nalgebra::Vector3::x() * -side, nalgebra::Vector3::z());
    b.add(link, part, lathe(&[[thick * 1.4, -0.017], [thick * 1.4, thick * 1.2]]).at(&outwards));
    // The arm points up and outwards at rest.
    let length = b.dice.real(0.3, 0.55);
    let z = thick * 0.6;
    let front_x = if side > 0.0 { 1.0 } else { -1.0 };
    let reach = [front_x * length * 0.55, length * 0.85, z];
    let path = [[0.0, 0.0, z].into(), reach.into()];
    b.add(
        link,
        part,
        tapered(&path, Section::Flat(thick, thick * 0.6), nalgebra::Vector3::z(), |_| 1.0).at(&outwards),
    );
    let grip = b.mat(finish::plain([0.75, 0.1, 0.08], 0.4, 30.0));
    let mut ball = vec![[thick * 0.7, -thick]];
    ball.extend(dome(thick * 0.9, -thick * 0.3, thick));
    b.add(link, grip, lathe(&ball).at(&(outwards * super::builder::shifted(reach))));
}
