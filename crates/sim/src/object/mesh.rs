//! Mesh files: OBJ with materials, STL.

use std::collections::HashMap;
use std::fmt::Write as _;
use std::fs;
use std::io::{self, Cursor};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

use image::{ImageReader, Limits, RgbImage};
use nalgebra::{Isometry3, Point3, Vector3};
use tracing::warn;

use super::error::ObjectError;
use super::normals::{face_normal, with_normals};
use super::{Material, Mesh};

/// The largest mesh file that is read, 256 MiB: a hundred times the largest of PartNet-Mobility.
const MAX_MESH_BYTES: u64 = 256 << 20;
/// The largest edge of a texture.
const MAX_TEXTURE_EDGE: u32 = 8192;

/// The contents of a mesh file, one part per material.
#[derive(Clone, Debug)]
pub(super) struct MeshFile {
    pub(super) parts: Vec<(Mesh, Option<Material>)>,
}

/// Textures by path, so that all of an object shares them. `None` is a texture that could not be read.
#[derive(Default)]
pub(super) struct Textures(Mutex<HashMap<PathBuf, Option<Arc<RgbImage>>>>);

impl Textures {
    pub(super) fn get(&self, path: &Path) -> Option<Arc<RgbImage>> {
        let mut known = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        known.entry(path.to_owned()).or_insert_with(|| read_texture(path)).clone()
    }
}

/// Reads a texture, or says in the log why the colour alone will be used.
fn read_texture(path: &Path) -> Option<Arc<RgbImage>> {
    let decode = || -> Result<RgbImage, image::ImageError> {
        let mut reader = ImageReader::open(path)?.with_guessed_format()?;
        let mut limits = Limits::default();
        limits.max_image_width = Some(MAX_TEXTURE_EDGE);
        limits.max_image_height = Some(MAX_TEXTURE_EDGE);
        reader.limits(limits);
        Ok(reader.decode()?.into_rgb8())
    };
    decode().map(Arc::new).map_err(|e| warn!("{}: texture is left out: {e}", path.display())).ok()
}

/// Reads an OBJ or STL file. Parts without triangles are left out.
pub(super) fn read(path: &Path, textures: &Textures) -> Result<MeshFile, ObjectError> {
    let bytes = read_limited(path, MAX_MESH_BYTES)?;
    let extension = path.extension().map(|e| e.to_string_lossy().to_lowercase()).unwrap_or_default();
    let parts = match extension.as_str() {
        "obj" => read_obj(path, &bytes, textures)?,
        "stl" => vec![(read_stl(path, &bytes)?, None)],
        _ => return Err(ObjectError::MeshFormat { path: path.to_owned(), found: extension }),
    };
    let parts: Vec<_> = parts.into_iter().filter(|(mesh, _)| !mesh.triangles.is_empty()).collect();
    if parts.is_empty() {
        warn!("{}: mesh has no triangles", path.display());
    }
    Ok(MeshFile { parts })
}

/// The whole file, unless it is larger than `limit` bytes or no file but a device or pipe, which may have no end.
pub(super) fn read_limited(path: &Path, limit: u64) -> Result<Vec<u8>, ObjectError> {
    let metadata = fs::metadata(path).map_err(|e| ObjectError::read(path, e))?;
    if !metadata.is_file() {
        return Err(ObjectError::read(path, io::Error::other("not a regular file")));
    }
    let size = metadata.len();
    if size > limit {
        return Err(ObjectError::TooLarge { path: path.to_owned(), limit, found: size, unit: "bytes" });
    }
    fs::read(path).map_err(|e| ObjectError::read(path, e))
}

fn read_obj(
    path: &Path,
    bytes: &[u8],
    textures: &Textures,
) -> Result<Vec<(Mesh, Option<Material>)>, ObjectError> {
    let folder = path.parent().unwrap_or(Path::new("."));
    let options =
        tobj::LoadOptions { triangulate: true, single_index: true, ignore_points: true, ignore_lines: true };
    // Names and comments may be in any encoding; numbers are ASCII.
    let text = String::from_utf8_lossy(bytes);
    let (models, materials) = tobj::load_obj_buf(&mut Cursor::new(text.as_bytes()), &options, |name| {
        let library = folder.join(name);
        match read_limited(&library, MAX_MESH_BYTES) {
            Ok(bytes) => {
                let text = with_whole_colours(&library, &String::from_utf8_lossy(&bytes));
                tobj::load_mtl_buf(&mut Cursor::new(text.as_bytes()))
            }
            Err(e) => {
                warn!("materials are left out: {e}");
                Ok((Vec::new(), Default::default()))
            }
        }
    })
    .map_err(|e| ObjectError::mesh(path, e))?;
    let materials = materials.unwrap_or_else(|e| {
        warn!("{}: materials are left out: {e}", path.display());
        Vec::new()
    });

    let mut parts: Vec<(Option<usize>, Mesh)> = Vec::new();
    for model in models {
        let id = model.mesh.material_id;
        let mesh = from_tobj(path, model.mesh)?;
        match parts.iter_mut().find(|(other, _)| *other == id) {
            Some((_, whole)) => whole.append(&mesh),
            None => parts.push((id, mesh)),
        }
    }
    let material = |id: usize| materials.get(id).map(|m| from_mtl(m, folder, textures));
    Ok(parts.into_iter().map(|(id, mesh)| (mesh, id.and_then(material))).collect())
}

/// In MTL, one number makes a grey; tobj panics unless there are three. Lines with none or two are left out.
fn with_whole_colours(library: &Path, text: &str) -> String {
    let mut whole = String::with_capacity(text.len());
    for line in text.lines() {
        let mut words = line.split_whitespace();
        let is_colour = words.next().is_some_and(|word| matches!(word, "Ka" | "Kd" | "Ks" | "Ke"));
        let numbers: Vec<&str> = words.collect();
        match numbers[..] {
            [grey] if is_colour => {
                // Writing to a string cannot fail.
                let _ = writeln!(whole, "{} {grey} {grey}", line.trim());
            }
            [] | [_, _] if is_colour => {
                let (library, line) = (library.display(), line.trim());
                warn!("{library}: expected one number or three, found {line:?}: left out");
            }
            _ => {
                whole.push_str(line);
                whole.push('\n');
            }
        }
    }
    whole
}

fn from_tobj(path: &Path, mesh: tobj::Mesh) -> Result<Mesh, ObjectError> {
    let positions: Vec<_> = mesh.positions.chunks_exact(3).map(Point3::from_slice).collect();
    check_finite(path, &positions)?;
    let mut uvs: Vec<[f32; 2]> = mesh.texcoords.chunks_exact(2).map(|c| [c[0], c[1]]).collect();
    if uvs.len() != positions.len() || uvs.iter().flatten().any(|c| !c.is_finite()) {
        uvs = vec![[0.0; 2]; positions.len()];
    }
    let triangles: Vec<[u32; 3]> = mesh.indices.chunks_exact(3).map(|t| [t[0], t[1], t[2]]).collect();
    if let Some(index) = triangles.iter().flatten().find(|&&i| i as usize >= positions.len()) {
        return Err(ObjectError::mesh(path, format!("vertex {index} of {}", positions.len())));
    }
    let normals: Vec<Vector3<f32>> = mesh.normals.chunks_exact(3).map(Vector3::from_column_slice).collect();
    if normals.len() != positions.len() {
        return Ok(with_normals(positions, uvs, triangles));
    }
    Ok(repair_normals(Mesh { positions, normals, uvs, triangles }))
}

/// Makes given normals unit vectors; one that is zero or not finite becomes that of a face it belongs to.
fn repair_normals(mut mesh: Mesh) -> Mesh {
    mesh.triangles.retain(|t| face_normal(&mesh.positions, t).is_some());
    for t in &mesh.triangles {
        let face = face_normal(&mesh.positions, t).unwrap_or_else(Vector3::z);
        for &i in t {
            let normal = &mut mesh.normals[i as usize];
            *normal = normal.try_normalize(1e-6).filter(|n| n.iter().all(|c| c.is_finite())).unwrap_or(face);
        }
    }
    mesh
}

fn from_mtl(mtl: &tobj::Material, folder: &Path, textures: &Textures) -> Material {
    // Options such as `-s 1 1 1` stand before the name, which has no spaces then.
    let texture = mtl.diffuse_texture.as_deref().map(|name| {
        let name = if name.starts_with('-') { name.rsplit(' ').next().unwrap_or(name) } else { name };
        folder.join(name.replace('\\', "/"))
    });
    let unit = |x: f32| if x.is_finite() { x.clamp(0.0, 1.0) } else { 1.0 };
    let diffuse = mtl.diffuse.unwrap_or(Material::default().colour).map(unit);
    let texture = texture.and_then(|path| textures.get(&path));
    Material {
        // As in the viewer the published data was made with, a texture replaces the colour: many files leave
        // Kd black beside a texture.
        colour: if texture.is_some() { [1.0; 3] } else { diffuse },
        texture,
        specular: mtl.specular.map_or(0.0, |s| s.map(unit).iter().sum::<f32>() / 3.0),
        shininess: mtl.shininess.filter(|s| s.is_finite()).unwrap_or(30.0).clamp(1.0, 1000.0),
        opacity: mtl.dissolve.map_or(1.0, unit),
    }
}

fn read_stl(path: &Path, bytes: &[u8]) -> Result<Mesh, ObjectError> {
    let stl = stl_io::read_stl(&mut Cursor::new(bytes)).map_err(|e| ObjectError::mesh(path, e))?;
    let positions: Vec<Point3<f32>> = stl.vertices.iter().map(|v| Point3::from(v.0)).collect();
    check_finite(path, &positions)?;
    let triangles = stl.faces.iter().map(|f| f.vertices.map(|i| i as u32)).collect();
    let uvs = vec![[0.0; 2]; positions.len()];
    Ok(with_normals(positions, uvs, triangles))
}

fn check_finite(path: &Path, positions: &[Point3<f32>]) -> Result<(), ObjectError> {
    let wrong = |p: &Point3<f32>| p.iter().copied().find(|c| !c.is_finite());
    match positions.iter().enumerate().find_map(|(vertex, p)| wrong(p).map(|found| (vertex, found))) {
        Some((vertex, found)) => Err(ObjectError::MeshNotFinite { path: path.to_owned(), vertex, found }),
        None => Ok(()),
    }
}

impl Mesh {
    /// Adds the triangles of another mesh.
    pub(super) fn append(&mut self, other: &Mesh) {
        let shift = self.positions.len() as u32;
        self.positions.extend_from_slice(&other.positions);
        self.normals.extend_from_slice(&other.normals);
        self.uvs.extend_from_slice(&other.uvs);
        self.triangles.extend(other.triangles.iter().map(|t| t.map(|i| i + shift)));
    }

    /// The mesh scaled, then moved.
    pub(super) fn placed(&self, pose: &Isometry3<f32>, scale: &Vector3<f32>) -> Mesh {
        let mirrored = scale.product() < 0.0;
        let turn = |n: &Vector3<f32>| pose * n.component_div(scale).try_normalize(0.0).unwrap_or(*n);
        Mesh {
            positions: self
                .positions
                .iter()
                .map(|p| pose * Point3::from(p.coords.component_mul(scale)))
                .collect(),
            normals: self.normals.iter().map(turn).collect(),
            uvs: self.uvs.clone(),
            triangles: self
                .triangles
                .iter()
                .map(|&[a, b, c]| if mirrored { [a, c, b] } else { [a, b, c] })
                .collect(),
        }
    }
}

impl Default for Material {
    /// Light grey, slightly glossy: what a mesh without a material gets.
    fn default() -> Self {
        Self { colour: [0.7; 3], texture: None, specular: 0.1, shininess: 30.0, opacity: 1.0 }
    }
}
