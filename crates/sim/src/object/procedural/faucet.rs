//! Taps: one or two handles and a spout that may swing.

use std::f32::consts::PI;

use nalgebra::{Point3, Vector3};

use super::builder::{Builder, Group, LinkId, Mat, Motion, ROOT, frame, front, shifted, turned};
use super::finish;
use super::lathe::{dome, lathe};
use super::solid::{bevelled, cuboid, ngon, prism};
use super::sweep::{Section, arc, rounded, sweep, tapered};

/// What all parts of a tap share.
struct Tap {
    metal: Mat,
    accent: Mat,
    /// Radius of the column.
    column: f32,
    /// Radius of the spout.
    spout: f32,
    /// How far the spout reaches to the front.
    reach: f32,
    square: bool,
}

pub(super) fn build(b: &mut Builder) {
    let metal = b.draw(finish::fitting);
    let accent = if b.dice.chance(0.6) { metal } else { b.draw(finish::fitting) };
    let column = b.dice.real(0.07, 0.16);
    let tap = Tap {
        metal,
        accent,
        column,
        spout: column * b.dice.real(0.4, 0.8),
        reach: b.dice.real(0.6, 1.2),
        square: b.dice.chance(0.25),
    };
    match b.dice.weighted(&[(4.0, 0), (3.0, 1), (3.0, 2), (1.5, 3)]) {
        0 => tap.single_on_top(b),
        1 => tap.pair(b),
        2 => tap.single_at_side(b),
        _ => tap.on_wall(b),
    }
}

impl Tap {
    /// A post from z0 to z1 on an axis.
    fn post(&self, radius: f32, z0: f32, z1: f32) -> super::solid::Solid {
        if self.square {
            bevelled([-radius, -radius, z0], [radius, radius, z1], radius * 0.12)
        } else {
            lathe(&[[radius, z0], [radius, z1]])
        }
    }

    fn base(&self, b: &mut Builder, half_width: f32) {
        let (r, h) = (self.column * b.dice.real(1.2, 1.7), b.dice.real(0.02, 0.06));
        if half_width > 0.0 {
            let outline = super::solid::rounded_rectangle(2.0 * r, 2.0 * (half_width + r), r * 0.9);
            b.add(ROOT, self.metal, prism(&outline, 0.0, h, 0.97));
        } else if self.square {
            b.add(ROOT, self.metal, bevelled([-r, -r, 0.0], [r, r, h], h * 0.3));
        } else {
            b.add(ROOT, self.metal, lathe(&[[r, 0.0], [r, h * 0.5], [r * 0.85, h]]));
        }
    }

    /// The spout from a point on the column's axis, towards -x.
    fn spout(&self, b: &mut Builder, link: LinkId, z: f32, room_above: bool) {
        let (r, reach) = (self.spout, self.reach);
        let section = if self.square { Section::Flat(2.2 * r, 1.3 * r) } else { Section::Round(r) };
        let side = Vector3::y();
        let kind = if room_above {
            b.dice.weighted(&[(4.0, 0), (2.0, 1), (2.0, 2), (1.0, 3)])
        } else {
            b.dice.count(2, 3)
        };
        let path: Vec<Point3<f32>> = match kind {
            0 => {
                // A swan's neck.
                let rise = b.dice.real(0.3, 0.9);
                let radius = reach / 2.0;
                let drop = b.dice.real(0.1, 0.5) * rise;
                let mut path = vec![Point3::new(0.0, 0.0, z)];
                let centre = [-radius, 0.0, z + rise];
                path.extend(arc(centre, [Vector3::x(), Vector3::z()], [radius; 2], (0.0, PI)));
                path.push(Point3::new(-reach, 0.0, z + rise - drop));
                path
            }
            1 => {
                let rise = b.dice.real(0.3, 0.8);
                let bend = b.dice.real(0.03, 0.15);
                let drop = b.dice.real(0.08, 0.2);
                rounded(
                    &[
                        [0.0, 0.0, z],
                        [0.0, 0.0, z + rise],
                        [-reach, 0.0, z + rise],
                        [-reach, 0.0, z + rise - drop],
                    ],
                    bend,
                )
            }
            2 => {
                let slope = b.dice.real(-0.1, 0.35) * reach;
                let low = z - self.spout;
                let drop = b.dice.real(0.06, 0.14);
                rounded(
                    &[[0.0, 0.0, low], [-reach, 0.0, low + slope], [-reach - 0.05, 0.0, low + slope - drop]],
                    0.08,
                )
            }
            _ => {
                let rise = b.dice.real(0.1, 0.3);
                let centre = [0.0, 0.0, z - self.spout - rise * 0.2];
                arc(centre, [-Vector3::x(), Vector3::z()], [reach, rise], (PI / 2.0, 0.12))
            }
        };
        let end = path[path.len() - 1];
        let narrow = b.dice.real(0.75, 1.0);
        b.add(link, self.metal, tapered(&path, section, side, |s| 1.0 + (narrow - 1.0) * s));
        if b.dice.chance(0.5) && kind < 2 {
            let mouth = lathe(&[[r * 1.15, -0.05], [r * 1.15, 0.05]]);
            b.add(link, self.accent, mouth.at(&shifted([end.x, end.y, end.z])));
        }
    }

    /// The spout on a ring of its own that swings, or fixed.
    fn swinging_spout(&self, b: &mut Builder, z: f32, probability: f32) {
        let link = if b.dice.chance(probability) {
            let range = b.dice.real(0.7, 2.2);
            b.link(
                ROOT,
                "spout",
                Motion::Hinge { at: [0.0, 0.0, z], axis: [0.0, 0.0, 1.0], limits: (-range, range) },
            )
        } else {
            ROOT
        };
        self.spout(b, link, z, true);
    }

    /// A lever on top of the column that turns around it.
    fn single_on_top(&self, b: &mut Builder) {
        self.base(b, 0.0);
        let height = b.dice.real(0.35, 0.9);
        let r = self.column;
        b.add(ROOT, self.metal, self.post(r, 0.0, height));
        let cap = b.dice.real(0.08, 0.2);
        let spout_z = height * b.dice.real(0.65, 0.95);
        self.spout(b, ROOT, spout_z, false);
        let range = b.dice.real(0.8, 1.571);
        let at = [0.0, 0.0, height + 0.003];
        let link =
            b.link(ROOT, "switch", Motion::Hinge { at, axis: [0.0, 0.0, 1.0], limits: (-range, range) });
        let mut head = Group::default();
        if self.square {
            head.add(self.accent, self.post(r, 0.0, cap));
        } else {
            let mut profile = vec![[r, 0.0]];
            profile.extend(dome(r, cap * 0.5, cap * 0.5));
            head.add(self.accent, lathe(&profile));
        }
        let length = b.dice.real(0.3, 0.7);
        let thick = b.dice.real(0.03, 0.07);
        let rise = b.dice.real(0.0, 0.6) * length;
        // To the front over the spout, or to the back.
        let way = if b.dice.chance(0.7) { -1.0 } else { 1.0 };
        let start = [way * r * 0.3, 0.0, cap * 0.7];
        let knee = [way * length * 0.4, 0.0, cap * 0.75 + rise * 0.25];
        let tip = [way * length, 0.0, cap * 0.75 + rise];
        let path = rounded(&[start, knee, tip], 0.15);
        let section = if b.dice.chance(0.5) {
            Section::Flat(thick * 1.3, thick * 0.6)
        } else {
            Section::Round(thick / 2.0)
        };
        head.add(self.accent, sweep(&path, section, Vector3::y()));
        b.put(link, head.at(&shifted(at)));
    }

    /// Two valves beside the spout.
    fn pair(&self, b: &mut Builder) {
        let apart = b.dice.real(0.35, 0.75);
        let bridge = b.dice.chance(0.5);
        if bridge {
            self.base(b, apart);
        } else {
            self.base(b, 0.0);
        }
        let height = b.dice.real(0.15, 0.45);
        b.add(ROOT, self.metal, self.post(self.column, 0.0, height));
        self.swinging_spout(b, height, 0.35);
        let valve = b.dice.real(0.12, 0.3);
        let r = self.column * b.dice.real(0.6, 0.9);
        if !bridge && b.dice.chance(0.6) {
            let z = valve * 0.5;
            let bar = [[0.0, -apart, z], [0.0, apart, z]].map(Point3::from);
            b.add(ROOT, self.metal, sweep(&bar, Section::Round(r * 0.5), Vector3::x()));
        }
        let shape = b.dice.count(0, 3);
        let size = b.dice.real(0.1, 0.2).min(apart * 0.45);
        for side in [-1.0, 1.0] {
            let place = shifted([0.0, side * apart, 0.0]);
            b.add(
                ROOT,
                self.metal,
                lathe(&[[r * 1.3, 0.0], [r * 1.2, 0.03], [r, 0.04], [r, valve]]).at(&place),
            );
            self.valve_handle(b, [0.0, side * apart, valve + 0.003], Vector3::z(), side, shape, size);
        }
    }

    /// A handle that turns around `axis` (up or to the front): cross, lever, knob or three-spoke wheel.
    fn valve_handle(
        &self,
        b: &mut Builder,
        at: [f32; 3],
        axis: Vector3<f32>,
        side: f32,
        shape: usize,
        size: f32,
    ) {
        let a = [axis.x, axis.y, axis.z];
        let motion = if shape == 2 && b.dice.chance(0.6) {
            Motion::Spin { at, axis: a }
        } else {
            let limits = if side > 0.0 { (-1.571, 0.0) } else { (0.0, 1.571) };
            Motion::Hinge { at, axis: a, limits }
        };
        let link = b.link(ROOT, "switch", motion);
        let place = if axis.z > 0.5 { shifted(at) } else { front(at) };
        let r = (size * 0.28).clamp(0.02, 0.05);
        let mut group = Group::default();
        let z = size * 0.5;
        group.add(self.accent, lathe(&[[r * 1.5, 0.0], [r * 1.1, z - r], [r * 1.1, z + r]]));
        match shape {
            0 => {
                for angle in [0.4, 0.4 + PI / 2.0] {
                    let bar = [[-size, 0.0, z], [size, 0.0, z]].map(Point3::from);
                    let bar = sweep(&bar, Section::Round(r * 0.7), Vector3::y());
                    group.add(self.accent, bar.at(&turned(angle)));
                }
            }
            1 => {
                // Towards the outside, like an arm.
                let tip = size * 2.0;
                let path =
                    rounded(&[[0.0, 0.0, z], [0.0, side * tip * 0.5, z], [0.0, side * tip, z + 0.03]], 0.1);
                let section = Section::Flat(r * 1.6, r * 0.9);
                let lever = sweep(&path, section, Vector3::x());
                let turn = if axis.z > 0.5 { 0.0 } else { PI / 2.0 };
                group.add(self.accent, lever.at(&turned(turn)));
            }
            2 => {
                group.add(self.accent, prism(&ngon(size * 0.6, 10), z * 0.4, z * 1.7, 0.85));
            }
            _ => {
                group.add(
                    self.accent,
                    bevelled([-size, -r * 0.7, z * 0.8], [size, r * 0.7, z * 1.3], r * 0.2),
                );
            }
        }
        let mark = if side > 0.0 { [0.8, 0.1, 0.1] } else { [0.1, 0.25, 0.8] };
        let mark = b.mat(finish::plain(mark, 0.3, 20.0));
        let top = if shape == 2 { z * 1.7 } else { z + r };
        group.add(mark, lathe(&[[r * 0.5, top], [r * 0.5, top + 0.004]]).untouchable());
        b.put(link, group.at(&place));
    }

    /// A column with a lever at its side.
    fn single_at_side(&self, b: &mut Builder) {
        self.base(b, 0.0);
        let height = b.dice.real(0.3, 0.7);
        b.add(ROOT, self.metal, self.post(self.column, 0.0, height));
        self.swinging_spout(b, height, 0.6);
        let side = b.dice.sign();
        let z = height * b.dice.real(0.45, 0.75);
        let stub = self.column * b.dice.real(0.5, 0.8);
        let root = [0.0, side * self.column * 0.7, z];
        let out = self.column * 0.9;
        // A frame whose z points to the side and whose y points up.
        let place = frame(root, Vector3::x() * -side, Vector3::z());
        b.add(ROOT, self.metal, lathe(&[[stub, 0.0], [stub, out]]).at(&place));
        let at = [0.0, root[1] + side * (out + 0.003), z];
        let range = b.dice.real(0.6, 1.2);
        let motion = Motion::Hinge { at, axis: [0.0, 1.0, 0.0], limits: (-range * 0.4, range) };
        let link = b.link(ROOT, "switch", motion);
        let mut group = Group::default();
        let collar = b.dice.real(0.06, 0.14);
        group.add(self.accent, lathe(&[[stub, 0.0], [stub, collar * 0.8], [stub * 0.8, collar]]));
        let length = b.dice.real(0.25, 0.6);
        let thick = b.dice.real(0.03, 0.06);
        let lean = b.dice.real(0.0, 0.7) * length;
        let path = rounded(
            &[
                [0.0, 0.0, collar * 0.6],
                [0.0, length * 0.5, collar * 0.7],
                [0.0, length, collar * 0.7 + lean],
            ],
            0.2,
        );
        group.add(self.accent, sweep(&path, Section::Round(thick / 2.0), Vector3::x()));
        let outwards = frame(at, Vector3::x() * -side, Vector3::z());
        b.put(link, group.at(&outwards));
    }

    /// On a plate against the wall, handles towards the front.
    fn on_wall(&self, b: &mut Builder) {
        let apart = b.dice.real(0.35, 0.7);
        let (half, t) = (self.column * 1.5, b.dice.real(0.02, 0.06));
        if b.dice.chance(0.6) {
            b.add(ROOT, self.metal, cuboid([0.0, -apart - half, -half], [t, apart + half, half]));
        }
        let r = self.column * b.dice.real(0.5, 0.8);
        let stem = b.dice.real(0.1, 0.25);
        let shape = b.dice.count(0, 3);
        let size = b.dice.real(0.1, 0.18);
        for side in [-1.0, 1.0] {
            let place = front([t, side * apart, 0.0]);
            b.add(
                ROOT,
                self.metal,
                lathe(&[[r * 1.6, 0.0], [r * 1.5, t], [r, t + 0.02], [r, stem]]).at(&place),
            );
            let at = [t - stem - 0.003, side * apart, 0.0];
            self.valve_handle(b, at, -Vector3::x(), side, shape, size);
        }
        let place = front([t, 0.0, 0.0]);
        b.add(
            ROOT,
            self.metal,
            lathe(&[[r * 1.8, 0.0], [r * 1.7, t], [r * 1.2, t + 0.02], [r * 1.2, stem]]).at(&place),
        );
        let bar = [[t * 0.5, -apart, 0.0], [t * 0.5, apart, 0.0]].map(Point3::from);
        b.add(ROOT, self.metal, sweep(&bar, Section::Round(r * 0.6), Vector3::z()));
        let z = r * 0.8;
        self.spout(b, ROOT, z, false);
    }
}
