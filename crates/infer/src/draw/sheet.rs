//! The contact sheet: the input, every primitive's overlay, and how to read them, on one page.

use image::RgbImage;
use where2act_core::Prediction;

use super::canvas::{Canvas, Rgba, text_width};
use super::overlay::{INK, PAPER, overlay, overlay_size};
use super::view::View;
use crate::DenseMaps;

const FAINT: Rgba = [95, 105, 120, 255];
const HEADER: usize = 70;
const GAP: usize = 18;

/// Draws the contact sheet of a prediction over the observation it was made for; `maps` are those of that prediction.
#[must_use]
pub fn draw_sheet(maps: &DenseMaps<'_>, prediction: &Prediction) -> RgbImage {
    sheet(maps, prediction).map(Canvas::into_rgb).unwrap_or_default()
}

fn sheet(maps: &DenseMaps<'_>, prediction: &Prediction) -> Option<Canvas> {
    let view = View::new(maps.observation);
    let (cell_width, cell_height) = overlay_size(&view);
    let cells = prediction.primitives.len() + 2;
    let columns = if cells <= 4 { cells } else { cells.div_ceil(2).min(4) };
    let rows = cells.div_ceil(columns);
    let width = columns * (cell_width + GAP) + GAP;
    let mut canvas = Canvas::new(width, HEADER + rows * (cell_height + GAP), PAPER)?;
    let at = |cell: usize| {
        (GAP + cell % columns * (cell_width + GAP), HEADER + cell / columns * (cell_height + GAP))
    };

    let source = if prediction.input.source.is_empty() { "observation" } else { &prediction.input.source };
    canvas.text((GAP as f32, 12.0), 26.0, INK, &fitted(source, 26.0, (width - 2 * GAP) as f32));
    let short: String = prediction.model.sha256.chars().take(12).collect();
    let about = format!("{}, {} ({short})", prediction.input.kind, prediction.model.name);
    canvas.text((GAP as f32, 41.0), 19.0, FAINT, &about);

    let (x, y) = at(0);
    canvas.text((x as f32 + 8.0, y as f32 + 6.0), 26.0, INK, "input");
    canvas.paste(&view.canvas(false)?, x as i32, y as i32 + 40);
    for (cell, of) in prediction.primitives.iter().enumerate() {
        let (x, y) = at(cell + 1);
        canvas.paste(&overlay(&view, maps, of)?, x as i32, y as i32);
    }
    let has_points = prediction.primitives.iter().flat_map(|of| &of.proposals).any(|p| p.point.is_some());
    let (x, y) = at(cells - 1);
    legend(&mut canvas, (x as f32 + 8.0, y as f32 + 6.0), has_points);
    Some(canvas)
}

fn legend(canvas: &mut Canvas, (x, y): (f32, f32), has_points: bool) {
    canvas.text((x, y), 26.0, INK, "how to read");
    let size = if has_points {
        "        (at least as large as they are)"
    } else {
        "        (how large is not known)"
    };
    let lines = [
        "colour: how actionable a place is",
        "        (bars end at 1, 0.5, 0.2, ...:",
        "        compare their numbers)",
        "white hand: the best proposal",
        "grey hands: the next two",
        size,
        "dots: the other proposals",
        "magenta arrow: motion after contact",
        "magenta disc: where the hand touches",
        "1 0.93: rank, score",
        "        (no rate of success)",
    ];
    for (i, line) in lines.iter().enumerate() {
        canvas.text((x, y + 50.0 + 32.0 * i as f32), 23.0, FAINT, line);
    }
}

/// The end of a text that is too wide for a line: of a path that is what tells it from others.
fn fitted(text: &str, size: f32, width: f32) -> String {
    if text_width(text, size) <= width {
        return text.to_owned();
    }
    let mut rest = text.chars();
    while rest.next().is_some() {
        let short = format!("...{}", rest.as_str());
        if text_width(&short, size) <= width {
            return short;
        }
    }
    String::new()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn long_names_keep_their_end() {
        assert_eq!(fitted("a.png", 26.0, 1000.0), "a.png");
        let long = format!("{}/é/cabinet.png", "folder/".repeat(100));
        let short = fitted(&long, 26.0, 400.0);
        assert!(short.starts_with("...") && short.ends_with("/é/cabinet.png"), "{short}");
        assert!(text_width(&short, 26.0) <= 400.0);
        assert_eq!(fitted("abc", 26.0, 1.0), "");
    }
}
