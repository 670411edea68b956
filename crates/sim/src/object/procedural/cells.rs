//! Openings of cabinets, desks and fridges and what closes them: doors, drawers, shelves.

use super::builder::{Builder, Group, LinkId, Mat, Motion, ROOT, front};
use super::handle::{HandleKind, Handles};
use super::panel::Panels;
use super::solid::cuboid;

/// A rectangle in the plane of a front, metres: `y` to the left as seen from there, `z` up.
#[derive(Clone, Copy, Debug)]
pub(super) struct Rect {
    pub(super) y: (f32, f32),
    pub(super) z: (f32, f32),
}

impl Rect {
    pub(super) fn width(&self) -> f32 {
        self.y.1 - self.y.0
    }

    pub(super) fn height(&self) -> f32 {
        self.z.1 - self.z.0
    }

    pub(super) fn centre(&self) -> [f32; 2] {
        [(self.y.0 + self.y.1) / 2.0, (self.z.0 + self.z.1) / 2.0]
    }

    /// Larger on every side, or smaller.
    pub(super) fn grown(&self, by: f32) -> Self {
        Self { y: (self.y.0 - by, self.y.1 + by), z: (self.z.0 - by, self.z.1 + by) }
    }

    /// Split from the bottom up, with gaps of this width.
    pub(super) fn rows(&self, shares: &[f32], gap: f32) -> Vec<Self> {
        split(self.z, shares, gap).into_iter().map(|z| Self { z, ..*self }).collect()
    }

    /// Split from the right (-y) to the left, with gaps of this width.
    pub(super) fn columns(&self, shares: &[f32], gap: f32) -> Vec<Self> {
        split(self.y, shares, gap).into_iter().map(|y| Self { y, ..*self }).collect()
    }
}

fn split((low, high): (f32, f32), shares: &[f32], gap: f32) -> Vec<(f32, f32)> {
    let room = high - low - gap * (shares.len() - 1) as f32;
    let scale = room / shares.iter().sum::<f32>();
    let mut at = low;
    shares
        .iter()
        .map(|share| {
            let from = at;
            at += share * scale + gap;
            (from, from + share * scale)
        })
        .collect()
}

/// The edge a door hangs on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Side {
    /// +y, on the left as seen from the front.
    Left,
    Right,
    Top,
    Bottom,
}

/// How the fronts of an object look and fit.
#[derive(Clone, Copy, Debug)]
pub(super) struct Fronts {
    pub(super) panels: Panels,
    pub(super) handles: Handles,
    /// Material inside: trays, shelves.
    pub(super) inside: Mat,
    /// x of the plane that the backs of the fronts touch.
    pub(super) plane: f32,
    /// Depth of what lies behind.
    pub(super) depth: f32,
    /// Thickness of the boards around the openings.
    pub(super) board: f32,
    /// Clearance between neighbouring fronts.
    pub(super) gap: f32,
    /// Where along a door its handle sits, in [-1, 1] from the bottom to the top.
    pub(super) handle_height: f32,
}

impl Fronts {
    /// The rectangle a front covers for an opening: over half of the boards around it, or inside of it.
    pub(super) fn cover(&self, opening: Rect, overlay: bool) -> Rect {
        opening.grown(if overlay { (self.board - self.gap) / 2.0 } else { -self.gap })
    }

    /// Clearance that two doors need which meet at their free edges, so that neither catches the other.
    pub(super) fn meeting_gap(&self, width: f32) -> f32 {
        self.gap.max(1.6 * self.panels.thickness * self.panels.thickness / width)
    }

    /// A hinged door over a rectangle.
    pub(super) fn door(&self, b: &mut Builder, parent: LinkId, rect: Rect, side: Side) -> LinkId {
        let [y, z] = rect.centre();
        let face = self.plane - self.panels.thickness;
        let (at, axis) = match side {
            Side::Left => ([face, rect.y.1, z], [0.0, 0.0, -1.0]),
            Side::Right => ([face, rect.y.0, z], [0.0, 0.0, 1.0]),
            Side::Top => ([face, y, rect.z.1], [0.0, 1.0, 0.0]),
            Side::Bottom => ([face, y, rect.z.0], [0.0, -1.0, 0.0]),
        };
        let open = match side {
            Side::Left | Side::Right => b.dice.weighted(&[(5.0, 1.571), (2.0, 2.09), (2.0, 2.6)]),
            _ => b.dice.real(1.3, 1.65),
        };
        let link = b.link(parent, "door", Motion::Hinge { at, axis, limits: (0.0, open) });
        let place = front([self.plane, y, z]);
        b.put(link, self.panels.make(rect.width(), rect.height()).at(&place));
        self.door_handle(b, link, rect, side);
        link
    }

    fn door_handle(&self, b: &mut Builder, link: LinkId, rect: Rect, side: Side) {
        let (w, h) = (rect.width(), rect.height());
        let inset = (self.panels.rim(w, h) / 2.0).max(self.handles.margin());
        if inset > 0.4 * w.min(h) {
            return;
        }
        let [y, z] = rect.centre();
        let face = self.plane - self.panels.thickness;
        match side {
            Side::Left | Side::Right => {
                let edge = if side == Side::Left { rect.y.0 + inset } else { rect.y.1 - inset };
                let hangs = self.handles.kind == HandleKind::Ring;
                let handle = if hangs {
                    self.handles.make_across(0.1, 0.1)
                } else {
                    self.handles.make(h * 0.8, inset * 2.0)
                };
                let slack = (h / 2.0 - reach(&handle, 1) - 0.03).max(0.0);
                b.put(link, handle.at(&front([face, edge, z + self.handle_height * slack])));
            }
            Side::Top | Side::Bottom => {
                let edge = if side == Side::Top { rect.z.0 + inset } else { rect.z.1 - inset };
                b.put(link, self.handles.make_across(w * 0.8, inset * 2.0).at(&front([face, y, edge])));
            }
        }
    }

    /// One door, or two that meet in the middle if the rectangle is wide.
    pub(super) fn doors(&self, b: &mut Builder, rect: Rect) {
        let double = rect.width() > 0.9 * rect.height() || (rect.width() > 0.6 && b.dice.chance(0.7));
        if double && rect.width() > 0.35 {
            let gap = self.meeting_gap(rect.width() / 2.0);
            let halves = rect.columns(&[1.0, 1.0], gap);
            self.door(b, ROOT, halves[0], Side::Right);
            self.door(b, ROOT, halves[1], Side::Left);
        } else {
            let side = if b.dice.chance(0.5) { Side::Left } else { Side::Right };
            self.door(b, ROOT, rect, side);
        }
    }

    /// A drawer behind a rectangle; `opening` bounds its tray.
    pub(super) fn drawer(&self, b: &mut Builder, parent: LinkId, rect: Rect, opening: Rect) -> LinkId {
        let travel = self.depth * b.dice.real(0.35, 0.85);
        let link = b.link(parent, "drawer", Motion::Slide { axis: [-1.0, 0.0, 0.0], limits: (0.0, travel) });
        let [y, z] = rect.centre();
        let (w, h) = (rect.width(), rect.height());
        let panels = self.panels.for_drawers();
        b.put(link, panels.make(w, h).at(&front([self.plane, y, z])));
        self.tray(b, link, rect, opening);
        let face = self.plane - panels.thickness;
        let high =
            if matches!(self.handles.kind, HandleKind::Lip) { h / 2.0 - self.handles.margin() } else { 0.0 };
        let inset = self.handles.margin();
        if h > 2.1 * inset {
            let pair = w > 0.75 && self.handle_height > 0.0;
            let places: &[f32] = if pair { &[-0.27, 0.27] } else { &[0.0] };
            for place in places {
                let room = if pair { w * 0.4 } else { w * 0.85 };
                let handle = self.handles.make_across(room, h * 0.8);
                b.put(link, handle.at(&front([face, y + place * w, z + high])));
            }
        }
        link
    }

    fn tray(&self, b: &mut Builder, link: LinkId, rect: Rect, opening: Rect) {
        let wall = (0.012 + 0.01 * rect.width()).min(0.025);
        let (y0, y1) = (opening.y.0.max(rect.y.0) + 0.012, opening.y.1.min(rect.y.1) - 0.012);
        let (z0, top) = (opening.z.0.max(rect.z.0) + 0.012, opening.z.1.min(rect.z.1) - 0.012);
        let z1 = z0 + (top - z0) * 0.8;
        let (x0, x1) = (self.plane, self.plane + self.depth * 0.93);
        if y1 - y0 < 0.05 || z1 - z0 < 0.02 {
            return;
        }
        let mut tray = Group::default();
        tray.add(self.inside, cuboid([x0, y0, z0], [x1, y1, z0 + wall * 0.7]));
        tray.add(self.inside, cuboid([x0, y0, z0], [x1, y0 + wall, z1]));
        tray.add(self.inside, cuboid([x0, y1 - wall, z0], [x1, y1, z1]));
        tray.add(self.inside, cuboid([x1 - wall, y0, z0], [x1, y1, z1]));
        b.put(link, tray);
    }

    /// Drawers one above the other, their heights in these shares from the bottom up.
    pub(super) fn drawers(&self, b: &mut Builder, rect: Rect, opening: Rect, shares: &[f32]) {
        for row in rect.rows(shares, self.gap) {
            self.drawer(b, ROOT, row, opening);
        }
    }

    /// Fixed shelves in an opening.
    pub(super) fn shelves(&self, b: &mut Builder, opening: Rect, count: usize) {
        let x1 = self.plane + self.depth;
        for i in 1..=count {
            let z = opening.z.0 + opening.height() * i as f32 / (count + 1) as f32;
            let half = self.board.min(0.03) / 2.0;
            let shelf = cuboid([self.plane + 0.03, opening.y.0, z - half], [x1, opening.y.1, z + half]);
            b.add(ROOT, self.inside, shelf);
        }
    }
}

/// How far a group reaches from the origin along an axis.
pub(super) fn reach(group: &Group, axis: usize) -> f32 {
    group.0.iter().flat_map(|(_, solid)| &solid.mesh.positions).map(|p| p[axis].abs()).fold(0.0, f32::max)
}
