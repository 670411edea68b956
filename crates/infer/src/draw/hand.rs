//! The hand as lines: stem, palm, two fingers, and an arrow for its motion.
//!
//! ```text
//!                 palm  fingers
//!                   +------------
//!   stem -----------|             * contact point      ---> approach
//!                   +------------
//! ```

use nalgebra::{Matrix3, Point3, Rotation3, Vector3};
use where2act_core::{GRIPPER, Intrinsics, Primitive, Proposal};

use super::canvas::{Canvas, Rgba, Xy};
use super::labels::Taken;
use super::view::Lens;

const BEST: Rgba = [255, 255, 255, 255];
const OTHER: Rgba = [165, 173, 190, 255];
const OUTLINE: Rgba = [10, 20, 40, 255];
const MOTION: Rgba = [255, 40, 200, 255];
/// Half the drawn opening of closed fingers, metres, so that they are seen as two.
const CLOSED_HALF: f32 = 0.008;
/// Length of the drawn stem behind the palm, metres.
const STEM: f32 = 0.05;
/// How far open fingers reach past the contact point, metres: the tip at the end of the approach.
const REACH: f32 = GRIPPER.tip - 0.10;

/// Draws a proposal's hand at its contact, with its motion, and notes in `taken` where. `span` is how many pixels 0.1 m
/// should at least take.
pub(crate) fn draw_hand(
    canvas: &mut Canvas,
    lens: &Lens,
    primitive: Primitive,
    proposal: &Proposal,
    span: f32,
    taken: &mut Taken,
) {
    let Some(hand) = Hand::new(lens, proposal, span) else { return };
    let best = proposal.rank == 1;
    let width = (0.05 * span).max(1.2) * if best { 1.3 } else { 1.0 };
    let open = primitive.is_pulling();
    let (half, tip) = if open { (GRIPPER.finger_travel, REACH) } else { (CLOSED_HALF, 0.0) };
    let finger = GRIPPER.finger_max[2];
    let outlines: [&[[f32; 3]]; 2] = [
        &[[0.0, half, tip], [0.0, half, -finger], [0.0, -half, -finger], [0.0, -half, tip]],
        &[[0.0, 0.0, -finger], [0.0, 0.0, -finger - STEM]],
    ];
    let outlines = outlines.map(|outline| -> Vec<Xy> {
        let drawn: Option<_> = outline.iter().map(|p| hand.at(*p)).collect();
        drawn.unwrap_or_default()
    });
    for (extra, colour) in [(1.6 * width, OUTLINE), (0.0, if best { BEST } else { OTHER })] {
        for outline in &outlines {
            canvas.line(outline, width + extra, colour);
        }
    }
    let (from, to) = match primitive {
        Primitive::Pushing => ([0.0, 0.0, 0.0], [0.0, 0.0, 0.07]),
        Primitive::Pulling => ([0.0, 0.0, -finger - STEM], [0.0, 0.0, -finger - STEM - 0.07]),
        Primitive::PushingUp | Primitive::PullingUp => ([0.0, half, -0.01], [0.0, half + 0.07, -0.01]),
        Primitive::PushingLeft | Primitive::PullingLeft => ([0.005, 0.0, -0.01], [0.085, 0.0, -0.01]),
    };
    if let (Some(from), Some(to)) = (hand.at(from), hand.at(to)) {
        canvas.arrow(from, to, width * 1.4, MOTION, OUTLINE);
        taken.line(&[from, to]);
    }
    outlines.iter().for_each(|outline| taken.line(outline));
    if let Some(contact) = hand.at([0.0; 3]) {
        canvas.disc(contact, width * 1.7, OUTLINE);
        canvas.disc(contact, width * 1.1, MOTION);
    }
}

/// A hand whose points can be put on the canvas.
struct Hand {
    rotation: Rotation3<f32>,
    contact: Contact,
    /// Enlargement around the contact.
    scale: f32,
}

/// Where the hand touches.
enum Contact {
    /// In space, seen through a camera; without depth a metre away, which makes no difference to how it looks.
    Point(Point3<f32>, Intrinsics),
    /// Only in the picture; the hand is seen as from far away.
    Pixel(Xy),
}

impl Hand {
    fn new(lens: &Lens, proposal: &Proposal, span: f32) -> Option<Self> {
        // The array holds rows; nalgebra reads columns.
        let rotation = Rotation3::from_matrix_unchecked(Matrix3::from(proposal.rotation).transpose());
        let per_metre = span / 0.1;
        let pixel = lens.centre(proposal.pixel);
        let Some(camera) = lens.intrinsics else {
            return Some(Self { rotation, contact: Contact::Pixel(pixel), scale: per_metre });
        };
        let on_ray = || camera.back_project(pixel.0, pixel.1, 1.0);
        let point = proposal.point.map_or_else(on_ray, Point3::from);
        camera.project(&point)?;
        let enlarged = per_metre * point.z / camera.fx;
        let scale = if proposal.point.is_some() { enlarged.max(1.0) } else { enlarged };
        Some(Self { rotation, contact: Contact::Point(point, camera), scale })
    }

    /// Canvas position of a point given along the hand's axes, metres from the contact.
    fn at(&self, in_hand: [f32; 3]) -> Option<Xy> {
        let offset = self.rotation * Vector3::from(in_hand) * self.scale;
        match &self.contact {
            Contact::Point(point, intrinsics) => intrinsics.project(&(point + offset)),
            Contact::Pixel((x, y)) => Some((x + offset.x, y + offset.y)),
        }
    }
}
