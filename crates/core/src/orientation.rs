//! Hand orientations as six numbers.

use nalgebra::{Matrix3, Rotation3, Vector3};
use serde::{Deserialize, Serialize};

use crate::Primitive;

/// A hand orientation as `[approach, forward]`: the hand's z axis, then its x axis, three numbers each. This is the
/// one layout of the project; networks read and write it in this order.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Orientation6(pub [f32; 6]);

impl Orientation6 {
    /// From two directions, kept as they are.
    #[must_use]
    pub fn new(approach: Vector3<f32>, forward: Vector3<f32>) -> Self {
        Self([approach.x, approach.y, approach.z, forward.x, forward.y, forward.z])
    }

    /// The first three numbers.
    #[must_use]
    pub fn approach(&self) -> Vector3<f32> {
        Vector3::new(self.0[0], self.0[1], self.0[2])
    }

    /// The last three numbers.
    #[must_use]
    pub fn forward(&self) -> Vector3<f32> {
        Vector3::new(self.0[3], self.0[4], self.0[5])
    }

    /// The hand as a mirror shows it that swaps the camera's left and right. It is its own mirror image in both planes along its
    /// approach, so that it is a hand again: for *-up with its forward axis turned round, because a mirror that keeps up and
    /// approach swaps the third.
    #[must_use]
    pub fn mirrored(&self, primitive: Primitive) -> Self {
        let [ax, ay, az, fx, fy, fz] = self.0;
        let turn = if matches!(primitive, Primitive::PushingUp | Primitive::PullingUp) { -1.0 } else { 1.0 };
        Self([-ax, ay, az, turn * -fx, turn * fy, turn * fz])
    }

    /// The rotation it stands for: see [`orthonormal_frame`].
    #[must_use]
    pub fn to_rotation(&self) -> Rotation3<f32> {
        orthonormal_frame(self.approach(), self.forward())
    }

    /// The two axes of a rotation.
    #[must_use]
    pub fn from_rotation(rotation: &Rotation3<f32>) -> Self {
        let m = rotation.matrix();
        Self::new(m.column(2).into(), m.column(0).into())
    }
}

/// The right-handed frame `[x y z]` with z along `approach` and x as near to `forward` as possible (Gram-Schmidt).
/// Zero, parallel or non-finite directions are replaced by an arbitrary but fixed choice, so that the result is a
/// rotation for every input.
#[must_use]
pub fn orthonormal_frame(approach: Vector3<f32>, forward: Vector3<f32>) -> Rotation3<f32> {
    let z = unit(approach).unwrap_or(Vector3::z());
    let x = unit(forward).and_then(|f| unit(f - z * z.dot(&f))).unwrap_or_else(|| any_orthogonal(&z));
    let x = (x - z * z.dot(&x)).normalize();
    Rotation3::from_matrix_unchecked(Matrix3::from_columns(&[x, z.cross(&x), z]))
}

/// `v` scaled to length one; `None` if it is shorter than 1e-6 or not finite.
fn unit(v: Vector3<f32>) -> Option<Vector3<f32>> {
    let largest = v.amax();
    let usable = v.iter().all(|x| x.is_finite()) && largest > 1e-6;
    // Dividing first keeps the square of a huge component finite.
    usable.then(|| (v / largest).normalize())
}

fn any_orthogonal(z: &Vector3<f32>) -> Vector3<f32> {
    let helper = if z.x.abs() < 0.9 { Vector3::x() } else { Vector3::y() };
    (helper - z * z.dot(&helper)).normalize()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn any_vector() -> impl Strategy<Value = Vector3<f32>> {
        prop_oneof![
            prop::array::uniform3(-2.0f32..2.0).prop_map(Vector3::from),
            prop::array::uniform3(proptest::num::f32::ANY).prop_map(Vector3::from),
            Just(Vector3::zeros()),
            Just(Vector3::new(0.0, 0.0, 3.0)),
        ]
    }

    proptest! {
        #[test]
        fn every_input_gives_a_rotation(a in any_vector(), f in any_vector()) {
            let m = *orthonormal_frame(a, f).matrix();
            prop_assert!((m.transpose() * m - Matrix3::identity()).amax() < 1e-5);
            prop_assert!((m.determinant() - 1.0).abs() < 1e-5);
        }

        #[test]
        fn parallel_directions_too(a in any_vector(), s in -3.0f32..3.0) {
            let m = *orthonormal_frame(a, a * s).matrix();
            prop_assert!((m.determinant() - 1.0).abs() < 1e-5);
        }
    }

    #[test]
    fn a_rotation_survives_the_round_trip() {
        let rotation = Rotation3::from_euler_angles(0.3, -1.2, 2.0);
        let back = Orientation6::from_rotation(&rotation).to_rotation();
        assert!(rotation.angle_to(&back) < 1e-3);
    }
}
