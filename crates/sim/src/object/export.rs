//! Objects as URDF folders that other simulators load, laid out as those of PartNet-Mobility.

use std::fmt::Write as _;
use std::fs;
use std::io;
use std::path::Path;
use std::sync::Arc;

use image::RgbImage;
use nalgebra::Isometry3;

use super::error::ObjectError;
use super::{ConvexPiece, Joint, JointKind, Link, Material, Mesh, Object};

/// Torque or force and speed that URDF demands of a joint; nothing here drives it.
const EFFORT_AND_VELOCITY: &str = "effort=\"100\" velocity=\"10\"";

/// Writes `folder/mobility.urdf` with its meshes (OBJ), materials, textures, part names and category. The folder
/// must be new or empty, and appears whole or not at all. Loading it gives the same links, joints and convex
/// pieces by name. Their order may differ: the loader counts links level by level, and generators count a handle
/// right after its door.
///
/// # Errors
/// Whatever the file system says.
pub fn export(object: &Object, folder: &Path) -> Result<(), ObjectError> {
    let failed = |source| ObjectError::Write { path: folder.to_owned(), source };
    let occupied =
        fs::read_dir(folder).map(|mut entries| entries.next().is_some()).unwrap_or(folder.exists());
    if occupied {
        return Err(failed(io::Error::new(io::ErrorKind::AlreadyExists, "something else there already")));
    }
    let parent = folder.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let write = || -> io::Result<()> {
        fs::create_dir_all(parent)?;
        let mut builder = tempfile::Builder::new();
        builder.prefix(".partial-");
        // Temporary folders are private unless told otherwise; the umask makes of this what it makes of any other.
        #[cfg(unix)]
        builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o777));
        let partial = builder.tempdir_in(parent)?;
        write_all(object, partial.path())?;
        fs::rename(partial.path(), folder)?;
        // It has another name now: there is nothing left to delete.
        let _ = partial.keep();
        Ok(())
    };
    write().map_err(failed)
}

fn write_all(object: &Object, folder: &Path) -> io::Result<()> {
    fs::create_dir(folder.join("textured_objs"))?;
    fs::write(folder.join("textured_objs/materials.mtl"), materials(object, folder)?)?;
    let mut urdf = format!("<?xml version=\"1.0\"?>\n<robot name=\"{}\">\n", escaped(&object.name));
    let mut semantics = String::new();
    for (i, link) in object.links.iter().enumerate() {
        let (mut seen, mut felt) = (Vec::new(), Vec::new());
        for (k, visual) in link.visuals.iter().enumerate() {
            let name = format!("textured_objs/link{i}-visual{k}.obj");
            fs::write(folder.join(&name), visual_obj(&visual.mesh, visual.material))?;
            seen.push(name);
        }
        for (k, piece) in link.pieces.iter().enumerate() {
            let Some(text) = piece_obj(piece) else { continue };
            let name = format!("textured_objs/link{i}-piece{k}.obj");
            fs::write(folder.join(&name), text)?;
            felt.push(name);
        }
        describe(&mut urdf, object, link, &seen, &felt);
        let motion = match &link.joint {
            None => "static",
            Some(Joint { kind: JointKind::Prismatic, .. }) => "slider",
            Some(_) => "hinge",
        };
        let word = |s: &str| s.split_whitespace().collect::<Vec<_>>().join("_");
        let _ = writeln!(semantics, "{} {motion} {}", word(&link.name), word(&link.label));
    }
    urdf.push_str("</robot>\n");
    fs::write(folder.join("mobility.urdf"), urdf)?;
    fs::write(folder.join("semantics.txt"), semantics)?;
    if let Some(category) = object.category {
        fs::write(folder.join("meta.json"), format!("{{\"model_cat\": \"{category}\"}}\n"))?;
    }
    Ok(())
}

/// The URDF elements of a link, of what is welded to it and of its joint. Writing to a string cannot fail.
fn describe(urdf: &mut String, object: &Object, link: &Link, seen: &[String], felt: &[String]) {
    let name = escaped(&link.name);
    let _ = writeln!(urdf, "  <link name=\"{name}\">");
    for (element, files) in [("visual", seen), ("collision", felt)] {
        for file in files {
            let _ = writeln!(
                urdf,
                "    <{element}>\n      <geometry><mesh filename=\"{file}\"/></geometry>\n    </{element}>"
            );
        }
    }
    urdf.push_str("  </link>\n");
    for welded in link.welded.iter().map(|w| escaped(w)) {
        let _ = writeln!(
            urdf,
            "  <link name=\"{welded}\"/>\n  <joint name=\"weld_{welded}\" type=\"fixed\">\n    \
             <parent link=\"{name}\"/>\n    <child link=\"{welded}\"/>\n  </joint>"
        );
    }
    let Some(joint) = &link.joint else { return };
    let (kind, limit) = match joint.kind {
        JointKind::Revolute => ("revolute", Some(joint.limits)),
        JointKind::Continuous => ("continuous", None),
        JointKind::Prismatic => ("prismatic", Some(joint.limits)),
    };
    let range =
        limit.map(|(lower, upper)| format!("lower=\"{lower}\" upper=\"{upper}\" ")).unwrap_or_default();
    let axis = joint.axis;
    let _ = writeln!(
        urdf,
        "  <joint name=\"{}\" type=\"{kind}\">\n    {}\n    <parent link=\"{}\"/>\n    <child link=\"{name}\"/>\n    \
         <axis xyz=\"{} {} {}\"/>\n    <limit {range}{EFFORT_AND_VELOCITY}/>\n  </joint>",
        escaped(&joint.name),
        origin(&joint.parent_from_joint),
        escaped(&object.links[joint.parent].name),
        axis.x,
        axis.y,
        axis.z,
    );
}

fn origin(pose: &Isometry3<f32>) -> String {
    let xyz = pose.translation.vector;
    let (roll, pitch, yaw) = pose.rotation.cast::<f64>().euler_angles();
    format!("<origin xyz=\"{} {} {}\" rpy=\"{roll} {pitch} {yaw}\"/>", xyz.x, xyz.y, xyz.z)
}

fn visual_obj(mesh: &Mesh, material: usize) -> String {
    let mut text = String::from("mtllib materials.mtl\n");
    for p in &mesh.positions {
        let _ = writeln!(text, "v {} {} {}", p.x, p.y, p.z);
    }
    for [u, v] in &mesh.uvs {
        let _ = writeln!(text, "vt {u} {v}");
    }
    for n in &mesh.normals {
        let _ = writeln!(text, "vn {} {} {}", n.x, n.y, n.z);
    }
    let _ = writeln!(text, "usemtl material{material}");
    for [a, b, c] in mesh.triangles.iter().map(|t| t.map(|i| i + 1)) {
        let _ = writeln!(text, "f {a}/{a}/{a} {b}/{b}/{b} {c}/{c}/{c}");
    }
    text
}

/// The surface of a piece; `None` for one without volume.
fn piece_obj(piece: &ConvexPiece) -> Option<String> {
    let triangles = piece.triangles()?;
    let mut text = String::new();
    for p in &piece.points {
        let _ = writeln!(text, "v {} {} {}", p.x, p.y, p.z);
    }
    for [a, b, c] in triangles.iter().map(|t| t.map(|i| i + 1)) {
        let _ = writeln!(text, "f {a} {b} {c}");
    }
    Some(text)
}

/// The MTL file; textures are written on the way.
fn materials(object: &Object, folder: &Path) -> io::Result<String> {
    let mut text = String::new();
    for (i, material) in object.materials.iter().enumerate() {
        let [r, g, b] = material.colour;
        let (s, n, d) = (material.specular, material.shininess, material.opacity);
        let _ = writeln!(text, "newmtl material{i}\nKd {r} {g} {b}\nKs {s} {s} {s}\nNs {n}\nd {d}");
        if let Some(texture) = &material.texture {
            fs::create_dir_all(folder.join("images"))?;
            let name = format!("images/texture_{i}.png");
            tinted(texture, material).save(folder.join(&name)).map_err(io::Error::other)?;
            let _ = writeln!(text, "map_Kd ../{name}");
        }
        text.push('\n');
    }
    Ok(text)
}

/// The texture times the colour: readers of MTL do not agree on whether a texture is tinted.
fn tinted(texture: &Arc<RgbImage>, material: &Material) -> RgbImage {
    let mut out = (**texture).clone();
    for pixel in out.pixels_mut() {
        for (channel, tint) in pixel.0.iter_mut().zip(material.colour) {
            *channel = (f32::from(*channel) * tint).round() as u8;
        }
    }
    out
}

fn escaped(name: &str) -> String {
    name.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}
