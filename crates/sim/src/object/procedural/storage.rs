//! Cabinets, chests of drawers, wardrobes, sideboards.

use super::builder::{Builder, Mat, Motion, ROOT, front, top};
use super::carcass::{Carcass, Feet, feet, fitted};
use super::cells::{Fronts, Rect, Side};
use super::finish;
use super::handle::Handles;
use super::panel::Panels;
use super::solid::{bevelled, cuboid};

/// A cabinet under construction.
struct Cabinet {
    carcass: Carcass,
    fronts: Fronts,
    body: Mat,
    overlay: bool,
}

/// What fills a cell.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Fill {
    Drawers,
    Doors,
    Shelves,
    Flap,
    Drop,
}

pub(super) fn build(b: &mut Builder) {
    // Width, depth and height of the usual kinds: sideboard, chest of drawers, bedside, wardrobe, narrow and tall.
    let (w, d, h) = b.dice.pick(&[
        (1.6, 0.5, 0.8),
        (1.1, 0.5, 0.95),
        (0.6, 0.5, 0.65),
        (1.0, 0.55, 1.7),
        (0.5, 0.45, 1.5),
        (1.0, 0.6, 0.9),
        (1.9, 0.5, 0.6),
        (0.8, 0.4, 1.2),
    ]);
    let stretch = [b.dice.real(0.85, 1.2), b.dice.real(0.8, 1.25), b.dice.real(0.85, 1.15)];
    let [w, d, h] = fitted(w * stretch[0], d * stretch[1], h * stretch[2], 0.93);
    let body = b.draw(finish::furniture);
    let accent = {
        let first = b.finish_of(body);
        let finish = finish::companion(&mut b.dice, &first);
        if b.dice.chance(0.5) { body } else { b.mat(finish) }
    };
    let standing = b.dice.weighted(&[
        (2.0, Feet::None),
        (2.0, Feet::Plinth),
        (2.0, Feet::Square),
        (1.0, Feet::Round),
        (1.5, Feet::Tapered),
        (0.5, Feet::Wheels),
    ]);
    let lift = match standing {
        Feet::None => 0.0,
        Feet::Plinth | Feet::Wheels => b.dice.real(0.03, 0.1),
        _ => b.dice.real(0.06, 0.3) * h.min(1.0),
    };
    let legs = if b.dice.chance(0.6) { accent } else { b.draw(finish::fitting) };
    feet(b, standing, (-d / 2.0, d / 2.0), (-w / 2.0, w / 2.0), lift, legs);
    let board = b.dice.real(0.018, 0.05);
    let slab = if b.dice.chance(0.45) { b.dice.real(0.02, 0.05) } else { 0.0 };
    let outside = Rect { y: (-w / 2.0, w / 2.0), z: (lift, h - slab) };
    let carcass = Carcass { x: (-d / 2.0, d / 2.0), outside, board };
    if b.dice.chance(0.08) {
        chest(b, carcass, body, accent);
        return;
    }
    let back = if b.dice.chance(0.7) { body } else { accent };
    carcass.build(b, body, back);
    if slab > 0.0 {
        let over = b.dice.real(0.0, 0.05);
        let material = if b.dice.chance(0.3) { b.draw(finish::stone) } else { accent };
        let bevel = b.dice.real(0.0, 0.4) * slab;
        b.add(
            ROOT,
            material,
            bevelled(
                [-d / 2.0 - over - 0.03, -w / 2.0 - over, h - slab],
                [d / 2.0, w / 2.0 + over, h],
                bevel,
            ),
        );
    }
    let front = if b.dice.chance(0.6) { body } else { accent };
    let panels = Panels::furniture(b, front);
    let handles = Handles::furniture(b);
    let overlay = b.dice.chance(0.6);
    let plane = if overlay { carcass.x.0 } else { carcass.x.0 + panels.thickness };
    let fronts = Fronts {
        panels,
        handles,
        inside: if b.dice.chance(0.5) { body } else { accent },
        plane,
        depth: carcass.x.1 - plane - board.min(0.02),
        board,
        gap: b.dice.real(0.0035, 0.008),
        handle_height: b.dice.real(-1.0, 1.0),
    };
    let cabinet = Cabinet { carcass, fronts, body, overlay };
    cabinet.lay_out(b);
}

impl Cabinet {
    fn lay_out(&self, b: &mut Builder) {
        let all = self.carcass.opening();
        let aspect = all.width() / all.height();
        match b.dice.weighted(&[(3.0, 0), (2.5, 1), (2.5, 2), (3.0, 3), (0.8, 4)]) {
            0 => {
                let most = ((all.width() / 0.35) as usize).clamp(1, 3);
                let columns = b.dice.count(1, most);
                for column in self.columns(b, all, columns) {
                    self.fill(b, column, Fill::Drawers);
                }
            }
            1 => {
                let columns = ((aspect / 0.8).round() as usize).clamp(1, 3);
                for column in self.columns(b, all, columns) {
                    self.fill(b, column, Fill::Doors);
                }
            }
            2 => {
                // A row of drawers above or below doors.
                let share = b.dice.real(0.18, 0.4);
                let below = b.dice.chance(0.35);
                let shares = if below { [share, 1.0 - share] } else { [1.0 - share, share] };
                let rows = self.rows(b, all, &shares);
                let (drawers, doors) = if below { (rows[0], rows[1]) } else { (rows[1], rows[0]) };
                let columns = ((all.width() / 0.5) as usize).clamp(1, 3);
                for cell in self.columns(b, drawers, columns) {
                    self.fronts.drawers(b, self.fronts.cover(cell, self.overlay), cell, &[1.0]);
                }
                let fill = if b.dice.chance(0.8) { Fill::Doors } else { Fill::Shelves };
                let columns = if doors.width() > 1.0 { b.dice.count(1, 2) } else { 1 };
                for cell in self.columns(b, doors, columns) {
                    self.fill(b, cell, fill);
                }
            }
            3 => {
                // Cells of anything.
                let cells = if aspect > 0.8 {
                    let columns = b.dice.count(2, ((all.width() / 0.3) as usize).clamp(2, 4));
                    self.columns(b, all, columns)
                } else {
                    let rows = b.dice.count(2, 4);
                    let shares = b.dice.shares(1.0, rows, 2.0);
                    self.rows(b, all, &shares)
                };
                let last = cells.len() - 1;
                for (i, cell) in cells.into_iter().enumerate() {
                    let fill = self.any_fill(b, cell);
                    let still = i == last && !b.moves() && fill == Fill::Shelves;
                    self.fill(b, cell, if still { Fill::Doors } else { fill });
                }
            }
            _ => self.sliding_doors(b, all),
        }
    }

    fn any_fill(&self, b: &mut Builder, cell: Rect) -> Fill {
        let wide = cell.width() > 1.3 * cell.height();
        b.dice.weighted(&[
            (3.0, Fill::Drawers),
            (3.0, Fill::Doors),
            (1.5, Fill::Shelves),
            (if wide { 1.2 } else { 0.1 }, Fill::Flap),
            (if wide { 0.5 } else { 0.0 }, Fill::Drop),
        ])
    }

    fn fill(&self, b: &mut Builder, cell: Rect, fill: Fill) {
        let cover = self.fronts.cover(cell, self.overlay);
        match fill {
            Fill::Drawers => {
                let most = ((cell.height() / 0.14) as usize).clamp(1, 6);
                let least = if most > 2 { 2 } else { 1 };
                let count = b.dice.count(least, most);
                let spread = b.dice.pick(&[1.0, 1.0, 1.4, 2.2]);
                let mut shares = b.dice.shares(1.0, count, spread);
                shares.sort_by(|a, b| b.total_cmp(a));
                self.fronts.drawers(b, cover, cell, &shares);
            }
            Fill::Doors => {
                let shelves = b.dice.count(0, ((cell.height() / 0.3) as usize).min(4));
                self.fronts.shelves(b, cell, shelves);
                self.fronts.doors(b, cover);
            }
            Fill::Shelves => {
                let shelves = b.dice.count(0, ((cell.height() / 0.25) as usize).min(4));
                self.fronts.shelves(b, cell, shelves);
            }
            Fill::Flap | Fill::Drop => {
                let side = if fill == Fill::Flap { Side::Top } else { Side::Bottom };
                self.fronts.door(b, ROOT, cover, side);
            }
        }
    }

    /// Columns of about the same width with boards between them.
    fn columns(&self, b: &mut Builder, cell: Rect, count: usize) -> Vec<Rect> {
        let spread = b.dice.pick(&[1.0, 1.0, 1.6]);
        let shares = b.dice.shares(1.0, count, spread);
        let columns = cell.columns(&shares, self.fronts.board);
        for pair in columns.windows(2) {
            self.carcass.divider(b, self.body, Rect { y: (pair[0].y.1, pair[1].y.0), z: cell.z });
        }
        columns
    }

    /// Rows, from the bottom up, with boards between them.
    fn rows(&self, b: &mut Builder, cell: Rect, shares: &[f32]) -> Vec<Rect> {
        let rows = cell.rows(shares, self.fronts.board);
        for pair in rows.windows(2) {
            self.carcass.divider(b, self.body, Rect { y: cell.y, z: (pair[0].z.1, pair[1].z.0) });
        }
        rows
    }

    /// Two doors that slide past each other.
    fn sliding_doors(&self, b: &mut Builder, all: Rect) {
        let count = b.dice.count(0, 3);
        let shelf_plane =
            Fronts { plane: self.fronts.plane + 0.1, depth: self.fronts.depth - 0.1, ..self.fronts };
        shelf_plane.shelves(b, all, count);
        let t = self.fronts.panels.thickness;
        let cell = all.grown(-0.006);
        let lap = 0.06;
        let half = cell.width() / 2.0 + lap / 2.0;
        let handle_kind = self.fronts.handles;
        for (i, back) in [0.006, t + 0.012].into_iter().enumerate() {
            let (y0, axis) = if i == 0 { (cell.y.0, 1.0) } else { (cell.y.1 - half, -1.0) };
            let travel = (cell.width() - half) * 0.95;
            let motion = Motion::Slide { axis: [0.0, axis, 0.0], limits: (0.0, travel) };
            let link = b.link(ROOT, "door", motion);
            let plane = self.carcass.x.0 + back + t;
            let place = front([plane, y0 + half / 2.0, cell.centre()[1]]);
            b.put(link, self.fronts.panels.make(half, cell.height()).at(&place));
            if i == 0 {
                let edge = y0 + handle_kind.margin();
                let handle = handle_kind.make(cell.height() * 0.6, 0.1);
                b.put(link, handle.at(&front([plane - t, edge, cell.centre()[1]])));
            } else {
                let edge = y0 + half - handle_kind.margin();
                let handle = Handles::of_kind(b, super::handle::HandleKind::None).make(0.1, 0.1);
                b.put(link, handle.at(&front([plane - t, edge, cell.centre()[1]])));
                let recess = cuboid([plane - t - 0.002, edge - 0.02, -0.08], [plane - t, edge + 0.02, 0.08]);
                let dark = b.draw(finish::dark);
                let lift = super::builder::shifted([0.0, 0.0, cell.centre()[1]]);
                b.add(link, dark, recess.untouchable().at(&lift));
            }
        }
    }
}

/// A chest with a lid on top, its opening upwards.
fn chest(b: &mut Builder, carcass: Carcass, body: Mat, accent: Mat) {
    let (x, r, t) = (carcass.x, carcass.outside, carcass.board);
    let lid_height = b.dice.real(0.03, 0.12);
    let rim = r.z.1 - lid_height;
    let tub = super::panel::tub([r.width() / 2.0, (x.1 - x.0) / 2.0], rim - r.z.0, t);
    b.add(ROOT, body, tub.at(&top([0.0, 0.0, r.z.0])));
    let over = b.dice.real(0.0, 0.03);
    let open = b.dice.real(1.3, 1.9);
    let motion = Motion::Hinge { at: [x.1, 0.0, rim], axis: [0.0, 1.0, 0.0], limits: (0.0, open) };
    let lid = b.link(ROOT, "lid", motion);
    let (low, high) = ([x.0 - over, r.y.0 - over, rim + 0.003], [x.1, r.y.1 + over, r.z.1]);
    let bevel = b.dice.real(0.0, 0.015);
    b.add(lid, accent, bevelled(low, high, bevel));
    if b.dice.chance(0.6) {
        let handles = Handles::furniture(b);
        let handle = handles.make_across(r.width() * 0.5, 0.06);
        b.put(lid, handle.at(&front([x.0 - over, 0.0, (rim + r.z.1) / 2.0])));
    }
}
