//! One primitive on one picture: heat, colour bar, hands, scores.

use image::RgbImage;
use rayon::prelude::*;
use where2act_core::{Primitive, PrimitivePrediction, Proposal};

use super::canvas::{Canvas, Rgba, label_extent, text_width};
use super::hand::draw_hand;
use super::heat::{heat_colour, heat_end, heat_opacity};
use super::labels::Taken;
use super::view::{Spot, View};
use crate::DenseMaps;

pub(crate) const INK: Rgba = [25, 30, 40, 255];
pub(crate) const PAPER: Rgba = [255, 255, 255, 255];
const LABEL_GROUND: Rgba = [255, 255, 255, 215];
/// Height of the line above the picture.
const TITLE: usize = 40;
/// Width of the colour bar's strip at the right.
const BAR: usize = 98;
/// Height of the text on labels and beside the colour bar: still legible on a contact sheet at half its size.
const LABEL_SIZE: f32 = 19.0;
/// Hands drawn: more of them hide the picture. The others are dots.
const HANDS: usize = 3;
/// Share of the picture's longer side that 0.1 m of a hand takes at least.
const HAND_SHARE: f32 = 0.09;

/// Draws what a prediction says about one primitive over the observation it was made for; `maps` are those of that prediction.
///
/// Heat is actionability, by a colour bar that ends at [`heat_end`] of the map's maximum; the white hand is the best proposal,
/// grey ones come next, dots are the rest; the arrow is the motion after contact, numbers are scores. Hands are drawn so large
/// that they can be seen: at least 9 % of the picture's longer side for 0.1 m, and without depth always that.
#[must_use]
pub fn draw_overlay(maps: &DenseMaps<'_>, of: &PrimitivePrediction) -> RgbImage {
    overlay(&View::new(maps.observation), maps, of).map(Canvas::into_rgb).unwrap_or_default()
}

/// Size of every overlay of a view.
pub(crate) fn overlay_size(view: &View) -> (usize, usize) {
    (view.size.width.max(260) + BAR, view.size.height + TITLE)
}

pub(crate) fn overlay(view: &View, maps: &DenseMaps<'_>, of: &PrimitivePrediction) -> Option<Canvas> {
    let (width, height) = overlay_size(view);
    let mut canvas = Canvas::new(width, height, PAPER)?;
    let end = heat_end(of.actionability.max);
    let mut picture = view.canvas(true)?;
    paint_heat(&mut picture, view, maps, of.primitive, end);
    draw_proposals(&mut picture, view, of);
    canvas.paste(&picture, 0, TITLE as i32);
    draw_bar(&mut canvas, view, end);

    canvas.text((8.0, 6.0), 26.0, INK, of.primitive.name());
    let best =
        of.proposals.first().map_or("no proposal".to_owned(), |p| format!("best {}", two_digits(p.score)));
    let at = (width as f32 - text_width(&best, 20.0) - 10.0, 10.0);
    canvas.text(at, 20.0, INK, &best);
    Some(canvas)
}

fn paint_heat(canvas: &mut Canvas, view: &View, maps: &DenseMaps<'_>, primitive: Primitive, end: f32) {
    let value = |x, y| match view.spot(x, y) {
        Spot::Picture(u, v) => maps.at(primitive, u, v),
        Spot::Point(i) => maps.at_point(primitive, i as usize),
        Spot::Nothing => None,
    };
    let rows = (0..view.size.height).into_par_iter();
    let rows: Vec<Vec<Option<f32>>> =
        rows.map(|y| (0..view.size.width).map(|x| value(x, y)).collect()).collect();
    for (y, row) in (0..).zip(rows) {
        for (x, value) in (0..).zip(row) {
            if let Some(value) = value {
                let [r, g, b] = heat_colour(value / end);
                canvas.blend(x, y, [r, g, b, heat_opacity(value / end)]);
            }
        }
    }
}

fn draw_proposals(canvas: &mut Canvas, view: &View, of: &PrimitivePrediction) {
    let span = HAND_SHARE * view.size.width.max(view.size.height) as f32;
    let centre = |p: &Proposal| match (p.point, view.lens.intrinsics) {
        (Some(point), Some(intrinsics)) => intrinsics.project(&point.into()).unwrap_or((-1.0, -1.0)),
        _ => view.lens.centre(p.pixel),
    };
    for proposal in of.proposals.iter().skip(HANDS) {
        canvas.disc(centre(proposal), 0.07 * span, [10, 20, 40, 255]);
        canvas.disc(centre(proposal), 0.045 * span, [255, 255, 255, 255]);
    }
    // The best last, on top.
    let mut taken = Taken::default();
    for proposal in of.proposals.iter().take(HANDS).rev() {
        draw_hand(canvas, &view.lens, of.primitive, proposal, span, &mut taken);
    }
    let extent = (canvas.width() as f32, canvas.height() as f32);
    for proposal in of.proposals.iter().take(HANDS) {
        let text = format!("{} {}", proposal.rank, two_digits(proposal.score));
        let size = label_extent(&text, LABEL_SIZE);
        let corner = taken.place(centre(proposal), size, 0.3 * span, extent);
        canvas.label(corner, LABEL_SIZE, &text, INK, LABEL_GROUND);
    }
}

/// A score as pictures show it, rounded down: none of them is certain.
fn two_digits(score: f32) -> String {
    format!("{:.2}", (100.0 * score).floor() / 100.0)
}

fn draw_bar(canvas: &mut Canvas, view: &View, end: f32) {
    let (left, top, bottom) = (canvas.width() - BAR + 12, TITLE + 14, TITLE + view.size.height - 14);
    let rows = bottom.saturating_sub(top).max(1);
    for row in 0..rows {
        let value = 1.0 - row as f32 / rows as f32;
        let [r, g, b] = heat_colour(value);
        for x in 0..16 {
            canvas.blend((left + x) as i32, (top + row) as i32, [r, g, b, 255]);
        }
    }
    for share in [0.0, 0.5, 1.0] {
        let y = bottom as f32 - share * rows as f32;
        canvas.line(&[(left as f32 + 16.0, y), (left as f32 + 21.0, y)], 1.5, INK);
        let number = format!("{}", (share * end * 1e6).round() / 1e6);
        canvas.text((left as f32 + 24.0, y - 0.5 * LABEL_SIZE), LABEL_SIZE, INK, &number);
    }
}
