//! Time of one 448x448 observation, all cores. Target: 10 ms for 50,000 triangles on two.

use std::hint::black_box;
use std::sync::Arc;

use criterion::{Criterion, criterion_group, criterion_main};
use image::{Rgb, RgbImage};
use nalgebra::{Isometry3, Point3, Vector3};
use where2act_core::{Camera, ImageSize};
use where2act_sim::object::{Link, Material, Mesh, Object, Visual};
use where2act_sim::render::{Look, render};

/// A cabinet-sized box whose six faces are grids with slight relief: as many triangles as asked for.
fn relief_box(triangles: usize) -> Mesh {
    let n = ((triangles / 12) as f32).sqrt().round() as u32;
    let mut mesh = Mesh::default();
    for face in 0..6 {
        let (axis, sign) = (face % 3, if face < 3 { 1.0 } else { -1.0 });
        let first = mesh.positions.len() as u32;
        for i in 0..=n {
            for j in 0..=n {
                let (s, t) = (i as f32 / n as f32, j as f32 / n as f32);
                let mut p = Point3::origin();
                p[axis] = sign * (0.5 + 0.01 * ((20.0 * s).sin() + (17.0 * t).cos()));
                p[(axis + 1) % 3] = s - 0.5;
                p[(axis + 2) % 3] = t - 0.5;
                let mut normal = Vector3::zeros();
                normal[axis] = sign;
                mesh.positions.push(p);
                mesh.normals.push(normal);
                mesh.uvs.push([s, t]);
            }
        }
        for i in 0..n {
            for j in 0..n {
                let a = first + i * (n + 1) + j;
                mesh.triangles.extend([[a, a + 1, a + n + 2], [a, a + n + 2, a + n + 1]]);
            }
        }
    }
    mesh
}

fn object(triangles: usize, texture: Option<Arc<RgbImage>>) -> Object {
    let visual = Visual { mesh: Arc::new(relief_box(triangles)), material: 0 };
    let link = Link {
        name: "base".into(),
        label: "base".into(),
        welded: Vec::new(),
        joint: None,
        visuals: vec![visual],
        pieces: Vec::new(),
    };
    let material =
        Material { colour: [0.7, 0.5, 0.3], texture, specular: 0.3, shininess: 30.0, opacity: 1.0 };
    Object { name: "relief".into(), category: None, links: vec![link], materials: vec![material] }
}

fn observations(c: &mut Criterion) {
    let size = ImageSize::square(Camera::PUBLISHED_SIDE);
    let camera = Camera::orbit(Point3::origin(), 5.0, 2.6, 0.7, size, Camera::PUBLISHED_FOV);
    let texture = RgbImage::from_fn(1024, 1024, |x, y| Rgb([x as u8, y as u8, (x ^ y) as u8]));
    let texture = Arc::new(texture);
    for (name, triangles, texture) in [
        ("render 5,000 triangles", 5_000, None),
        ("render 50,000 triangles", 50_000, None),
        ("render 50,000 triangles, textured", 50_000, Some(&texture)),
    ] {
        let object = object(triangles, texture.cloned());
        let poses = [Isometry3::identity()];
        let look = Look::default();
        c.bench_function(name, |b| b.iter(|| render(&object, &poses, black_box(&camera), &look)));
    }
}

criterion_group! {
    name = benches;
    config = Criterion::default().sample_size(20);
    targets = observations
}
criterion_main!(benches);
