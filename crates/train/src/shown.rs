//! How a view is shown to a network: in a mirror, by a camera that is not held upright.
//!
//! A picture is turned about its middle, also where that is not where the camera's axis is, as in a close-up: it is then another
//! part of what the rolled camera sees, and directions are the same.

use nalgebra::{Point3, Rotation2, Vector2, Vector3};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use where2act_core::{ImageSize, Pixel};

use crate::config::BatchConfig;
use crate::questions::Question;

/// Farthest that a camera is rolled about its axis, degrees.
const ROLL: f32 = 20.0;

/// What a mirror that swaps left and right, and then a camera rolled about its axis, make of a scene.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Shown {
    mirrored: bool,
    roll: Option<Rotation2<f32>>,
}

impl Shown {
    /// As often mirrored and rolled as the configuration wants.
    pub(crate) fn draw(config: &BatchConfig, rng: &mut ChaCha8Rng) -> Self {
        let mirrored = rng.random::<f32>() < config.mirrored;
        let rolled = config.rolled > 0.0 && rng.random::<f32>() < config.rolled;
        let roll = rolled.then(|| Rotation2::new(rng.random_range(-ROLL..ROLL).to_radians()));
        Self { mirrored, roll }
    }

    /// A direction in the camera frame.
    pub(crate) fn direction(&self, v: Vector3<f32>) -> Vector3<f32> {
        let across = Vector2::new(if self.mirrored { -v.x } else { v.x }, v.y);
        let across = self.roll.map_or(across, |roll| roll * across);
        Vector3::new(across.x, across.y, v.z)
    }

    /// A point in the camera frame.
    pub(crate) fn point(&self, point: Point3<f32>) -> Point3<f32> {
        Point3::from(self.direction(point.coords))
    }

    /// The question about the scene as it is shown; its pixel stays that of the scene as it is.
    pub(crate) fn turn(&self, question: &mut Question) {
        if self.mirrored {
            question.mirror();
        }
        let Some(roll) = self.roll else { return };
        for axis in question.orientation.as_chunks_mut::<3>().0 {
            let across = roll * Vector2::new(axis[0], axis[1]);
            (axis[0], axis[1]) = (across.x, across.y);
        }
    }

    /// Where a pixel of a square picture is then, if it is still in it.
    pub(crate) fn pixel(&self, Pixel { u, v }: Pixel, side: usize) -> Option<Pixel> {
        let u = if self.mirrored { side as u32 - 1 - u } else { u };
        let Some(roll) = self.roll else { return Some(Pixel { u, v }) };
        let middle = Vector2::repeat(0.5 * side as f32);
        let at = roll * (Vector2::new(u as f32 + 0.5, v as f32 + 0.5) - middle) + middle;
        let inside = at.iter().all(|x| (0.0..side as f32).contains(x));
        inside.then(|| Pixel { u: at.x as u32, v: at.y as u32 })
    }

    /// A square picture; what a rolled camera sees beside it looks like its border.
    pub(crate) fn picture(&self, mut rgb: Vec<[u8; 3]>, side: usize) -> Vec<[u8; 3]> {
        if self.mirrored {
            rgb.chunks_exact_mut(side).for_each(<[_]>::reverse);
        }
        let Some(roll) = self.roll else { return rgb };
        let (middle, size, last) = (0.5 * side as f32, ImageSize::square(side), side - 1);
        let seen = |u: usize, v: usize| {
            let from = roll.inverse() * Vector2::new(u as f32 + 0.5 - middle, v as f32 + 0.5 - middle);
            let [x, y] = [from.x, from.y].map(|x| (x + middle - 0.5).clamp(0.0, last as f32));
            let (left, top) = (x as usize, y as usize);
            let (across, down) = (x - left as f32, y - top as f32);
            let at =
                |u: usize, v: usize| rgb[size.index(Pixel { u: u.min(last) as u32, v: v.min(last) as u32 })];
            let corners = [at(left, top), at(left + 1, top), at(left, top + 1), at(left + 1, top + 1)];
            [0, 1, 2].map(|channel| {
                let [a, b, c, d] = corners.map(|colour| f32::from(colour[channel]));
                let [upper, lower] = [a + across * (b - a), c + across * (d - c)];
                (upper + down * (lower - upper)).round() as u8
            })
        };
        (0..side).flat_map(|v| (0..side).map(move |u| (u, v))).map(|(u, v)| seen(u, v)).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Rotation3;
    use where2act_core::{Camera, Grasp, Orientation6, Primitive, Seed};

    fn shown(mirrored: bool, degrees: f32) -> Shown {
        Shown { mirrored, roll: Some(Rotation2::new(degrees.to_radians())) }
    }

    #[test]
    fn the_configuration_says_how_often() {
        let rng = &mut Seed(1).rng();
        let mut of = |mirrored, rolled| {
            let config = BatchConfig { mirrored, rolled, ..BatchConfig::default() };
            let all: Vec<_> = (0..1000).map(|_| Shown::draw(&config, rng)).collect();
            let rolls: Vec<f32> = all.iter().filter_map(|s| Some(s.roll?.angle().to_degrees())).collect();
            assert!(rolls.iter().all(|roll| roll.abs() <= ROLL));
            (
                all.iter().filter(|s| s.mirrored).count(),
                rolls.len(),
                rolls.iter().filter(|r| **r > 10.0).count(),
            )
        };
        assert_eq!(of(0.0, 0.0), (0, 0, 0));
        assert_eq!(of(1.0, 0.0), (1000, 0, 0));
        let (mirrored, rolled, far) = of(0.5, 0.5);
        assert!([mirrored, rolled].iter().all(|n| (400..600).contains(n)) && (80..170).contains(&far));
    }

    /// What is seen of a point is where its pixel goes, and has its colour; a hand there moves as the directions are shown.
    #[test]
    fn pixels_points_colours_and_hands_go_together() {
        const SIDE: usize = 224;
        let camera =
            Camera::orbit(Point3::origin(), 5.0, 0.3, 0.6, ImageSize::square(SIDE), Camera::PUBLISHED_FOV);
        // Colours that change slowly, so that a neighbour's is nearly the same.
        let colour = |u: usize, v: usize| [u as u8, v as u8, ((u + v) / 2) as u8];
        let rgb: Vec<_> = (0..SIDE * SIDE).map(|i| colour(i % SIDE, i / SIDE)).collect();
        for shown in
            [shown(false, 17.0), shown(true, -20.0), shown(true, 0.0), Shown { mirrored: true, roll: None }]
        {
            let picture = shown.picture(rgb.clone(), SIDE);
            let mut outside = 0;
            for (u, v) in (0..SIDE).step_by(9).flat_map(|v| (0..SIDE).step_by(7).map(move |u| (u, v))) {
                let pixel = Pixel { u: u as u32, v: v as u32 };
                let Some(at) = shown.pixel(pixel, SIDE) else {
                    outside += 1;
                    continue;
                };
                let point = shown.point(camera.intrinsics.pixel_to_point(pixel, 4.0));
                let (x, y) = camera.intrinsics.project(&point).unwrap();
                assert!((x - at.u as f32 - 0.5).abs() < 0.51 && (y - at.v as f32 - 0.5).abs() < 0.51);
                let found = picture[ImageSize::square(SIDE).index(at)];
                for (found, expected) in found.into_iter().zip(colour(u, v)) {
                    assert!(found.abs_diff(expected) <= 1, "{pixel:?} {found} {expected}");
                }
            }
            assert_eq!(outside > 0, shown.roll.is_some_and(|roll| roll.angle() != 0.0), "{outside}");
            for primitive in Primitive::ALL {
                let rotation = Rotation3::from_euler_angles(0.4, -0.8, 1.9);
                let grasp = |rotation| Grasp { point: Point3::origin(), rotation };
                let mut question = Question::example(primitive, Orientation6::from_rotation(&rotation).0);
                shown.turn(&mut question);
                let turned = Orientation6(question.orientation).to_rotation();
                let wanted = shown.direction(primitive.intended_direction(&grasp(rotation)));
                let found = primitive.intended_direction(&grasp(turned));
                assert!((wanted - found).norm() < 1e-5, "{primitive}: {wanted} {found}");
            }
        }
    }
}
