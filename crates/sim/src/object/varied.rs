//! The same object in other proportions, perhaps lying on its side.

use std::f32::consts::FRAC_PI_2;
use std::sync::Arc;

use nalgebra::{Isometry3, Matrix3, Rotation3, Translation3, Unit, Vector3};
use rand::{Rng, RngExt};

use super::{Joint, JointKind, Link, Mesh, Object, bounding_sphere};

/// Every direction becomes longer or shorter by at most this factor, before the whole is fitted.
const STRETCH: f32 = 1.5;
/// Probability that an object is turned by one to three quarter turns around the axis to its front: what was on top
/// is at a side or below.
const ROLLED: f64 = 0.3;
/// Probability that it lies on its back, the front up.
const ON_ITS_BACK: f64 = 0.1;

impl Object {
    /// Stretches the object along its own axes, turns it by quarter turns and fits it into the sphere that it filled.
    /// Joints turn as far as they did; what slid by a part's width does so again. Makes more of few objects:
    /// [`crate::collect::Recipe::varied`].
    #[must_use]
    pub fn varied(&self, rng: &mut impl Rng) -> Self {
        let factors = Vector3::from_fn(|_, _| STRETCH.powf(rng.random_range(-1.0..=1.0)));
        let stretch = Matrix3::from_diagonal(&factors);
        let kind: f64 = rng.random();
        let quarters = rng.random_range(1..=3) as f32;
        let turn = if kind < ROLLED {
            Rotation3::from_axis_angle(&Vector3::x_axis(), quarters * FRAC_PI_2)
        } else if kind < ROLLED + ON_ITS_BACK {
            Rotation3::from_axis_angle(&Vector3::y_axis(), FRAC_PI_2)
        } else {
            Rotation3::identity()
        };
        self.transformed(&(turn.matrix() * stretch))
    }

    /// The object with every vertex at rest (all joints at 0) moved by a linear map, centred and fitted.
    fn transformed(&self, map: &Matrix3<f32>) -> Self {
        let old = self.world_from_links(&vec![0.0; self.links.len() - 1]);
        let seen = || {
            let links = self.links.iter().zip(&old);
            links.flat_map(|(link, pose)| {
                link.visuals.iter().flat_map(|v| &v.mesh.positions).map(move |p| pose * p)
            })
        };
        let (_, radius) = bounding_sphere(seen());
        let (centre, mapped) = bounding_sphere(seen().map(|p| map * p));
        let fit = if mapped > 0.0 { radius / mapped } else { 1.0 };
        let map = map * fit;
        // Links keep their origins on their axes and take the world's directions.
        let new: Vec<Isometry3<f32>> = old
            .iter()
            .map(|pose| Translation3::from(map * pose.translation.vector - centre.coords * fit).into())
            .collect();
        let link = |(index, link): (usize, &Link)| {
            let local = map * old[index].rotation.to_rotation_matrix().matrix();
            let mut link = link.clone();
            link.joint = link.joint.map(|joint| {
                let along = local * joint.axis.into_inner();
                let scale = if joint.kind == JointKind::Prismatic { along.norm() } else { 1.0 };
                Joint {
                    parent_from_joint: new[joint.parent].inv_mul(&new[index]),
                    axis: Unit::new_normalize(along),
                    limits: (joint.limits.0 * scale, joint.limits.1 * scale),
                    ..joint
                }
            });
            for visual in &mut link.visuals {
                visual.mesh = Arc::new(mapped_mesh(&visual.mesh, &local));
            }
            link.pieces.iter_mut().flat_map(|piece| &mut piece.points).for_each(|p| *p = local * *p);
            link
        };
        Self { links: self.links.iter().enumerate().map(link).collect(), ..self.clone() }
    }
}

fn mapped_mesh(mesh: &Mesh, map: &Matrix3<f32>) -> Mesh {
    // Normals stay across the surface under the inverse's transpose, which is the matrix of cofactors but for a scale.
    let [x, y, z] = [0, 1, 2].map(|i| map.column(i).into_owned());
    let cofactors = Matrix3::from_columns(&[y.cross(&z), z.cross(&x), x.cross(&y)]);
    Mesh {
        positions: mesh.positions.iter().map(|p| map * p).collect(),
        normals: mesh.normals.iter().map(|n| (cofactors * n).try_normalize(0.0).unwrap_or(*n)).collect(),
        uvs: mesh.uvs.clone(),
        triangles: mesh.triangles.clone(),
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Point3;
    use where2act_core::{Category, Seed};

    use super::*;
    use crate::object::procedural::generate;

    fn world(object: &Object, q: &[f32]) -> Vec<Vec<Point3<f32>>> {
        let poses = object.world_from_links(q);
        let of = |(link, pose): (&Link, &Isometry3<f32>)| {
            link.visuals.iter().flat_map(|v| &v.mesh.positions).map(|p| pose * p).collect()
        };
        object.links.iter().zip(&poses).map(of).collect()
    }

    #[test]
    fn varied_objects_fill_the_sphere_keep_their_tree_and_differ() {
        for category in Category::ALL {
            for seed in 0..12 {
                let object = generate(category, Seed(seed));
                let varied = object.varied(&mut Seed(seed).rng());
                assert_eq!(varied.links.len(), object.links.len());
                let points: Vec<_> = world(&varied, &vec![0.0; object.links.len() - 1]).concat();
                let (centre, radius) = bounding_sphere(points.into_iter());
                assert!(
                    (radius - 1.0).abs() < 1e-3 && centre.coords.norm() < 1e-3,
                    "{category}:{seed}: {radius}"
                );
                for link in varied.movable() {
                    let (joint, was) = (varied.joint(link), object.joint(link));
                    assert_eq!((joint.kind, joint.parent), (was.kind, was.parent));
                    assert!(joint.range() > 0.0 && joint.limits.0 <= 0.0 && joint.limits.1 >= 0.0);
                }
                let normals = varied.links.iter().flat_map(|l| &l.visuals).flat_map(|v| &v.mesh.normals);
                assert!(normals.into_iter().all(|n| (n.norm() - 1.0).abs() < 1e-3));
                assert!(varied.links.iter().zip(&object.links).any(|(a, b)| a.pieces != b.pieces));
            }
        }
    }

    #[test]
    fn what_slides_goes_where_the_map_takes_it() {
        let map = Matrix3::new(0.0, 0.0, 1.2, 0.0, 0.8, 0.0, -1.4, 0.0, 0.0);
        for seed in 0..20 {
            let object = generate(Category::StorageFurniture, Seed(seed));
            let mapped = object.transformed(&map);
            let slides = |l: &usize| object.joint(*l).kind == JointKind::Prismatic;
            let share = |object: &Object| -> Vec<f32> {
                object.movable().map(|l| if slides(&l) { object.joint(l).limits.1 } else { 0.0 }).collect()
            };
            let (open, opened) =
                (world(&object, &share(&object)).concat(), world(&mapped, &share(&mapped)).concat());
            let (shut, shut_mapped) = (
                world(&object, &vec![0.0; object.links.len() - 1]).concat(),
                world(&mapped, &vec![0.0; object.links.len() - 1]).concat(),
            );
            // Motions are mapped as vertices are, but for the one factor that fits the whole.
            let moved = |a: &[Point3<f32>], b: &[Point3<f32>]| {
                a.iter().zip(b).map(|(a, b)| b - a).collect::<Vec<_>>()
            };
            let (was, is) = (moved(&shut, &open), moved(&shut_mapped, &opened));
            let scale = is.iter().map(Vector3::norm).sum::<f32>()
                / was.iter().map(|v| (map * v).norm()).sum::<f32>().max(1e-9);
            for (was, is) in was.iter().zip(&is) {
                assert!((map * was * scale - is).norm() < 1e-4, "{was:?} {is:?}");
            }
        }
    }

    #[test]
    fn axes_of_hinges_stay_where_parts_meet() {
        let map = Matrix3::from_diagonal(&Vector3::new(1.4, 0.7, 1.1));
        let object = generate(Category::Microwave, Seed(3));
        let mapped = object.transformed(&map);
        let rest = vec![0.0; object.links.len() - 1];
        let (old, new) = (object.world_from_links(&rest), mapped.world_from_links(&rest));
        let spread = |poses: &[Isometry3<f32>]| poses[1].translation.vector - poses[0].translation.vector;
        let ratio = spread(&new).component_div(&(map * spread(&old)));
        assert!((ratio.max() - ratio.min()).abs() < 1e-3, "{ratio}");
    }
}
