//! Weights `[out, in, k, k]` rearranged for the matrix product of each form.

use super::form::{Form, Source, tap_of};
use crate::gemm::Panels;
use crate::winograd::{F23, F32, F43, Winograd};
use crate::{AlignedBuf, Isa, ShapeError};

/// Weights of a convolution as a network holds them.
#[derive(Clone, Copy, Debug)]
pub struct Weights<'a> {
    /// `[outputs, inputs, k, k]`.
    pub kernel: &'a [f32],
    /// `[outputs]`; none is zero.
    pub bias: Option<&'a [f32]>,
    /// Output channels.
    pub outputs: usize,
}

/// Blocks of 16 channels of the sources, by how many of their channels are in use.
pub(super) fn valid_blocks(sources: &[Source]) -> Vec<usize> {
    let blocks = |c: usize| (0..c.div_ceil(16)).map(move |b| (c - 16 * b).min(16));
    sources.iter().flat_map(|source| blocks(source.stored())).collect()
}

/// Packed weights, and the bias padded to whole blocks.
pub(super) fn pack(
    isa: Isa,
    form: Form,
    sources: &[Source],
    weights: Weights<'_>,
) -> Result<(Panels, AlignedBuf), ShapeError> {
    let is_split = |source: &Source| matches!(source, Source::Split(_));
    let split = if form == Form::UpWinograd { 0 } else { sources.iter().filter(|s| is_split(s)).count() };
    ShapeError::check("split sources of a form that cannot read them", 0, split)?;
    if let Form::Direct { stride, .. } = form {
        ShapeError::check("steps of a convolution (1 is more than none)", 1, stride.min(1))?;
    }
    let inputs: usize = sources.iter().map(|source| source.channels()).sum();
    let area = form.kernel() * form.kernel();
    ShapeError::check("weights of a convolution", weights.outputs * inputs * area, weights.kernel.len())?;
    let outputs = weights.outputs.next_multiple_of(16);
    let mut bias = AlignedBuf::zeros(outputs);
    if let Some(values) = weights.bias {
        ShapeError::check("bias of a convolution", weights.outputs, values.len())?;
        bias[..values.len()].copy_from_slice(values);
    }

    // What stored channel k of the sources means: the channel of the weights, and its parities if split.
    let mut stored = Vec::new();
    for source in sources {
        let first = stored.last().map_or(0, |(c, _): &(usize, _)| c + 1);
        match *source {
            Source::Plain(n) => stored.extend((0..n).map(|c| (first + c, None))),
            Source::Split(n) => {
                stored.extend((0..4 * n).map(|c| (first + c / 4, Some((c / 2 % 2, c % 2)))));
            }
        }
    }
    let valid = valid_blocks(sources).repeat(form.taps());
    let kernel = |output: usize, input: usize| {
        (output < weights.outputs).then(|| &weights.kernel[(output * inputs + input) * area..][..area])
    };

    let panels = match form {
        Form::Direct { .. } => Panels::pack(isa, 1, valid, outputs, |_, k, n| {
            let (tap, input) = (k / inputs, k % inputs);
            kernel(n, input).map_or(0.0, |kernel| kernel[tap])
        }),
        Form::UpDirect => Panels::pack(isa, 4, valid, outputs, |phase, k, n| {
            let (tap, input) = (k / inputs, k % inputs);
            let small = kernel(n, input).map_or([[0.0; 3]; 3], |kernel| shrink(kernel, phase, None));
            small[tap / 2][tap % 2] as f32
        }),
        Form::UpWinograd => transformed::<F32>(isa, valid, 4 * outputs, |k, n| {
            let (input, parities) = stored[k];
            kernel(n % outputs, input).map_or([[0.0; 3]; 3], |kernel| shrink(kernel, n / outputs, parities))
        }),
        Form::Winograd2 => transformed::<F23>(isa, valid, outputs, |k, n| square(kernel(n, stored[k].0))),
        Form::Winograd4 => transformed::<F43>(isa, valid, outputs, |k, n| square(kernel(n, stored[k].0))),
    };
    Ok((panels, bias))
}

/// A 3x3 kernel in f64, zero where there is none.
fn square(kernel: Option<&[f32]>) -> [[f64; 3]; 3] {
    kernel.map_or([[0.0; 3]; 3], |kernel| {
        std::array::from_fn(|y| std::array::from_fn(|x| f64::from(kernel[3 * y + x])))
    })
}

/// The 2x2 kernel that output pixels of a phase (2 * parity of y + parity of x) see on the small picture: taps
/// of the 3x3 kernel that fall on the same pixel are summed. With `parities`, only those taps that fall on
/// pixels of these parities of the large picture.
fn shrink(kernel: &[f32], phase: usize, parities: Option<(usize, usize)>) -> [[f64; 3]; 3] {
    let (py, px) = (phase / 2, phase % 2);
    let mut small = [[0.0; 3]; 3];
    for y in 0..3 {
        for x in 0..3 {
            let here = ((py + y + 1) % 2, (px + x + 1) % 2);
            if parities.is_none_or(|parities| parities == here) {
                small[tap_of(py, y)][tap_of(px, x)] += f64::from(kernel[3 * y + x]);
            }
        }
    }
    small
}

/// G g G^T for every pair of channels, plane by plane.
fn transformed<W: Winograd>(
    isa: Isa,
    valid: Vec<usize>,
    n: usize,
    kernel: impl Fn(usize, usize) -> [[f64; 3]; 3] + Sync,
) -> Panels {
    let filter = W::filter();
    Panels::pack(isa, W::N * W::N, valid, n, |plane, k, n| {
        let (down, across) = (filter[plane / W::N], filter[plane % W::N]);
        let kernel = kernel(k, n);
        let rows = kernel.iter().map(|row| row[0] * across[0] + row[1] * across[1] + row[2] * across[2]);
        rows.zip(down).map(|(row, d)| row * d).sum::<f64>() as f32
    })
}
