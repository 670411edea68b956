//! Whether a hand has a free way and something to work on.

use where2act_core::{GRIPPER, Grasp, Primitive};

use crate::physics::Clearance;
use crate::scene::SettledScene;

/// Corners of a box in the hand frame, metres.
type HandBox = ([f32; 3], [f32; 3]);

const PALM: HandBox = (GRIPPER.hand_min, GRIPPER.hand_max);
/// Depth of the region at the finger tips in which something must be for a grip, metres: the fingers pass the
/// contact point by 1.2 cm.
const GRIP_DEPTH: f32 = 0.016;

/// One finger's box, without its taper, opened by `opening`, on the side of +y (1) or -y (-1).
fn finger(side: f32, opening: f32) -> HandBox {
    let ([x0, y0, z0], [x1, y1, z1]) = (GRIPPER.finger_min, GRIPPER.finger_max);
    let (near, far, lift) = (y0 + opening, y1 + opening, GRIPPER.finger_offset);
    let (low, high) = if side > 0.0 { (near, far) } else { (-far, -near) };
    ([x0, low, z0 + lift], [x1, high, z1 + lift])
}

/// The space between open fingers, at their tips.
fn between() -> HandBox {
    let half = 0.9 * GRIPPER.finger_travel;
    let (x0, x1) = (GRIPPER.finger_min[0], GRIPPER.finger_max[0]);
    ([x0, -half, GRIPPER.tip - GRIP_DEPTH], [x1, half, GRIPPER.tip])
}

/// Geometric checks on one scene.
pub(super) struct Clear(Clearance);

impl Clear {
    pub(super) fn new(scene: &SettledScene) -> Self {
        Self(scene.clearance())
    }

    /// Whether the hand is free at the start and on the way, and touches what it should at the end of its approach.
    pub(super) fn allows(&self, primitive: Primitive, link: usize, grasp: &Grasp) -> bool {
        let opening = primitive.fingers().opening();
        let fingers = [finger(1.0, opening), finger(-1.0, opening)];
        let contact = grasp.hand_at(primitive.contact_distance());
        let anything = |_| true;
        if primitive.is_pulling()
            && (!self.0.touches(between(), &contact, |l| l == link)
                || fingers.iter().any(|&f| self.0.touches(f, &contact, anything)))
        {
            return false;
        }
        if self.0.touches(PALM, &contact, anything)
            || fingers.iter().any(|&f| self.0.touches(f, &contact, |l| l != link))
        {
            return false;
        }
        let start = grasp.hand_at(Primitive::START_DISTANCE);
        fingers.iter().chain([&PALM]).all(|&part| !self.0.touches(part, &start, anything))
    }
}
