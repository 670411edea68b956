//! The hand: a free multibody of palm and two sliding fingers, pulled by implicit springs towards a target.

use nalgebra::{Isometry3, Vector3};
use rapier3d::math::{Pose, Vector};
use rapier3d::parry::query::{ShapeCastOptions, cast_shapes};
use rapier3d::prelude::{
    Collider, ColliderHandle, GenericJointBuilder, JointAxesMask, JointAxis, MassProperties, Multibody,
    MultibodyJointHandle, MultibodyLink, RigidBodyBuilder, RigidBodyHandle,
};
use where2act_core::{FingerState, GRIPPER};

use super::contacts::Body;
use super::world::{HAND_GROUP, OBJECT_GROUP, World, displace, groups, x_to};
use super::{convert, shapes};

/// Mass in kg and inertia in kg m2 added to the palm. They stand for the arm behind it; without them the drive is
/// stiffer than the step can follow.
const ARM: (f32, f32) = (1.0, 0.05);
/// How near the free approach may come to anything before steps are taken again, metres.
const APPROACH_MARGIN: f32 = 0.003;

/// Where the parts of the hand are in the world.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct HandPose {
    pub(crate) hand: Isometry3<f32>,
    pub(crate) fingers: [Isometry3<f32>; 2],
}

/// A hand in a [`World`], and what its drive aims at.
pub(crate) struct Hand {
    palm: RigidBodyHandle,
    fingers: [RigidBodyHandle; 2],
    joints: [MultibodyJointHandle; 2],
    /// Target of the six free coordinates: place in the world, then the turn since the start as the time integral of
    /// angular velocity.
    target: [f32; 6],
    /// Velocity of the target.
    velocity: [f32; 6],
}

impl World {
    /// Adds a hand at rest.
    pub(crate) fn add_hand(&mut self, world_from_hand: &Isometry3<f32>, fingers: FingerState) -> Hand {
        let start = convert::pose(world_from_hand);
        let opening = fingers.opening();
        let (mass, inertia) = ARM;
        let arm = MassProperties::new(Vector::ZERO, mass, Vector::splat(inertia));
        let palm = self.add_hand_body(start, Body::Palm, shapes::hand_shape(), arm);
        let finger = |world: &mut Self, side: f32| {
            let offset = Pose::from_translation(Vector::new(0.0, side * opening, GRIPPER.finger_offset));
            let shape = shapes::finger_shape(side);
            let finger = world.add_hand_body(start * offset, Body::Finger, shape, MassProperties::default());
            let axis = x_to(Vector::Y * side);
            let joint = GenericJointBuilder::new(JointAxesMask::LOCKED_PRISMATIC_AXES)
                .local_frame1(Pose::from_parts(Vector::new(0.0, 0.0, GRIPPER.finger_offset), axis))
                .local_frame2(Pose::from_rotation(axis))
                .limits(JointAxis::LinX, [0.0, GRIPPER.finger_travel])
                .contacts_enabled(false);
            let joint = world.rapier.insert_multibody_joint(palm, finger, joint.build());
            (finger, joint.expect("a new body has no other joint, so it closes no loop"))
        };
        let (left, right) = (finger(self, 1.0), finger(self, -1.0));
        let t = start.translation;
        let mut hand = Hand {
            palm,
            fingers: [left.0, right.0],
            joints: [left.1, right.1],
            target: [t.x, t.y, t.z, 0.0, 0.0, 0.0],
            velocity: [0.0; 6],
        };
        self.start_drives(&hand, opening);
        hand.set_velocity(self, [0.0; 6]);
        hand.set_opening(self, opening);
        hand
    }

    fn add_hand_body(
        &mut self,
        pose: Pose,
        body: Body,
        (shape, body_from_shape): (rapier3d::geometry::SharedShape, Pose),
        extra: MassProperties,
    ) -> RigidBodyHandle {
        let builder = RigidBodyBuilder::dynamic()
            .can_sleep(false)
            .gravity_scale(0.0)
            .additional_mass_properties(extra)
            .pose(pose)
            .user_data(body.to_user_data());
        let handle = self.rapier.bodies.insert(builder);
        let collider =
            shapes::collider(shape, body_from_shape).collision_groups(groups(HAND_GROUP, OBJECT_GROUP));
        self.rapier.colliders.insert_with_parent(collider, handle, &mut self.rapier.bodies);
        handle
    }

    /// Gives the hand its degrees of freedom, dampings and finger positions.
    fn start_drives(&mut self, hand: &Hand, opening: f32) {
        let rapier = &mut self.rapier;
        let Some((multibody, _)) = rapier.multibody_joints.get_mut(hand.joints[0]) else { return };
        multibody.set_self_contacts_enabled(false);
        multibody.forward_kinematics(&rapier.bodies, true);
        let mut displacement = vec![0.0; multibody.ndofs()];
        multibody.damping_mut().fill(GRIPPER.hand_damping);
        let fingers = multibody.links().filter(|link| link.rigid_body_handle() != hand.palm);
        for axis in fingers.map(MultibodyLink::assembly_id).collect::<Vec<_>>() {
            displacement[axis] = opening;
            multibody.damping_mut()[axis] = GRIPPER.finger_damping;
        }
        displace(multibody, &mut rapier.bodies, &displacement);
    }

    /// Where the parts of the hand are.
    pub(crate) fn hand_pose(&self, hand: &Hand) -> HandPose {
        let pose = |body: RigidBodyHandle| convert::isometry(self.rapier.bodies[body].position());
        HandPose { hand: pose(hand.palm), fingers: hand.fingers.map(pose) }
    }

    /// Colliders of palm and fingers.
    pub(super) fn hand_colliders(&self, hand: &Hand) -> impl Iterator<Item = ColliderHandle> + '_ {
        let [left, right] = hand.fingers;
        [hand.palm, left, right]
            .into_iter()
            .flat_map(|body| self.rapier.bodies[body].colliders().iter().copied())
    }

    /// Where a collider is according to its body. rapier updates a collider's own pose only in the next step.
    pub(super) fn collider_pose(&self, collider: &Collider) -> Pose {
        let body = collider.parent().and_then(|body| self.rapier.bodies.get(body));
        match (body, collider.position_wrt_parent()) {
            (Some(body), Some(local)) => *body.position() * *local,
            _ => *collider.position(),
        }
    }
}

impl Hand {
    fn multibody<'w>(&self, world: &'w mut World) -> Option<&'w mut Multibody> {
        world.rapier.multibody_joints.get_mut(self.joints[0]).map(|(multibody, _)| multibody)
    }

    /// Lets the target move at this velocity (linear, angular; world axes) from where it is. The target's velocity
    /// enters the drive as an offset of the spring, so that spring and damper follow it implicitly.
    pub(crate) fn set_velocity(&mut self, world: &mut World, velocity: [f32; 6]) {
        self.velocity = velocity;
        let lead = GRIPPER.hand_damping / GRIPPER.hand_stiffness;
        let rest: [f32; 6] = std::array::from_fn(|axis| self.target[axis] + lead * velocity[axis]);
        if let Some(multibody) = self.multibody(world) {
            let root = &mut multibody.root_mut().joint;
            for (axis, rest) in rest.into_iter().enumerate() {
                root.set_spring(axis, GRIPPER.hand_stiffness, rest);
            }
        }
    }

    /// Moves the target on by one step at its velocity.
    pub(crate) fn advance_target(&mut self, world: &mut World) {
        let dt = world.dt();
        for (target, velocity) in self.target.iter_mut().zip(self.velocity) {
            *target += velocity * dt;
        }
        self.set_velocity(world, self.velocity);
    }

    /// Drives both fingers to `opening` metres from the closed position.
    pub(crate) fn set_opening(&mut self, world: &mut World, opening: f32) {
        for joint in self.joints {
            if let Some((multibody, link)) = world.rapier.multibody_joints.get_mut(joint)
                && let Some(link) = multibody.link_mut(link)
            {
                link.joint.set_spring(0, GRIPPER.finger_stiffness, opening);
            }
        }
    }

    /// The share of a straight move by `way` that touches nothing, with a margin, if the object stands still.
    pub(crate) fn free_share(&self, world: &World, way: &Vector3<f32>) -> f32 {
        let options = ShapeCastOptions {
            max_time_of_impact: 1.0,
            target_distance: APPROACH_MARGIN,
            stop_at_penetration: true,
            compute_impact_geometry_on_penetration: false,
        };
        let way = convert::vector(way);
        let mut free = 1.0f32;
        for h in world.hand_colliders(self).map(|h| &world.rapier.colliders[h]) {
            let hand_pose = world.collider_pose(h);
            for o in world.object_colliders().map(|o| &world.rapier.colliders[o]) {
                let object_pose = world.collider_pose(o);
                let hit =
                    cast_shapes(&hand_pose, way, h.shape(), &object_pose, Vector::ZERO, o.shape(), options);
                free = match hit {
                    Ok(None) => free,
                    Ok(Some(hit)) => free.min(hit.time_of_impact),
                    Err(_) => 0.0,
                };
            }
        }
        free
    }

    /// Puts the hand and its target `offset` further, moving at `velocity` as if it had been driven there.
    pub(crate) fn jump(&mut self, world: &mut World, offset: &Vector3<f32>, velocity: &Vector3<f32>) {
        let rapier = &mut world.rapier;
        if let Some((multibody, _)) = rapier.multibody_joints.get_mut(self.joints[0]) {
            let mut displacement = vec![0.0; multibody.ndofs()];
            displacement[..3].copy_from_slice(offset.as_slice());
            displace(multibody, &mut rapier.bodies, &displacement);
            multibody.generalized_velocity_mut().rows_mut(0, 3).copy_from(&velocity.cast());
        }
        for (target, offset) in self.target.iter_mut().zip(offset.iter()) {
            *target += offset;
        }
        self.set_velocity(world, [velocity.x, velocity.y, velocity.z, 0.0, 0.0, 0.0]);
    }
}
