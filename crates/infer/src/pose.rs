//! From an orientation at a contact point to poses a robot can drive to.

use nalgebra::{Isometry3, Point3, Rotation3, UnitQuaternion};
use where2act_core::{Grasp, Pixel, Primitive, Proposal, Stage};

/// A proposal without its rank. With a contact point it carries the poses of the primitive's published motion, whose
/// lengths are metres of the real hand whatever the object's size.
pub(crate) fn proposal(
    primitive: Primitive,
    pixel: Pixel,
    point: Option<Point3<f32>>,
    rotation: &Rotation3<f32>,
    (score, actionability): (f32, f32),
) -> Proposal {
    let motion = point.map(|point| primitive.motion(&Grasp { point, rotation: *rotation }));
    let quaternion = UnitQuaternion::from_rotation_matrix(rotation);
    let [x, y, z, w] = quaternion.coords.into();
    // One of the two quaternions of a rotation, always the same.
    let sign = if w < 0.0 { -1.0 } else { 1.0 };
    let m = rotation.matrix();
    Proposal {
        rank: 0,
        pixel,
        point: point.map(Into::into),
        approach: m.column(2).into_owned().into(),
        forward: m.column(0).into_owned().into(),
        rotation: m.transpose().into(),
        quaternion_xyzw: [x * sign, y * sign, z * sign, w * sign],
        hand_pose: motion.as_ref().map(|m| rows(&m.start)),
        waypoints: motion
            .iter()
            .flat_map(|m| m.waypoints().map(|pose| rows(&pose)).collect::<Vec<_>>())
            .collect(),
        gripper_width: 2.0 * primitive.fingers().opening(),
        close_at: motion.as_ref().and_then(|m| {
            let close = m.stages.iter().position(|s| matches!(s, Stage::Close { .. }))?;
            Some(m.stages.iter().take(close).filter(|s| matches!(s, Stage::Move { .. })).count())
        }),
        score,
        actionability,
    }
}

/// A pose as the rows of a 4x4 matrix.
fn rows(pose: &Isometry3<f32>) -> [[f32; 4]; 4] {
    // nalgebra's arrays are lists of columns.
    pose.to_homogeneous().transpose().into()
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;

    #[test]
    fn poses_are_rows_of_camera_from_hand() {
        let rotation = Rotation3::from_euler_angles(0.4, -0.8, 1.9);
        let point = Point3::new(0.1, -0.2, 1.5);
        let p = proposal(Primitive::Pulling, Pixel { u: 3, v: 4 }, Some(point), &rotation, (0.5, 0.6));
        let approach = Vector3::from(p.approach);
        assert!((approach - rotation * Vector3::z()).norm() < 1e-6);
        let pose = p.hand_pose.unwrap();
        let column = |m: &[[f32; 4]; 4], c: usize| Vector3::new(m[0][c], m[1][c], m[2][c]);
        assert!((column(&pose, 2) - approach).norm() < 1e-6);
        assert!((column(&pose, 0) - Vector3::from(p.forward)).norm() < 1e-6);
        assert!((column(&pose, 3) - (point.coords - approach * 0.15)).norm() < 1e-6);
        assert_eq!(pose[3], [0.0, 0.0, 0.0, 1.0]);
        assert_eq!(p.waypoints.len(), 3);
        assert_eq!(p.waypoints[0], pose);
        assert!((column(&p.waypoints[1], 3) - (point.coords - approach * 0.10)).norm() < 1e-6);
        assert_eq!((p.close_at, p.gripper_width), (Some(1), 0.08));
        assert_eq!(p.grasp(), Some(Grasp { point, rotation }));
        let poses: Vec<_> = p.poses().collect();
        let motion = Primitive::Pulling.motion(&Grasp { point, rotation });
        for (found, expected) in poses.iter().zip(motion.waypoints()) {
            assert!((found.to_homogeneous() - expected.to_homogeneous()).amax() < 1e-6, "{found} {expected}");
        }
        assert_eq!(poses.len(), 3);
        let [x, y, z, w] = p.quaternion_xyzw;
        let q = UnitQuaternion::from_quaternion(nalgebra::Quaternion::new(w, x, y, z));
        assert!((q * Vector3::x() - Vector3::from(p.forward)).norm() < 1e-5 && w >= 0.0);
    }

    #[test]
    fn without_a_point_there_is_an_orientation_only() {
        let p = proposal(Primitive::Pushing, Pixel { u: 0, v: 0 }, None, &Rotation3::identity(), (0.1, 0.2));
        assert!(p.point.is_none() && p.hand_pose.is_none() && p.waypoints.is_empty() && p.close_at.is_none());
        assert!(p.grasp().is_none() && p.poses().next().is_none());
        assert_eq!(p.gripper_width, 0.0);
    }
}
