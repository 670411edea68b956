//! From a URDF file to an [`Object`].

use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::ptr;
use std::sync::Arc;

use nalgebra::{Isometry3, Point3, Vector3};
use rayon::prelude::*;
use urdf_rs::{Geometry, Robot};

use super::error::ObjectError;
use super::mesh::{self, MeshFile, Textures};
use super::soup::Soup;
use super::urdf::Part;
use super::{
    ConvexPiece, JointKind, Link, Material, Mesh, Object, Visual, bounding_sphere, cache, partnet, shapes,
    sides, urdf,
};

/// Loads a URDF file with everything it refers to; convex pieces are kept in the folder `cache`.
pub(super) fn load(path: &Path, cache: Option<&Path>) -> Result<Object, ObjectError> {
    let robot = urdf::parse(path)?;
    let parts = urdf::parts(path, &robot)?;
    let notes = partnet::annotations(path);
    let loader = Loader::new(path, &robot)?;

    let mut materials = Palette::default();
    let mut links = Vec::with_capacity(parts.len());
    let mut touchable = Vec::new();
    for part in &parts {
        let (visuals, shapes) = loader.part(part, &mut materials)?;
        touchable.push(shapes);
        let names: Vec<&String> = part.members.iter().map(|m| &robot.links[m.0].name).collect();
        let label = names.iter().find_map(|n| notes.labels.get(*n)).unwrap_or(names[0]);
        links.push(Link {
            name: names[0].clone(),
            label: label.clone(),
            welded: names[1..].iter().map(|n| (*n).clone()).collect(),
            joint: part.joint.clone(),
            visuals,
            pieces: Vec::new(),
        });
    }
    add_pieces(&mut links, touchable, cache);
    if links.iter().all(|l| l.visuals.is_empty() && l.pieces.is_empty()) {
        return Err(ObjectError::Empty { path: path.to_owned(), found: "no triangles in any link" });
    }
    let materials = materials.0.into_iter().map(|(material, _)| material).collect();
    let object = Object { name: notes.name, category: notes.category, links, materials };
    check_size(path, &object)?;
    Ok(object)
}

/// Objects reach no further than this from the origin, metres: cameras stand some 5 m away. PartNet-Mobility's reach 1 m.
const FURTHEST: f32 = 3.0;
/// The same of an object with one joint at either limit: drawers and sashes may come out as far as objects are large.
const FURTHEST_OPEN: f32 = 2.0 * FURTHEST;
/// Radius of an object at least, metres: fingers are 2 cm wide.
const SMALLEST: f32 = 0.02;

/// Refuses what no camera sees and no hand can move.
fn check_size(path: &Path, object: &Object) -> Result<(), ObjectError> {
    let points_at = |q: &[f32]| -> Vec<Point3<f32>> {
        let poses = object.world_from_links(q);
        let points = object.links.iter().zip(&poses).flat_map(|(link, pose)| {
            let visible = link.visuals.iter().flat_map(|visual| &visual.mesh.positions);
            visible.chain(link.pieces.iter().flat_map(|piece| &piece.points)).map(move |p| pose * p)
        });
        points.collect()
    };
    let reach = |points: &[Point3<f32>]| points.iter().map(|p| p.coords.norm()).fold(0.0, f32::max);
    let closed = points_at(&object.closed());
    let (_, radius) = bounding_sphere(closed.iter().copied());
    let (path, reach_closed) = (path.to_owned(), reach(&closed));
    if radius < SMALLEST || reach_closed > FURTHEST {
        return Err(ObjectError::Size {
            path,
            furthest: FURTHEST,
            smallest: SMALLEST,
            radius,
            reach: reach_closed,
        });
    }
    for link in object.movable().filter(|link| object.joint(*link).kind == JointKind::Prismatic) {
        let joint = object.joint(link);
        for limit in [joint.limits.0, joint.limits.1] {
            let mut q = object.closed();
            q[link - 1] = limit;
            let reach = reach(&points_at(&q));
            if reach > FURTHEST_OPEN {
                let joint = joint.name.clone();
                return Err(ObjectError::Opens { path, joint, q: limit, furthest: FURTHEST_OPEN, reach });
            }
        }
    }
    Ok(())
}

/// A collision shape: a mesh in its own frame and where it sits on the link.
struct Touchable {
    mesh: Soup,
    link_from_mesh: Isometry3<f32>,
}

/// Decomposes every distinct mesh once and puts its pieces where the mesh is used.
fn add_pieces(links: &mut [Link], touchable: Vec<Vec<Touchable>>, cache: Option<&Path>) {
    let mut distinct: Vec<Soup> = Vec::new();
    let mut known: HashMap<Vec<u32>, usize> = HashMap::new();
    let mut used = Vec::new();
    for (link, shapes) in touchable.into_iter().enumerate() {
        for shape in shapes {
            let bits = shape.mesh.points.iter().flat_map(|p| [p.x, p.y, p.z].map(f32::to_bits));
            let key = bits.chain(shape.mesh.triangles.iter().flatten().copied()).collect();
            let index = *known.entry(key).or_insert_with(|| {
                distinct.push(shape.mesh);
                distinct.len() - 1
            });
            used.push((link, index, shape.link_from_mesh));
        }
    }
    let pieces = cache::pieces(&distinct, cache);
    for (link, index, pose) in used {
        links[link].pieces.extend(
            pieces[index]
                .iter()
                .map(|piece| ConvexPiece { points: piece.points.iter().map(|p| pose * p).collect() }),
        );
    }
}

/// Materials of an object, each once, with the URDF element that defines them if there is one. Textured elements have
/// entries of their own even where they share a texture: random looks paint every entry anew.
#[derive(Default)]
struct Palette<'a>(Vec<(Material, Option<&'a urdf_rs::Material>)>);

impl<'a> Palette<'a> {
    fn index(&mut self, material: Material, element: Option<&'a urdf_rs::Material>) -> usize {
        let same = |(m, e): &(Material, Option<&urdf_rs::Material>)| {
            let texture = match (&m.texture, &material.texture) {
                (Some(a), Some(b)) => Arc::ptr_eq(a, b) && e.map(ptr::from_ref) == element.map(ptr::from_ref),
                (None, None) => true,
                _ => false,
            };
            let numbers = |m: &Material| (m.colour, m.specular, m.shininess, m.opacity);
            texture && numbers(m) == numbers(&material)
        };
        self.0.iter().position(same).unwrap_or_else(|| {
            self.0.push((material, element));
            self.0.len() - 1
        })
    }
}

/// A mesh with its own material, if it has one, and its scale.
type ScaledMesh = (Mesh, Option<Material>, Vector3<f32>);

struct Loader<'a> {
    urdf: &'a Path,
    robot: &'a Robot,
    files: HashMap<String, MeshFile>,
    textures: Textures,
    /// The robot's named materials.
    named: HashMap<&'a str, &'a urdf_rs::Material>,
}

impl<'a> Loader<'a> {
    /// Reads every mesh file once, in parallel.
    fn new(urdf: &'a Path, robot: &'a Robot) -> Result<Self, ObjectError> {
        let textures = Textures::default();
        let mut names: Vec<(&str, &str)> = robot
            .links
            .iter()
            .flat_map(|l| {
                let all = l.visual.iter().map(|v| &v.geometry).chain(l.collision.iter().map(|c| &c.geometry));
                all.filter_map(|g| match g {
                    Geometry::Mesh { filename, .. } => Some((filename.as_str(), l.name.as_str())),
                    _ => None,
                })
            })
            .collect();
        names.sort_unstable();
        names.dedup_by_key(|n| n.0);
        let read = |&(name, link): &(&str, &str)| {
            let path = find_mesh(urdf, name, link)?;
            Ok((name.to_owned(), mesh::read(&path, &textures)?))
        };
        // The first error in the order of names, so that a report does not depend on threads.
        let files: Vec<Result<_, ObjectError>> = names.par_iter().map(read).collect();
        let named = robot.materials.iter().map(|m| (m.name.as_str(), m)).collect();
        Ok(Self { urdf, robot, files: files.into_iter().collect::<Result<_, _>>()?, textures, named })
    }

    /// Everything on the links of a part, in the part's frame.
    fn part(
        &self,
        part: &Part,
        palette: &mut Palette<'a>,
    ) -> Result<(Vec<Visual>, Vec<Touchable>), ObjectError> {
        let (mut seen, mut touchable) = (Vec::new(), Vec::new());
        for (index, part_from_link) in &part.members {
            let link = &self.robot.links[*index];
            let place = |origin| -> Result<Isometry3<f32>, ObjectError> {
                let owner = format!("link {:?}", link.name);
                Ok(urdf::pose(self.urdf, &owner, part_from_link, origin)?.cast())
            };
            for visual in &link.visual {
                let pose = place(&visual.origin)?;
                let element = visual.material.as_ref().map(|m| self.definition(m));
                for (mesh, material, scale) in self.meshes(&link.name, &visual.geometry)? {
                    let material = match (material, element) {
                        (Some(of_mesh), _) => palette.index(of_mesh, None),
                        (None, Some(element)) => palette.index(self.material(element), Some(element)),
                        (None, None) => palette.index(Material::default(), None),
                    };
                    seen.push((mesh.placed(&pose, &scale), material));
                }
            }
            let visible = link.visual.iter().map(|v| (&v.geometry, &v.origin));
            let solid = link.collision.iter().map(|c| (&c.geometry, &c.origin));
            let shapes: Vec<_> = if link.collision.is_empty() { visible.collect() } else { solid.collect() };
            for (geometry, origin) in shapes {
                let mut soup = Soup::default();
                for (mesh, _, scale) in self.meshes(&link.name, geometry)? {
                    let shift = soup.points.len() as u32;
                    soup.points
                        .extend(mesh.positions.iter().map(|p| Point3::from(p.coords.component_mul(&scale))));
                    soup.triangles.extend(mesh.triangles.iter().map(|t| t.map(|i| i + shift)));
                }
                touchable.push(Touchable { mesh: soup, link_from_mesh: place(origin)? });
            }
        }
        sides::separate(&mut seen);
        seen.retain(|(mesh, _)| !mesh.triangles.is_empty());
        let visual = |(mesh, material)| Visual { mesh: Arc::new(mesh), material };
        Ok((seen.into_iter().map(visual).collect(), touchable))
    }

    /// The meshes of a geometry in its own frame, not yet scaled.
    fn meshes(&self, link: &str, geometry: &Geometry) -> Result<Vec<ScaledMesh>, ObjectError> {
        let check = |expected, found: &[f64], fine: fn(f32) -> bool| {
            if found.iter().map(|&x| x as f32).all(|x| x.is_finite() && fine(x)) {
                return Ok(());
            }
            let (path, owner) = (self.urdf.to_owned(), format!("link {link:?}"));
            Err(ObjectError::Number { path, owner, expected, found: found.to_vec() })
        };
        let positive = |sizes: &[f64]| check("positive sizes", sizes, |x| x > 0.0);
        let one = |mesh| Ok(vec![(mesh, None, Vector3::repeat(1.0))]);
        match geometry {
            Geometry::Box { size } => {
                positive(&size.0)?;
                one(shapes::cuboid(Vector3::from(size.0).cast()))
            }
            Geometry::Cylinder { radius, length } => {
                positive(&[*radius, *length])?;
                one(shapes::cylinder(*radius as f32, *length as f32))
            }
            Geometry::Capsule { radius, length } => {
                positive(&[*radius, *length])?;
                one(shapes::capsule(*radius as f32, *length as f32))
            }
            Geometry::Sphere { radius } => {
                positive(&[*radius])?;
                one(shapes::sphere(*radius as f32))
            }
            Geometry::Mesh { filename, scale } => {
                let scale = scale.map_or([1.0; 3], |s| s.0);
                check("a scale other than zero", &scale, |x| x != 0.0)?;
                let scale = Vector3::from(scale).cast();
                let file = &self.files[filename];
                Ok(file
                    .parts
                    .iter()
                    .map(|(mesh, material)| (mesh.clone(), material.clone(), scale))
                    .collect())
            }
        }
    }

    /// Where a material is defined: here, or by the robot under its name.
    fn definition(&self, material: &'a urdf_rs::Material) -> &'a urdf_rs::Material {
        let defined_here = material.color.is_some() || material.texture.is_some();
        let named = self.named.get(material.name.as_str()).filter(|_| !defined_here);
        named.copied().unwrap_or(material)
    }

    fn material(&self, element: &urdf_rs::Material) -> Material {
        let unit = |x: f64| if x.is_finite() { x.clamp(0.0, 1.0) as f32 } else { 1.0 };
        let texture = element.texture.as_ref();
        let texture = texture.and_then(|t| self.textures.get(&resolve(self.urdf, &t.filename)));
        let fallback = if texture.is_some() { [1.0; 3] } else { Material::default().colour };
        let rgba = element.color.as_ref().map(|c| c.rgba.0.map(unit));
        Material {
            colour: rgba.map_or(fallback, |c| [c[0], c[1], c[2]]),
            texture,
            opacity: rgba.map_or(1.0, |c| c[3]),
            ..Material::default()
        }
    }
}

fn find_mesh(urdf: &Path, name: &str, link: &str) -> Result<PathBuf, ObjectError> {
    let mesh = resolve(urdf, name);
    if mesh.is_file() { Ok(mesh) } else { Err(ObjectError::MissingMesh { mesh, link: link.to_owned() }) }
}

/// Where a file named in a URDF is. Names in a ROS package are looked for in the folders above the URDF, which
/// usually are the package.
fn resolve(urdf: &Path, name: &str) -> PathBuf {
    let folder = urdf.parent().unwrap_or(Path::new("."));
    let name = name.replace('\\', "/");
    if let Some(in_package) = name.strip_prefix("package://") {
        let inner = in_package.split_once('/').map_or(in_package, |(_, inner)| inner);
        let candidates = folder.ancestors().flat_map(|f| [f.join(inner), f.join(in_package)]);
        return candidates.into_iter().find(|p| p.is_file()).unwrap_or_else(|| folder.join(inner));
    }
    folder.join(name.strip_prefix("file://").unwrap_or(&name))
}
