//! Whether the hand has room: nothing that is seen may be where palm and fingers are at the start, nor between them and the
//! camera, nor where the palm is until the finger tips touch, nor, for pulling, where the open fingers are before they close.
//! (The simulator's `Clearance` asks the object itself, of which a camera sees half.)

use nalgebra::{Point3, Rotation3, Vector3};
use where2act_core::{GRIPPER, Primitive};

/// Farthest that a part of the hand is from the contact point at the start, metres: the corners of the palm's back.
pub(crate) const REACH: f32 = 0.206;
/// The same of the open fingers when they are about to close.
pub(crate) const GRIP_REACH: f32 = 0.079;
/// How far inside the hand a point must be, metres: depth cameras are no more exact than that.
const MARGIN: f32 = 0.002;
/// Points inside the hand that are more than a flying pixel.
const ENOUGH: u32 = 2;

/// Points that are compared at a time.
const BLOCK: usize = 128;

/// What is seen around a contact point.
pub(crate) struct Room {
    /// Points less than [`REACH`] away, as offsets from the contact point in the camera frame, metres: all x, all y, all z.
    offsets: [Vec<f32>; 3],
    /// Points less than [`GRIP_REACH`] away, offsets from the contact point, more densely than the others: fingers are narrow.
    close: Vec<Vector3<f32>>,
    /// The contact point in the camera frame.
    contact: Point3<f32>,
}

impl Room {
    /// `close` are asked by hands that pull alone.
    pub(crate) fn new(
        obstacles: impl IntoIterator<Item = Point3<f32>>,
        close: impl IntoIterator<Item = Point3<f32>>,
        contact: &Point3<f32>,
    ) -> Self {
        let mut offsets = [const { Vec::new() }; 3];
        for offset in obstacles
            .into_iter()
            .map(|point| point - contact)
            .filter(|offset| offset.norm_squared() < REACH * REACH)
        {
            offsets.iter_mut().zip(offset.iter()).for_each(|(all, one)| all.push(*one));
        }
        let close = close.into_iter().map(|point| point - contact);
        let close = close.filter(|o| o.norm_squared() < GRIP_REACH * GRIP_REACH).collect();
        Self { offsets, close, contact: *contact }
    }

    /// Whether a hand with this rotation fits: at the start, where contact fails a trial; and with the palm when the finger
    /// tips touch, because a push must not begin with it, and a grip would not get that far. Between the two the palm moves
    /// by less than half its depth. Pulling needs fingers on both sides of something, or there is nothing to hold; the pulls
    /// that move sideways succeed nearly as often with fingers that only press (figures in `weights/EXPERIMENTS.md`).
    pub(crate) fn fits(&self, primitive: Primitive, rotation: &Rotation3<f32>) -> bool {
        let opening = primitive.fingers().opening();
        let [xs, ys, zs] = &self.offsets;
        let mut inside = 0;
        // Block by block, so that a crowded place is known early and the compiler makes vectors of the rest.
        for ((xs, ys), zs) in xs.chunks(BLOCK).zip(ys.chunks(BLOCK)).zip(zs.chunks(BLOCK)) {
            for ((x, y), z) in xs.iter().zip(ys).zip(zs) {
                let point = rotation.inverse_transform_vector(&Vector3::new(*x, *y, *z));
                let at = |distance: f32| [point.x, point.y, point.z + distance];
                let start = at(Primitive::START_DISTANCE);
                inside += u32::from(in_palm(start) | in_fingers(start, opening) | in_palm(at(GRIPPER.tip)));
            }
            if inside >= ENOUGH {
                return false;
            }
        }
        primitive != Primitive::Pulling || self.grips(rotation)
    }

    /// Whether nothing is seen before palm and fingers at the start, of all that hides points from the camera. Behind what is seen
    /// nobody knows of room: it may be a shut drawer's inside, or the far side of a window.
    pub(crate) fn begins_in_view(
        &self,
        rotation: &Rotation3<f32>,
        hidden: impl Fn(&Point3<f32>) -> bool,
    ) -> bool {
        let approach: Vector3<f32> = rotation.matrix().column(2).into();
        let at = |height: f32| self.contact + approach * (height - Primitive::START_DISTANCE);
        !GRIPPER.along_axis().into_iter().any(|height| hidden(&at(height)))
    }

    /// Whether open fingers at the end of the approach have nothing inside them.
    fn grips(&self, rotation: &Rotation3<f32>) -> bool {
        let inside = self.close.iter().filter(|offset| {
            let point = rotation.inverse_transform_vector(offset);
            let at = [point.x, point.y, point.z + Primitive::Pulling.contact_distance()];
            in_fingers(at, GRIPPER.finger_travel)
        });
        inside.take(ENOUGH as usize).count() < ENOUGH as usize
    }
}

/// Whether a point of the hand frame is inside the palm.
#[inline(always)]
fn in_palm([x, y, z]: [f32; 3]) -> bool {
    let ([x0, y0, z0], [x1, y1, z1]) = (GRIPPER.hand_min, GRIPPER.hand_max);
    let within = |x: f32, low: f32, high: f32| (x > low + MARGIN) & (x < high - MARGIN);
    within(x, x0, x1) & within(y, y0, y1) & within(z, z0, z1)
}

/// Whether a point of the hand frame is inside one of the fingers, which are `opening` from where they meet.
#[inline(always)]
fn in_fingers([x, y, z]: [f32; 3], opening: f32) -> bool {
    let (z, y) = (z - GRIPPER.finger_offset, y.abs() - opening);
    let [half, outer] = GRIPPER.finger_section(z);
    let (bottom, top) = (GRIPPER.finger_min[2], GRIPPER.finger_max[2]);
    // Where closed fingers meet they have no surface.
    let inner = if opening > 0.0 { MARGIN } else { 0.0 };
    (z > bottom) & (z < top - MARGIN) & (x.abs() < half - MARGIN) & (y >= inner) & (y < outer - MARGIN)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hidden::Directions;

    /// A hand that comes straight along the camera's axis, with its y axis along the camera's.
    fn straight() -> Rotation3<f32> {
        Rotation3::identity()
    }

    /// Two points at an offset from the contact point.
    fn seen(x: f32, y: f32, z: f32) -> Room {
        let contact = Point3::new(0.1, -0.2, 1.5);
        let point = contact + Vector3::new(x, y, z);
        let points = [point, point, contact, Point3::origin()];
        Room::new(points, points, &contact)
    }

    #[test]
    fn what_stands_before_the_surface_meets_palm_or_fingers() {
        use Primitive::{Pulling, PullingLeft, PullingUp, Pushing};
        let fits = |room: &Room, primitive| room.fits(primitive, &straight());
        // Right where the palm begins, and a flying pixel there.
        assert!(!fits(&seen(0.0, 0.09, -0.1), Pushing) && !fits(&seen(0.0, 0.09, -0.1), Pulling));
        let contact = Point3::origin();
        let alone = Room::new(std::iter::once(Point3::new(0.0, 0.09, -0.1)), std::iter::empty(), &contact);
        assert!(fits(&alone, Pushing));
        // Beside the palm: nothing is in the way, unless the hand is turned by a right angle.
        let beside = seen(0.09, 0.0, -0.1);
        assert!(fits(&beside, Pushing));
        assert!(!beside.fits(Pushing, &Rotation3::from_axis_angle(&Vector3::z_axis(), 1.57)));
        // Before closed fingers, between open ones, and where an open one is.
        assert!(!fits(&seen(0.0, 0.0, -0.045), Pushing) && fits(&seen(0.0, 0.0, -0.045), Pulling));
        assert!(fits(&seen(0.0, 0.045, -0.045), Pushing) && !fits(&seen(0.0, 0.045, -0.045), Pulling));
        // A finger is narrower at its tip than behind it.
        let (at_tip, behind) = (seen(0.0, 0.055, -0.04), seen(0.0, 0.055, -0.0465));
        assert!(fits(&at_tip, PullingUp) && !fits(&behind, PullingUp));
        // Before the palm, which gets there before the finger tips touch.
        let step = seen(0.0, 0.09, -0.06);
        assert!(!fits(&step, Pushing) && !fits(&step, Pulling) && fits(&seen(0.0, 0.09, -0.045), Pushing));
        // A wide surface is in the way of fingers that would close behind it, one between them is what they hold.
        let (wide, handle) = (seen(0.0, 0.045, 0.0), seen(0.0, 0.03, 0.0));
        assert!(!fits(&wide, Pulling) && fits(&wide, PullingUp) && fits(&wide, PullingLeft));
        assert!(fits(&handle, Pulling) && fits(&seen(0.0, 0.045, 0.013), Pulling));
        // The surface itself, and what is out of reach.
        assert!(fits(&seen(0.0, 0.05, 0.0), Pushing) && seen(0.0, 0.0, -0.3).offsets[0].len() == 1);
    }

    #[test]
    fn who_begins_behind_what_is_seen_does_not_begin_in_view() {
        // A surface that reaches 4 cm to all sides, so far before the contact point and so far to the right of the ray there, metres.
        let contact = Point3::new(0.1, -0.2, 1.5);
        let grid = |i: i32| Vector3::new((i % 9 - 4) as f32, (i / 9 - 4) as f32, 0.0) * 0.01;
        let in_view = |ahead: f32, shift: f32, rotation: &Rotation3<f32>| {
            let points: Vec<_> = (0..81)
                .map(|i| contact * (1.0 - ahead / contact.z) + grid(i) + Vector3::x() * shift)
                .collect();
            let seen = Directions::new(&points);
            Room::new([], [], &contact).begins_in_view(rotation, |point| seen.hides(point))
        };
        // Towards the camera, from behind the surface or beside it.
        let back = Rotation3::from_axis_angle(&Vector3::x_axis(), std::f32::consts::PI);
        assert!(!in_view(0.05, 0.0, &back) && !in_view(0.05, 0.03, &back) && !in_view(-0.05, 0.0, &back));
        assert!(in_view(0.05, 0.09, &back) && in_view(0.05, -0.09, &back));
        // From the camera's side: nothing but what is touched lies behind the hand, or something far before it hides it.
        assert!(in_view(-0.05, 0.0, &straight()) && in_view(0.0, 0.0, &straight()));
        assert!(!in_view(0.5, 0.0, &straight()) && in_view(0.5, 0.2, &straight()));
    }

    #[test]
    fn no_corner_of_the_hand_is_out_of_reach() {
        let ([_, _, back], [x, y, _]) = (GRIPPER.hand_min, GRIPPER.hand_max);
        let corner = Vector3::new(x, y, back - Primitive::START_DISTANCE);
        assert!((corner.norm()..corner.norm() + 1e-3).contains(&REACH));
        let ([_, _, bottom], [x, y, _]) = (GRIPPER.finger_min, GRIPPER.finger_max);
        let back = GRIPPER.finger_offset + bottom - Primitive::Pulling.contact_distance();
        let corner = Vector3::new(x, GRIPPER.finger_travel + y, back);
        assert!((corner.norm()..corner.norm() + 1e-3).contains(&GRIP_REACH));
    }
}
