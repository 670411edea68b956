//! Windows: casements, awnings, sliding and double-hung sashes.

use super::builder::{Builder, LinkId, Mat, Motion, ROOT, front, turned};
use super::carcass::fitted;
use super::cells::{Fronts, Rect, Side};
use super::finish;
use super::handle::{HandleKind, Handles, lever};
use super::panel::{Panels, ring};
use super::solid::{bevelled, cuboid};

struct Window {
    opening: Rect,
    /// x of the frame's front and back.
    frame: (f32, f32),
    sash: Panels,
    mat: Mat,
    metal: Mat,
}

pub(super) fn build(b: &mut Builder) {
    let ratio = b.dice.real(0.6, 1.7);
    let [w, _, h] = fitted(ratio, 0.12, 1.1, 0.95);
    let mat = match b.dice.count(0, 3) {
        0 | 1 => b.draw(finish::painted),
        2 => b.draw(finish::wood),
        _ => b.draw(finish::steel),
    };
    let glass = {
        let clear = [[0.62, 0.74, 0.78], [0.75, 0.85, 0.88], [0.5, 0.6, 0.62]];
        let mut finish = finish::plain(b.dice.pick(&clear), 0.9, 90.0);
        finish.material.opacity = b.dice.real(0.2, 0.5);
        b.mat(finish)
    };
    let metal = b.draw(finish::fitting);
    let (bar, deep) = (b.dice.real(0.04, 0.1), b.dice.real(0.1, 0.22));
    let bars = b.dice.pick(&[(1, 1), (1, 1), (1, 2), (2, 2), (2, 3), (3, 3)]);
    let (thick, rail) = (b.dice.real(0.025, deep * 0.42), b.dice.real(0.035, 0.08));
    let sash = Panels::glazed(mat, glass, thick, rail, bars);
    let outside = Rect { y: (-w / 2.0, w / 2.0), z: (-h / 2.0, h / 2.0) };
    let frame = (-deep / 2.0, deep / 2.0);
    b.add(ROOT, mat, ring([w / 2.0, h / 2.0], bar, -frame.1, -frame.0).at(&front([0.0; 3])));
    if b.dice.chance(0.5) {
        let (out, t) = (b.dice.real(0.02, 0.1), 0.03);
        let low = [frame.0 - out, -w / 2.0 - 0.03, -h / 2.0 - t];
        b.add(ROOT, mat, bevelled(low, [frame.1, w / 2.0 + 0.03, -h / 2.0], 0.006));
    }
    let window = Window { opening: outside.grown(-bar), frame, sash, mat, metal };
    match b.dice.weighted(&[(3.5, 0), (1.2, 1), (3.0, 2), (3.0, 3), (1.0, 4)]) {
        0 => window.casements(b),
        1 => {
            let fanlight = b.dice.chance(0.5);
            window.tilting(b, fanlight);
        }
        2 => window.sliding(b),
        3 => window.hung(b),
        _ => window.casement_beside_fixed(b),
    }
}

impl Window {
    fn fronts(&self, b: &mut Builder, kind: HandleKind) -> Fronts {
        Fronts {
            panels: self.sash,
            handles: Handles::of_kind(b, kind),
            inside: self.mat,
            plane: self.frame.0 + self.sash.thickness,
            depth: 0.1,
            board: 0.03,
            gap: 0.005,
            handle_height: 0.0,
        }
    }

    fn grip(b: &mut Builder) -> HandleKind {
        b.dice.weighted(&[
            (1.5, HandleKind::None),
            (2.0, HandleKind::Bow),
            (2.0, HandleKind::Loop),
            (1.5, HandleKind::Bar),
            (1.0, HandleKind::Knob),
            (1.0, HandleKind::Lip),
        ])
    }

    /// A pane without a joint.
    fn fixed(&self, b: &mut Builder, rect: Rect, plane: f32) {
        let [y, z] = rect.centre();
        b.put(ROOT, self.sash.make(rect.width(), rect.height()).at(&front([plane, y, z])));
    }

    /// One or two sashes hinged at the sides.
    fn casements(&self, b: &mut Builder) {
        let kind = Self::grip(b);
        let fronts = self.fronts(b, kind);
        let rect = self.opening.grown(-0.004);
        if rect.width() > 0.7 && b.dice.chance(0.75) {
            let halves = rect.columns(&[1.0, 1.0], fronts.meeting_gap(rect.width() / 2.0));
            let right = fronts.door(b, ROOT, halves[0], Side::Right);
            fronts.door(b, ROOT, halves[1], Side::Left);
            if kind == HandleKind::None {
                self.latch(b, right, halves[0].y.1, 1.0);
            }
        } else {
            let side = if b.dice.chance(0.5) { Side::Left } else { Side::Right };
            let sash = fronts.door(b, ROOT, rect, side);
            if kind == HandleKind::None {
                let (edge, sign) = if side == Side::Left { (rect.y.0, -1.0) } else { (rect.y.1, 1.0) };
                self.latch(b, sash, edge, sign);
            }
        }
    }

    /// A lever that turns on a sash's free stile; `sign` of y from the hinges to there.
    fn latch(&self, b: &mut Builder, sash: LinkId, edge: f32, sign: f32) {
        let at = [self.frame.0 - 0.001, edge - sign * 0.025, self.opening.centre()[1]];
        // It hangs at rest.
        let motion = Motion::Hinge { at, axis: [1.0, 0.0, 0.0], limits: (-1.571, 1.571) };
        let link = b.link(sash, "handle", motion);
        let (length, thick) = (b.dice.real(0.12, 0.22), b.dice.real(0.018, 0.03));
        let gap = b.dice.real(0.03, 0.05);
        let handle = lever(&mut b.dice, length, thick, gap, self.metal);
        b.put(link, handle.at(&(front(at) * turned(-std::f32::consts::FRAC_PI_2))));
    }

    /// Hinged above; as a fanlight over a fixed pane, or alone.
    fn tilting(&self, b: &mut Builder, fanlight: bool) {
        let kind = Self::grip(b);
        let fronts = self.fronts(b, kind);
        let rect = self.opening.grown(-0.004);
        if fanlight {
            let share = b.dice.real(0.25, 0.45);
            let rows = rect.rows(&[1.0 - share, share], 0.03);
            self.fixed(b, rows[0].grown(0.004), fronts.plane);
            let bar = Rect { y: self.opening.y, z: (rows[0].z.1 + 0.002, rows[1].z.0 - 0.004) };
            b.add(ROOT, self.mat, cuboid([self.frame.0, bar.y.0, bar.z.0], [self.frame.1, bar.y.1, bar.z.1]));
            fronts.door(b, ROOT, rows[1], Side::Top);
        } else {
            fronts.door(b, ROOT, rect, Side::Top);
        }
    }

    /// Two sashes in two tracks, one or both of which slide sideways.
    fn sliding(&self, b: &mut Builder) {
        let rect = self.opening.grown(-0.003);
        let lap = 0.05;
        let half = rect.width() / 2.0 + lap / 2.0;
        let t = self.sash.thickness;
        let both = b.dice.chance(0.6);
        let kind = Self::grip(b);
        let handles = Handles::of_kind(b, kind);
        let front_first = b.dice.sign();
        for (i, plane) in [self.frame.0 + t, self.frame.0 + 2.0 * t + 0.008].into_iter().enumerate() {
            let side = if i == 0 { front_first } else { -front_first };
            // A sash on side -1 (right) slides to the left (+y).
            let y = if side < 0.0 { rect.y.0 + half / 2.0 } else { rect.y.1 - half / 2.0 };
            let z = rect.centre()[1];
            if i == 1 && !both {
                self.fixed(b, Rect { y: (y - half / 2.0, y + half / 2.0), z: rect.z }, plane);
                continue;
            }
            let travel = (rect.width() - half) * 0.97;
            let motion = Motion::Slide { axis: [0.0, -side, 0.0], limits: (0.0, travel) };
            let link = b.link(ROOT, "window", motion);
            b.put(link, self.sash.make(half, rect.height()).at(&front([plane, y, z])));
            if i == 0 {
                let inset = handles.margin().max(self.sash.rim(half, rect.height()) / 2.0);
                let edge = y + side * (half / 2.0 - inset);
                b.put(link, handles.make(rect.height() * 0.5, 0.08).at(&front([plane - t, edge, z])));
            }
        }
    }

    /// Double hung: the lower sash slides up in front of the upper one.
    fn hung(&self, b: &mut Builder) {
        let rect = self.opening.grown(-0.003);
        let lap = 0.04;
        let half = rect.height() / 2.0 + lap / 2.0;
        let t = self.sash.thickness;
        let (y, low, high) = (rect.centre()[0], rect.z.0 + half / 2.0, rect.z.1 - half / 2.0);
        let travel = (rect.height() - half) * 0.95;
        let plane = self.frame.0 + t;
        let lower = b.link(ROOT, "window", Motion::Slide { axis: [0.0, 0.0, 1.0], limits: (0.0, travel) });
        b.put(lower, self.sash.make(rect.width(), half).at(&front([plane, y, low])));
        let kind = Self::grip(b);
        let handles = Handles::of_kind(b, kind);
        let rail = self.sash.rim(rect.width(), half).max(2.0 * handles.margin());
        let pair = rect.width() > 0.8 && kind == HandleKind::Knob;
        for offset in if pair { &[-0.25, 0.25][..] } else { &[0.0][..] } {
            let at = [plane - t, y + offset * rect.width(), rect.z.0 + rail / 2.0];
            b.put(lower, handles.make_across(rect.width() * 0.5, rail).at(&front(at)));
        }
        self.fixed(b, Rect { y: rect.y, z: (high - half / 2.0, high + half / 2.0) }, plane + t + 0.008);
    }

    /// A casement and a fixed pane.
    fn casement_beside_fixed(&self, b: &mut Builder) {
        let kind = Self::grip(b);
        let fronts = self.fronts(b, kind);
        let rect = self.opening.grown(-0.004);
        let share = b.dice.real(0.35, 0.65);
        let columns = rect.columns(&[share, 1.0 - share], 0.03);
        self.fixed(b, columns[0].grown(0.004), fronts.plane);
        let bar = (columns[0].y.1 + 0.002, columns[1].y.0 - 0.004);
        let z = self.opening.z;
        b.add(ROOT, self.mat, cuboid([self.frame.0, bar.0, z.0], [self.frame.1, bar.1, z.1]));
        let side = if b.dice.chance(0.5) { Side::Left } else { Side::Right };
        let sash = fronts.door(b, ROOT, columns[1], side);
        if kind == HandleKind::None {
            let (edge, sign) =
                if side == Side::Left { (columns[1].y.0, -1.0) } else { (columns[1].y.1, 1.0) };
            self.latch(b, sash, edge, sign);
        }
    }
}
