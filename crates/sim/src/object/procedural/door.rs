//! Doors in their frames.

use super::builder::{Builder, Group, LinkId, Mat, Motion, ROOT, front, shifted, turned};
use super::carcass::fitted;
use super::cells::{Rect, Side};
use super::finish;
use super::handle::{HandleKind, Handles, knob, lever};
use super::panel::Panels;
use super::solid::{bevelled, cuboid};

/// The frame around an opening and the leaves in it.
struct Doorway {
    opening: Rect,
    /// x of the frame's front and back.
    frame: (f32, f32),
    /// Leaves open towards the viewer and shut flush with the frame's front, or away from the viewer and shut flush with its
    /// back: who stands on the side that they do not open to sees them recessed, behind a stop.
    outwards: bool,
    leaf: Leaf,
}

/// How the leaves are made.
#[derive(Clone, Copy)]
struct Leaf {
    fields: usize,
    glass: bool,
    thickness: f32,
    mat: Mat,
    field_mat: Mat,
    glass_mat: Mat,
    metal: Mat,
    grip: Grip,
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Grip {
    Lever,
    Knob,
    Pull,
    Plate,
}

pub(super) fn build(b: &mut Builder) {
    let double = b.dice.chance(0.3);
    let width = if double { b.dice.real(1.2, 1.9) } else { b.dice.real(0.7, 1.1) };
    let [w, _, h] = fitted(width, 0.1, b.dice.real(1.85, 2.3), 0.96);
    let jamb = b.dice.real(0.03, 0.1);
    let deep = b.dice.real(0.06, 0.2);
    let frame_mat = if b.dice.chance(0.6) { b.draw(finish::painted) } else { b.draw(finish::wood) };
    let mat = if b.dice.chance(0.4) { frame_mat } else { b.draw(finish::furniture) };
    let field_mat = if b.dice.chance(0.75) { mat } else { b.draw(finish::furniture) };
    let leaf = Leaf {
        fields: b.dice.weighted(&[(2.0, 0), (2.0, 1), (2.0, 2), (1.5, 3), (1.0, 4), (1.0, 6)]),
        glass: b.dice.chance(0.3),
        thickness: b.dice.real(0.035, 0.08).min(deep),
        mat,
        field_mat,
        glass_mat: b.draw(finish::glass),
        metal: b.draw(finish::fitting),
        grip: b.dice.weighted(&[
            (4.0, Grip::Lever),
            (3.0, Grip::Knob),
            (2.0, Grip::Pull),
            (0.6, Grip::Plate),
        ]),
    };
    let sill = if b.dice.chance(0.4) { b.dice.real(0.015, 0.04) } else { 0.0 };
    let transom = if b.dice.chance(0.15) { h * b.dice.real(0.12, 0.2) } else { 0.0 };
    let opening = Rect { y: (jamb - w / 2.0, w / 2.0 - jamb), z: (sill, h - jamb - transom) };
    let frame = (-deep / 2.0, deep / 2.0);
    let doorway = Doorway { opening, frame, outwards: b.dice.chance(0.8), leaf };
    surround(b, [w, h], &doorway, frame_mat);
    if transom > 0.0 {
        let pane = Rect { y: opening.y, z: (opening.z.1 + jamb * 0.6, h - jamb) };
        let bar = Rect { y: opening.y, z: (opening.z.1, pane.z.0) };
        board(b, frame_mat, frame, bar);
        board(b, leaf.glass_mat, (-0.006, 0.006), pane);
    }
    if !double && b.dice.chance(0.1) {
        doorway.slide(b);
        return;
    }
    doorway.stops(b, frame_mat);
    if double {
        let gap = (2.0 * leaf.thickness * leaf.thickness / w).max(0.005);
        let halves = opening.grown(-0.004).columns(&[1.0, 1.0], gap);
        // Often only one leaf has a grip that moves.
        doorway.hang(b, halves[0], Side::Right, leaf.grip);
        let second = if b.dice.chance(0.5) { leaf.grip } else { Grip::Plate };
        doorway.hang(b, halves[1], Side::Left, second);
    } else {
        let side = if b.dice.chance(0.5) { Side::Left } else { Side::Right };
        doorway.hang(b, opening.grown(-0.004), side, leaf.grip);
    }
}

/// A fixed board that fills a rectangle between two depths.
fn board(b: &mut Builder, mat: Mat, x: (f32, f32), r: Rect) {
    b.add(ROOT, mat, cuboid([x.0, r.y.0, r.z.0], [x.1, r.y.1, r.z.1]));
}

/// Jambs, head, perhaps a sill and a casing on the wall side.
fn surround(b: &mut Builder, [w, h]: [f32; 2], doorway: &Doorway, mat: Mat) {
    let (o, x) = (doorway.opening, doorway.frame);
    board(b, mat, x, Rect { y: (-w / 2.0, o.y.0), z: (0.0, h) });
    board(b, mat, x, Rect { y: (o.y.1, w / 2.0), z: (0.0, h) });
    let jamb = w / 2.0 - o.y.1;
    board(b, mat, x, Rect { y: o.y, z: (h - jamb, h) });
    if o.z.0 > 0.0 {
        let stone = b.draw(finish::stone);
        board(b, stone, (x.0 - 0.02, x.1 + 0.02), Rect { y: o.y, z: (0.0, o.z.0) });
    }
    if b.dice.chance(0.5) {
        let trim = b.dice.real(0.012, 0.03);
        let wide = (w / 2.0 - o.y.1) * b.dice.real(0.7, 1.0);
        for (y0, y1) in [(-w / 2.0, wide - w / 2.0), (w / 2.0 - wide, w / 2.0)] {
            b.add(ROOT, mat, cuboid([x.0 - trim, y0, 0.0], [x.0, y1, h]));
        }
        b.add(ROOT, mat, cuboid([x.0 - trim, wide - w / 2.0, h - wide], [x.0, w / 2.0 - wide, h]));
    }
}

impl Doorway {
    /// x of the front of shut leaves.
    fn face(&self) -> f32 {
        if self.outwards { self.frame.0 } else { self.frame.1 - self.leaf.thickness }
    }

    /// x of the back of shut leaves.
    fn plane(&self) -> f32 {
        self.face() + self.leaf.thickness
    }

    /// Strips around the opening that shut leaves lie against, as far as the frame has room for them.
    fn stops(&self, b: &mut Builder, mat: Mat) {
        let clear = 0.002;
        let room =
            if self.outwards { self.frame.1 - self.plane() } else { self.face() - self.frame.0 } - clear;
        let deep = room.min(0.03);
        if deep < 0.006 {
            return;
        }
        let near = if self.outwards { self.plane() + clear } else { self.face() - clear - deep };
        let (x, o, proud) = ((near, near + deep), self.opening, 0.012);
        board(b, mat, x, Rect { y: (o.y.0, o.y.0 + proud), z: o.z });
        board(b, mat, x, Rect { y: (o.y.1 - proud, o.y.1), z: o.z });
        board(b, mat, x, Rect { y: (o.y.0 + proud, o.y.1 - proud), z: (o.z.1 - proud, o.z.1) });
    }

    /// A leaf on hinges.
    fn hang(&self, b: &mut Builder, rect: Rect, side: Side, grip: Grip) {
        let (edge, sign) = if side == Side::Left { (rect.y.1, -1.0) } else { (rect.y.0, 1.0) };
        let open = b.dice.pick(&[1.4, 1.571, 1.571, 2.0]);
        let (x, limits) =
            if self.outwards { (self.face(), (0.0, open)) } else { (self.plane(), (-open, 0.0)) };
        let motion = Motion::Hinge { at: [x, edge, 0.0], axis: [0.0, 0.0, sign], limits };
        let link = b.link(ROOT, "door", motion);
        let [y, z] = rect.centre();
        let body = self.leaf(b, rect.width(), rect.height());
        b.put(link, body.at(&front([self.plane(), y, z])));
        let free = if side == Side::Left { rect.y.0 } else { rect.y.1 };
        self.grip(b, link, grip, [free, rect.z.0 + rect.height() * 0.47], sign);
    }

    /// A leaf that slides in front of the frame.
    fn slide(&self, b: &mut Builder) {
        let o = self.opening.grown(0.01);
        let sign = b.dice.sign();
        let motion =
            Motion::Slide { axis: [0.0, sign, 0.0], limits: (0.0, o.width() * b.dice.real(0.6, 0.9)) };
        let link = b.link(ROOT, "door", motion);
        let [y, z] = o.centre();
        let plane = self.frame.0 - 0.04;
        let body = self.leaf(b, o.width(), o.height());
        b.put(link, body.at(&front([plane, y, z])));
        let free = if sign > 0.0 { o.y.0 } else { o.y.1 };
        let handles = Handles::of_kind(b, HandleKind::Bar);
        let inset = free + sign * (handles.margin() + 0.03);
        b.put(link, handles.make(0.7, 0.1).at(&front([plane - self.leaf.thickness, inset, z])));
        let rail_z = self.opening.z.1 + 0.03;
        let (y0, y1) = if sign > 0.0 { (o.y.0, o.y.1 + 0.3) } else { (o.y.0 - 0.3, o.y.1) };
        let rail = bevelled([self.frame.0 - 0.03, y0, rail_z], [self.frame.0, y1, rail_z + 0.03], 0.005);
        b.add(ROOT, self.leaf.metal, rail);
    }

    /// The leaf around its middle: flat, or fields of wood or glass one above the other.
    fn leaf(&self, b: &mut Builder, w: f32, h: f32) -> Group {
        let Leaf { fields, glass, thickness: t, mat, field_mat, glass_mat, .. } = self.leaf;
        if fields == 0 {
            return Panels::flat(mat, t, 0.004).make(w, h);
        }
        let columns = if fields >= 4 { 2 } else { 1 };
        let rows = fields / columns;
        let stile = b.dice.real(0.08, 0.14).min(w * 0.2);
        let shares = b.dice.shares(1.0, rows, 2.0);
        let all = Rect { y: (stile - w / 2.0, w / 2.0 - stile), z: (stile * 1.4 - h / 2.0, h / 2.0 - stile) };
        let mut group = Group::default();
        // Seen from the front x runs right; fields are symmetric, so y of the rectangles serves as x.
        group.add(mat, cuboid([-w / 2.0, -h / 2.0, 0.0], [all.y.0, h / 2.0, t]));
        group.add(mat, cuboid([all.y.1, -h / 2.0, 0.0], [w / 2.0, h / 2.0, t]));
        group.add(mat, cuboid([all.y.0, -h / 2.0, 0.0], [all.y.1, all.z.0, t]));
        group.add(mat, cuboid([all.y.0, all.z.1, 0.0], [all.y.1, h / 2.0, t]));
        let rows = all.rows(&shares, stile);
        for pair in rows.windows(2) {
            group.add(mat, cuboid([all.y.0, pair[0].z.1, 0.0], [all.y.1, pair[1].z.0, t]));
        }
        let glazed_rows = if glass { b.dice.count(1, rows.len()) } else { 0 };
        for (i, row) in rows.iter().enumerate() {
            let cells = row.columns(&vec![1.0; columns], stile * 0.7);
            for pair in cells.windows(2) {
                group.add(mat, cuboid([pair[0].y.1, row.z.0, 0.0], [pair[1].y.0, row.z.1, t]));
            }
            for cell in cells {
                let glazed = i + glazed_rows >= rows.len();
                let (m, deep) = if glazed { (glass_mat, 0.4) } else { (field_mat, 0.22) };
                let (low, high) = ([cell.y.0, cell.z.0, t * deep], [cell.y.1, cell.z.1, t * (1.0 - deep)]);
                group.add(m, cuboid(low, high));
                if !glazed && cell.width().min(cell.height()) > 0.12 {
                    let i = 0.03;
                    let (low, high) =
                        ([low[0] + i, low[1] + i, t * 0.05], [high[0] - i, high[1] - i, t * 0.95]);
                    group.add(field_mat, bevelled(low, high, t * 0.25).untouchable());
                }
            }
        }
        group
    }

    /// What the leaf is held by, near its free edge; `sign` is that of y from the hinges to there.
    fn grip(&self, b: &mut Builder, link: LinkId, grip: Grip, [edge, z]: [f32; 2], sign: f32) {
        let metal = self.leaf.metal;
        let backset = b.dice.real(0.055, 0.1);
        let y = edge - sign * backset;
        let (face, back) = (self.face(), self.plane());
        let plate = b.dice.chance(0.5);
        if plate && grip != Grip::Pull {
            let (half, tall) = (0.028, b.dice.real(0.08, 0.2));
            for x in [face, back] {
                let side = if x == face { -0.006 } else { 0.006 };
                b.add(link, metal, cuboid([x, y - half, z - tall], [x + side, y + half, z + tall]));
            }
        }
        let stand = if plate { 0.008 } else { 0.001 };
        // Both sides of the leaf turn together.
        let outer = front([face - stand, y, z]);
        let inner =
            super::builder::frame([back + stand, y, z], nalgebra::Vector3::y(), nalgebra::Vector3::z());
        match grip {
            Grip::Lever => {
                let limits = if sign > 0.0 { (0.0, 0.9) } else { (-0.9, 0.0) };
                let motion = Motion::Hinge { at: [face, y, z], axis: [1.0, 0.0, 0.0], limits };
                let handle = b.link(link, "handle", motion);
                let (length, thick, gap) =
                    (b.dice.real(0.12, 0.24), b.dice.real(0.018, 0.04), b.dice.real(0.035, 0.06));
                let one = lever(&mut b.dice, length, thick, gap, metal);
                // The lever points to the hinges: to the right in a front frame if those are at -y.
                let flip = if sign > 0.0 { shifted([0.0; 3]) } else { turned(std::f32::consts::PI) };
                b.put(handle, one.clone().at(&(outer * flip)));
                let flip = if sign < 0.0 { shifted([0.0; 3]) } else { turned(std::f32::consts::PI) };
                b.put(handle, one.at(&(inner * flip)));
            }
            Grip::Knob => {
                let handle = b.link(
                    link,
                    "knob",
                    Motion::Hinge { at: [face, y, z], axis: [1.0, 0.0, 0.0], limits: (-1.2, 1.2) },
                );
                let (shape, radius) = (b.dice.count(0, 3), b.dice.real(0.026, 0.045));
                let one = knob(shape, radius, b.dice.real(0.03, 0.05));
                b.add(handle, metal, one.clone().at(&outer));
                b.add(handle, metal, one.at(&inner));
            }
            Grip::Pull => {
                let kind = b.dice.pick(&[HandleKind::Bar, HandleKind::Loop, HandleKind::Bow]);
                let handles = Handles::of_kind(b, kind);
                let room = b.dice.real(0.4, 1.2);
                b.put(link, handles.make(room, 0.1).at(&outer));
                b.put(link, handles.make(room, 0.1).at(&inner));
            }
            Grip::Plate => {
                let (w, h) = (0.045, b.dice.real(0.1, 0.16));
                b.add(link, metal, bevelled([face - 0.005, y - w, z - h], [face, y + w, z + h], 0.002));
            }
        }
    }
}
