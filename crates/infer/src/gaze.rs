//! The frame in which a network for pictures knows directions: that of a camera which looks at the object, as in training.

use nalgebra::{Point3, Rotation3, Vector3};

/// So far off the camera's axis, radians, the middle of an object may be that counts as looked at: in 640 scenes of training it was
/// up to 4.3 degrees (`weights/EXPERIMENTS.md`, "Cameras that are not held as in training").
const OFF_AXIS: f32 = 8.0 * std::f32::consts::PI / 180.0;

/// `camera_from_gaze`: the frame of the camera turned by the shortest way so that its axis goes through the middle of the object,
/// a point in the camera's frame. The camera's own if it looks there.
pub(crate) fn gaze(middle: &Point3<f32>) -> Rotation3<f32> {
    let turn = Rotation3::rotation_between(&Vector3::z(), &middle.coords);
    turn.filter(|turn| turn.angle() > OFF_AXIS).unwrap_or_else(Rotation3::identity)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn who_looks_beside_an_object_turns_to_it() {
        for middle in [Point3::new(2.0, 0.1, 3.0), Point3::new(-0.3, -0.6, 0.9), Point3::new(0.0, 30.0, 1.0)]
        {
            let turned = gaze(&middle).inverse() * middle;
            assert!(turned.xy().coords.norm() < 1e-3 && turned.z > 0.0, "{turned}");
            assert!(gaze(&middle).axis().unwrap().z.abs() < 1e-6);
        }
        for middle in [Point3::new(0.0, 0.0, 2.0), Point3::new(0.1, 0.1, 2.0), Point3::origin()] {
            assert_eq!(gaze(&middle), Rotation3::identity());
        }
        assert_eq!(gaze(&Point3::new(f32::NAN, 0.0, 1.0)), Rotation3::identity());
    }
}
