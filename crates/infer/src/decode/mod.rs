//! Features become proposals: actionability everywhere, candidates where it peaks, orientations there, their scores.

mod candidates;
mod heads;
mod select;

pub(crate) use candidates::Places;
pub(crate) use heads::{Codes, DecodingHeads};
pub(crate) use select::{Scored, select};

/// 1 / (1 + exp(-x)).
pub(crate) fn sigmoid(logit: f32) -> f32 {
    1.0 / (1.0 + (-logit).exp())
}
