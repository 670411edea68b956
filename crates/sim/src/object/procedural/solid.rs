//! Bodies with flat faces: boxes, bevelled boxes, prisms, plates with a hole.

use nalgebra::{Isometry3, Point3, Vector3};

use crate::object::{ConvexPiece, Mesh};

/// A body: what cameras see of it and the convex pieces that hands touch. Texture coordinates are in metres.
#[derive(Clone, Debug, Default)]
pub(super) struct Solid {
    pub(super) mesh: Mesh,
    pub(super) pieces: Vec<ConvexPiece>,
}

/// A corner of a triangle: position, normal, texture coordinate.
pub(super) type Corner = (Point3<f32>, Vector3<f32>, [f32; 2]);

impl Solid {
    /// The same body elsewhere.
    pub(super) fn at(mut self, pose: &Isometry3<f32>) -> Self {
        self.mesh.positions.iter_mut().for_each(|p| *p = pose * *p);
        self.mesh.normals.iter_mut().for_each(|n| *n = pose * *n);
        self.pieces.iter_mut().flat_map(|piece| &mut piece.points).for_each(|p| *p = pose * *p);
        self
    }

    /// The same body for the eye alone: prints, grooves, things too thin to touch.
    pub(super) fn untouchable(mut self) -> Self {
        self.pieces.clear();
        self
    }

    /// Both bodies as one.
    pub(super) fn with(mut self, other: Self) -> Self {
        append(&mut self.mesh, &other.mesh);
        self.pieces.extend(other.pieces);
        self
    }

    /// Adds a vertex.
    pub(super) fn vertex(&mut self, (position, normal, uv): Corner) -> u32 {
        self.mesh.positions.push(position);
        self.mesh.normals.push(normal);
        self.mesh.uvs.push(uv);
        (self.mesh.positions.len() - 1) as u32
    }

    /// Adds a triangle, wound counter-clockwise as seen from where its normals point.
    pub(super) fn triangle(&mut self, a: u32, b: u32, c: u32) {
        let p = |i: u32| self.mesh.positions[i as usize];
        let n = |i: u32| self.mesh.normals[i as usize];
        let face = (p(b) - p(a)).cross(&(p(c) - p(a)));
        if face.norm_squared() < 1e-16 {
            return;
        }
        let outwards = face.dot(&(n(a) + n(b) + n(c))) >= 0.0;
        self.mesh.triangles.push(if outwards { [a, b, c] } else { [a, c, b] });
    }

    /// Adds a quadrilateral, its corners in order around it.
    pub(super) fn quad(&mut self, corners: [Corner; 4]) {
        let [a, b, c, d] = corners.map(|corner| self.vertex(corner));
        self.triangle(a, b, c);
        self.triangle(a, c, d);
    }

    /// Adds a flat convex polygon.
    pub(super) fn polygon(&mut self, points: &[Point3<f32>], normal: Vector3<f32>, uvs: &[[f32; 2]]) {
        let first = self.mesh.positions.len() as u32;
        for (&p, &uv) in points.iter().zip(uvs) {
            self.vertex((p, normal, uv));
        }
        for i in 1..points.len() as u32 - 1 {
            self.triangle(first, first + i, first + i + 1);
        }
    }
}

/// Adds the triangles of `other` to `mesh`.
pub(super) fn append(mesh: &mut Mesh, other: &Mesh) {
    let first = mesh.positions.len() as u32;
    mesh.positions.extend_from_slice(&other.positions);
    mesh.normals.extend_from_slice(&other.normals);
    mesh.uvs.extend_from_slice(&other.uvs);
    mesh.triangles.extend(other.triangles.iter().map(|t| t.map(|i| i + first)));
}

/// An axis-aligned box between two corners, in any order.
pub(super) fn cuboid(a: [f32; 3], b: [f32; 3]) -> Solid {
    bevelled(a, b, 0.0)
}

/// A box with chamfered edges, shaded as if they were round. The grain runs along its longest side.
pub(super) fn bevelled(a: [f32; 3], b: [f32; 3], bevel: f32) -> Solid {
    let (a, b) = (Point3::from(a), Point3::from(b));
    let (min, max) = (a.inf(&b), a.sup(&b));
    let half = (max - min) / 2.0;
    let centre = min + half;
    let bevel = bevel.min(half.min() * 0.9);
    let grain = half.imax();
    let uv = |p: &Vector3<f32>, axis: usize| {
        let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
        if u == grain { [p[v], p[u]] } else { [p[u], p[v]] }
    };
    // The corner of the face across `axis` on the side `s[axis]`, with the signs `s` for all three axes.
    let corner = |s: [f32; 3], axis: usize| {
        let p = Vector3::from_fn(|i, _| s[i] * (half[i] - if i == axis { 0.0 } else { bevel }));
        let mut normal = Vector3::zeros();
        normal[axis] = s[axis];
        (centre + p, normal, uv(&p, axis))
    };
    let mut solid = Solid::default();
    let signs = [-1.0, 1.0];
    for axis in 0..3 {
        let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
        for sign in signs {
            let at = |su: f32, sv: f32| {
                let mut s = [0.0; 3];
                (s[axis], s[u], s[v]) = (sign, su, sv);
                corner(s, axis)
            };
            solid.quad([at(-1.0, -1.0), at(1.0, -1.0), at(1.0, 1.0), at(-1.0, 1.0)]);
        }
        if bevel > 0.0 {
            // The edges along `axis`, between the faces across u and v.
            for (su, sv) in [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)] {
                let at = |end: f32, face: usize| {
                    let mut s = [0.0; 3];
                    (s[axis], s[u], s[v]) = (end, su, sv);
                    corner(s, face)
                };
                solid.quad([at(-1.0, u), at(1.0, u), at(1.0, v), at(-1.0, v)]);
            }
        }
    }
    if bevel > 0.0 {
        for i in 0..8 {
            let s = [0, 1, 2].map(|axis| signs[i >> axis & 1]);
            let [a, b, c] = [0, 1, 2].map(|axis| solid.vertex(corner(s, axis)));
            solid.triangle(a, b, c);
        }
    }
    solid.pieces.push(ConvexPiece::cuboid(min, max));
    solid
}

/// A prism over a convex outline in the xy plane (counter-clockwise), from `z0` to `z1`, its top outline scaled by
/// `taper`. Outlines that turn by less than 40 degrees at a corner are shaded smoothly there.
pub(super) fn prism(outline: &[[f32; 2]], z0: f32, z1: f32, taper: f32) -> Solid {
    let n = outline.len();
    let bottom: Vec<_> = outline.iter().map(|p| Point3::new(p[0], p[1], z0)).collect();
    let top: Vec<_> = outline.iter().map(|p| Point3::new(p[0] * taper, p[1] * taper, z1)).collect();
    let normals: Vec<Vector3<f32>> = (0..n)
        .map(|i| {
            let along = bottom[(i + 1) % n] - bottom[i];
            along.cross(&(top[i] - bottom[i])).try_normalize(1e-12).unwrap_or_else(Vector3::z)
        })
        .collect();
    let blend = |i: usize, other: usize| {
        if normals[i].dot(&normals[other]) > 0.766 {
            (normals[i] + normals[other]).normalize()
        } else {
            normals[i]
        }
    };
    let mut solid = Solid::default();
    let mut along = 0.0;
    for i in 0..n {
        let j = (i + 1) % n;
        let (from, to) = (blend(i, (i + n - 1) % n), blend(i, j));
        let width = (bottom[j] - bottom[i]).norm();
        solid.quad([
            (bottom[i], from, [along, z0]),
            (bottom[j], to, [along + width, z0]),
            (top[j], to, [along + width, z1]),
            (top[i], from, [along, z1]),
        ]);
        along += width;
    }
    let uvs = |points: &[Point3<f32>]| points.iter().map(|p| [p.x, p.y]).collect::<Vec<_>>();
    solid.polygon(&bottom, -Vector3::z(), &uvs(&bottom));
    solid.polygon(&top, Vector3::z(), &uvs(&top));
    solid.pieces.push(ConvexPiece { points: bottom.into_iter().chain(top).collect() });
    solid
}

/// A rectangle around the origin with round corners.
pub(super) fn rounded_rectangle(width: f32, height: f32, radius: f32) -> Vec<[f32; 2]> {
    let radius = radius.min(width.min(height) * 0.499).max(1e-3);
    let steps = 4;
    let mut outline = Vec::with_capacity(4 * (steps + 1));
    for quarter in 0..4 {
        let (sx, sy) = [(1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0), (1.0, -1.0)][quarter];
        for step in 0..=steps {
            let angle = std::f32::consts::FRAC_PI_2 * (quarter as f32 + step as f32 / steps as f32);
            outline.push([
                sx * (width / 2.0 - radius) + radius * angle.cos(),
                sy * (height / 2.0 - radius) + radius * angle.sin(),
            ]);
        }
    }
    outline
}

/// A regular polygon or, with many sides, a circle around the origin.
pub(super) fn ngon(radius: f32, sides: usize) -> Vec<[f32; 2]> {
    (0..sides)
        .map(|i| {
            let angle = std::f32::consts::TAU * (i as f32 + 0.5) / sides as f32;
            [radius * angle.cos(), radius * angle.sin()]
        })
        .collect()
}

/// A rectangular plate in the xy plane from `z0` to `z1`, half sizes `half`, with a round hole around `hole` of this
/// radius: 12 pieces.
pub(super) fn plate_with_hole(half: [f32; 2], hole: [f32; 2], radius: f32, z0: f32, z1: f32) -> Solid {
    let sectors = 12;
    let fine = 4;
    let mut solid = Solid::default();
    // Where the ray from the hole's centre leaves the plate.
    let rim = |angle: f32| {
        let d = [angle.cos(), angle.sin()];
        let reach = (0..2)
            .filter(|&i| d[i].abs() > 1e-6)
            .map(|i| (d[i].signum() * half[i] - hole[i]) / d[i])
            .fold(f32::INFINITY, f32::min);
        [hole[0] + d[0] * reach, hole[1] + d[1] * reach]
    };
    let corners = [[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]]
        .map(|s: [f32; 2]| [s[0] * half[0], s[1] * half[1]])
        .map(|c| ((c[1] - hole[1]).atan2(c[0] - hole[0]).rem_euclid(std::f32::consts::TAU), c));
    let step = std::f32::consts::TAU / sectors as f32;
    let on_circle = |angle: f32, r: f32| [hole[0] + r * angle.cos(), hole[1] + r * angle.sin()];
    let lift = |p: [f32; 2], z: f32| Point3::new(p[0], p[1], z);
    for sector in 0..sectors {
        let (from, to) = (sector as f32 * step, (sector + 1) as f32 * step);
        let mut outer = vec![rim(from)];
        outer.extend(
            corners.iter().filter(|(angle, _)| (from + 1e-4..to - 1e-4).contains(angle)).map(|c| c.1),
        );
        outer.push(rim(to));
        // The hull's inner side is a chord: half of its sagitta is given to either side.
        let inner = radius * 2.0 / (1.0 + (step / 2.0).cos());
        let mut points = Vec::new();
        for z in [z0, z1] {
            points.extend(outer.iter().map(|&p| lift(p, z)));
            points.extend([from, to].map(|a| lift(on_circle(a, inner), z)));
        }
        solid.pieces.push(ConvexPiece { points });
        let arc: Vec<_> = (0..=fine).map(|i| on_circle(to - step * i as f32 / fine as f32, radius)).collect();
        let middle = outer[outer.len() / 2];
        for (z, normal) in [(z0, -Vector3::z()), (z1, Vector3::z())] {
            let at = |p: [f32; 2]| (lift(p, z), normal, p);
            let centre = solid.vertex(at(middle));
            let ring: Vec<_> = outer[..].iter().chain(&arc).map(|&p| solid.vertex(at(p))).collect();
            for i in 0..ring.len() {
                solid.triangle(centre, ring[i], ring[(i + 1) % ring.len()]);
            }
        }
        for pair in arc.windows(2) {
            let at = |p: [f32; 2], z: f32| {
                let inwards = Vector3::new(hole[0] - p[0], hole[1] - p[1], 0.0) / radius;
                (lift(p, z), inwards, [p[0] + p[1], z])
            };
            solid.quad([at(pair[0], z0), at(pair[1], z0), at(pair[1], z1), at(pair[0], z1)]);
        }
        for pair in outer.windows(2) {
            let along = lift(pair[1], 0.0) - lift(pair[0], 0.0);
            let normal = along.cross(&Vector3::z()).try_normalize(1e-9).unwrap_or_else(Vector3::x);
            let at = |p: [f32; 2], z: f32| (lift(p, z), normal, [p[0] + p[1], z]);
            solid.quad([at(pair[0], z0), at(pair[1], z0), at(pair[1], z1), at(pair[0], z1)]);
        }
    }
    solid
}
