//! Boards that close an opening: door leaves, drawer fronts, lids, sashes. In a front frame around their middle:
//! x right, y up, back at z = 0, front at z = thickness.

use super::builder::{Builder, Group, Mat, shifted};
use super::finish;
use super::solid::{Solid, bevelled, cuboid};

#[derive(Clone, Copy, Debug, PartialEq)]
enum Style {
    Flat,
    /// Stiles and rails around a thinner field.
    Framed,
    /// The same with a raised field.
    Raised,
    /// Glass in a frame, with bars across: columns, rows.
    Glazed(usize, usize),
    /// Boards side by side.
    Planks(usize),
    /// Louvres in a frame.
    Slats,
}

/// The boards of one object, all alike.
#[derive(Clone, Copy, Debug)]
pub(super) struct Panels {
    style: Style,
    mat: Mat,
    field: Mat,
    pub(super) thickness: f32,
    /// Width of stiles and rails.
    rail: f32,
    bevel: f32,
}

impl Panels {
    /// Furniture fronts of this material.
    pub(super) fn furniture(b: &mut Builder, mat: Mat) -> Self {
        let style = b.dice.weighted(&[
            (4.0, Style::Flat),
            (2.0, Style::Framed),
            (1.5, Style::Raised),
            (1.0, Style::Glazed(1, 1)),
            (0.5, Style::Glazed(2, 3)),
            (0.7, Style::Planks(4)),
            (0.6, Style::Slats),
        ]);
        let field = match style {
            Style::Glazed(..) => b.draw(finish::glass),
            _ if b.dice.chance(0.2) => b.draw(finish::furniture),
            _ => mat,
        };
        let d = &mut b.dice;
        let (thickness, rail) = (d.real(0.018, 0.045), d.real(0.045, 0.11));
        Self {
            style,
            mat,
            field,
            thickness,
            rail,
            bevel: if d.chance(0.5) { d.real(0.003, 0.012) } else { 0.0 },
        }
    }

    /// Plain fronts of this material.
    pub(super) fn flat(mat: Mat, thickness: f32, bevel: f32) -> Self {
        Self { style: Style::Flat, mat, field: mat, thickness, rail: 0.05, bevel }
    }

    /// Glass fronts with bars across it.
    pub(super) fn glazed(mat: Mat, glass: Mat, thickness: f32, rail: f32, bars: (usize, usize)) -> Self {
        Self { style: Style::Glazed(bars.0, bars.1), mat, field: glass, thickness, rail, bevel: 0.0 }
    }

    /// The same, but for drawers: never glass or louvres.
    pub(super) fn for_drawers(mut self) -> Self {
        if matches!(self.style, Style::Glazed(..) | Style::Slats) {
            self.style = Style::Framed;
            self.field = self.mat;
        }
        self
    }

    /// Width of the rim on which a handle sits.
    pub(super) fn rim(&self, width: f32, height: f32) -> f32 {
        if matches!(self.style, Style::Flat | Style::Planks(_)) { 0.0 } else { self.rail_for(width, height) }
    }

    fn rail_for(&self, width: f32, height: f32) -> f32 {
        self.rail.min(0.22 * width.min(height))
    }

    /// A board of this size.
    pub(super) fn make(&self, width: f32, height: f32) -> Group {
        let (x, y, t) = (width / 2.0, height / 2.0, self.thickness);
        let rail = self.rail_for(width, height);
        let (fx, fy) = (x - rail, y - rail);
        let mut group = Group::default();
        // A recess as shallow as this one hardly matters to a hand: small boards are one piece.
        let whole = width.min(height) < 0.3;
        match self.style {
            Style::Flat => {
                group.add(self.mat, bevelled([-x, -y, 0.0], [x, y, t], self.bevel));
            }
            Style::Planks(n) => {
                let step = width / n as f32;
                for i in 0..n {
                    let left = -x + step * i as f32;
                    let plank = bevelled([left, -y, 0.0], [left + step, y, t], 0.008);
                    group.add(self.mat, plank.untouchable());
                }
                group.0[0].1.pieces = cuboid([-x, -y, 0.0], [x, y, t]).pieces;
            }
            Style::Framed | Style::Raised => {
                group.add(self.mat, ring([x, y], rail, 0.0, t));
                group.add(self.field, cuboid([-fx, -fy, t * 0.2], [fx, fy, t * 0.6]));
                if self.style == Style::Raised && fx.min(fy) > 0.05 {
                    let inset = 0.025_f32.min(fx.min(fy) * 0.4);
                    let raised = bevelled(
                        [inset - fx, inset - fy, t * 0.3],
                        [fx - inset, fy - inset, t * 0.95],
                        t * 0.3,
                    );
                    group.add(self.field, raised.untouchable());
                }
            }
            Style::Glazed(columns, rows) => {
                group.add(self.mat, ring([x, y], rail, 0.0, t));
                group.add(self.field, cuboid([-fx, -fy, t * 0.4], [fx, fy, t * 0.6]));
                let bar = (rail * 0.25).min(0.02);
                for i in 1..columns {
                    let at = -fx + 2.0 * fx * i as f32 / columns as f32;
                    group.add(
                        self.mat,
                        cuboid([at - bar, -fy, t * 0.15], [at + bar, fy, t * 0.85]).untouchable(),
                    );
                }
                for i in 1..rows {
                    let at = -fy + 2.0 * fy * i as f32 / rows as f32;
                    group.add(
                        self.mat,
                        cuboid([-fx, at - bar, t * 0.15], [fx, at + bar, t * 0.85]).untouchable(),
                    );
                }
            }
            Style::Slats => {
                group.add(self.mat, ring([x, y], rail, 0.0, t));
                group.add(self.field, cuboid([-fx, -fy, t * 0.15], [fx, fy, t * 0.4]));
                let count = (2.0 * fy / 0.06).clamp(2.0, 24.0) as usize;
                let step = 2.0 * fy / count as f32;
                for i in 0..count {
                    let low = -fy + step * i as f32;
                    let slat = cuboid([-fx, low + step * 0.12, t * 0.3], [fx, low + step * 0.88, t * 0.75]);
                    group.add(self.field, slat.untouchable());
                }
            }
        }
        if whole {
            group.0.iter_mut().for_each(|(_, solid)| solid.pieces.clear());
            group.0[0].1.pieces = cuboid([-x, -y, 0.0], [x, y, t]).pieces;
        }
        group
    }
}

/// Four bars around a rectangle of these half sizes, `width` wide, from `z0` to `z1`.
pub(super) fn ring(half: [f32; 2], width: f32, z0: f32, z1: f32) -> Solid {
    let [x, y] = half;
    cuboid([-x, -y, z0], [width - x, y, z1])
        .with(cuboid([x - width, -y, z0], [x, y, z1]))
        .with(cuboid([width - x, -y, z0], [x - width, width - y, z1]))
        .with(cuboid([width - x, y - width, z0], [x - width, y, z1]))
}

/// A hollow box open at its front (z = depth), half sizes `half`, back at z = 0: five walls.
pub(super) fn tub(half: [f32; 2], depth: f32, wall: f32) -> Solid {
    let [x, y] = half;
    ring(half, wall, wall, depth).with(cuboid([-x, -y, 0.0], [x, y, wall]).at(&shifted([0.0; 3])))
}
