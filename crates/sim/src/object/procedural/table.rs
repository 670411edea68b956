//! Tables and desks with drawers and doors.

use super::builder::{Builder, Mat, ROOT, shifted};
use super::carcass::{Carcass, Feet, feet, fitted};
use super::cells::{Fronts, Rect, Side};
use super::finish;
use super::handle::Handles;
use super::lathe::lathe;
use super::panel::Panels;
use super::solid::{bevelled, cuboid, ngon, prism};

struct Desk {
    w: f32,
    d: f32,
    h: f32,
    /// Thickness of the top and how far it reaches over.
    slab: f32,
    over: f32,
    frame: Mat,
    fronts: Fronts,
}

pub(super) fn build(b: &mut Builder) {
    let (rw, rd, rh) = b.dice.pick(&[
        (1.5, 0.8, 0.8),
        (1.2, 0.6, 0.75),
        (0.6, 0.55, 0.7),
        (1.2, 0.8, 0.45),
        (1.0, 0.4, 0.8),
    ]);
    let [w, d, h] =
        fitted(rw * b.dice.real(0.85, 1.2), rd * b.dice.real(0.85, 1.2), rh * b.dice.real(0.85, 1.15), 0.93);
    let frame = b.draw(finish::furniture);
    let first = b.finish_of(frame);
    let tone = finish::companion(&mut b.dice, &first);
    let tone = b.mat(tone);
    let top = match b.dice.count(0, 4) {
        0 => b.draw(finish::stone),
        1 => b.draw(finish::glass),
        2 => tone,
        _ => frame,
    };
    let face = if b.dice.chance(0.6) { frame } else { tone };
    let panels = Panels::furniture(b, face).for_drawers();
    let fronts = Fronts {
        panels,
        handles: Handles::furniture(b),
        inside: frame,
        plane: -d / 2.0 + panels.thickness,
        depth: d - panels.thickness - 0.04,
        board: b.dice.real(0.018, 0.04),
        gap: b.dice.real(0.004, 0.008),
        handle_height: b.dice.real(0.0, 1.0),
    };
    let (slab, over) = (b.dice.real(0.02, 0.06), b.dice.real(0.01, 0.06));
    let bevel = b.dice.real(0.0, 0.4) * slab;
    let low = [-d / 2.0 - over, -w / 2.0 - over, h - slab];
    b.add(ROOT, top, bevelled(low, [d / 2.0 + over, w / 2.0 + over, h], bevel));
    let desk = Desk { w, d, h, slab, over, frame, fronts };
    match b.dice.weighted(&[(4.0, 0), (3.0, 1), (2.0, 2), (1.0, 3)]) {
        0 => desk.legs_and_apron(b),
        1 => desk.pedestals(b),
        2 => desk.shelf_below(b),
        _ => desk.column(b),
    }
}

impl Desk {
    /// A carcass under the top for drawers side by side.
    fn apron(&self, b: &mut Builder, width: f32, height: f32) {
        let z1 = self.h - self.slab;
        let outside = Rect { y: (-width / 2.0, width / 2.0), z: (z1 - height, z1) };
        let carcass = Carcass { x: (-self.d / 2.0, self.d / 2.0), outside, board: self.fronts.board };
        carcass.build(b, self.frame, self.frame);
        let opening = carcass.opening();
        let count = ((width / b.dice.real(0.35, 0.8)) as usize).clamp(1, 4);
        let cells = opening.columns(&vec![1.0; count], self.fronts.board);
        for pair in cells.windows(2) {
            carcass.divider(b, self.frame, Rect { y: (pair[0].y.1, pair[1].y.0), z: opening.z });
        }
        let rows: &[f32] = if height > 0.3 { &[1.0, 1.0] } else { &[1.0] };
        for cell in cells {
            self.fronts.drawers(b, self.fronts.cover(cell, false), cell, rows);
        }
    }

    fn leg_kind(b: &mut Builder) -> Feet {
        b.dice.pick(&[Feet::Square, Feet::Square, Feet::Round, Feet::Tapered])
    }

    fn legs_and_apron(&self, b: &mut Builder) {
        let height = b.dice.real(0.12, 0.26).min(self.h * 0.45);
        self.apron(b, self.w, height);
        let kind = Self::leg_kind(b);
        let (x, y) = ((-self.d / 2.0, self.d / 2.0), (-self.w / 2.0, self.w / 2.0));
        feet(b, kind, x, y, self.h - self.slab - height, self.frame);
    }

    /// Cabinets at one or both sides, and perhaps a drawer between them.
    fn pedestals(&self, b: &mut Builder) {
        let both = b.dice.chance(0.45) && self.w > 1.0;
        let width = self.w * b.dice.real(0.22, 0.36);
        let top = self.h - self.slab;
        let first = b.dice.sign();
        for side in if both { &[1.0, -1.0][..] } else { &[1.0][..] } {
            let side = side * first;
            let edge = side * self.w / 2.0;
            let inner = edge - side * width;
            let outside = Rect { y: (edge.min(inner), edge.max(inner)), z: (b.dice.pick(&[0.0, 0.03]), top) };
            let carcass = Carcass { x: (-self.d / 2.0, self.d / 2.0), outside, board: self.fronts.board };
            carcass.build(b, self.frame, self.frame);
            let cell = carcass.opening();
            let cover = self.fronts.cover(cell, false);
            if b.dice.chance(0.7) {
                let count = b.dice.count(2, 4);
                let mut shares = b.dice.shares(1.0, count, 1.8);
                shares.sort_by(|a, b| b.total_cmp(a));
                self.fronts.drawers(b, cover, cell, &shares);
            } else {
                let shelves = b.dice.count(0, 2);
                self.fronts.shelves(b, cell, shelves);
                let hinge = if side > 0.0 { Side::Left } else { Side::Right };
                self.fronts.door(b, ROOT, cover, hinge);
            }
        }
        if !both {
            let t = self.fronts.board;
            let y = -first * self.w / 2.0;
            if b.dice.chance(0.5) {
                let (x, inner) = ((-self.d / 2.0, self.d / 2.0), y + first * t);
                b.add(ROOT, self.frame, cuboid([x.0, y, 0.0], [x.1, inner, top]));
            } else {
                let span = (y.min(y + first * 0.12), y.max(y + first * 0.12));
                feet(b, Feet::Square, (-self.d / 2.0, self.d / 2.0), span, top, self.frame);
            }
        }
        if b.dice.chance(0.6) {
            let x = self.d / 2.0 - 0.03;
            let span = self.w / 2.0 - 0.02;
            b.add(ROOT, self.frame, cuboid([x, -span, top * 0.45], [x + 0.02, span, top]));
        }
    }

    /// A side table: a drawer under the top, a shelf between the legs.
    fn shelf_below(&self, b: &mut Builder) {
        self.legs_and_apron(b);
        let z = self.h * b.dice.real(0.12, 0.3);
        let (x, y) = (self.d / 2.0 - 0.03, self.w / 2.0 - 0.03);
        b.add(ROOT, self.frame, cuboid([-x, -y, z], [x, y, z + 0.02]));
    }

    /// A drawer box on one column with a broad foot.
    fn column(&self, b: &mut Builder) {
        let height = b.dice.real(0.12, 0.22).min(self.h * 0.4);
        self.apron(b, self.w * 0.8, height);
        let z = self.h - self.slab - height;
        let r = b.dice.real(0.05, 0.11);
        let reach = 0.45 * self.w.min(self.d) + self.over;
        if b.dice.chance(0.5) {
            b.add(
                ROOT,
                self.frame,
                lathe(&[[reach, 0.0], [reach, 0.02], [r * 1.4, 0.06], [r, 0.12], [r, z]]),
            );
        } else {
            b.add(ROOT, self.frame, prism(&ngon(r, 4), 0.0, z, 1.0));
            for turn in [0.0, std::f32::consts::FRAC_PI_2] {
                let bar = bevelled([-reach, -0.04, 0.0], [reach, 0.04, 0.05], 0.01);
                b.add(ROOT, self.frame, bar.at(&super::builder::turned(turn)).at(&shifted([0.0; 3])));
            }
        }
    }
}
