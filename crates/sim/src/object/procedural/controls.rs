//! Buttons, dials and displays of machines.

use super::builder::{Builder, Group, Mat, Motion, ROOT, front};
use super::cells::Rect;
use super::finish;
use super::handle::dial;
use super::solid::{bevelled, cuboid, ngon, prism};

/// Fills a control panel whose surface is at `x`: a display, and buttons or dials below it (or beside it, if wide).
pub(super) fn panel(b: &mut Builder, area: Rect, x: f32) {
    let tall = area.height() > area.width();
    let area = area.grown(-0.12 * area.width().min(area.height()));
    let (screen, rest) = if tall {
        let parts = area.rows(&[3.5, 1.0], 0.03);
        (parts[1], parts[0])
    } else {
        let parts = area.columns(&[2.5, 1.0], 0.03);
        (parts[1], parts[0])
    };
    if b.dice.chance(0.75) {
        display(b, screen, x);
    }
    match b.dice.weighted(&[(3.0, 0), (3.0, 1), (1.5, 2), (1.5, 3)]) {
        0 => dials(b, rest, x, tall),
        1 => buttons(b, rest, x, tall, true),
        2 => buttons(b, rest, x, tall, false),
        _ => {
            let parts = if tall { rest.rows(&[1.0, 1.4], 0.02) } else { rest.columns(&[1.0, 1.0], 0.02) };
            dials(b, parts[0], x, tall);
            buttons(b, parts[1], x, tall, false);
        }
    }
}

/// A dark screen.
pub(super) fn display(b: &mut Builder, area: Rect, x: f32) {
    let mat = b.draw(finish::dark);
    let [y, z] = area.centre();
    let (w, h) = (area.width() / 2.0, area.height().min(area.width()) * 0.35);
    b.add(ROOT, mat, cuboid([x - 0.003, y - w, z - h], [x, y + w, z + h]).untouchable());
}

/// One to four dials that turn without end, along the longer side.
pub(super) fn dials(b: &mut Builder, area: Rect, x: f32, tall: bool) {
    let (long, short) = if tall { (area.height(), area.width()) } else { (area.width(), area.height()) };
    let most = ((long / (short * 0.9)) as usize).clamp(1, 4);
    let count = b.dice.count(1, most);
    let shares = vec![1.0; count];
    let cells = if tall { area.rows(&shares, 0.01) } else { area.columns(&shares, 0.01) };
    let mat = if b.dice.chance(0.5) { b.draw(finish::plastic) } else { b.draw(finish::fitting) };
    let mark = b.draw(finish::dark);
    let share = b.dice.real(0.28, 0.46);
    let seed = b.dice.count(0, 1000) as u64;
    for cell in cells {
        let [y, z] = cell.centre();
        let radius = (cell.width().min(cell.height()) * share).min(0.09);
        let at = [x - 0.003, y, z];
        let knob = b.link(ROOT, "knob", Motion::Spin { at, axis: [-1.0, 0.0, 0.0] });
        // The same dial in every place: its own generator, seeded alike.
        let mut alike = super::dice::Dice(where2act_core::Seed(seed).child("dial", 0).rng());
        b.put(knob, dial(&mut alike, radius, mat, mark).at(&front(at)));
    }
}

/// A grid of buttons; only large ones, or the last row, can be pressed.
pub(super) fn buttons(b: &mut Builder, area: Rect, x: f32, tall: bool, many: bool) {
    let (columns, rows) = match (tall, many) {
        (true, true) => (b.dice.count(2, 3), b.dice.count(3, 5)),
        (true, false) => (1, b.dice.count(1, 3)),
        (false, true) => (b.dice.count(3, 6), b.dice.count(1, 2)),
        (false, false) => (b.dice.count(2, 4), 1),
    };
    let mat = b.draw(finish::plastic);
    let round = b.dice.chance(0.35);
    let height = b.dice.real(0.008, 0.022);
    let gap = 0.22 * (area.width() / columns as f32).min(area.height() / rows as f32);
    for (row, strip) in area.rows(&vec![1.0; rows], gap).into_iter().enumerate() {
        for cell in strip.columns(&vec![1.0; columns], gap) {
            let cap = cap(mat, cell, round, height);
            let [y, z] = cell.centre();
            let link = if !many || row == 0 {
                b.link(ROOT, "button", Motion::Slide { axis: [1.0, 0.0, 0.0], limits: (0.0, height * 0.8) })
            } else {
                ROOT
            };
            b.put(link, cap.at(&front([x, y, z])));
        }
    }
}

/// The cap of a button over a cell.
pub(super) fn cap(mat: Mat, cell: Rect, round: bool, height: f32) -> Group {
    let (w, h) = (cell.width() / 2.0, cell.height() / 2.0);
    let mut group = Group::default();
    group.add(
        mat,
        if round {
            prism(&ngon(w.min(h), 14), 0.0, height, 0.92)
        } else {
            bevelled([-w, -h, 0.0], [w, h, height], height * 0.3)
        },
    );
    group
}
