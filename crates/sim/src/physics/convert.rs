//! Between the project's maths (nalgebra) and rapier's (glam).

use nalgebra::{Isometry3, Point3, Quaternion, Translation3, UnitQuaternion, Vector3};
use rapier3d::math::{Pose, Rotation, Vector};

pub(super) fn vector(v: &Vector3<f32>) -> Vector {
    Vector::new(v.x, v.y, v.z)
}

pub(super) fn point(p: &Point3<f32>) -> Vector {
    Vector::new(p.x, p.y, p.z)
}

pub(super) fn pose(m: &Isometry3<f32>) -> Pose {
    let q = m.rotation.as_ref().coords;
    Pose::from_parts(vector(&m.translation.vector), Rotation::from_xyzw(q.x, q.y, q.z, q.w))
}

pub(super) fn isometry(pose: &Pose) -> Isometry3<f32> {
    let (t, r) = (pose.translation, pose.rotation);
    let rotation = UnitQuaternion::new_normalize(Quaternion::new(r.w, r.x, r.y, r.z));
    Isometry3::from_parts(Translation3::new(t.x, t.y, t.z), rotation)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn poses_mean_the_same_on_both_sides() {
        let m = Isometry3::new(Vector3::new(0.1, -2.0, 3.0), Vector3::new(0.4, 1.0, -0.7));
        let p = Point3::new(0.3, 0.2, -0.9);
        let there = pose(&m).transform_point(point(&p));
        assert!((vector(&(m * p).coords) - there).length() < 1e-6);
        assert!((isometry(&pose(&m)).to_homogeneous() - m.to_homogeneous()).amax() < 1e-6);
    }
}
