//! Raw orientations to hand axes, many at once.

use nalgebra::Vector3;
use where2act_core::Orientation6;

/// Orientations come in blocks of this many, which the compiler turns into vectors.
pub(super) const LANES: usize = 16;

type Lanes = [f32; LANES];

/// Raw orientations `[6, n]` -> `[9, n]`: approach, forward and left of [`Orientation6::to_rotation`]; `n` is a multiple
/// of [`LANES`].
pub(super) fn axes(raw: &[f32]) -> Vec<f32> {
    let (blocks, rest) = raw.as_chunks::<LANES>();
    debug_assert!(rest.is_empty() && blocks.len().is_multiple_of(6));
    let count = blocks.len() / 6;
    let mut found = vec![0.0; 9 * count * LANES];
    for block in 0..count {
        let of_block = std::array::from_fn(|i| blocks.get(i * count + block).copied().unwrap_or_default());
        let to = found.as_chunks_mut().0.iter_mut().skip(block).step_by(count);
        to.zip(frames(&of_block)).for_each(|(to, axis)| *to = axis);
    }
    found
}

/// Approach, forward and left of one of them.
pub(super) fn columns(axes: &[f32], sample: usize) -> [Vector3<f32>; 3] {
    let n = axes.len() / 9;
    let number = |i: usize| axes.get(i * n + sample).copied().unwrap_or(0.0);
    [0, 3, 6].map(|i| Vector3::new(number(i), number(i + 1), number(i + 2)))
}

/// Gram-Schmidt as in `where2act_core::orthonormal_frame`, which is left to do what is not to be done with arithmetic
/// alone: directions too short or not finite.
#[expect(clippy::indexing_slicing, reason = "lanes of arrays of that size")]
fn frames(raw: &[Lanes; 6]) -> [Lanes; 9] {
    let mut axes = [[0.0; LANES]; 9];
    let mut shortest = [0.0; LANES];
    for i in 0..LANES {
        let (z, short_z) = unit([raw[0][i], raw[1][i], raw[2][i]]);
        let (forward, short_forward) = unit([raw[3][i], raw[4][i], raw[5][i]]);
        let (x, short_x) = unit(without(forward, z));
        let (x, _) = unit(without(x, z));
        let y = [z[1] * x[2] - z[2] * x[1], z[2] * x[0] - z[0] * x[2], z[0] * x[1] - z[1] * x[0]];
        for k in 0..3 {
            (axes[k][i], axes[3 + k][i], axes[6 + k][i]) = (z[k], x[k], y[k]);
        }
        // A sum, because a comparison would drop what is not a number.
        shortest[i] = short_z.min(short_forward).min(short_x) + 0.0 * (z[0] + forward[0] + x[0]);
    }
    for i in 0..LANES {
        // `partial_cmp`, so that NaN goes the careful way.
        if !matches!(shortest[i].partial_cmp(&1e-6), Some(std::cmp::Ordering::Greater)) {
            let rotation = Orientation6(raw.map(|lanes| lanes[i])).to_rotation();
            for (axis, column) in [2, 0, 1].into_iter().enumerate() {
                for k in 0..3 {
                    axes[3 * axis + k][i] = rotation.matrix()[(k, column)];
                }
            }
        }
    }
    axes
}

/// `v` scaled to length one, first by its largest number, and that number.
#[inline(always)]
fn unit(v: [f32; 3]) -> ([f32; 3], f32) {
    let largest = v[0].abs().max(v[1].abs()).max(v[2].abs());
    let v = v.map(|x| x / largest);
    let length = (v[0] * v[0] + v[1] * v[1] + v[2] * v[2]).sqrt();
    (v.map(|x| x / length), largest)
}

/// `v` without its part along `z`.
#[inline(always)]
fn without(v: [f32; 3], z: [f32; 3]) -> [f32; 3] {
    let along = v[0] * z[0] + v[1] * z[1] + v[2] * z[2];
    [v[0] - along * z[0], v[1] - along * z[1], v[2] - along * z[2]]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_orientation_has_the_axes_of_its_rotation() {
        let mut raw: Vec<[f32; 6]> = (0..500)
            .map(|i| std::array::from_fn(|k| ((i * 37 + k * 11) % 101) as f32 / 50.0 - 1.0))
            .collect();
        raw.extend([
            [0.0; 6],
            [f32::NAN, 0.0, 0.0, 1.0, 0.0, 0.0],
            [1.0, 0.0, 0.0, 0.0, f32::INFINITY, 0.0],
            [1.0, 2.0, 3.0, 2.0, 4.0, 6.0],
            [1e30, -1e30, 1e30, 1e-5, 2e-5, 0.0],
            [1e-7, 0.0, 0.0, 0.0, 1.0, 0.0],
            [0.0, 0.0, 1.0, 0.0, 0.0, 0.0],
        ]);
        raw.resize(512, [1.0, 0.0, 0.0, 0.0, 1.0, 0.0]);
        let planes: Vec<f32> = (0..6).flat_map(|i| raw.iter().map(move |six| six[i])).collect();
        let found = axes(&planes);
        for (sample, six) in raw.iter().enumerate() {
            let rotation = Orientation6(*six).to_rotation();
            let m = rotation.matrix();
            for (i, expected) in
                [2, 0, 1].into_iter().flat_map(|c| (0..3).map(move |k| m[(k, c)])).enumerate()
            {
                let found = found[i * 512 + sample];
                assert!((found - expected).abs() < 2e-6, "{six:?}: {found}, expected {expected}");
            }
            let columns = nalgebra::Matrix3::from_columns(&super::columns(&found, sample));
            assert!(
                (columns - nalgebra::Matrix3::from_columns(&[2, 0, 1].map(|c| m.column(c)))).amax() < 2e-6
            );
        }
    }
}
