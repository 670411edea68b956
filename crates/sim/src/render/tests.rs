use std::sync::Arc;

use image::{Rgb, RgbImage};
use nalgebra::Translation3;
use where2act_core::{ImageSize, Observation, Seed};

use super::*;
use crate::object::{Link, Visual};

fn material(colour: [f32; 3]) -> Material {
    Material { colour, texture: None, specular: 0.0, shininess: 10.0, opacity: 1.0 }
}

fn object(parts: Vec<Vec<(Mesh, usize)>>, materials: Vec<Material>) -> Object {
    let link = |visuals: Vec<(Mesh, usize)>| Link {
        name: String::new(),
        label: String::new(),
        welded: Vec::new(),
        joint: None,
        visuals: visuals.into_iter().map(|(m, material)| Visual { mesh: Arc::new(m), material }).collect(),
        pieces: Vec::new(),
    };
    Object { name: "test".into(), category: None, links: parts.into_iter().map(link).collect(), materials }
}

const EMPTY: Object =
    Object { name: String::new(), category: None, links: Vec::new(), materials: Vec::new() };

fn poses(object: &Object) -> Vec<Isometry3<f32>> {
    vec![Isometry3::identity(); object.links.len()]
}

/// A rectangle spanned by two edges from a corner, its texture upright along the second.
fn rectangle(corner: [f32; 3], right: [f32; 3], up: [f32; 3]) -> Mesh {
    let (o, r, u) = (Point3::from(corner), Vector3::from(right), Vector3::from(up));
    Mesh {
        positions: vec![o, o + r, o + r + u, o + u],
        normals: vec![r.cross(&u).normalize(); 4],
        uvs: vec![[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]],
        triangles: vec![[0, 1, 2], [0, 2, 3]],
    }
}

fn sphere(radius: f32, rings: u32) -> Mesh {
    let mut mesh = Mesh::default();
    for i in 0..=rings {
        for j in 0..=2 * rings {
            let polar = std::f32::consts::PI * i as f32 / rings as f32;
            let around = std::f32::consts::PI * j as f32 / rings as f32;
            let n = Vector3::new(polar.sin() * around.cos(), polar.sin() * around.sin(), polar.cos());
            mesh.positions.push(Point3::from(n * radius));
            mesh.normals.push(n);
            mesh.uvs.push([0.0; 2]);
        }
    }
    let row = 2 * rings + 1;
    for i in 0..rings {
        for j in 0..2 * rings {
            let a = i * row + j;
            mesh.triangles.extend([[a, a + row, a + row + 1], [a, a + row + 1, a + 1]]);
        }
    }
    mesh
}

/// Looks along +x at the origin from 5 m, so that world y is left and z is up.
fn front_camera() -> Camera {
    let size = ImageSize::square(448);
    Camera::look_at(Point3::new(-5.0, 0.0, 0.0), Point3::origin(), size, Camera::PUBLISHED_FOV)
}

fn middle() -> Pixel {
    Pixel { u: 224, v: 224 }
}

#[test]
fn a_wall_has_its_depth_normal_and_link_everywhere() {
    let wall = rectangle([0.5, 3.0, -3.0], [0.0, -6.0, 0.0], [0.0, 0.0, 6.0]);
    let object = object(vec![vec![], vec![(wall, 0)]], vec![material([1.0; 3])]);
    let view = render(&object, &poses(&object), &front_camera(), &Look::default());
    for (i, depth) in view.depth.iter().enumerate() {
        assert!((depth - 5.5).abs() < 1e-4, "pixel {i}: {depth}");
        assert!((view.normals_in_world[i] + Vector3::x()).norm() < 1e-5);
        assert_eq!(view.link[i], 2);
    }
    assert_eq!(view.link_at(middle()), Some(1));
    assert!((view.normal_in_world(middle()).unwrap() + Vector3::x()).norm() < 1e-5);
    assert_eq!(view.movable_pixels().len(), 448 * 448);
}

#[test]
fn points_seen_on_a_sphere_lie_on_it_and_its_outline_is_right() {
    let radius = 0.6;
    let object = object(vec![vec![(sphere(radius, 200), 0)]], vec![material([0.5; 3])]);
    let camera =
        Camera::orbit(Point3::origin(), 5.0, 2.0, 0.8, ImageSize::square(448), Camera::PUBLISHED_FOV);
    let view = render(&object, &poses(&object), &camera, &Look::default());
    let mut seen = 0;
    for v in 0..448 {
        for u in 0..448 {
            let pixel = Pixel { u, v };
            let Some(point) = view.point_in_world(pixel) else { continue };
            seen += 1;
            assert!((point.coords.norm() - radius).abs() < 2e-4, "{pixel:?}: {point}");
            assert!(view.normal_in_world(pixel).unwrap().dot(&point.coords.normalize()) > 0.999);
        }
    }
    // The outline is a circle of radius f tan(asin(r / d)) pixels.
    let outline = camera.intrinsics.fx * (radius / 5.0f32).asin().tan();
    let area = std::f32::consts::PI * outline * outline;
    assert!((seen as f32 / area - 1.0).abs() < 0.005, "{seen} pixels, expected {area}");
}

#[test]
fn nearer_things_hide_others_and_extras_have_no_link() {
    let far = rectangle([1.0, 1.0, -1.0], [0.0, -2.0, 0.0], [0.0, 0.0, 2.0]);
    let near = rectangle([0.0, 0.2, -0.2], [0.0, -0.4, 0.0], [0.0, 0.0, 0.4]);
    let object = object(vec![vec![(near, 0)], vec![(far.clone(), 0)]], vec![material([1.0, 0.0, 0.0])]);
    let view = render(&object, &poses(&object), &front_camera(), &Look::default());
    assert_eq!(view.link_at(middle()), Some(0));
    assert_eq!(view.link_at(Pixel { u: 150, v: 224 }), Some(1));
    assert_eq!(view.link_at(Pixel { u: 5, v: 5 }), None);
    assert_eq!(view.rgb[0], [255; 3]);
    let blue = material([0.0, 0.0, 1.0]);
    let extra =
        Extra { mesh: &far, world_from_mesh: Translation3::new(-3.0, 0.0, 0.0).into(), material: &blue };
    let view = render_with(&object, &poses(&object), &[extra], &front_camera(), &Look::default());
    let at = view.camera.size.index(middle());
    assert_eq!((view.link[at], view.rgb[at][0]), (0, 0));
    assert!((view.depth[at] - 3.0).abs() < 1e-4);
}

#[test]
fn textures_are_upright_and_perspective_correct() {
    // Red left half, lower right quarter green; the wall leans away to the right.
    let mut texture = RgbImage::from_pixel(64, 64, Rgb([0, 0, 255]));
    for y in 0..64 {
        for x in 0..64 {
            if x < 32 {
                texture.put_pixel(x, y, Rgb([255, 0, 0]));
            } else if y >= 32 {
                texture.put_pixel(x, y, Rgb([0, 255, 0]));
            }
        }
    }
    let wall = rectangle([-1.0, 0.8, -0.8], [2.0, -1.6, 0.0], [0.0, 0.0, 1.6]);
    let textured = Material { texture: Some(Arc::new(texture)), ..material([1.0; 3]) };
    let object = object(vec![vec![(wall, 0)]], vec![textured]);
    let view = render(&object, &poses(&object), &front_camera(), &Look::default());
    let strongest = |pixel: Pixel| {
        let c = view.rgb[view.camera.size.index(pixel)];
        (0..3).max_by_key(|&i| c[i]).unwrap()
    };
    assert_eq!(strongest(Pixel { u: 180, v: 224 }), 0);
    assert_eq!(strongest(Pixel { u: 260, v: 200 }), 2);
    assert_eq!(strongest(Pixel { u: 260, v: 250 }), 1);
    // The middle of the wall is at the origin: colours change there, not in the middle of its outline.
    assert_eq!(strongest(Pixel { u: 221, v: 224 }), 0);
    assert_ne!(strongest(Pixel { u: 226, v: 224 }), 0);
}

#[test]
fn what_is_behind_the_near_plane_is_cut_off() {
    // A floor that reaches from far behind the camera to far in front of it.
    let floor = rectangle([-20.0, 5.0, -1.0], [0.0, -10.0, 0.0], [40.0, 0.0, 0.0]);
    let object = object(vec![vec![(floor, 0)]], vec![material([0.5; 3])]);
    let camera = front_camera();
    let view = render(&object, &poses(&object), &camera, &Look::default());
    for v in 0..448 {
        let pixel = Pixel { u: 224, v };
        let down = camera.intrinsics.pixel_to_point(pixel, 1.0).y;
        let expected = if down > 0.0 && 1.0 / down < 25.0 { 1.0 / down } else { 0.0 };
        let depth = view.depth[camera.size.index(pixel)];
        assert!((depth - expected).abs() <= 1e-3 * expected, "row {v}: {depth}, expected {expected}");
    }
    // Nearer than 0.1 m: not drawn.
    let close = rectangle([-4.95, 1.0, -1.0], [0.0, -2.0, 0.0], [0.0, 0.0, 2.0]);
    let object = self::object(vec![vec![(close, 0)]], vec![material([0.5; 3])]);
    assert!(render(&object, &poses(&object), &camera, &Look::default()).depth.iter().all(|&d| d == 0.0));
}

#[test]
fn meshes_are_tight_from_all_sides_and_edges_are_blended() {
    let object = object(vec![vec![(sphere(0.7, 37), 0)]], vec![material([0.2; 3])]);
    for seed in 0..20 {
        let camera = sample_camera(Point3::origin(), &mut Seed(seed).rng(), true);
        let view = render(&object, &poses(&object), &camera, &Look::default());
        // A gap would show up as background, or as the far side.
        let centre_depth = camera.world_from_camera.translation.vector.norm();
        for (row, depths) in view.depth.chunks(448).enumerate() {
            let first = depths.iter().position(|&d| d > 0.0);
            let last = depths.iter().rposition(|&d| d > 0.0);
            if let (Some(first), Some(last)) = (first, last) {
                assert!(depths[first..=last].iter().all(|&d| d > 0.0 && d < centre_depth), "row {row}");
            }
        }
        let edge = view.rgb.iter().filter(|c| (190..250).contains(&c[0])).count();
        assert!(edge > 100, "{edge} blended pixels");
    }
}

#[test]
fn a_wall_that_faces_camera_and_light_is_as_bright_as_it_should_be() {
    let wall = rectangle([0.0, 1.0, -1.0], [0.0, -2.0, 0.0], [0.0, 0.0, 2.0]);
    let look = Look {
        ambient: 0.2,
        lights: vec![Light { position: [-5.0, 0.0, 0.0], colour: [0.4, 0.5, 0.1] }],
        ..Look::default()
    };
    for specular in [0.0, 0.3] {
        let material = Material { specular, ..material([1.0, 0.5, 0.2]) };
        let object = object(vec![vec![(wall.clone(), 0)]], vec![material.clone()]);
        let view = render(&object, &poses(&object), &front_camera(), &look);
        let expected: [f32; 3] = std::array::from_fn(|c| {
            let light = look.lights[0].colour[c];
            // A vertical wall has 0.85 of the light from everywhere.
            sensor::linear(material.colour[c]) * (0.85 * 0.2 + light) + specular * light
        });
        assert_eq!(view.rgb[view.camera.size.index(middle())], sensor::code(&Vector3::from(expected)));
    }
}

#[test]
fn glass_is_solid_for_depth_and_lets_light_through() {
    let pane = rectangle([0.0, 1.0, -1.0], [0.0, -2.0, 0.0], [0.0, 0.0, 2.0]);
    let behind = rectangle([0.5, 1.0, -1.0], [0.0, -2.0, 0.0], [0.0, 0.0, 2.0]);
    let glass = Material { opacity: 0.3, ..material([0.0, 0.0, 1.0]) };
    let object = object(vec![vec![(behind, 1)], vec![(pane, 0)]], vec![glass, material([1.0, 0.0, 0.0])]);
    let view = render(&object, &poses(&object), &front_camera(), &Look::default());
    let at = view.camera.size.index(middle());
    assert_eq!(view.link[at], 2);
    assert!((view.depth[at] - 5.0).abs() < 1e-4);
    assert!(view.rgb[at][0] > 150 && view.rgb[at][2] > 40 && view.rgb[at][1] == 0, "{:?}", view.rgb[at]);
}

#[test]
fn looks_change_colours_only_and_repeat() {
    let object = object(vec![vec![(sphere(0.7, 30), 0)]], vec![material([0.6, 0.3, 0.1])]);
    let plain = render(&object, &poses(&object), &front_camera(), &Look::default());
    let mut different = 0;
    for seed in 0..12 {
        let look = Look::random(&mut Seed(seed).rng());
        let view = render(&object, &poses(&object), &front_camera(), &look);
        assert_eq!((&view.depth, &view.link), (&plain.depth, &plain.link));
        assert_eq!(view, render(&object, &poses(&object), &front_camera(), &look));
        different += usize::from(view.rgb != plain.rgb);
        let text = serde_json::to_string(&look).unwrap();
        assert_eq!(serde_json::from_str::<Look>(&text).unwrap(), look);
    }
    assert!(different >= 8, "{different} of 12 random looks differ");
}

#[test]
fn odd_inputs_do_no_harm() {
    let mut broken = sphere(0.5, 8);
    broken.positions[3] = Point3::new(f32::NAN, 0.0, f32::INFINITY);
    broken.normals[20] = Vector3::zeros();
    broken.triangles.push([1, 1, 1]);
    let object = object(vec![vec![(broken, 0), (Mesh::default(), 7)]], vec![material([0.5; 3])]);
    let view = render(&object, &poses(&object), &front_camera(), &Look::default());
    assert!(view.depth.iter().all(|d| d.is_finite()));
    let shadow = Shadow { corners: 9.0, reach: 1e30, cast: 9.0, length: 1e30 };
    for (position, paint) in [([0.0, 0.0, 0.5], None), ([-0.5, 0.0, 0.0], Some(Seed(3)))] {
        let lights = vec![Light { position, colour: [0.5; 3] }];
        for lights in [lights, Vec::new()] {
            let look = Look { lights, paint, shadow, ..Look::default() };
            for side in [448, 1, 0] {
                let camera = Camera { size: ImageSize::square(side), ..front_camera() };
                assert_eq!(render(&object, &poses(&object), &camera, &look).rgb.len(), side * side);
                assert_eq!(render(&EMPTY, &[], &camera, &look).depth.len(), side * side);
            }
        }
    }
    let nothing = render(&EMPTY, &[], &front_camera(), &Look::default());
    assert!(nothing.rgb.iter().all(|&c| c == [255; 3]));
    assert!(nothing.point_in_world(middle()).is_none());
}

#[test]
fn an_observation_holds_what_the_view_holds() {
    let object = object(vec![vec![(sphere(0.5, 20), 0)]], vec![material([0.5; 3])]);
    let view = render(&object, &poses(&object), &front_camera(), &Look::default());
    let points = view.observation().foreground_points();
    assert_eq!(points.len(), view.link.iter().filter(|&&l| l > 0).count());
    let (pixel, point) = points[points.len() / 2];
    let world = view.camera.world_from_camera * point;
    assert!((world - view.point_in_world(pixel).unwrap()).norm() < 1e-5);
    let Observation::Image { rgb: Some(rgb), .. } = view.observation() else { panic!("no picture") };
    assert_eq!(rgb, view.rgb);
    // The mean of a picture survives halving.
    let mean = |p: &[[u8; 3]]| p.iter().map(|c| f64::from(c[0])).sum::<f64>() / p.len() as f64;
    assert!((mean(&view.rgb_at(224)) - mean(&view.rgb)).abs() < 0.3);
    assert_eq!(view.rgb_at(100).len(), 10_000);
}

#[test]
fn beside_the_picture_there_is_nothing() {
    let wall = rectangle([0.5, 3.0, -3.0], [0.0, -6.0, 0.0], [0.0, 0.0, 6.0]);
    let object = object(vec![vec![], vec![(wall, 0)]], vec![material([0.5; 3])]);
    let view = render(&object, &poses(&object), &front_camera(), &Look::default());
    let size = view.camera.size;
    let (width, height) = (size.width as u32, size.height as u32);
    let seen = |u, v| {
        let pixel = Pixel { u, v };
        (view.point_in_world(pixel).is_some(), view.normal_in_world(pixel).is_some(), view.link_at(pixel))
    };
    assert_eq!(seen(width - 1, height - 1), (true, true, Some(1)));
    for (u, v) in [(width, 0), (0, height), (u32::MAX, 0), (0, u32::MAX)] {
        assert_eq!(seen(u, v), (false, false, None), "{u} {v}");
    }
}

#[test]
fn the_short_way_for_white_backgrounds_gives_the_same_picture() {
    let object = object(vec![vec![(sphere(0.5, 20), 0)]], vec![material([0.5, 0.2, 0.9])]);
    let plain = render(&object, &poses(&object), &front_camera(), &Look::default());
    let backdrop = Backdrop::Gradient([1.0; 3], [1.0; 3]);
    let long = render(&object, &poses(&object), &front_camera(), &Look { backdrop, ..Look::default() });
    assert_eq!(plain, long);
}

#[test]
fn any_number_of_threads_draws_the_same() {
    let glass = Material { opacity: 0.4, ..material([0.1, 0.4, 1.0]) };
    let shiny = Material { specular: 0.5, ..material([0.6, 0.3, 0.1]) };
    let pane = rectangle([-0.7, 0.5, -0.6], [0.1, -0.9, 0.1], [0.0, 0.1, 1.3]);
    let object = object(vec![vec![(sphere(0.6, 150), 1)], vec![(pane, 0)]], vec![glass, shiny]);
    for seed in 0..6 {
        let rng = &mut Seed(seed).rng();
        let (camera, look) = (sample_camera(Point3::origin(), rng, true), Look::random(rng));
        let draw = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| render(&object, &poses(&object), &camera, &look))
        };
        assert_eq!(draw(1), draw(3));
    }
}

/// A wall that faces the camera, and a plate half a metre before it, parallel to it, in the middle of the picture.
fn plate_before_a_wall() -> Object {
    let wall = rectangle([0.5, 2.0, -2.0], [0.0, -4.0, 0.0], [0.0, 0.0, 4.0]);
    let plate = rectangle([0.4, 0.2, -0.2], [0.0, -0.4, 0.0], [0.0, 0.0, 0.4]);
    object(vec![vec![(wall, 0)], vec![(plate, 0)]], vec![material([0.5; 3])])
}

#[test]
fn a_plate_darkens_the_wall_on_the_far_side_of_the_lamp_alone() {
    let object = plate_before_a_wall();
    let lamp = Light { position: [-3.0, 0.0, 6.0], colour: [0.5; 3] };
    let bare = Look { lights: vec![lamp], ..Look::default() };
    let shadow = Shadow { corners: 0.0, reach: 0.2, cast: 0.5, length: 0.5 };
    let render = |look: &Look| render(&object, &poses(&object), &front_camera(), look);
    let (before, after) = (render(&bare), render(&Look { shadow, ..bare.clone() }));
    assert_eq!(before.depth, after.depth);
    let brightness = |view: &View, z: f32| {
        let camera = view.camera.camera_from_world();
        let (x, y) = view.camera.intrinsics.project(&(camera * Point3::new(0.5, 0.0, z))).expect("in front");
        f32::from(view.rgb[view.camera.size.index(Pixel { u: x as u32, v: y as u32 })][1])
    };
    // The lamp is above: the shadow lies below the plate, as far as the plate stands out.
    assert!(brightness(&after, -0.24) < 0.85 * brightness(&before, -0.24));
    for lit in [0.3, -0.6, 0.0, 1.5] {
        assert_eq!(brightness(&after, lit), brightness(&before, lit), "{lit}");
    }
}

#[test]
fn corners_are_darker_than_what_lies_open() {
    let back = rectangle([0.5, 1.0, 0.0], [0.0, -2.0, 0.0], [0.0, 0.0, 2.0]);
    let floor = rectangle([-1.5, 1.0, 0.0], [0.0, -2.0, 0.0], [2.0, 0.0, 0.0]);
    let object = object(vec![vec![(back, 0), (floor, 0)]], vec![material([0.5; 3])]);
    let size = ImageSize::square(448);
    let camera =
        Camera::look_at(Point3::new(-4.0, 0.0, 2.5), Point3::new(0.0, 0.0, 0.5), size, Camera::PUBLISHED_FOV);
    let shadow = Shadow { corners: 0.8, reach: 0.2, cast: 0.0, length: 0.2 };
    let even = Look { ambient: 0.9, lights: Vec::new(), ..Look::default() };
    let view = render(&object, &poses(&object), &camera, &Look { shadow, ..even });
    let brightness = |point: Point3<f32>| {
        let (x, y) = camera.intrinsics.project(&(camera.camera_from_world() * point)).expect("in front");
        f32::from(view.rgb[size.index(Pixel { u: x as u32, v: y as u32 })][1])
    };
    let (corner, open) = (brightness(Point3::new(0.48, 0.0, 0.0)), brightness(Point3::new(-0.5, 0.0, 0.0)));
    assert!(corner < 0.8 * open, "{corner}, {open}");
    assert_eq!(brightness(Point3::new(-1.0, 0.3, 0.0)), open);
}
