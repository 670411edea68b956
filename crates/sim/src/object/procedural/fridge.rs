//! Refrigerators, with freezers above, below or beside.

use super::builder::{Builder, LinkId, Mat, ROOT, front};
use super::carcass::{Carcass, Feet, feet, fitted};
use super::cells::{Fronts, Rect, Side};
use super::finish;
use super::handle::Handles;
use super::panel::Panels;
use super::solid::{bevelled, cuboid};

/// What closes the fridge, from the bottom up.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Front {
    /// A door on the common hinge side.
    Door,
    /// Two doors that meet in the middle.
    Pair,
    Drawer,
}

/// Fronts above each other, with their shares of the height.
type Rows = &'static [(f32, Front)];

pub(super) fn build(b: &mut Builder) {
    use Front::{Door, Drawer, Pair};
    // Weight, fronts from the bottom up with their shares of the height, width.
    let layouts: [(f32, Rows, f32); 9] = [
        (1.5, &[(1.0, Door)], 0.55),
        (2.0, &[(0.68, Door), (0.32, Door)], 0.48),
        (2.0, &[(0.36, Door), (0.64, Door)], 0.48),
        (2.0, &[(1.0, Pair)], 0.75),
        (1.5, &[(0.35, Drawer), (0.65, Pair)], 0.6),
        (0.8, &[(0.2, Drawer), (0.2, Drawer), (0.6, Pair)], 0.6),
        (0.8, &[(0.45, Pair), (0.55, Pair)], 0.6),
        (0.6, &[(0.3, Drawer), (0.7, Door)], 0.5),
        (1.0, &[(1.0, Door)], 0.9),
    ];
    let choices = layouts.map(|(weight, rows, width)| (weight, (rows, width)));
    let (rows, width) = b.dice.weighted(&choices);
    let sizes = [width * b.dice.real(0.85, 1.2), width * b.dice.real(0.7, 1.25).min(0.9 / width), 1.0];
    let [w, d, h] = fitted(sizes[0], sizes[1], sizes[2], 0.93);
    let shell = b.draw(finish::appliance);
    let face = if b.dice.chance(0.6) { shell } else { b.draw(finish::appliance) };
    let inside = b.mat(finish::plain([0.93, 0.94, 0.95], 0.3, 30.0));
    let lift = b.dice.real(0.02, 0.06);
    let rubber = b.draw(finish::dark);
    let standing = b.dice.pick(&[Feet::Plinth, Feet::Round]);
    feet(b, standing, (-d / 2.0 + 0.05, d / 2.0), (-w / 2.0, w / 2.0), lift, rubber);
    let wall = b.dice.real(0.035, 0.07);
    let thickness = b.dice.real(0.04, 0.1);
    let plane = thickness - d / 2.0;
    let outside = Rect { y: (-w / 2.0, w / 2.0), z: (lift, h) };
    let carcass = Carcass { x: (plane + 0.003, d / 2.0), outside, board: wall };
    carcass.build(b, shell, inside);
    let handles = Handles::machine(b);
    let bevel = b.dice.real(0.004, 0.025);
    let fronts = Fronts {
        panels: Panels::flat(face, thickness, bevel),
        handles,
        inside,
        plane,
        depth: d - thickness - wall,
        board: wall,
        gap: b.dice.real(0.006, 0.014),
        handle_height: 0.0,
    };
    let side = if b.dice.chance(0.65) { Side::Right } else { Side::Left };
    let shares: Vec<f32> = rows.iter().map(|r| r.0).collect();
    let covers = outside.rows(&shares, fronts.gap);
    let count = covers.len();
    for (i, (cover, row)) in covers.iter().zip(rows).enumerate() {
        let cell = cavity(b, &carcass, inside, *cover, i, count);
        // Handles gather where the lowest row meets the next.
        let handle_height = match (count, i) {
            (1, _) => 0.1,
            (_, 0) => 1.0,
            _ => -1.0,
        };
        let fridge = Fronts { handle_height, ..fronts };
        match row.1 {
            Drawer => {
                fridge.drawer(b, ROOT, *cover, cell);
            }
            Door => {
                interior(b, &fridge, cell);
                let link = fridge.door(b, ROOT, *cover, side);
                door_bins(b, &fridge, link, cell);
            }
            Pair => {
                // Side by side, one of them often narrower, with a wall between.
                let split = if count == 1 { b.dice.real(0.35, 0.5) } else { 0.5 };
                let gap = fridge.meeting_gap(cover.width() * split);
                let halves = cover.columns(&[1.0 - split, split], gap);
                if count == 1 {
                    let middle = (halves[0].y.1 + halves[1].y.0) / 2.0;
                    let y = (middle - wall / 2.0, middle + wall / 2.0);
                    carcass.divider(b, inside, Rect { y, z: cell.z });
                    interior(b, &fridge, Rect { y: (cell.y.0, y.0), z: cell.z });
                    interior(b, &fridge, Rect { y: (y.1, cell.y.1), z: cell.z });
                } else {
                    interior(b, &fridge, cell);
                }
                fridge.door(b, ROOT, halves[0], Side::Right);
                let left = fridge.door(b, ROOT, halves[1], Side::Left);
                if b.dice.chance(0.4) && halves[1].height() > 0.6 {
                    dispenser(b, left, halves[1], plane - thickness, rubber);
                }
            }
        }
    }
}

/// The room behind a row of doors; draws the floor between it and the row below.
fn cavity(b: &mut Builder, carcass: &Carcass, mat: Mat, cover: Rect, row: usize, rows: usize) -> Rect {
    let inner = carcass.opening();
    let half = carcass.board / 2.0;
    let low = if row == 0 { inner.z.0 } else { cover.z.0 + half };
    let high = if row + 1 == rows { inner.z.1 } else { cover.z.1 - half };
    if row > 0 {
        carcass.divider(b, mat, Rect { y: inner.y, z: (cover.z.0 - half, low) });
    }
    Rect { y: inner.y, z: (low, high) }
}

/// Glass shelves, set back from the door.
fn interior(b: &mut Builder, fronts: &Fronts, cell: Rect) {
    let count = (cell.height() / b.dice.real(0.2, 0.35)) as usize;
    let behind = Fronts { plane: fronts.plane + 0.12, depth: fronts.depth - 0.1, board: 0.012, ..*fronts };
    behind.shelves(b, cell, count.min(4));
}

/// Bins on the inside of a door, within what the opening leaves.
fn door_bins(b: &mut Builder, fronts: &Fronts, link: LinkId, cell: Rect) {
    let count = b.dice.count(0, (cell.height() / 0.35) as usize);
    let depth = 0.08;
    let (y0, y1) = (cell.y.0 + 0.06, cell.y.1 - 0.06);
    for i in 0..count {
        let z = cell.z.0 + cell.height() * (i as f32 + 0.3) / count as f32;
        let (x0, x1) = (fronts.plane, fronts.plane + depth);
        b.add(link, fronts.inside, cuboid([x0, y0, z], [x1, y1, z + 0.012]));
        b.add(link, fronts.inside, cuboid([x1 - 0.01, y0, z], [x1, y1, z + 0.08]));
    }
}

/// A dark niche for water and ice.
fn dispenser(b: &mut Builder, link: LinkId, door: Rect, face: f32, mat: Mat) {
    let [y, z] = door.centre();
    let (w, h) = (door.width() * b.dice.real(0.2, 0.3), door.height() * b.dice.real(0.08, 0.13));
    let place = front([face, y, z + door.height() * 0.12]);
    b.add(link, mat, bevelled([-w, -h, 0.0], [w, h, 0.006], 0.003).untouchable().at(&place));
}
