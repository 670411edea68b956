//! The frame in which a network knows directions: that of a camera which looks at the object, as in training.

use std::borrow::Cow;

use nalgebra::{Point3, Rotation3, Vector3};
use where2act_core::is_measured;

/// So far off the camera's axis, radians, the middle of an object may be that counts as looked at: in 640 scenes of training it was
/// up to 4.7 degrees (`weights/EXPERIMENTS.md`, "Cameras that are not held as in training").
const OFF_AXIS: f32 = 8.0 * std::f32::consts::PI / 180.0;
/// Sine of the angle between the camera's axis and the vertical below which no direction in the picture is up: that of 10 degrees.
/// Cameras of training look down by 60, or 70, degrees at most.
const STEEP: f32 = 0.174;

/// `camera_from_gaze`: the frame of the camera turned by the shortest way so that its axis goes through the middle of the object,
/// a point in the camera's frame, and then about that axis until `up`, a direction in the camera's frame, is at the top of its
/// picture; and by how much about the axis, radians. The camera's own if it looks there and is not rolled.
pub(crate) fn gaze(middle: &Point3<f32>, up: Option<Vector3<f32>>) -> (Rotation3<f32>, f32) {
    let turn = Rotation3::rotation_between(&Vector3::z(), &middle.coords);
    let turn = turn.filter(|turn| turn.angle() > OFF_AXIS).unwrap_or_else(Rotation3::identity);
    let roll = roll(&turn, up);
    (turn * Rotation3::from_axis_angle(&Vector3::z_axis(), roll), roll)
}

/// How far a camera is rolled that looks along the z axis of `camera_from_axis`. 0 if nobody says which way is up, and for who
/// looks so steeply up or down that nothing is at the top.
fn roll(camera_from_axis: &Rotation3<f32>, up: Option<Vector3<f32>>) -> f32 {
    let up = up.map(|up| camera_from_axis.inverse() * up.normalize());
    up.filter(|up| up.xy().norm() > STEEP).map_or(0.0, |up| up.x.atan2(-up.y))
}

/// [`gaze`] at the mean of a scan by a camera that is not rolled, and the scan as it is seen then.
pub(crate) fn gaze_at(
    points: &[Point3<f32>],
    up: Option<Vector3<f32>>,
) -> (Rotation3<f32>, Cow<'_, [Point3<f32>]>) {
    let measured = points.iter().filter(|point| is_measured(point));
    let sum = measured.fold(Vector3::zeros(), |sum: Vector3<f64>, point| sum + point.coords.cast());
    // How long it is is of no consequence.
    let (camera_from_gaze, _) = gaze(&Point3::from(sum.normalize().cast()), up);
    if camera_from_gaze == Rotation3::identity() {
        return (camera_from_gaze, Cow::Borrowed(points));
    }
    let gaze_from_camera = camera_from_gaze.inverse();
    // What was not measured stays that.
    let seen = |point: &Point3<f32>| if is_measured(point) { gaze_from_camera * point } else { *point };
    (camera_from_gaze, points.iter().map(seen).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn who_looks_beside_an_object_turns_to_it() {
        for middle in [Point3::new(2.0, 0.1, 3.0), Point3::new(-0.3, -0.6, 0.9), Point3::new(0.0, 30.0, 1.0)]
        {
            let turned = gaze(&middle, None).0.inverse() * middle;
            assert!(turned.xy().coords.norm() < 1e-3 && turned.z > 0.0, "{turned}");
            assert!(gaze(&middle, None).0.axis().unwrap().z.abs() < 1e-6);
        }
        for middle in [Point3::new(0.0, 0.0, 2.0), Point3::new(0.1, 0.1, 2.0), Point3::origin()] {
            assert_eq!(gaze(&middle, None).0, Rotation3::identity());
        }
        assert_eq!(gaze(&Point3::new(f32::NAN, 0.0, 1.0), None).0, Rotation3::identity());
    }

    #[test]
    fn who_is_rolled_is_turned_back() {
        let whole = |angle: f32| [-1.0, 0.0, 1.0].map(|turns| angle + turns * std::f32::consts::TAU);
        for degrees in [-170.0f32, -90.0, -30.0, 0.0, 20.0, 90.0, 180.0] {
            // From above: up leans away from who looks.
            let up = Rotation3::from_axis_angle(&Vector3::z_axis(), degrees.to_radians())
                * Vector3::new(0.0, -0.6, -0.8);
            let found = roll(&Rotation3::identity(), Some(up * 7.0));
            assert!(
                whole(found).iter().any(|f| (f - degrees.to_radians()).abs() < 1e-5),
                "{degrees}: {found}"
            );
            for middle in [Point3::new(0.0, 0.0, 2.0), Point3::new(1.0, -0.4, 2.0)] {
                let points =
                    [middle, middle + Vector3::new(0.3, 0.2, 0.0), middle - Vector3::new(0.3, 0.2, 0.0)];
                let (camera_from_gaze, seen) = gaze_at(&points, Some(up));
                let above = camera_from_gaze.inverse() * up;
                assert!(above.x.abs() < 1e-6 && above.y < 0.0, "{above}");
                assert!((camera_from_gaze * seen[1] - points[1]).norm() < 1e-6);
            }
        }
        let down = [Vector3::new(0.05, 0.1, -1.0), Vector3::zeros(), Vector3::repeat(f32::NAN)];
        assert!(down.iter().all(|up| roll(&Rotation3::identity(), Some(*up)) == 0.0));
    }

    #[test]
    fn what_a_scan_did_not_measure_stays_that() {
        let beside = [Point3::new(1.0, 0.0, 1.0), Point3::new(1.2, 0.0, 1.2)];
        let points = [beside[0], Point3::origin(), Point3::new(1.0, f32::NAN, 1.0), beside[1]];
        let (camera_from_gaze, seen) = gaze_at(&points, None);
        assert!((camera_from_gaze.angle() - 45f32.to_radians()).abs() < 1e-6);
        assert!((seen[0] - Point3::new(0.0, 0.0, 2f32.sqrt())).norm() < 1e-6);
        assert_eq!(seen.iter().map(is_measured).collect::<Vec<_>>(), [true, false, false, true]);
        assert!(
            matches!(gaze_at(&points[1..3], None), (turn, Cow::Borrowed(_)) if turn == Rotation3::identity())
        );
    }
}
