//! The picture of a run: losses and validation over steps.

use std::fs;
use std::path::{Path, PathBuf};

use plotters::prelude::*;
use serde_json::Value;
use where2act_core::write_whole;

/// The picture cannot be drawn.
#[derive(Debug, thiserror::Error)]
#[error("{}: cannot draw the curves: {why}", path.display())]
pub struct CurvesError {
    path: PathBuf,
    why: String,
}

const SIZE: (u32, u32) = (1200, 900);
const PANELS: [(&str, &str); 4] = [
    ("score", "score: cross-entropy"),
    ("geodesic", "proposal: angle (rad)"),
    ("actionability", "actionability: squared error"),
    ("figure", "validation: mean average precision"),
];

/// Draws the curves of a metrics file (see [`crate::run::files::METRICS`]) as PNG.
///
/// # Errors
/// If the metrics cannot be read or the picture cannot be written.
pub(crate) fn draw(metrics: &Path, picture: &Path) -> Result<(), CurvesError> {
    let fail = |why: String| CurvesError { path: picture.to_owned(), why };
    let text = fs::read_to_string(metrics).map_err(|e| fail(format!("{}: {e}", metrics.display())))?;
    let lines: Vec<Value> = text.lines().filter_map(|line| serde_json::from_str(line).ok()).collect();
    let mut pixels = vec![0u8; (SIZE.0 * SIZE.1 * 3) as usize];
    paint(&lines, &mut pixels).map_err(|e| fail(e.to_string()))?;
    let image = image::RgbImage::from_raw(SIZE.0, SIZE.1, pixels)
        .ok_or_else(|| fail("wrong buffer size".to_owned()))?;
    write_whole(picture, |w| {
        let encoder = image::codecs::png::PngEncoder::new(w);
        image.write_with_encoder(encoder).map_err(std::io::Error::other)
    })
    .map_err(|e| fail(e.to_string()))
}

type DrawError = Box<dyn std::error::Error>;

fn paint(lines: &[Value], pixels: &mut [u8]) -> Result<(), DrawError> {
    // A machine without fonts draws the same picture.
    plotters::style::register_font("sans-serif", FontStyle::Normal, epaint_default_fonts::UBUNTU_LIGHT)
        .map_err(|_| "the built-in font cannot be read")?;
    let root = BitMapBackend::with_buffer(pixels, SIZE).into_drawing_area();
    root.fill(&WHITE)?;
    for (area, (key, title)) in root.split_evenly((2, 2)).iter().zip(PANELS) {
        let points: Vec<(f64, f64)> = lines.iter().filter_map(|line| point(line, key)).collect();
        panel(area, title, &points)?;
    }
    root.present()?;
    Ok(())
}

fn point(line: &Value, key: &str) -> Option<(f64, f64)> {
    let value = line.get(key).or_else(|| line.get("validation")?.get(key))?.as_f64()?;
    Some((line["step"].as_f64()?, value))
}

/// One curve: the values thin, their running mean thick.
fn panel(
    area: &DrawingArea<BitMapBackend<'_>, plotters::coord::Shift>,
    title: &str,
    points: &[(f64, f64)],
) -> Result<(), DrawError> {
    let last = points.last().map_or(1.0, |p| p.0).max(1.0);
    let mut sorted: Vec<f64> = points.iter().map(|p| p.1).collect();
    sorted.sort_by(f64::total_cmp);
    // A spike of the first steps must not flatten the rest.
    let top = sorted.get(sorted.len().saturating_sub(1) * 99 / 100).copied().unwrap_or(1.0).max(1e-6);
    let mut chart = ChartBuilder::on(area)
        .caption(title, ("sans-serif", 22))
        .margin(12)
        .x_label_area_size(30)
        .y_label_area_size(56)
        .build_cartesian_2d(0.0..last, 0.0..top * 1.05)?;
    chart.configure_mesh().light_line_style(WHITE).x_labels(6).y_labels(6).draw()?;
    chart.draw_series(LineSeries::new(points.iter().copied(), RGBColor(170, 200, 230)))?;
    let window = (points.len() / 40).max(1);
    let mean = points.chunks(window).map(|chunk| {
        let n = chunk.len() as f64;
        (chunk.iter().map(|p| p.0).sum::<f64>() / n, chunk.iter().map(|p| p.1).sum::<f64>() / n)
    });
    chart.draw_series(LineSeries::new(mean, RGBColor(20, 80, 160).stroke_width(2)))?;
    Ok(())
}
