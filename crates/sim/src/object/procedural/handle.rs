//! Handles and knobs that do not move on their own, in a front frame: x right, y up, z towards the viewer, their base
//! at z = 0. A handle runs along y.
//!
//! A hand opens 0.08 m, whatever the object's size: most handles are thinner than that and stand off enough for a
//! finger, as in PartNet-Mobility; a few are not.

use std::f32::consts::{FRAC_PI_2, PI, TAU};

use nalgebra::Vector3;

use super::builder::{Builder, Group, Mat, shifted, turned};
use super::dice::Dice;
use super::lathe::{dome, lathe};
use super::solid::{Solid, bevelled, cuboid, ngon, prism};
use super::sweep::{Section, arc, rounded, sweep, tapered};

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum HandleKind {
    /// A straight bar on two posts.
    Bar,
    /// A bent rod, from surface to surface.
    Bow,
    /// A rod with two square corners.
    Loop,
    /// A round or square knob.
    Knob,
    /// A plate that stands out, with a hooked edge.
    Lip,
    /// A shell open at one side.
    Cup,
    /// A ring that hangs from a plate.
    Ring,
    /// Nothing to hold.
    None,
}

/// The handles of one object, all alike.
#[derive(Clone, Copy, Debug)]
pub(super) struct Handles {
    pub(super) kind: HandleKind,
    mat: Mat,
    post_mat: Mat,
    /// Thickness of what a hand closes around, metres.
    thickness: f32,
    /// Clear space behind it.
    gap: f32,
    /// Share of the room along y that a long handle takes.
    reach: f32,
    flat: bool,
    shape: usize,
}

/// A kind of handle as furniture has it.
const FURNITURE: [(f32, HandleKind); 8] = [
    (3.0, HandleKind::Bar),
    (2.5, HandleKind::Bow),
    (2.0, HandleKind::Loop),
    (3.5, HandleKind::Knob),
    (1.2, HandleKind::Lip),
    (0.8, HandleKind::Cup),
    (0.6, HandleKind::Ring),
    (1.0, HandleKind::None),
];

/// A kind of handle as machines have it.
const MACHINE: [(f32, HandleKind); 5] = [
    (4.0, HandleKind::Bar),
    (2.0, HandleKind::Bow),
    (2.5, HandleKind::Loop),
    (1.0, HandleKind::Lip),
    (1.2, HandleKind::None),
];

impl Handles {
    /// Handles for furniture.
    pub(super) fn furniture(b: &mut Builder) -> Self {
        let kind = b.dice.weighted(&FURNITURE);
        Self::of_kind(b, kind)
    }

    /// Handles for machines.
    pub(super) fn machine(b: &mut Builder) -> Self {
        let kind = b.dice.weighted(&MACHINE);
        Self::of_kind(b, kind)
    }

    /// Handles of one kind.
    pub(super) fn of_kind(b: &mut Builder, kind: HandleKind) -> Self {
        let mat =
            if b.dice.chance(0.8) { b.draw(super::finish::fitting) } else { b.draw(super::finish::wood) };
        let post_mat = if b.dice.chance(0.8) { mat } else { b.draw(super::finish::fitting) };
        let d = &mut b.dice;
        Self {
            kind,
            mat,
            post_mat,
            thickness: if d.chance(0.85) { d.real(0.016, 0.042) } else { d.real(0.042, 0.085) },
            gap: if d.chance(0.85) { d.real(0.034, 0.07) } else { d.real(0.012, 0.034) },
            reach: d.real(0.2, 0.75),
            flat: d.chance(0.4),
            shape: d.count(0, 5),
        }
    }

    /// How far the handle's middle stays from the edge of what it is on.
    pub(super) fn margin(&self) -> f32 {
        match self.kind {
            HandleKind::Knob => 0.055,
            HandleKind::Ring => 0.07,
            HandleKind::Cup => 0.05,
            HandleKind::Lip => self.thickness * 0.9 + 0.025,
            _ => self.thickness / 2.0 + 0.025,
        }
    }

    /// A handle for a place with this room along y and across.
    pub(super) fn make(&self, room: f32, across: f32) -> Group {
        let mut group = Group::default();
        let t = self.thickness.min(across * 0.5);
        let length = (room * self.reach).clamp(0.12_f32.min(room * 0.9), 1.1);
        let section = if self.flat { Section::Flat(t, t * 0.7) } else { Section::Round(t / 2.0) };
        let out = self.gap + t / 2.0;
        match self.kind {
            HandleKind::None => {}
            HandleKind::Bar => {
                let (y, post) = (length / 2.0, length * 0.38);
                let bar = if self.flat {
                    bevelled([-t / 2.0, -y, self.gap], [t / 2.0, y, self.gap + t * 0.7], t * 0.12)
                } else {
                    sweep(&[[0.0, -y, out].into(), [0.0, y, out].into()], section, Vector3::x())
                };
                group.add(self.mat, bar);
                let foot = prism(&ngon(t * 0.38, if self.flat { 4 } else { 10 }), 0.0, out, 1.0);
                for side in [-post, post] {
                    group.add(self.post_mat, foot.clone().at(&shifted([0.0, side, 0.0])));
                }
            }
            HandleKind::Bow => {
                let path = arc(
                    [0.0, 0.0, -0.2 * out],
                    [Vector3::y(), Vector3::z()],
                    [length / 2.0, out * 1.2],
                    (0.16, PI - 0.16),
                );
                group.add(self.mat, sweep(&path, section, Vector3::x()));
            }
            HandleKind::Loop => {
                let y = length / 2.0;
                let path = rounded(
                    &[[0.0, -y, 0.0], [0.0, -y, out], [0.0, y, out], [0.0, y, 0.0]],
                    if self.shape.is_multiple_of(2) { 0.015 } else { 0.04 },
                );
                group.add(self.mat, sweep(&path, section, Vector3::x()));
            }
            HandleKind::Knob => group.0.push((self.mat, knob(self.shape, self.knob_radius(), self.gap))),
            HandleKind::Lip => {
                let (y, t) = (length / 2.0, t * 0.5);
                group.add(self.mat, cuboid([-t / 2.0, -y, 0.0], [t / 2.0, y, self.gap]));
                group.add(self.mat, bevelled([-t * 1.8, -y, self.gap - t], [t / 2.0, y, self.gap], t * 0.2));
            }
            HandleKind::Cup => {
                let (y, h, wall) = ((length / 2.0).min(0.16), 0.035, 0.01);
                group.add(self.mat, bevelled([h - wall, -y, 0.0], [h, y, self.gap + wall], 0.004));
                group.add(self.mat, bevelled([-h * 0.4, -y, self.gap], [h, y, self.gap + wall], 0.004));
                for side in [-1.0, 1.0] {
                    group.add(
                        self.mat,
                        cuboid([-h * 0.4, side * y, 0.0], [h, side * (y - wall), self.gap + wall]),
                    );
                }
            }
            HandleKind::Ring => {
                group
                    .add(self.post_mat, lathe(&[[0.04, 0.0], [0.036, 0.008], [0.014, 0.012], [0.012, 0.03]]));
                let radius = 0.05;
                let path = arc([-radius, 0.0, 0.032], [Vector3::x(), Vector3::y()], [radius; 2], (0.0, TAU));
                group.add(self.mat, sweep(&path, Section::Round(0.009), Vector3::z()));
            }
        }
        group
    }

    /// The same handle along x, what opens to -x now opening down.
    pub(super) fn make_across(&self, room: f32, height: f32) -> Group {
        self.make(room, height).at(&turned(FRAC_PI_2))
    }

    fn knob_radius(&self) -> f32 {
        (self.thickness * 0.9).clamp(0.018, 0.042)
    }
}

/// A knob of one of six shapes, its face about `gap + radius` out.
pub(super) fn knob(shape: usize, radius: f32, gap: f32) -> Solid {
    let r = radius;
    let stem = r * 0.45;
    match shape % 6 {
        0 => {
            let mut profile = vec![[r * 0.8, 0.0], [stem, 0.008], [stem, gap * 0.7]];
            profile.extend((0..=8).map(|i| {
                let (s, c) = (PI * (0.14 + 0.86 * i as f32 / 8.0)).sin_cos();
                [(r * s).max(1e-3), gap * 0.7 + r * 0.9 - r * c]
            }));
            lathe(&profile)
        }
        1 => {
            let mut profile = vec![[stem, 0.0], [stem, gap], [r, gap + 0.004]];
            profile.extend(dome(r, gap + 0.012, r * 0.35));
            lathe(&profile)
        }
        2 => lathe(&[[r, 0.0], [r, gap + r * 0.6], [r * 0.88, gap + r * 0.7]]),
        3 => lathe(&[[r * 0.6, 0.0], [r * 0.5, gap * 0.5], [r, gap + r * 0.3], [r * 0.9, gap + r * 0.5]]),
        4 => prism(&ngon(stem, 8), 0.0, gap, 1.0).with(bevelled(
            [-r * 0.9, -r * 0.9, gap],
            [r * 0.9, r * 0.9, gap + r * 0.7],
            r * 0.12,
        )),
        _ => prism(&ngon(r, 6), 0.0, gap + r * 0.4, 0.85),
    }
}

/// A dial to turn: a disc with a grip across it or a pointer mark, its back at z = 0.
pub(super) fn dial(dice: &mut Dice, radius: f32, mat: Mat, mark: Mat) -> Group {
    let mut group = Group::default();
    let height = radius * dice.real(0.5, 1.1);
    match dice.count(0, 3) {
        0 => {
            group.add(mat, lathe(&[[radius, 0.0], [radius, height * 0.45], [radius * 0.92, height * 0.5]]));
            let (w, h) = (radius * 0.2, radius * 0.92);
            group.add(mat, bevelled([-w, -h, height * 0.4], [w, h, height], w * 0.3));
        }
        1 => {
            group.add(mat, lathe(&[[radius, 0.0], [radius * 0.85, height], [radius * 0.75, height * 1.04]]));
        }
        2 => {
            group.add(mat, prism(&ngon(radius, 12), 0.0, height, 0.9));
        }
        _ => {
            group.add(
                mat,
                lathe(&[[radius, 0.0], [radius * 0.98, height * 0.2], [radius * 0.6, height * 0.3]]),
            );
            group.add(mat, lathe(&[[radius * 0.6, height * 0.3], [radius * 0.55, height]]));
        }
    }
    let (w, y) = (radius * 0.07, radius * 0.5);
    let point = cuboid([-w, y * 0.3, height * 1.02], [w, y * 1.05, height * 1.05]);
    group.add(mark, point.untouchable());
    group
}

/// A lever from its pivot at the origin along x, `length` long, standing `gap` off the surface at z = 0.
pub(super) fn lever(dice: &mut Dice, length: f32, thickness: f32, gap: f32, mat: Mat) -> Group {
    let mut group = Group::default();
    let r = thickness / 2.0;
    let z = gap + r;
    group.add(mat, lathe(&[[r * 1.9, 0.0], [r * 1.8, 0.012], [r * 0.9, 0.016], [r * 0.9, z]]));
    let section =
        if dice.chance(0.5) { Section::Round(r) } else { Section::Flat(thickness, thickness * 0.7) };
    let droop = dice.pick(&[0.0, 0.0, -0.25, 0.2]) * length;
    match dice.count(0, 2) {
        0 => {
            let path = [[-r, 0.0, z], [length, 0.0, z]].map(Into::into);
            group.add(mat, sweep(&path, section, Vector3::y()));
        }
        1 => {
            let path = rounded(&[[-r, 0.0, z], [length * 0.5, 0.0, z], [length, droop, z]], length * 0.4);
            let end = dice.real(0.6, 1.0);
            group.add(mat, tapered(&path, section, Vector3::y(), |s| 1.0 + (end - 1.0) * s));
        }
        _ => {
            let path = rounded(&[[-r, 0.0, z], [length, 0.0, z], [length, 0.0, gap * 0.5]], 0.02);
            group.add(mat, sweep(&path, section, Vector3::y()));
        }
    }
    group
}
