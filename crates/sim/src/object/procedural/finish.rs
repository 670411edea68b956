//! Materials that objects of a kind are made of.

use std::sync::Arc;

use image::RgbImage;

use super::dice::Dice;
use super::texture::{self, Colour, blend, shade};
use crate::object::Material;

/// A material and how many metres its texture spans.
#[derive(Clone, Debug)]
pub(super) struct Finish {
    pub(super) material: Material,
    pub(super) tile: f32,
}

/// One colour all over.
pub(super) fn plain(colour: Colour, specular: f32, shininess: f32) -> Finish {
    Finish { material: Material { colour, texture: None, specular, shininess, opacity: 1.0 }, tile: 1.0 }
}

fn textured(picture: RgbImage, tile: f32, specular: f32, shininess: f32) -> Finish {
    let texture = Some(Arc::new(picture));
    Finish { material: Material { colour: [1.0; 3], texture, specular, shininess, opacity: 1.0 }, tile }
}

/// A colour of this hue in [0, 1), saturation and value.
fn hsv(hue: f32, saturation: f32, value: f32) -> Colour {
    [0.0, 2.0 / 3.0, 1.0 / 3.0].map(|shift| {
        let d = ((hue + shift).fract() * 6.0 - 3.0).abs() - 1.0;
        value * (1.0 + saturation * (d.clamp(0.0, 1.0) - 1.0))
    })
}

/// A slightly different colour.
fn vary(dice: &mut Dice, colour: Colour, amount: f32) -> Colour {
    let light = dice.real(1.0 - amount, 1.0 + amount);
    colour.map(|c| (c * light + dice.real(-amount, amount) * 0.2).clamp(0.0, 1.0))
}

/// Paint as on walls, doors and furniture: mostly whites and greys, sometimes a colour.
pub(super) fn paint_colour(dice: &mut Dice) -> Colour {
    let hue = dice.real(0.0, 1.0);
    let (saturation, value) = (dice.real(0.15, 0.65), dice.real(0.3, 0.9));
    let base = dice.weighted(&[
        (3.0, [0.93, 0.92, 0.89]),
        (1.0, [0.85, 0.82, 0.74]),
        (1.0, [0.6, 0.61, 0.62]),
        (0.7, [0.3, 0.31, 0.33]),
        (0.5, [0.12, 0.12, 0.13]),
        (2.5, hsv(hue, saturation, value)),
    ]);
    vary(dice, base, 0.06)
}

/// A bright colour, as of plastic things.
pub(super) fn vivid(dice: &mut Dice) -> Colour {
    let (hue, saturation, value) = (dice.real(0.0, 1.0), dice.real(0.5, 0.95), dice.real(0.45, 0.95));
    hsv(hue, saturation, value)
}

/// Painted wood or metal, now and then with a visible grain.
pub(super) fn painted(dice: &mut Dice) -> Finish {
    let colour = paint_colour(dice);
    if dice.chance(0.3) {
        let grain = dice.real(0.1, 0.3);
        return textured(texture::wood(dice, colour, grain, 1), 0.7, 0.1, 16.0);
    }
    plain(colour, dice.real(0.05, 0.35), dice.real(12.0, 40.0))
}

/// Bare or varnished wood.
pub(super) fn wood(dice: &mut Dice) -> Finish {
    let base = dice.pick(&[
        [0.80, 0.62, 0.40],
        [0.87, 0.74, 0.54],
        [0.70, 0.48, 0.28],
        [0.55, 0.34, 0.19],
        [0.45, 0.25, 0.15],
        [0.33, 0.20, 0.13],
        [0.62, 0.30, 0.17],
        [0.66, 0.58, 0.48],
        [0.24, 0.17, 0.13],
    ]);
    let base = vary(dice, base, 0.12);
    let (contrast, tile) = (dice.real(0.25, 0.8), dice.real(0.4, 1.1));
    let boards = dice.weighted(&[(4.0, 1), (1.0, 2), (1.0, 4)]);
    textured(texture::wood(dice, base, contrast, boards), tile, dice.real(0.05, 0.3), 24.0)
}

/// What furniture is made of.
pub(super) fn furniture(dice: &mut Dice) -> Finish {
    match dice.weighted(&[(6.0, 0), (4.0, 1), (0.7, 2)]) {
        0 => wood(dice),
        1 => painted(dice),
        _ => steel(dice),
    }
}

/// A second material that goes with a first: the same in another tone, white, or another wood.
pub(super) fn companion(dice: &mut Dice, first: &Finish) -> Finish {
    let mut tone = first.clone();
    let tint = dice.real(0.6, 0.95);
    tone.material.colour = shade(tone.material.colour, tint);
    match dice.count(0, 3) {
        0 | 1 => tone,
        2 => painted(dice),
        _ => wood(dice),
    }
}

/// Steel: brushed or smooth.
pub(super) fn steel(dice: &mut Dice) -> Finish {
    let grey = dice.real(0.45, 0.8);
    let base = [grey, grey * dice.real(0.98, 1.0), grey * dice.real(0.96, 1.03)];
    if dice.chance(0.6) {
        let strength = dice.real(0.04, 0.14);
        return textured(texture::brushed(dice, base, strength), dice.real(0.3, 0.8), 0.5, 30.0);
    }
    plain(base, 0.6, 50.0)
}

/// What handles and fittings are made of: chrome, steel, brass, bronze, black iron.
pub(super) fn fitting(dice: &mut Dice) -> Finish {
    let colour = dice.weighted(&[
        (4.0, [0.75, 0.76, 0.78]),
        (2.0, [0.55, 0.56, 0.58]),
        (1.5, [0.78, 0.62, 0.32]),
        (1.0, [0.45, 0.33, 0.22]),
        (2.0, [0.1, 0.1, 0.11]),
        (0.8, [0.9, 0.9, 0.9]),
    ]);
    plain(vary(dice, colour, 0.08), dice.real(0.4, 0.9), dice.real(30.0, 90.0))
}

/// Plastic in the colours of household goods.
pub(super) fn plastic(dice: &mut Dice) -> Finish {
    let bright = vivid(dice);
    let colour = dice.weighted(&[
        (2.0, [0.92, 0.92, 0.9]),
        (2.0, [0.15, 0.15, 0.16]),
        (1.5, [0.5, 0.5, 0.52]),
        (1.0, [0.82, 0.77, 0.66]),
        (3.5, bright),
    ]);
    let colour = vary(dice, colour, 0.06);
    if dice.chance(0.2) {
        let spot = shade(colour, 0.8);
        return textured(texture::speckled(dice, colour, spot, 0.4), 0.15, 0.15, 12.0);
    }
    plain(colour, dice.real(0.15, 0.5), dice.real(15.0, 50.0))
}

/// The shell of kitchen and laundry machines.
pub(super) fn appliance(dice: &mut Dice) -> Finish {
    let bright = vivid(dice);
    match dice.weighted(&[(4.0, 0), (2.5, 1), (3.0, 2), (1.0, 3)]) {
        0 => plain(vary(dice, [0.93, 0.93, 0.92], 0.05), 0.35, 40.0),
        1 => plain(vary(dice, [0.1, 0.1, 0.11], 0.3), 0.4, 45.0),
        2 => steel(dice),
        _ => plain(blend(bright, [0.8; 3], 0.3), 0.4, 40.0),
    }
}

/// Dark or tinted glass, or clear.
pub(super) fn glass(dice: &mut Dice) -> Finish {
    let colour = dice.pick(&[[0.1, 0.11, 0.12], [0.55, 0.66, 0.7], [0.75, 0.85, 0.88], [0.35, 0.42, 0.4]]);
    let mut finish = plain(vary(dice, colour, 0.1), 0.9, 90.0);
    finish.material.opacity = if colour[0] < 0.2 { dice.real(0.6, 0.95) } else { dice.real(0.2, 0.5) };
    finish
}

/// Nearly black: screens, rubber, hollows.
pub(super) fn dark(dice: &mut Dice) -> Finish {
    let grey = dice.real(0.03, 0.14);
    plain([grey, grey, grey * 1.05], 0.2, 30.0)
}

/// Glazed or enamelled.
pub(super) fn enamel(dice: &mut Dice) -> Finish {
    let bright = vivid(dice);
    let colour = dice.weighted(&[(2.0, [0.94, 0.93, 0.9]), (2.0, bright), (1.0, [0.2, 0.2, 0.22])]);
    plain(vary(dice, colour, 0.05), 0.7, 70.0)
}

/// Granite, marble or plain stone.
pub(super) fn stone(dice: &mut Dice) -> Finish {
    let grey = dice.real(0.25, 0.9);
    let base = [grey, grey * dice.real(0.93, 1.0), grey * dice.real(0.86, 1.0)];
    let other = if grey > 0.5 { shade(base, 0.55) } else { shade(base, 1.8) };
    if dice.chance(0.5) {
        return textured(texture::marble(dice, base, other), dice.real(0.6, 1.2), 0.5, 60.0);
    }
    textured(texture::speckled(dice, base, other, 0.45), 0.3, 0.4, 50.0)
}

/// Brown or white cardboard.
pub(super) fn cardboard(dice: &mut Dice) -> Finish {
    let base =
        dice.weighted(&[(5.0, [0.72, 0.55, 0.37]), (1.5, [0.6, 0.44, 0.29]), (1.0, [0.9, 0.88, 0.84])]);
    let base = vary(dice, base, 0.08);
    textured(texture::cardboard(dice, base), 0.5, 0.02, 8.0)
}

/// Printed paper, as on gift boxes.
pub(super) fn printed(dice: &mut Dice) -> Finish {
    let (ground, ink) = (paint_colour(dice), vivid(dice));
    textured(texture::printed(dice, ground, ink), dice.real(0.4, 0.9), 0.1, 16.0)
}

/// Wicker.
pub(super) fn woven(dice: &mut Dice) -> Finish {
    let base = dice.pick(&[[0.72, 0.55, 0.36], [0.5, 0.35, 0.22], [0.85, 0.8, 0.7], [0.4, 0.4, 0.42]]);
    textured(texture::woven(dice, base), dice.real(0.25, 0.5), 0.05, 10.0)
}

/// A printed label that spans this many metres.
pub(super) fn label(dice: &mut Dice, span: f32) -> Finish {
    let ink = if dice.chance(0.5) { vivid(dice) } else { [0.1, 0.1, 0.12] };
    let ground = if dice.chance(0.7) { [0.95, 0.94, 0.9] } else { paint_colour(dice) };
    textured(texture::label(dice, ground, ink), span, 0.1, 16.0)
}
