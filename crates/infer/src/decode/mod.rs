//! Features become proposals: actionability everywhere, candidates where it peaks, orientations there, their scores.

mod candidates;
mod frames;
mod heads;
mod second_look;
mod select;
#[cfg(test)]
mod tests;
mod ways;

pub(crate) use candidates::Places;
pub(crate) use heads::{Codes, DecodingHeads, Tried};
pub(crate) use second_look::LOOKS;
pub(crate) use select::{Scored, select};

/// 1 / (1 + exp(-x)), to some 3e-7. The library's exponential would be called number by number, a quarter of a million times
/// a picture; this one is arithmetic that the compiler does in vectors.
#[inline]
pub(crate) fn sigmoid(logit: f32) -> f32 {
    // 1.5 * 2^23: what is added to it is rounded to a whole number, which then stands in the lowest bits.
    const ROUND: f32 = 12_582_912.0;
    // exp(-x) = 2^n exp(r), |r| <= ln 2 / 2, with ln 2 in two parts so that r is exact enough.
    let x = (-logit).clamp(-87.0, 87.0);
    let rounded = x * std::f32::consts::LOG2_E + ROUND;
    let n = rounded - ROUND;
    let r = x - n * 0.693_359_4 + n * 2.121_944_4e-4;
    // Taylor's series: its next term is below (ln 2 / 2)^8 / 8! = 5e-9.
    let terms = [1.0 / 5040.0, 1.0 / 720.0, 1.0 / 120.0, 1.0 / 24.0, 1.0 / 6.0, 0.5, 1.0, 1.0];
    let series = terms.into_iter().fold(0.0, |sum, term| sum * r + term);
    let power = f32::from_bits((rounded.to_bits() << 23).wrapping_add(1.0f32.to_bits()));
    1.0 / (1.0 + series * power)
}
