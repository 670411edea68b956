//! What cabinets, tables and machines stand on and are enclosed by.

use super::builder::{Builder, Group, Mat, ROOT, shifted};
use super::cells::Rect;
use super::solid::{bevelled, cuboid, ngon, prism};

/// A size with this width, depth and height ratio whose half diagonal is `radius`.
pub(super) fn fitted(width: f32, depth: f32, height: f32, radius: f32) -> [f32; 3] {
    let k = 2.0 * radius / (width * width + depth * depth + height * height).sqrt();
    [width * k, depth * k, height * k]
}

/// A box of boards, open at the front: left, right, top, bottom and back.
#[derive(Clone, Copy, Debug)]
pub(super) struct Carcass {
    /// x of its front edges and of its back.
    pub(super) x: (f32, f32),
    /// The outside, seen from the front.
    pub(super) outside: Rect,
    /// Thickness of the boards.
    pub(super) board: f32,
}

impl Carcass {
    /// The opening between the boards.
    pub(super) fn opening(&self) -> Rect {
        self.outside.grown(-self.board)
    }

    /// Builds the five boards.
    pub(super) fn build(&self, b: &mut Builder, mat: Mat, back: Mat) {
        let ((x0, x1), r, t) = (self.x, self.outside, self.board);
        let o = self.opening();
        let mut group = Group::default();
        group.add(mat, cuboid([x0, r.y.0, r.z.0], [x1, o.y.0, r.z.1]));
        group.add(mat, cuboid([x0, o.y.1, r.z.0], [x1, r.y.1, r.z.1]));
        group.add(mat, cuboid([x0, o.y.0, r.z.0], [x1, o.y.1, o.z.0]));
        group.add(mat, cuboid([x0, o.y.0, o.z.1], [x1, o.y.1, r.z.1]));
        group.add(back, cuboid([x1 - t.min(0.02), o.y.0, o.z.0], [x1, o.y.1, o.z.1]));
        b.put(ROOT, group);
    }

    /// A board across the opening at this height, or upright at this y.
    pub(super) fn divider(&self, b: &mut Builder, mat: Mat, cell: Rect) {
        let x1 = self.x.1 - self.board.min(0.02);
        b.add(ROOT, mat, cuboid([self.x.0, cell.y.0, cell.z.0], [x1, cell.y.1, cell.z.1]));
    }
}

/// Ways to stand.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Feet {
    None,
    Plinth,
    Square,
    Round,
    Tapered,
    Wheels,
}

/// Feet under a rectangle in the ground plane, from z = 0 up to `height`.
pub(super) fn feet(b: &mut Builder, kind: Feet, x: (f32, f32), y: (f32, f32), height: f32, mat: Mat) {
    let thickness = b.dice.real(0.03, 0.07).min(0.2 * (x.1 - x.0)).min(0.2 * (y.1 - y.0));
    let inset = thickness * b.dice.real(0.5, 1.0);
    if kind == Feet::None {
        return;
    }
    if kind == Feet::Plinth {
        let inset = b.dice.real(0.0, 0.05);
        b.add(ROOT, mat, cuboid([x.0 + inset, y.0 + inset, 0.0], [x.1 - inset, y.1 - inset, height]));
        return;
    }
    let r = thickness / 2.0;
    let leg = match kind {
        Feet::Square => bevelled([-r, -r, 0.0], [r, r, height], r * 0.15),
        Feet::Round => prism(&ngon(r, 12), 0.0, height, 1.0),
        Feet::Tapered => prism(&ngon(r * 0.55, 12), 0.0, height, 1.8),
        _ => super::lathe::lathe(&[[r * 0.6, 0.0], [r, height * 0.3], [r, height * 0.7], [r * 0.6, height]]),
    };
    for px in [x.0 + inset, x.1 - inset] {
        for py in [y.0 + inset, y.1 - inset] {
            b.add(ROOT, mat, leg.clone().at(&shifted([px, py, 0.0])));
        }
    }
}
