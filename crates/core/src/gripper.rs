//! The robot hand: a Panda gripper as boxes, and its drives.

use serde::Serialize;

/// Shape and drives of the hand. The hand frame is that of `panda_hand` in Franka's URDF: its origin is where the hand is
/// mounted; z points along the fingers, y along their motion.
///
/// The boxes bound the Panda's collision meshes, whose convex hulls the published trials use; the narrow finger tips
/// decide which part of the hand touches first when the approach is oblique. The drive gains are those of the
/// supplement, section B.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct GripperGeometry {
    /// Lower corner of the hand's box in the hand frame, metres.
    pub hand_min: [f32; 3],
    /// Upper corner of the hand's box in the hand frame, metres.
    pub hand_max: [f32; 3],
    /// Lower corner of the left finger's box in its own frame, metres. The right finger is its mirror in x and y.
    pub finger_min: [f32; 3],
    /// Upper corner of the left finger's box in its own frame, metres.
    pub finger_max: [f32; 3],
    /// The finger's box narrows from this height in its frame, metres, ...
    pub finger_shoulder: f32,
    /// ... to this outer y at the tip, metres, ...
    pub finger_tip_y: f32,
    /// ... and to this half width along x, metres.
    pub finger_tip_x: f32,
    /// Where the fingers' frames sit along the hand's z, metres.
    pub finger_offset: f32,
    /// How far one finger slides outwards, metres: open fingers are twice this apart.
    pub finger_travel: f32,
    /// Distance from the hand frame's origin to the finger tips along z, metres.
    pub tip: f32,
    /// Stiffness of the hand's six free axes, N/m and N m/rad.
    pub hand_stiffness: f32,
    /// Damping of the hand's six free axes, N s/m and N m s/rad.
    pub hand_damping: f32,
    /// Stiffness of each finger, N/m.
    pub finger_stiffness: f32,
    /// Damping of each finger, N s/m.
    pub finger_damping: f32,
}

/// The Panda gripper of the published trials.
pub const GRIPPER: GripperGeometry = GripperGeometry {
    hand_min: [-0.0316, -0.102, -0.0259],
    hand_max: [0.0316, 0.102, 0.0655],
    finger_min: [-0.0104, 0.0, 0.0002],
    finger_max: [0.0104, 0.0264, 0.0538],
    finger_shoulder: 0.021,
    finger_tip_y: 0.0152,
    finger_tip_x: 0.008_75,
    finger_offset: 0.0584,
    finger_travel: 0.04,
    tip: 0.0584 + 0.0538,
    hand_stiffness: 1000.0,
    hand_damping: 400.0,
    finger_stiffness: 200.0,
    finger_damping: 60.0,
};

impl GripperGeometry {
    /// How far behind what is seen a point of the hand counts as out of view, metres: less than half of the palm's depth.
    pub const OUT_OF_VIEW: f32 = 0.02;

    /// Half the width along x of a finger, and its outer y, at a height in its own frame, metres: of
    /// [`Self::finger_corners`]' hull.
    #[inline]
    #[must_use]
    pub fn finger_section(&self, z: f32) -> [f32; 2] {
        let [wide_x, wide_y, top] = self.finger_max;
        let narrow = ((z - self.finger_shoulder) / (top - self.finger_shoulder)).clamp(0.0, 1.0);
        [wide_x + narrow * (self.finger_tip_x - wide_x), wide_y + narrow * (self.finger_tip_y - wide_y)]
    }

    /// Heights on the hand's z axis that stand for where it is, metres: the middle of the palm, and four from its front to near
    /// the finger tips.
    #[must_use]
    pub fn along_axis(&self) -> [f32; 5] {
        let (low, high) = (self.hand_min[2], self.hand_max[2]);
        let ahead = |share: f32| high + share * (self.tip - high);
        [0.5 * (low + high), high, ahead(0.25), ahead(0.5), ahead(0.75)]
    }

    /// Corners of the convex left finger in its own frame, metres; the right finger is turned by half a turn about z.
    #[must_use]
    pub fn finger_corners(&self) -> [[f32; 3]; 12] {
        let ([x0, y0, z0], [x1, y1, z1]) = (self.finger_min, self.finger_max);
        let (shoulder, tip_x, tip_y) = (self.finger_shoulder, self.finger_tip_x, self.finger_tip_y);
        let [a, b, c, d] = [[x0, y0], [x1, y0], [x1, y1], [x0, y1]];
        let [e, f, g, h] = [[-tip_x, y0], [tip_x, y0], [tip_x, tip_y], [-tip_x, tip_y]];
        let at = |[x, y]: [f32; 2], z: f32| [x, y, z];
        [
            at(a, z0),
            at(b, z0),
            at(c, z0),
            at(d, z0),
            at(a, shoulder),
            at(b, shoulder),
            at(c, shoulder),
            at(d, shoulder),
            at(e, z1),
            at(f, z1),
            at(g, z1),
            at(h, z1),
        ]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn corners_of_a_finger_lie_on_its_sections() {
        let corners = GRIPPER.finger_corners();
        for [x, y, z] in corners {
            let [half, outer] = GRIPPER.finger_section(z);
            assert!(
                (x.abs() - half).abs() < 1e-7 && (y == GRIPPER.finger_min[1] || (y - outer).abs() < 1e-7)
            );
        }
        let [half, outer] = GRIPPER.finger_section(0.5 * (GRIPPER.finger_shoulder + GRIPPER.finger_max[2]));
        assert!(half > GRIPPER.finger_tip_x && half < GRIPPER.finger_max[0]);
        assert!(outer > GRIPPER.finger_tip_y && outer < GRIPPER.finger_max[1]);
    }
}
