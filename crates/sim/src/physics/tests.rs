//! What the physics must not do: make energy, lose the hand, let parts through.

use nalgebra::{Isometry3, Point3, Unit, Vector3};
use where2act_core::{FingerState, GRIPPER, Grasp};

use rapier3d::math::Vector;
use rapier3d::prelude::{PhysicsWorld, RigidBodyBuilder, RigidBodyHandle};

use super::world::empty_world;
use super::{Hand, PUBLISHED_HZ, Shapes, World, shapes};
use crate::object::{ConvexPiece, Joint, JointKind, Link, Object};

fn link(name: &str, joint: Option<Joint>, pieces: Vec<ConvexPiece>) -> Link {
    Link { name: name.into(), label: name.into(), welded: Vec::new(), joint, visuals: Vec::new(), pieces }
}

fn joint(parent: usize, kind: JointKind, axis: Vector3<f32>, limits: (f32, f32)) -> Joint {
    Joint {
        name: format!("{kind:?}"),
        parent,
        kind,
        parent_from_joint: Isometry3::identity(),
        axis: Unit::new_normalize(axis),
        limits,
    }
}

fn cuboid(min: [f32; 3], max: [f32; 3]) -> ConvexPiece {
    ConvexPiece::cuboid(Point3::from(min), Point3::from(max))
}

fn object(links: Vec<Link>) -> Object {
    Object { name: "test".into(), category: None, links, materials: Vec::new() }
}

fn world(object: &Object, q: &[f32]) -> World {
    World::new(object, &Shapes::new(object).unwrap(), q, PUBLISHED_HZ)
}

/// A lid of 10 kg that turns about y.
fn lid() -> Object {
    let joint = joint(0, JointKind::Revolute, -Vector3::y(), (0.0, 1.5));
    let plate = cuboid([0.0, -0.25, 0.0], [0.5, 0.25, 0.04]);
    object(vec![link("base", None, vec![]), link("lid", Some(joint), vec![plate])])
}

fn energy(world: &World) -> f32 {
    world.links[1..]
        .iter()
        .map(|body| {
            let body = &world.rapier.bodies[*body];
            body.kinetic_energy() + body.mass() * 9.81 * body.center_of_mass().z
        })
        .sum()
}

#[test]
fn a_falling_lid_loses_energy_until_it_lies_still() {
    let object = lid();
    let mut world = world(&object, &[1.2]);
    let start = energy(&world);
    let mut last = start;
    for _ in 0..5000 {
        world.step();
        let now = energy(&world);
        // Positions and velocities are half a step apart, which shows when the fall ends within one.
        assert!(now <= last + 2e-3 * start, "{last} J became {now} J");
        last = now;
    }
    assert!(world.q(1).abs() < 1e-3, "{}", world.q(1));
    assert!(last < 0.5 * start);
}

#[test]
fn a_slider_in_free_fall_reaches_the_speed_of_its_damping() {
    let slide = joint(0, JointKind::Prismatic, -Vector3::z(), (0.0, 100.0));
    let weight = cuboid([-0.05; 3], [0.05; 3]);
    let object = object(vec![link("base", None, vec![]), link("weight", Some(slide), vec![weight])]);
    let mut world = world(&object, &[0.0]);
    // m dv/dt = m g - c v with m = 1 kg and c = 10 N s/m: within a second, v = g / 10.
    for _ in 0..1000 {
        world.step();
    }
    let before = world.q(1);
    for _ in 0..500 {
        world.step();
    }
    let speed = world.q(1) - before;
    assert!((speed - 0.981).abs() < 0.01, "{speed} m/s");
}

/// Linear momentum, and angular momentum about the origin.
fn momentum(world: &PhysicsWorld, bodies: &[RigidBodyHandle]) -> (Vector, Vector) {
    let each = bodies.iter().map(|body| {
        let body = &world.bodies[*body];
        let linear = body.mass() * body.linvel();
        // Inertia about the centre of mass: diagonal in the frame of its principal axes.
        let properties = body.mass_properties();
        let turn = *body.rotation() * properties.local_mprops.principal_inertia_local_frame;
        let spin = turn * (properties.local_mprops.principal_inertia() * (turn.inverse() * body.angvel()));
        (linear, body.center_of_mass().cross(linear) + spin)
    });
    each.fold((Vector::ZERO, Vector::ZERO), |sum, one| (sum.0 + one.0, sum.1 + one.1))
}

#[test]
fn a_collision_in_free_space_keeps_linear_and_angular_momentum() {
    let mut world = empty_world(PUBLISHED_HZ);
    world.gravity = Vector::ZERO;
    let mut body = |half: [f32; 3], place: Vector, speed: Vector, spin: Vector| {
        let builder =
            RigidBodyBuilder::dynamic().can_sleep(false).translation(place).linvel(speed).angvel(spin);
        let body = world.bodies.insert(builder);
        let (shape, pose) = shapes::cuboid(half.map(|h| -h), half);
        world.colliders.insert_with_parent(shapes::collider(shape, pose), body, &mut world.bodies);
        body
    };
    // Off centre and turning, so that the blow changes speeds, spins and directions.
    let turning = Vector::new(1.0, 0.5, -2.0);
    let bodies = [
        body([0.1, 0.05, 0.15], Vector::new(-0.3, 0.06, 0.05), Vector::new(1.0, 0.0, 0.1), turning),
        body([0.08, 0.12, 0.06], Vector::new(0.3, 0.0, 0.0), Vector::new(-0.5, 0.05, 0.0), Vector::ZERO),
    ];
    // Mass properties are known after the first step.
    world.step();
    let before = momentum(&world, &bodies);
    let approach =
        |world: &PhysicsWorld| world.bodies[bodies[0]].linvel().x - world.bodies[bodies[1]].linvel().x;
    assert!(approach(&world) > 1.4);
    for _ in 0..500 {
        world.step();
    }
    let after = momentum(&world, &bodies);
    assert!(approach(&world) < 0.3, "they have not met");
    let exchanged = world.bodies[bodies[0]].mass() * 1.0;
    // Impulses on both bodies are opposite to the last bit. Their arms differ by the gap between both contact
    // points, at most the prediction distance of 2 mm on 0.1 m, and free rotation is integrated in steps.
    let linear = (after.0 - before.0).length() / exchanged;
    assert!(linear < 1e-5, "linear: {linear} of what was exchanged");
    let angular = (after.1 - before.1).length() / (exchanged * 0.1);
    assert!(angular < 0.02, "angular: {angular} of what was exchanged");
}

fn drive(world: &mut World, hand: &mut Hand, velocity: [f32; 6], steps: usize) {
    hand.set_velocity(world, velocity);
    for _ in 0..steps {
        hand.advance_target(world);
        world.step();
    }
}

#[test]
fn a_free_hand_gets_where_it_is_driven_and_its_fingers_close() {
    let object = object(vec![link("base", None, vec![])]);
    let mut world = world(&object, &[]);
    let start =
        Grasp::new(Point3::new(0.3, -0.2, 0.4), Vector3::new(-1.0, 0.3, -0.5), Vector3::z()).hand_at(0.1);
    let mut hand = world.add_hand(&start, FingerState::Open);
    assert!((world.hand_pose(&hand).hand.translation.vector - start.translation.vector).norm() < 1e-6);
    drive(&mut world, &mut hand, [0.1, -0.05, 0.02, 0.2, 0.0, 0.1], 500);
    drive(&mut world, &mut hand, [0.0; 6], 500);
    let pose = world.hand_pose(&hand);
    let moved = pose.hand.translation.vector - start.translation.vector;
    assert!((moved - Vector3::new(0.1, -0.05, 0.02)).norm() < 1e-3, "{moved}");
    let turned = (pose.hand.rotation * start.rotation.inverse()).scaled_axis();
    assert!((turned - Vector3::new(0.2, 0.0, 0.1)).norm() < 5e-3, "{turned}");
    let gap = |world: &World| {
        let [left, right] = world.hand_pose(&hand).fingers;
        (left.translation.vector - right.translation.vector).norm()
    };
    assert!((gap(&world) - 2.0 * GRIPPER.finger_travel).abs() < 1e-3);
    let mut closing = hand;
    closing.set_opening(&mut world, 0.0);
    drive(&mut world, &mut closing, [0.0; 6], 1500);
    let [left, right] = world.hand_pose(&closing).fingers;
    assert!((left.translation.vector - right.translation.vector).norm() < 1e-3);
}

#[test]
fn no_wall_lets_the_hand_through() {
    let wall = cuboid([0.0, -0.5, -0.5], [0.02, 0.5, 0.5]);
    let object = object(vec![link("base", None, vec![wall])]);
    let mut world = world(&object, &[]);
    let grasp = Grasp::new(Point3::new(0.02, 0.0, 0.0), -Vector3::x(), Vector3::z());
    let mut hand = world.add_hand(&grasp.hand_at(0.15), FingerState::Closed);
    assert!(!world.overlaps(&hand));
    hand.set_velocity(&mut world, [-0.05, 0.0, 0.0, 0.0, 0.0, 0.0]);
    let mut deepest = 0.0f32;
    for _ in 0..1500 {
        hand.advance_target(&mut world);
        world.step();
        deepest = deepest.max(world.hand_penetration());
    }
    assert!(world.hand_contact(0).is_some());
    assert!(deepest < 2e-3, "{deepest} m deep");
    let tip = world.hand_pose(&hand).hand.translation.x - GRIPPER.tip;
    assert!((tip - 0.02).abs() < 2e-3, "finger tips at {tip} m, the wall begins at 0.02 m");
}

#[test]
fn a_falling_lid_does_not_pass_through_the_hand() {
    let object = lid();
    let mut world = world(&object, &[1.2]);
    // Fingers point along x, at the height where the lid meets them at half of its way.
    let grasp = Grasp::new(Point3::new(0.4, 0.0, 0.25), Vector3::x(), Vector3::z());
    let mut hand = world.add_hand(&grasp.hand_at(GRIPPER.tip), FingerState::Closed);
    let mut deepest = 0.0f32;
    for _ in 0..2000 {
        hand.advance_target(&mut world);
        world.step();
        deepest = deepest.max(world.hand_penetration());
        // The lid's lower face, above the middle of the finger tips.
        let pose = world.hand_pose(&hand).hand;
        let tip = pose * Point3::new(0.0, 0.0, GRIPPER.tip);
        let in_lid = world.world_from_link(1).inverse_transform_point(&tip);
        assert!(in_lid.z < 0.0, "the hand is above the lid's lower face: {in_lid}");
    }
    assert!(deepest < 2e-3, "{deepest} m deep");
    // 5 kg on the lid's hinge side weigh on a spring of 1,000 N/m: the lid rests on the hand.
    assert!(world.q(1) > 0.2 && world.hand_contact(1).is_some(), "{}", world.q(1));
}

#[test]
fn a_grip_holds_a_drawer_against_its_damping() {
    // A drawer of 8 kg that slides towards -x, with an upright bar as handle before it.
    let slide = joint(0, JointKind::Prismatic, -Vector3::x(), (0.0, 0.3));
    let pieces = vec![
        cuboid([0.0, -0.1, -0.1], [0.2, 0.1, 0.1]),
        cuboid([-0.06, -0.008, -0.06], [-0.04, 0.008, 0.06]),
        cuboid([-0.04, -0.008, -0.06], [0.0, 0.008, -0.04]),
        cuboid([-0.04, -0.008, 0.04], [0.0, 0.008, 0.06]),
    ];
    let object = object(vec![link("base", None, vec![]), link("drawer", Some(slide), pieces)]);
    let mut world = world(&object, &[0.0]);
    // The finger tips reach the middle of the bar from both sides along y.
    let grasp = Grasp::new(Point3::new(-0.042, 0.0, 0.0), Vector3::x(), Vector3::z());
    let mut hand = world.add_hand(&grasp.hand_at(GRIPPER.tip), FingerState::Open);
    assert!(!world.overlaps(&hand));
    hand.set_opening(&mut world, 0.0);
    drive(&mut world, &mut hand, [0.0; 6], 1000);
    let in_drawer = |world: &World, hand: &Hand| {
        world
            .world_from_link(1)
            .inverse_transform_point(&world.hand_pose(hand).hand.translation.vector.into())
    };
    let gripped = in_drawer(&world, &hand);
    drive(&mut world, &mut hand, [-0.025, 0.0, 0.0, 0.0, 0.0, 0.0], 2000);
    drive(&mut world, &mut hand, [0.0; 6], 2000);
    assert!((world.q(1) - 0.1).abs() < 5e-3, "pulled 0.1 m, the drawer came {} m", world.q(1));
    let slip = (in_drawer(&world, &hand) - gripped).norm();
    assert!(slip < 2e-3, "slipped {slip} m");
}

#[test]
fn overlap_at_the_start_is_seen_without_a_step() {
    let wall = cuboid([0.0, -0.5, -0.5], [0.02, 0.5, 0.5]);
    let object = object(vec![link("base", None, vec![wall])]);
    let grasp = Grasp::new(Point3::new(0.02, 0.0, 0.0), -Vector3::x(), Vector3::z());
    for (distance, expected) in [(GRIPPER.tip + 1e-3, false), (GRIPPER.tip - 1e-3, true)] {
        let mut world = world(&object, &[]);
        let hand = world.add_hand(&grasp.hand_at(distance), FingerState::Closed);
        assert_eq!(world.overlaps(&hand), expected, "at {distance} m");
    }
}

#[test]
fn odd_joints_stand_where_they_are_put() {
    let far = joint(0, JointKind::Prismatic, Vector3::x(), (0.3, 0.5));
    let turning = joint(1, JointKind::Continuous, Vector3::z(), (-10.0, 10.0));
    let empty = joint(2, JointKind::Revolute, Vector3::z(), (-1.0, -0.5));
    let block = cuboid([-0.02; 3], [0.02; 3]);
    let object = object(vec![
        link("base", None, vec![]),
        link("far", Some(far), vec![block.clone()]),
        link("turning", Some(turning), vec![block]),
        link("empty", Some(empty), vec![]),
    ]);
    let q = [0.4, 3.1, -0.75];
    let mut world = world(&object, &q);
    for (link, expected) in object.world_from_links(&q).iter().enumerate() {
        let found = world.world_from_link(link);
        assert!((found.to_homogeneous() - expected.to_homogeneous()).amax() < 1e-5, "link {link}");
    }
    for _ in 0..500 {
        world.step();
    }
    assert!(!world.broke_down());
    for (link, q) in q.iter().enumerate() {
        assert!((world.q(link + 1) - q).abs() < 1e-3, "joint {link}: {}", world.q(link + 1));
    }
}

#[test]
fn many_heavy_pieces_stay_where_they_are() {
    let door = joint(0, JointKind::Revolute, Vector3::z(), (0.0, 1.5));
    let pieces = (0..60).map(|i| {
        let y = 0.012 * i as f32;
        // They overlap by half and weigh 1.2 t in all.
        cuboid([0.0, y, -0.8], [0.5, y + 0.024, 0.8])
    });
    let object = object(vec![link("base", None, vec![]), link("door", Some(door), pieces.collect())]);
    let mut world = world(&object, &[0.7]);
    for _ in 0..1000 {
        world.step();
    }
    assert!((world.q(1) - 0.7).abs() < 1e-4, "{}", world.q(1));
}
