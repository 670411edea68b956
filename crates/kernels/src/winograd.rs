//! Winograd's minimal filtering: one-dimensional transforms, applied to rows and columns.
//!
//! F(m, r) computes m outputs of an r-tap filter from n = m + r - 1 inputs with n products: output
//! A^T [(G g) * (B^T d)], with matrices that follow from n - 1 interpolation points and infinity.

use crate::simd::Vector;

/// Values that a transform handles; shorter ones leave the rest unused.
pub(crate) const MAX_TILE: usize = 6;

/// One F(m, r).
pub(crate) trait Winograd {
    /// Inputs of a tile.
    const N: usize;
    /// Outputs of a tile.
    const M: usize;
    /// Taps of the filter.
    const R: usize;
    /// The finite interpolation points.
    const POINTS: &'static [f64];

    /// B^T x.
    fn input<V: Vector>(x: [V; MAX_TILE]) -> [V; MAX_TILE];
    /// A^T x; the first `M` values count.
    fn output<V: Vector>(x: [V; MAX_TILE]) -> [V; 4];

    /// G: row i holds the powers of point i, divided by the product of its differences to the other points;
    /// the last row, for infinity, takes the last tap.
    fn filter() -> Vec<[f64; 3]> {
        let points = Self::POINTS.iter().enumerate();
        let mut rows: Vec<[f64; 3]> = points
            .map(|(i, p)| {
                let others = Self::POINTS.iter().enumerate().filter(|(j, _)| *j != i);
                let scale: f64 = others.map(|(_, q)| p - q).product();
                std::array::from_fn(|k| if k < Self::R { p.powi(k as i32) / scale } else { 0.0 })
            })
            .collect();
        rows.push(std::array::from_fn(|k| f64::from(u8::from(k == Self::R - 1))));
        rows
    }
}

/// F(4, 3) with points 0, +-1/sqrt 2, +-sqrt 2, infinity: as fast as the usual 0, +-1, +-2 and five times as
/// accurate, because the points multiply to one and the matrices stay small.
pub(crate) struct F43;

const A: f32 = std::f32::consts::FRAC_1_SQRT_2;
const B: f32 = std::f32::consts::SQRT_2;

impl Winograd for F43 {
    const N: usize = 6;
    const M: usize = 4;
    const R: usize = 3;
    const POINTS: &'static [f64] = &[
        0.0,
        std::f64::consts::FRAC_1_SQRT_2,
        -std::f64::consts::FRAC_1_SQRT_2,
        std::f64::consts::SQRT_2,
        -std::f64::consts::SQRT_2,
    ];

    /// Rows: (x^2 - 1/2)(x^2 - 2); x (x +- a)(x^2 - 2); x (x +- b)(x^2 - 1/2); x (x^2 - 1/2)(x^2 - 2).
    #[inline(always)]
    fn input<V: Vector>(x: [V; MAX_TILE]) -> [V; MAX_TILE] {
        let (even_a, odd_a) = (x[2].scale_add(-2.0, x[4]), x[1].scale_add(-2.0, x[3]).scale(A));
        let (even_b, odd_b) = (x[2].scale_add(-0.5, x[4]), x[1].scale_add(-0.5, x[3]).scale(B));
        [
            x[2].scale_add(-2.5, x[0].add(x[4])),
            even_a.add(odd_a),
            even_a.sub(odd_a),
            even_b.add(odd_b),
            even_b.sub(odd_b),
            x[3].scale_add(-2.5, x[1].add(x[5])),
        ]
    }

    #[inline(always)]
    fn output<V: Vector>(x: [V; MAX_TILE]) -> [V; 4] {
        let (sum_a, dif_a) = (x[1].add(x[2]), x[1].sub(x[2]));
        let (sum_b, dif_b) = (x[3].add(x[4]), x[3].sub(x[4]));
        [
            x[0].add(sum_a).add(sum_b),
            dif_a.scale_add(A, dif_b.scale(B)),
            sum_a.scale_add(A * A, sum_b.scale(B * B)),
            dif_a.scale_add(A * A * A, dif_b.scale_add(B * B * B, x[5])),
        ]
    }
}

/// B^T for the points 0, 1, -1, infinity, which F(2, 3) and F(3, 2) share.
#[inline(always)]
fn input_of_four<V: Vector>(x: [V; MAX_TILE]) -> [V; MAX_TILE] {
    [x[2].sub(x[0]), x[2].add(x[1]), x[2].sub(x[1]), x[3].sub(x[1]), x[0], x[0]]
}

/// F(2, 3) with points 0, +-1, infinity.
pub(crate) struct F23;

impl Winograd for F23 {
    const N: usize = 4;
    const M: usize = 2;
    const R: usize = 3;
    const POINTS: &'static [f64] = &[0.0, 1.0, -1.0];

    #[inline(always)]
    fn input<V: Vector>(x: [V; MAX_TILE]) -> [V; MAX_TILE] {
        input_of_four(x)
    }
    #[inline(always)]
    fn output<V: Vector>(x: [V; MAX_TILE]) -> [V; 4] {
        let (sum, dif) = (x[1].add(x[2]), x[1].sub(x[2]));
        [x[0].add(sum), dif.add(x[3]), dif, dif]
    }
}

/// F(3, 2) with points 0, +-1, infinity.
pub(crate) struct F32;

impl Winograd for F32 {
    const N: usize = 4;
    const M: usize = 3;
    const R: usize = 2;
    const POINTS: &'static [f64] = &[0.0, 1.0, -1.0];

    #[inline(always)]
    fn input<V: Vector>(x: [V; MAX_TILE]) -> [V; MAX_TILE] {
        input_of_four(x)
    }
    #[inline(always)]
    fn output<V: Vector>(x: [V; MAX_TILE]) -> [V; 4] {
        let (sum, dif) = (x[1].add(x[2]), x[1].sub(x[2]));
        [x[0].add(sum), dif, sum.add(x[3]), dif]
    }
}
