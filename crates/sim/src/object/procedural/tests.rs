//! What every generated object promises, for all categories and many seeds.

use nalgebra::{Isometry3, Matrix3, Point3};
use rapier3d::math::{Pose, Vector};
use rapier3d::parry::query;
use rapier3d::parry::shape::SharedShape;
use where2act_core::{Category, Seed};

use super::generate;
use crate::object::{ConvexPiece, JointKind, Object};

const SEEDS: u64 = 50;

fn all() -> impl Iterator<Item = Object> {
    Category::ALL.into_iter().flat_map(|category| (0..SEEDS).map(move |seed| generate(category, Seed(seed))))
}

#[test]
fn trees_are_valid_and_limits_ordered() {
    for object in all() {
        assert!(object.links[0].joint.is_none(), "{}", object.name);
        assert!(!object.movable().is_empty(), "{} has no movable part", object.name);
        for link in object.movable() {
            let joint = object.joint(link);
            assert!(joint.parent < link, "{} {}", object.name, joint.name);
            let (low, high) = joint.limits;
            assert!(low.is_finite() && high.is_finite() && low <= 0.0 && 0.0 <= high, "{}", object.name);
            assert!(joint.range() > 0.003, "{} {} hardly moves: {}", object.name, joint.name, joint.range());
            if joint.kind == JointKind::Continuous {
                assert_eq!(joint.limits, (-10.0, 10.0));
            }
        }
    }
}

#[test]
fn links_are_seen_and_touched_and_inside_the_unit_sphere() {
    for object in all() {
        let poses = object.world_from_links(&object.closed());
        let mut farthest = 0.0f32;
        for (link, pose) in object.links.iter().zip(&poses) {
            assert!(!link.visuals.is_empty() && !link.pieces.is_empty(), "{} {}", object.name, link.label);
            for visual in &link.visuals {
                let mesh = &visual.mesh;
                let n = mesh.positions.len();
                assert!(visual.material < object.materials.len());
                assert!(mesh.normals.len() == n && mesh.uvs.len() == n);
                assert!(mesh.triangles.iter().flatten().all(|&i| (i as usize) < n));
                assert!(
                    mesh.normals.iter().all(|v| (v.norm() - 1.0).abs() < 1e-3),
                    "{} {}",
                    object.name,
                    link.label
                );
                assert!(mesh.uvs.iter().flatten().all(|v| v.is_finite()));
                let radius = mesh.positions.iter().map(|p| (pose * p).coords.norm()).fold(0.0, f32::max);
                farthest = farthest.max(radius);
            }
            let radius = link.pieces.iter().flat_map(|p| &p.points).map(|p| (pose * p).coords.norm());
            assert!(
                radius.fold(0.0, f32::max) < 1.06,
                "{} {}: a piece leaves the sphere",
                object.name,
                link.label
            );
        }
        assert!((0.99..=1.001).contains(&farthest), "{}: radius {farthest}", object.name);
    }
}

/// Volume of the box that the corners' own axes span, by their spread.
fn thinnest(piece: &ConvexPiece) -> f32 {
    let n = piece.points.len() as f32;
    let mean = piece.points.iter().fold(nalgebra::Vector3::zeros(), |sum, p| sum + p.coords) / n;
    let spread = piece.points.iter().fold(Matrix3::zeros(), |sum, p| {
        let d = p.coords - mean;
        sum + d * d.transpose()
    });
    (spread / n).symmetric_eigenvalues().min().max(0.0).sqrt()
}

#[test]
fn pieces_are_solid_and_few() {
    for object in all() {
        let pieces: usize = object.links.iter().map(|l| l.pieces.len()).sum();
        assert!(pieces <= 160, "{}: {pieces} pieces", object.name);
        assert!(
            (50..=20_000).contains(&object.triangle_count()),
            "{}: {}",
            object.name,
            object.triangle_count()
        );
        for link in &object.links {
            for piece in &link.pieces {
                assert!(piece.points.len() >= 4);
                assert!(
                    piece
                        .points
                        .iter()
                        .flat_map(|p| p.coords.iter().copied().collect::<Vec<_>>())
                        .all(f32::is_finite)
                );
                assert!(thinnest(piece) > 5e-4, "{} {}: a flat piece {piece:?}", object.name, link.label);
            }
        }
    }
}

fn shape(piece: &ConvexPiece, pose: &Isometry3<f32>) -> SharedShape {
    let corner = |p: &Point3<f32>| {
        let p = pose * p;
        Vector::new(p.x, p.y, p.z)
    };
    let points: Vec<Vector> = piece.points.iter().map(corner).collect();
    SharedShape::convex_hull(&points).expect("a solid piece")
}

#[test]
fn parts_that_can_collide_are_apart_when_closed() {
    let mut close = Vec::new();
    for object in all() {
        let poses = object.world_from_links(&object.closed());
        let shapes: Vec<Vec<SharedShape>> = object
            .links
            .iter()
            .zip(&poses)
            .map(|(link, pose)| link.pieces.iter().map(|piece| shape(piece, pose)).collect())
            .collect();
        for b in object.movable() {
            // A part never collides with its direct parent.
            for a in (0..b).filter(|&a| a != object.joint(b).parent) {
                for one in &shapes[a] {
                    for other in &shapes[b] {
                        let gap = query::distance(&Pose::IDENTITY, &**one, &Pose::IDENTITY, &**other);
                        let gap = gap.expect("convex pieces").distance;
                        let (a, b) = (&object.links[a], &object.links[b]);
                        if gap < 5e-4 {
                            close.push(format!(
                                "{}: {} {} and {} {}",
                                object.name, a.label, a.name, b.label, b.name
                            ));
                        }
                    }
                }
            }
        }
    }
    close.dedup();
    assert!(close.is_empty(), "parts within 0.5 mm:\n{}", close.join("\n"));
}

#[test]
fn same_seed_same_object_other_seed_another() {
    for category in Category::ALL {
        let print = |seed: u64| {
            let object = generate(category, Seed(seed));
            let visuals = object.links.iter().flat_map(|l| &l.visuals);
            let positions: Vec<Point3<f32>> = visuals.flat_map(|v| v.mesh.positions.clone()).collect();
            (
                object.name.clone(),
                positions,
                object.materials,
                object.links.iter().map(|l| l.joint.clone()).collect::<Vec<_>>(),
            )
        };
        let prints: Vec<_> = (0..20).map(print).collect();
        assert!(print(7) == prints[7], "{category}");
        for (i, one) in prints.iter().enumerate() {
            assert!(
                prints[..i].iter().all(|other| other.1 != one.1),
                "{category}:{i} is like an earlier one"
            );
        }
    }
}

#[test]
fn doors_shut_flush_with_the_side_that_they_open_to() {
    let (mut towards, mut away) = (0, 0);
    for seed in 0..SEEDS {
        let object = generate(Category::Door, Seed(seed));
        let shut = object.world_from_links(&object.closed());
        let mut sides = Vec::new();
        for link in object.movable() {
            let joint = object.joint(link);
            if object.links[link].label != "door" || joint.kind != JointKind::Revolute {
                continue;
            }
            let points = || object.links[link].pieces.iter().flat_map(|piece| &piece.points);
            let depth = |pose: &Isometry3<f32>| points().map(|p| (pose * p).x).sum::<f32>();
            let q = if joint.limits.1 > -joint.limits.0 { 0.5 } else { -0.5 };
            let open = shut[joint.parent] * joint.parent_from_link(q);
            // The front faces -x, and frames are as deep before the middle as behind it.
            let outwards = depth(&open) < depth(&shut[link]);
            let hinge = (shut[joint.parent] * joint.parent_from_joint).translation.x;
            assert_eq!(outwards, hinge < 0.0, "{} hinges at {hinge}", object.name);
            sides.push(outwards);
        }
        assert!(sides.windows(2).all(|pair| pair[0] == pair[1]), "{}: leaves open apart", object.name);
        towards += usize::from(sides.first() == Some(&true));
        away += usize::from(sides.first() == Some(&false));
    }
    assert!(towards > away && away > 0, "{towards} towards the viewer, {away} away");
}
