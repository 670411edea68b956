//! Finding the visible surface near a point.

use nalgebra::{Point3, Vector3};
use parry3d::math::Vector;
use parry3d::query::PointQuery;
use parry3d::shape::Triangle;

use crate::scene::SettledScene;

/// How far to both sides of a surface its inside is looked for, metres.
const PROBE: f32 = 0.004;

/// A point on the visible surface of an object.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SurfacePoint {
    /// Index of the link.
    pub link: usize,
    /// The point, in the world frame.
    pub point_in_world: Point3<f32>,
    /// Outward unit normal, in the world frame.
    pub normal_in_world: Vector3<f32>,
    /// Distance from where it was looked for, metres.
    pub distance: f32,
}

impl SettledScene {
    /// The point of the visible surface nearest to a point in the world; with `link`, on that link alone. `None` if
    /// there is no surface.
    #[must_use]
    pub fn nearest_surface(&self, point_in_world: &Point3<f32>, link: Option<usize>) -> Option<SurfacePoint> {
        let mut nearest: Option<SurfacePoint> = None;
        for (index, world_from_link) in self.world_from_links().into_iter().enumerate() {
            if link.is_some_and(|wanted| wanted != index) {
                continue;
            }
            let local = world_from_link.inverse_transform_point(point_in_world);
            let query = vector(&local);
            for visual in &self.object().links[index].visuals {
                for corners in &visual.mesh.triangles {
                    let [a, b, c] = corners.map(|corner| vector(&visual.mesh.positions[corner as usize]));
                    let triangle = Triangle::new(a, b, c);
                    let (Some(normal), projected) =
                        (triangle.normal(), triangle.project_local_point(query, false))
                    else {
                        continue;
                    };
                    let distance = (projected.point - query).length();
                    if nearest.is_none_or(|best| distance < best.distance) {
                        let p = Point3::new(projected.point.x, projected.point.y, projected.point.z);
                        let n = Vector3::new(normal.x, normal.y, normal.z);
                        nearest = Some(SurfacePoint {
                            link: index,
                            point_in_world: world_from_link * p,
                            normal_in_world: world_from_link * n,
                            distance,
                        });
                    }
                }
            }
        }
        nearest.map(|found| self.outward(found))
    }

    /// Turns the normal outwards. The winding of real meshes says nothing, so it is the side on which no collision
    /// piece lies, or, of sheets in free air, the side away from the object's middle.
    fn outward(&self, found: SurfacePoint) -> SurfacePoint {
        let world_from_link = self.world_from_links()[found.link];
        let inside = |side: f32| {
            let probe = found.point_in_world + found.normal_in_world * (side * PROBE);
            let local = world_from_link.inverse_transform_point(&probe);
            self.piece_contains(found.link, &local)
        };
        let flip = match (inside(1.0), inside(-1.0)) {
            (true, false) => true,
            (false, true) => false,
            _ => found.normal_in_world.dot(&found.point_in_world.coords) < 0.0,
        };
        let normal_in_world = if flip { -found.normal_in_world } else { found.normal_in_world };
        SurfacePoint { normal_in_world, ..found }
    }
}

fn vector(p: &Point3<f32>) -> Vector {
    Vector::new(p.x, p.y, p.z)
}
