//! One object in a rapier world: fixed root, one multibody of joints in reduced coordinates.

use nalgebra::Isometry3;
use rapier3d::math::{Pose, Rotation, Vector};
use rapier3d::prelude::{
    ColliderHandle, FrictionModel, GenericJoint, GenericJointBuilder, Group, InteractionGroups,
    InteractionTestMode, JointAxesMask, JointAxis, MassProperties, Multibody, MultibodyJointHandle,
    PhysicsWorld, RigidBodyBuilder, RigidBodyHandle, SpringCoefficients,
};

use super::contacts::Body;
use super::{Shapes, convert, shapes};
use crate::object::{Joint, JointKind, Object};

/// Damping of the object's joints, N s/m and N m s/rad (supplement, section B).
const JOINT_DAMPING: f32 = 10.0;
/// Mass in kg and inertia in kg m2 of links without pieces, which would make the joint's equation singular.
const EMPTY_LINK: (f32, f32) = (0.1, 1e-3);

/// The object's collision group and the hand's: the parts of the hand do not collide with each other.
pub(super) const OBJECT_GROUP: Group = Group::GROUP_1;
pub(super) const HAND_GROUP: Group = Group::GROUP_2;

/// A world that holds one object and, once [`super::Hand`] is added, a hand.
pub(crate) struct World {
    pub(super) rapier: PhysicsWorld,
    pub(super) links: Vec<RigidBodyHandle>,
    /// Of every movable link: its joint and the place of its position among rapier's six joint coordinates.
    joints: Vec<(MultibodyJointHandle, usize)>,
}

impl World {
    /// The object at rest at joint positions `q`, to be advanced in steps of 1 / `hz` seconds.
    pub(crate) fn new(object: &Object, shapes: &Shapes, q: &[f32], hz: f32) -> Self {
        let mut world = Self { rapier: empty_world(hz), links: Vec::new(), joints: Vec::new() };
        for link in 0..object.links.len() {
            world.add_link(object, shapes, link);
        }
        world.set_q(q);
        world
    }

    fn add_link(&mut self, object: &Object, shapes: &Shapes, link: usize) {
        let rapier = &mut self.rapier;
        let pieces = shapes.link(link);
        let body = match &object.links[link].joint {
            None => RigidBodyBuilder::fixed(),
            Some(_) if pieces.is_empty() => {
                let (mass, inertia) = EMPTY_LINK;
                let properties = MassProperties::new(Vector::ZERO, mass, Vector::splat(inertia));
                RigidBodyBuilder::dynamic().can_sleep(false).additional_mass_properties(properties)
            }
            Some(_) => RigidBodyBuilder::dynamic().can_sleep(false),
        };
        let body = rapier.bodies.insert(body.user_data(Body::Link(link).to_user_data()));
        for (shape, pose) in pieces {
            let collider =
                shapes::collider(shape.clone(), *pose).collision_groups(groups(OBJECT_GROUP, Group::ALL));
            rapier.colliders.insert_with_parent(collider, body, &mut rapier.bodies);
        }
        self.links.push(body);
        if let Some(joint) = &object.links[link].joint {
            let handle = rapier
                .insert_multibody_joint(self.links[joint.parent], body, rapier_joint(joint))
                .expect("a new body has no other joint, so it closes no loop");
            self.joints.push((handle, if joint.kind == JointKind::Prismatic { 0 } else { 3 }));
        }
    }

    /// Puts all joints at `q`, at rest.
    fn set_q(&mut self, q: &[f32]) {
        let joints = self.joints.clone();
        let Some(&(first, _)) = joints.first() else { return };
        let rapier = &mut self.rapier;
        let indices: Vec<usize> =
            joints.iter().filter_map(|(h, _)| rapier.multibody_joints.get(*h).map(|(_, id)| id)).collect();
        let Some((multibody, _)) = rapier.multibody_joints.get_mut(first) else { return };
        // The root only loses its degrees of freedom here, so dampings set earlier would be those of other axes.
        multibody.forward_kinematics(&rapier.bodies, true);
        multibody.damping_mut().fill(JOINT_DAMPING);
        let mut displacement = vec![0.0; multibody.ndofs()];
        for ((index, (_, axis)), q) in indices.into_iter().zip(&joints).zip(q) {
            if let Some(link) = multibody.link(index) {
                displacement[link.assembly_id()] = q - link.joint.coords()[*axis];
            }
        }
        displace(multibody, &mut rapier.bodies, &displacement);
    }

    /// Advances by one step.
    pub(crate) fn step(&mut self) {
        self.rapier.step();
    }

    /// Position of a movable link's joint; 0 for the root.
    pub(crate) fn q(&self, link: usize) -> f32 {
        let Some((handle, axis)) = link.checked_sub(1).and_then(|i| self.joints.get(i)) else { return 0.0 };
        let joint = self.rapier.multibody_joints.get(*handle).and_then(|(multibody, id)| multibody.link(id));
        joint.map_or(0.0, |link| link.joint.coords()[*axis])
    }

    /// Positions of all joints.
    pub(crate) fn all_q(&self) -> Vec<f32> {
        (1..self.links.len()).map(|link| self.q(link)).collect()
    }

    /// Pose of a link.
    pub(crate) fn world_from_link(&self, link: usize) -> Isometry3<f32> {
        convert::isometry(self.rapier.bodies[self.links[link]].position())
    }

    /// Poses of all links.
    pub(crate) fn world_from_links(&self) -> Vec<Isometry3<f32>> {
        (0..self.links.len()).map(|link| self.world_from_link(link)).collect()
    }

    /// Whether the last step left the finite numbers; rapier stops such bodies and goes on.
    pub(crate) fn broke_down(&self) -> bool {
        !self.rapier.quarantine().bodies().is_empty() || self.links.iter().any(|link| !is_finite(self, *link))
    }

    /// Duration of a step in seconds.
    pub(crate) fn dt(&self) -> f32 {
        self.rapier.integration_parameters.dt
    }

    /// Colliders of the object's links.
    pub(super) fn object_colliders(&self) -> impl Iterator<Item = ColliderHandle> + '_ {
        self.links.iter().flat_map(|link| self.rapier.bodies[*link].colliders().iter().copied())
    }
}

fn is_finite(world: &World, body: RigidBodyHandle) -> bool {
    let pose = world.rapier.bodies[body].position();
    pose.translation.is_finite() && pose.rotation.is_finite()
}

/// Moves a multibody by a displacement of its coordinates and stops it.
pub(super) fn displace(
    multibody: &mut Multibody,
    bodies: &mut rapier3d::prelude::RigidBodySet,
    displacement: &[f32],
) {
    multibody.apply_displacements(displacement);
    multibody.generalized_velocity_mut().fill(0.0);
    multibody.forward_kinematics(bodies, false);
    multibody.update_rigid_bodies(bodies, true);
}

pub(super) fn groups(member: Group, collides_with: Group) -> InteractionGroups {
    InteractionGroups::new(member, collides_with, InteractionTestMode::And)
}

/// The rotation that turns rapier's joint axis, x, into `axis`.
pub(super) fn x_to(axis: Vector) -> Rotation {
    Rotation::from_rotation_arc(Vector::X, axis)
}

fn rapier_joint(joint: &Joint) -> GenericJoint {
    let frame = Pose::from_rotation(x_to(convert::vector(&joint.axis)));
    let (axis, locked) = match joint.kind {
        JointKind::Prismatic => (JointAxis::LinX, JointAxesMask::LOCKED_PRISMATIC_AXES),
        JointKind::Revolute | JointKind::Continuous => (JointAxis::AngX, JointAxesMask::LOCKED_REVOLUTE_AXES),
    };
    let builder = GenericJointBuilder::new(locked)
        .local_frame1(convert::pose(&joint.parent_from_joint) * frame)
        .local_frame2(frame)
        .contacts_enabled(false);
    match joint.kind {
        JointKind::Continuous => builder.build(),
        _ => builder.limits(axis, [joint.limits.0, joint.limits.1]).build(),
    }
}

/// Gravity and solver settings, as measured to reproduce SAPIEN's outcomes.
pub(super) fn empty_world(hz: f32) -> PhysicsWorld {
    let mut world = PhysicsWorld::new();
    world.gravity = Vector::new(0.0, 0.0, -9.81);
    let p = &mut world.integration_parameters;
    p.dt = 1.0 / hz;
    // One substep with four inner iterations is half as expensive as two substeps and as near to SAPIEN.
    p.num_solver_iterations = 1;
    p.num_internal_pgs_iterations = 4;
    p.friction_model = FrictionModel::Coulomb;
    p.contact_softness = SpringCoefficients::new(30.0, 10.0);
    p.static_contact_softness = SpringCoefficients::new(60.0, 10.0);
    // Contacts that begin 2 mm before touching: rapier's 2 cm would make the hand stop in the air.
    p.normalized_prediction_distance = 0.002;
    // The stricter pass makes a grip creep.
    p.friction_in_bias_pass = false;
    p.contact_recycling = true;
    p.max_ccd_substeps = 0;
    world
}
