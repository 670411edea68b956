//! Colours of actionability.

use colorgrad::Gradient;

/// The colour of a value in [0, 1]: turbo, from blue to red.
#[must_use]
pub fn heat_colour(value: f32) -> [u8; 3] {
    let [r, g, b, _] = colorgrad::preset::turbo().at(value.clamp(0.0, 1.0)).to_rgba8();
    [r, g, b]
}

/// Opacity of the heat over a picture: what is not actionable stays visible as it is.
pub(crate) fn heat_opacity(value: f32) -> u8 {
    (255.0 * (0.08 + 0.72 * value.clamp(0.0, 1.0).sqrt())) as u8
}

/// The value that has the last colour, where a map reaches `max`: the next of 1, 0.5, 0.2, 0.1, ... 0.0001. So there are few
/// scales, and maps of one scale can be compared.
#[must_use]
pub fn heat_end(max: f32) -> f32 {
    let steps = [1e-4, 2e-4, 5e-4, 1e-3, 2e-3, 5e-3, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5];
    steps.into_iter().find(|s| max <= *s).unwrap_or(1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bars_end_at_the_next_of_few_numbers() {
        assert_eq!([heat_end(0.51), heat_end(1.0), heat_end(0.5), heat_end(0.0)], [1.0, 1.0, 0.5, 1e-4]);
        assert_eq!(heat_end(0.07), 0.1);
        assert_eq!(heat_end(f32::NAN), 1.0);
    }

    #[test]
    fn low_is_blue_and_high_is_red() {
        let ([low_r, _, low_b], [high_r, _, high_b]) = (heat_colour(0.1), heat_colour(0.95));
        assert!(low_b > low_r && high_r > high_b);
    }
}
