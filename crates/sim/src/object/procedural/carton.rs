//! Boxes: cartons with flaps, caskets with lids.

use nalgebra::{Isometry3, Vector3};

use super::builder::{Builder, Mat, Motion, ROOT, frame, front, shifted, top};
use super::carcass::fitted;
use super::finish;
use super::handle::{HandleKind, Handles};
use super::panel::tub;
use super::solid::{Solid, bevelled, cuboid, prism};

/// Sizes of the body: along y, along x, height, wall.
#[derive(Clone, Copy)]
struct Body {
    w: f32,
    d: f32,
    h: f32,
    wall: f32,
}

pub(super) fn build(b: &mut Builder) {
    match b.dice.weighted(&[(5.0, 0), (2.5, 1), (1.2, 2), (1.3, 3)]) {
        0 => carton(b),
        1 => casket(b),
        2 => lift_off(b),
        _ => twin_lids(b),
    }
}

fn body(b: &mut Builder, radius: f32, heights: (f32, f32)) -> Body {
    let ratio = [b.dice.real(0.8, 1.6), b.dice.real(0.8, 1.3), b.dice.real(heights.0, heights.1)];
    let [w, d, h] = fitted(ratio[0], ratio[1], ratio[2], radius);
    Body { w, d, h, wall: b.dice.real(0.012, 0.035) }
}

fn shell(b: &mut Builder, size: Body, mat: Mat) {
    let walls = tub([size.w / 2.0, size.d / 2.0], size.h, size.wall);
    b.add(ROOT, mat, walls.at(&top([0.0; 3])));
}

/// The four sides: the direction inwards from each wall.
fn inwards(side: usize) -> Vector3<f32> {
    [Vector3::x(), -Vector3::x(), Vector3::y(), -Vector3::y()][side]
}

/// The frame of a flap: x along its hinge, y across it, z its outside when closed; `angle` 0 = closed, growing as it
/// opens. Turning around the frame's x opens it.
fn flap_frame(at: [f32; 3], inwards: Vector3<f32>, angle: f32) -> Isometry3<f32> {
    let axis = inwards.cross(&Vector3::z());
    frame(at, axis, inwards * angle.cos() + Vector3::z() * angle.sin())
}

/// A carton, all flaps closed or standing open.
fn carton(b: &mut Builder) {
    let size = body(b, 0.72, (0.5, 1.3));
    let mat = if b.dice.chance(0.75) { b.draw(finish::cardboard) } else { b.draw(finish::printed) };
    shell(b, size, mat);
    print(b, size);
    let closed = b.dice.chance(0.3);
    let t = b.dice.real(0.008, 0.018);
    let sides: &[usize] = match b.dice.weighted(&[(1.0, 1), (2.0, 2), (0.6, 3), (3.0, 4)]) {
        1 => &[1],
        2 if b.dice.chance(0.5) => &[0, 1],
        2 => &[2, 3],
        3 => &[1, 2, 3],
        _ => &[0, 1, 2, 3],
    };
    let open = b.dice.real(2.0, 2.7);
    let taper = b.dice.real(0.0, 0.12);
    let share = b.dice.real(0.35, 0.495);
    for &side in sides {
        let n = inwards(side);
        let (along, across) = if side < 2 { (size.w, size.d) } else { (size.d, size.w) };
        let across = if sides.len() == 1 { across - 2.0 * size.wall } else { across };
        // Front and back flaps close first, the side flaps over them.
        let level = size.h + if side < 2 || sides.len() < 3 { 0.003 } else { 0.011 + t };
        let reach = if sides.len() == 1 { across } else { across * share - 0.004 };
        let at = -n * (if side < 2 { size.d } else { size.w } / 2.0);
        let at = [at.x, at.y, level];
        let rest = if closed { 0.0 } else { open + b.dice.real(-0.35, 0.35) };
        let limit = if sides.len() == 1 { b.dice.real(2.6, 4.2) } else { 4.4 };
        let limits = (-rest, (limit - rest).max(0.2));
        let axis = n.cross(&Vector3::z());
        let link = b.link(ROOT, "lid", Motion::Hinge { at, axis: [axis.x, axis.y, axis.z], limits });
        let (half, cut) = (along / 2.0 - 0.004, taper * reach);
        let outline = [[-half, 0.0], [half, 0.0], [half - cut, reach], [cut - half, reach]];
        b.add(link, mat, prism(&outline, 0.0, t, 1.0).at(&flap_frame(at, n, rest)));
    }
}

/// A label or tape on a carton.
fn print(b: &mut Builder, size: Body) {
    if b.dice.chance(0.6) {
        let side = b.dice.real(0.25, 0.6) * size.w.min(size.h);
        let label = finish::label(&mut b.dice, side);
        let label = b.mat(label);
        let shift = [b.dice.real(-0.2, 0.2) * size.w, size.h * b.dice.real(0.4, 0.6)];
        b.add_as_mapped(ROOT, label, sticker(side).at(&front([-size.d / 2.0, shift[0], shift[1]])));
    }
}

/// A square print around the origin whose texture fills it once.
pub(super) fn sticker(side: f32) -> Solid {
    let h = side / 2.0;
    let mut print = Solid::default();
    let at =
        |x: f32, y: f32| ([x * h, y * h, 0.003].into(), Vector3::z(), [(x + 1.0) / 2.0, (y + 1.0) / 2.0]);
    print.quad([at(-1.0, -1.0), at(1.0, -1.0), at(1.0, 1.0), at(-1.0, 1.0)]);
    print
}

/// A box with one hinged lid: flat, with a skirt, or domed.
fn casket(b: &mut Builder) {
    let size = body(b, 0.85, (0.25, 1.0));
    let mat = match b.dice.count(0, 3) {
        0 => b.draw(finish::plastic),
        1 => b.draw(finish::woven),
        _ => b.draw(finish::furniture),
    };
    let lid_mat = if b.dice.chance(0.6) { mat } else { b.draw(finish::furniture) };
    shell(b, size, mat);
    let rest = if b.dice.chance(0.8) { 0.0 } else { b.dice.real(0.3, 1.7) };
    let open = b.dice.real(1.5, 2.4);
    let at = [size.d / 2.0, 0.0, size.h + 0.003];
    let motion = Motion::Hinge { at, axis: [0.0, 1.0, 0.0], limits: (-rest, open - rest) };
    let lid = b.link(ROOT, "lid", motion);
    // Over the lid's frame y runs from the hinge to the front.
    let place = flap_frame(at, -Vector3::x(), rest);
    let (half, reach) = (size.w / 2.0, size.d);
    let height = match b.dice.count(0, 2) {
        0 => {
            let t = b.dice.real(0.012, 0.05);
            let over = b.dice.real(0.0, 0.04);
            let bevel = b.dice.real(0.0, 0.3) * t;
            b.add(
                lid,
                lid_mat,
                bevelled([-half - over, 0.0, 0.0], [half + over, reach + over, t], bevel).at(&place),
            );
            t
        }
        1 => {
            let t = b.dice.real(0.1, 0.3) * size.h.max(0.3);
            let tray = tub([half, reach / 2.0], t, size.wall).at(&(frame(
                [0.0, reach / 2.0, t],
                Vector3::x(),
                -Vector3::y(),
            )));
            b.add(lid, lid_mat, tray.at(&place));
            t
        }
        _ => {
            let t = b.dice.real(0.15, 0.4) * reach;
            let outline: Vec<[f32; 2]> = (0..=10)
                .map(|i| {
                    let (s, c) = (std::f32::consts::PI * i as f32 / 10.0).sin_cos();
                    [reach / 2.0 * (1.0 + c), t * (0.25 + 0.75 * s)]
                })
                .chain([[0.0, 0.0], [reach, 0.0]])
                .collect();
            // The outline lies across the hinge: (y, z) of the lid's frame, drawn out along its x.
            let dome = prism(&outline, -half, half, 1.0).at(&frame([0.0; 3], Vector3::y(), Vector3::z()));
            b.add(lid, lid_mat, dome.at(&place));
            t * 0.3
        }
    };
    if b.dice.chance(0.65) {
        let kind = b.dice.pick(&[
            HandleKind::Knob,
            HandleKind::Loop,
            HandleKind::Lip,
            HandleKind::Ring,
            HandleKind::Bow,
        ]);
        let handles = Handles::of_kind(b, kind);
        let face = frame([0.0, reach + 0.002, height * 0.5], -Vector3::x(), Vector3::z());
        b.put(lid, handles.make_across(size.w * 0.4, 0.05).at(&(place * face)));
    }
}

/// A box whose lid lifts off.
fn lift_off(b: &mut Builder) {
    let size = body(b, 0.85, (0.35, 1.2));
    let mat = if b.dice.chance(0.5) { b.draw(finish::printed) } else { b.draw(finish::plastic) };
    let lid_mat = if b.dice.chance(0.4) { mat } else { b.draw(finish::plastic) };
    shell(b, size, mat);
    let skirt = b.dice.real(0.05, 0.25) * size.h.max(0.4);
    let over = size.wall + 0.006;
    let lift = b.dice.real(0.2, 0.6);
    let lid = b.link(ROOT, "lid", Motion::Slide { axis: [0.0, 0.0, 1.0], limits: (0.0, lift) });
    let roof = size.h + size.wall + 0.003;
    let cap = tub([size.w / 2.0 + over, size.d / 2.0 + over], skirt, size.wall);
    let upside_down = frame([0.0, 0.0, roof], Vector3::y(), Vector3::x());
    b.add(lid, lid_mat, cap.at(&upside_down));
    if b.dice.chance(0.7) {
        let kind = b.dice.pick(&[HandleKind::Knob, HandleKind::Loop, HandleKind::Bow]);
        let handles = Handles::of_kind(b, kind);
        b.put(lid, handles.make_across(size.w * 0.5, size.d * 0.5).at(&top([0.0, 0.0, roof])));
    }
}

/// A box with two lids that meet in the middle of its top.
fn twin_lids(b: &mut Builder) {
    let size = body(b, 0.85, (0.3, 0.9));
    let mat = b.draw(finish::furniture);
    shell(b, size, mat);
    let t = b.dice.real(0.012, 0.035);
    let open = b.dice.real(1.5, 2.6);
    let sides = if b.dice.chance(0.5) { [0, 1] } else { [2, 3] };
    let with_handle = b.dice.chance(0.6);
    let handles = Handles::furniture(b);
    for side in sides {
        let n = inwards(side);
        let (along, across) = if side < 2 { (size.w, size.d) } else { (size.d, size.w) };
        let edge = -n * (across / 2.0);
        // The hinge lies on top of the lid, so that its free edge does not rise over the other's.
        let at = [edge.x, edge.y, size.h + 0.003 + t];
        let axis = n.cross(&Vector3::z());
        let motion = Motion::Hinge { at, axis: [axis.x, axis.y, axis.z], limits: (0.0, open) };
        let lid = b.link(ROOT, "lid", motion);
        let place = flap_frame(at, n, 0.0);
        let reach = across / 2.0 - 0.004;
        b.add(lid, mat, cuboid([-along / 2.0, 0.0, -t], [along / 2.0, reach, 0.0]).at(&place));
        if with_handle {
            let at = shifted([0.0, reach - handles.margin() - 0.01, 0.0]);
            b.put(lid, handles.make_across(along * 0.5, 0.06).at(&(place * at)));
        }
    }
}
