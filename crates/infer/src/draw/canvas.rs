//! A picture to draw on: anti-aliased shapes and text.

use ab_glyph::{Font, FontRef, ScaleFont, point};
use image::RgbImage;
use tiny_skia::{Color, FillRule, LineCap, LineJoin, Paint, PathBuilder, Pixmap, Stroke, Transform};

/// Colour and opacity, each 0-255.
pub(crate) type Rgba = [u8; 4];
/// Position in pixels from the upper left corner.
pub(crate) type Xy = (f32, f32);

pub(crate) struct Canvas {
    pixels: Pixmap,
}

impl Canvas {
    /// A canvas of one colour; `None` for sides of 0 or above 16,384 pixels.
    pub(crate) fn new(width: usize, height: usize, [r, g, b, a]: Rgba) -> Option<Self> {
        let side = |n: usize| u32::try_from(n).ok().filter(|n| (1..=16_384).contains(n));
        let mut pixels = Pixmap::new(side(width)?, side(height)?)?;
        pixels.fill(Color::from_rgba8(r, g, b, a));
        Some(Self { pixels })
    }

    pub(crate) fn width(&self) -> usize {
        self.pixels.width() as usize
    }

    pub(crate) fn height(&self) -> usize {
        self.pixels.height() as usize
    }

    /// Lays a colour over one pixel.
    pub(crate) fn blend(&mut self, x: i32, y: i32, [r, g, b, a]: Rgba) {
        let (width, height) = (self.pixels.width() as i32, self.pixels.height() as i32);
        if !(0..width).contains(&x) || !(0..height).contains(&y) {
            return;
        }
        let at = (y * width + x) as usize * 4;
        let Some(pixel) = self.pixels.data_mut().get_mut(at..at + 4) else { return };
        let mix = |under: u8, over: u8| {
            let (under, over, a) = (u32::from(under), u32::from(over), u32::from(a));
            ((over * a + under * (255 - a) + 127) / 255) as u8
        };
        for (under, over) in pixel.iter_mut().zip([r, g, b, 255]) {
            *under = mix(*under, over);
        }
    }

    /// Copies another canvas to `(left, top)`.
    pub(crate) fn paste(&mut self, other: &Canvas, left: i32, top: i32) {
        let paint = tiny_skia::PixmapPaint::default();
        self.pixels.draw_pixmap(left, top, other.pixels.as_ref(), &paint, Transform::identity(), None);
    }

    /// An open line through points, with round ends.
    pub(crate) fn line(&mut self, points: &[Xy], width: f32, colour: Rgba) {
        let Some(path) = path(points, false) else { return };
        let stroke =
            Stroke { width, line_cap: LineCap::Round, line_join: LineJoin::Round, ..Stroke::default() };
        self.pixels.stroke_path(&path, &paint(colour), &stroke, Transform::identity(), None);
    }

    /// A filled polygon.
    pub(crate) fn polygon(&mut self, points: &[Xy], colour: Rgba) {
        let Some(path) = path(points, true) else { return };
        self.pixels.fill_path(&path, &paint(colour), FillRule::Winding, Transform::identity(), None);
    }

    /// A filled disc.
    pub(crate) fn disc(&mut self, (x, y): Xy, radius: f32, colour: Rgba) {
        if let Some(path) = PathBuilder::from_circle(x, y, radius) {
            self.pixels.fill_path(&path, &paint(colour), FillRule::Winding, Transform::identity(), None);
        }
    }

    /// A line with a head at its end, in a darker line around both. Shorter than its head, it is only a head.
    pub(crate) fn arrow(&mut self, from: Xy, to: Xy, width: f32, colour: Rgba, outline: Rgba) {
        let (dx, dy) = (to.0 - from.0, to.1 - from.1);
        let length = dx.hypot(dy);
        if length.is_nan() || length < 1e-3 {
            return;
        }
        let (dx, dy) = (dx / length, dy / length);
        let head = (3.4 * width).min(length);
        let neck = (to.0 - dx * head, to.1 - dy * head);
        let half = 0.6 * head;
        let corners =
            [to, (neck.0 - dy * half, neck.1 + dx * half), (neck.0 + dy * half, neck.1 - dx * half)];
        let [tip, left, right] = corners;
        self.line(&[from, neck], 1.7 * width, outline);
        self.line(&[tip, left, right, tip], 0.8 * width, outline);
        self.line(&[from, neck], width, colour);
        self.polygon(&corners, colour);
    }

    /// Text whose line's upper left corner is at `(x, y)`, `size` pixels high.
    pub(crate) fn text(&mut self, (x, y): Xy, size: f32, colour: Rgba, text: &str) {
        let Some(font) = font() else { return };
        let font = font.as_scaled(size);
        let baseline = y + font.ascent();
        let [r, g, b, a] = colour;
        let mut pen = x;
        for c in text.chars() {
            let glyph = font.scaled_glyph(c);
            let id = glyph.id;
            if let Some(outline) =
                font.outline_glyph(id.with_scale_and_position(glyph.scale, point(pen, baseline)))
            {
                let corner = outline.px_bounds().min;
                outline.draw(|gx, gy, cover| {
                    let alpha = (cover.clamp(0.0, 1.0) * f32::from(a)) as u8;
                    self.blend(corner.x as i32 + gx as i32, corner.y as i32 + gy as i32, [r, g, b, alpha]);
                });
            }
            pen += font.h_advance(id);
        }
    }

    /// Text in a box, for labels on a picture. `(x, y)` is the box's corner; [`label_extent`] says how large it is.
    pub(crate) fn label(&mut self, (x, y): Xy, size: f32, text: &str, ink: Rgba, ground: Rgba) {
        let (w, h) = label_extent(text, size);
        let pad = LABEL_PAD * size;
        self.polygon(&[(x, y), (x + w, y), (x + w, y + h), (x, y + h)], ground);
        self.text((x + pad, y + pad), size, ink, text);
    }

    /// The finished picture.
    pub(crate) fn into_rgb(self) -> RgbImage {
        let (width, height) = (self.pixels.width(), self.pixels.height());
        let rgb = self.pixels.data().chunks_exact(4).flat_map(|p| p.iter().take(3).copied()).collect();
        // The buffer has exactly the size asked for, so there is always a picture.
        RgbImage::from_raw(width, height, rgb).unwrap_or_default()
    }
}

/// Margin around the text of a label, as a share of the text's size.
const LABEL_PAD: f32 = 0.2;

/// Width and height of a label's box, pixels.
pub(crate) fn label_extent(text: &str, size: f32) -> (f32, f32) {
    let pad = 2.0 * LABEL_PAD * size;
    (text_width(text, size) + pad, size + pad)
}

/// Width of a line of text, pixels.
pub(crate) fn text_width(text: &str, size: f32) -> f32 {
    let Some(font) = font() else { return 0.0 };
    let font = font.as_scaled(size);
    text.chars().map(|c| font.h_advance(font.glyph_id(c))).sum()
}

/// Hack, from the crate that bundles it; parsing only reads its table of contents.
fn font() -> Option<FontRef<'static>> {
    FontRef::try_from_slice(epaint_default_fonts::HACK_REGULAR).ok()
}

fn paint([r, g, b, a]: Rgba) -> Paint<'static> {
    let mut paint = Paint { anti_alias: true, ..Paint::default() };
    paint.set_color_rgba8(r, g, b, a);
    paint
}

fn path(points: &[Xy], closed: bool) -> Option<tiny_skia::Path> {
    // Coordinates far outside only cost time; those that are no numbers fail here too.
    if !points.iter().all(|p| p.0.abs() < 1e5 && p.1.abs() < 1e5) {
        return None;
    }
    let mut builder = PathBuilder::new();
    let (first, rest) = points.split_first()?;
    builder.move_to(first.0, first.1);
    for point in rest {
        builder.line_to(point.0, point.1);
    }
    if closed {
        builder.close();
    }
    builder.finish()
}
