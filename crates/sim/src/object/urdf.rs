//! URDF as a tree: parsed with urdf-rs, checked, and with fixed joints welded.

use std::collections::HashMap;
use std::path::Path;

use nalgebra::{Isometry3, Point3, Translation3, Unit, UnitQuaternion, Vector3};
use tracing::warn;
use urdf_rs::{JointType, Pose, Robot};

use super::error::{ObjectError, one_line};
use super::mesh::read_limited;
use super::{Joint, JointKind};

/// The largest URDF that is read, 16 MiB; the largest of PartNet-Mobility has 0.4.
const MAX_URDF_BYTES: u64 = 16 << 20;
/// URDF is eight elements deep; parsers recurse, so a file of only opening tags would end the process.
const MAX_DEPTH: usize = 64;
/// Pictures hold 1 + the index of a part in a byte.
const MAX_PARTS: usize = 254;
/// Range of joints without limits, radians: the published trials clip them so.
const CONTINUOUS_LIMIT: f32 = 10.0;

/// The URDF links that make one rigid part.
pub(super) struct Part {
    /// Index into the robot's links, and its pose in the part's frame. The first link's frame is the part's.
    pub(super) members: Vec<(usize, Isometry3<f64>)>,
    /// How the part moves; `None` for the first part alone.
    pub(super) joint: Option<Joint>,
}

/// Parses a URDF file.
pub(super) fn parse(path: &Path) -> Result<Robot, ObjectError> {
    let invalid = |message: &str| ObjectError::Xml { path: path.to_owned(), message: one_line(message) };
    let bytes = read_limited(path, MAX_URDF_BYTES)?;
    let text = String::from_utf8(bytes).map_err(|e| invalid(&e.to_string()))?;
    let text = with_velocities(&text).map_err(|e| invalid(&e))?;
    let robot = urdf_rs::read_from_string(&text).map_err(|e| invalid(&e.to_string()))?;
    check_unique(path, "link", robot.links.iter().map(|l| &l.name))?;
    check_unique(path, "joint", robot.joints.iter().map(|j| &j.name))?;
    Ok(robot)
}

/// PartNet-Mobility leaves out the velocity limit, which urdf-rs demands: it is added where it is missing. On the
/// way, nesting too deep for a recursive parser is refused.
fn with_velocities(text: &str) -> Result<String, String> {
    let mut out = String::with_capacity(text.len() + 1024);
    let mut depth = 0usize;
    let mut rest = text;
    while let Some(start) = rest.find('<') {
        let (before, tag) = rest.split_at(start);
        out.push_str(before);
        let end = match tag {
            t if t.starts_with("<!--") => t.find("-->").map(|i| i + 3),
            t if t.starts_with("<![CDATA[") => t.find("]]>").map(|i| i + 3),
            t => tag_end(t),
        };
        let Some(end) = end else { return Err(format!("a tag that never ends: {:.30}", one_line(tag))) };
        let (tag, after) = tag.split_at(end);
        rest = after;
        if tag.starts_with("</") {
            depth = depth.saturating_sub(1);
        } else if !tag.starts_with("<!") && !tag.starts_with("<?") && !tag.ends_with("/>") {
            depth += 1;
        }
        if depth > MAX_DEPTH {
            return Err(format!("more than {MAX_DEPTH} nested elements"));
        }
        match tag.strip_prefix("<limit").filter(|t| t.starts_with([' ', '\t', '\r', '\n', '/', '>'])) {
            Some(attributes) if !attributes.contains("velocity") => {
                out.push_str("<limit velocity=\"0\"");
                out.push_str(attributes);
            }
            _ => out.push_str(tag),
        }
    }
    out.push_str(rest);
    Ok(out)
}

/// Length of a tag; a `>` inside quotes does not end it.
fn tag_end(tag: &str) -> Option<usize> {
    let mut quote = None;
    for (i, c) in tag.char_indices() {
        match (quote, c) {
            (None, '>') => return Some(i + 1),
            (None, '"' | '\'') => quote = Some(c),
            (Some(open), c) if open == c => quote = None,
            _ => {}
        }
    }
    None
}

fn check_unique<'a>(
    path: &Path,
    what: &'static str,
    names: impl Iterator<Item = &'a String>,
) -> Result<(), ObjectError> {
    let mut seen = std::collections::HashSet::new();
    for name in names {
        if !seen.insert(name) {
            return Err(ObjectError::DuplicateName { path: path.to_owned(), what, name: name.clone() });
        }
    }
    Ok(())
}

/// The rigid parts of a robot: the root first, then every part after its parent, in the order of the file.
pub(super) fn parts(path: &Path, robot: &Robot) -> Result<Vec<Part>, ObjectError> {
    let (root, children) = tree(path, robot)?;
    let mut parts = vec![Part { members: vec![(root, Isometry3::identity())], joint: None }];
    let mut reached = 1;
    let mut part = 0;
    while part < parts.len() {
        // Links that are welded on join the list while it is walked.
        let mut member = 0;
        while member < parts[part].members.len() {
            let (link, part_from_link) = parts[part].members[member];
            member += 1;
            for &j in children.get(&link).map_or(&[][..], Vec::as_slice) {
                reached += 1;
                let (joint, child) = (&robot.joints[j.0], j.1);
                let owner = format!("joint {:?}", joint.name);
                let part_from_joint = pose(path, &owner, &part_from_link, &joint.origin)?;
                match movable(path, joint, part, part_from_joint.cast())? {
                    Movement::Welded(offset) => parts[part].members.push((child, part_from_joint * offset)),
                    Movement::Joint(joint) => {
                        parts
                            .push(Part { members: vec![(child, Isometry3::identity())], joint: Some(joint) });
                    }
                }
            }
        }
        part += 1;
    }
    if reached < robot.links.len() {
        let seen: Vec<usize> = parts.iter().flat_map(|p| p.members.iter().map(|m| m.0)).collect();
        let lost = robot.links.iter().enumerate().find(|(i, _)| !seen.contains(i));
        let link = lost.map(|(_, l)| l.name.clone()).unwrap_or_default();
        return Err(ObjectError::Loop { path: path.to_owned(), link });
    }
    if parts.len() > MAX_PARTS {
        let (limit, found) = (MAX_PARTS as u64, parts.len() as u64);
        return Err(ObjectError::TooLarge { path: path.to_owned(), limit, found, unit: "rigid parts" });
    }
    if parts.len() == 1 {
        return Err(ObjectError::NoMovableJoint { path: path.to_owned(), joints: robot.joints.len() });
    }
    Ok(parts)
}

/// Joints (index of the joint, index of the child link) by parent link.
type Children = HashMap<usize, Vec<(usize, usize)>>;

fn tree(path: &Path, robot: &Robot) -> Result<(usize, Children), ObjectError> {
    let index: HashMap<&str, usize> =
        robot.links.iter().enumerate().map(|(i, l)| (l.name.as_str(), i)).collect();
    let mut children = Children::new();
    let mut parent_joint: HashMap<usize, &str> = HashMap::new();
    for (j, joint) in robot.joints.iter().enumerate() {
        let find = |end: &'static str, link: &str| {
            index.get(link).copied().ok_or_else(|| ObjectError::UnknownLink {
                path: path.to_owned(),
                joint: joint.name.clone(),
                end,
                link: link.to_owned(),
            })
        };
        let parent = find("parent", &joint.parent.link)?;
        let child = find("child", &joint.child.link)?;
        if let Some(first) = parent_joint.insert(child, &joint.name) {
            return Err(ObjectError::TwoParents {
                path: path.to_owned(),
                link: joint.child.link.clone(),
                first: first.to_owned(),
                second: joint.name.clone(),
            });
        }
        children.entry(parent).or_default().push((j, child));
    }
    let mut roots = (0..robot.links.len()).filter(|i| !parent_joint.contains_key(i));
    match (roots.next(), roots.next()) {
        (Some(root), None) => Ok((root, children)),
        (Some(first), Some(second)) => Err(ObjectError::SeveralRoots {
            path: path.to_owned(),
            first: robot.links[first].name.clone(),
            second: robot.links[second].name.clone(),
        }),
        (None, _) => match robot.links.first() {
            Some(link) => Err(ObjectError::Loop { path: path.to_owned(), link: link.name.clone() }),
            None => Err(ObjectError::Empty { path: path.to_owned(), found: "no links" }),
        },
    }
}

enum Movement {
    /// The child never moves and sits at this offset from the joint.
    Welded(Isometry3<f64>),
    Joint(Joint),
}

fn movable(
    path: &Path,
    joint: &urdf_rs::Joint,
    parent: usize,
    parent_from_joint: Isometry3<f32>,
) -> Result<Movement, ObjectError> {
    let refuse = |found| ObjectError::JointKind { path: path.to_owned(), joint: joint.name.clone(), found };
    if joint.mimic.is_some() {
        return Err(refuse("a joint that mimics another"));
    }
    let kind = match joint.joint_type {
        JointType::Fixed => return Ok(Movement::Welded(Isometry3::identity())),
        JointType::Revolute => JointKind::Revolute,
        JointType::Continuous => JointKind::Continuous,
        JointType::Prismatic => JointKind::Prismatic,
        JointType::Floating => return Err(refuse("floating")),
        JointType::Planar => return Err(refuse("planar")),
        JointType::Spherical => return Err(refuse("spherical")),
    };
    let xyz = joint.axis.xyz.0;
    let axis = Some(Vector3::from(xyz)).filter(|a| a.norm().is_finite());
    let axis = axis.and_then(|a| Unit::try_new(a, 1e-9)).ok_or_else(|| ObjectError::Axis {
        path: path.to_owned(),
        joint: joint.name.clone(),
        axis: xyz,
    })?;
    let (lower, upper) = (joint.limit.lower, joint.limit.upper);
    if lower.is_nan() || upper.is_nan() || lower > upper {
        return Err(ObjectError::Limits { path: path.to_owned(), joint: joint.name.clone(), lower, upper });
    }
    // What is finite in the file need not be so here.
    let limits = (lower as f32, upper as f32);
    let endless = limits == (f32::NEG_INFINITY, f32::INFINITY);
    let (kind, limits) = match kind {
        JointKind::Continuous => (kind, (-CONTINUOUS_LIMIT, CONTINUOUS_LIMIT)),
        JointKind::Revolute if endless => (JointKind::Continuous, (-CONTINUOUS_LIMIT, CONTINUOUS_LIMIT)),
        _ if !(limits.1 - limits.0).is_finite() => {
            return Err(ObjectError::Limits {
                path: path.to_owned(),
                joint: joint.name.clone(),
                lower,
                upper,
            });
        }
        JointKind::Revolute if limits.1 - limits.0 > 2.0 * CONTINUOUS_LIMIT => {
            let (range, most) = (limits.1 - limits.0, 2.0 * CONTINUOUS_LIMIT);
            return Err(ObjectError::Turns { path: path.to_owned(), joint: joint.name.clone(), range, most });
        }
        _ => (kind, limits),
    };
    if limits.0 == limits.1 {
        warn!("{}: joint {:?} cannot move: its limits are both {lower}", path.display(), joint.name);
        let offset: Isometry3<f64> = match kind {
            JointKind::Prismatic => Translation3::from(axis.into_inner() * lower).into(),
            _ => {
                Isometry3::from_parts(Translation3::identity(), UnitQuaternion::from_axis_angle(&axis, lower))
            }
        };
        return Ok(Movement::Welded(offset));
    }
    let axis = Unit::new_normalize(axis.into_inner().cast());
    Ok(Movement::Joint(Joint { name: joint.name.clone(), parent, kind, parent_from_joint, axis, limits }))
}

/// The pose of an `<origin>` in the frame of its part: rotation about the fixed x, then y, then z axis.
pub(super) fn pose(
    path: &Path,
    owner: &str,
    part_from_parent: &Isometry3<f64>,
    origin: &Pose,
) -> Result<Isometry3<f64>, ObjectError> {
    let [roll, pitch, yaw] = origin.rpy.0;
    let parent_from_origin = Isometry3::from_parts(
        Point3::from(origin.xyz.0).into(),
        UnitQuaternion::from_euler_angles(roll, pitch, yaw),
    );
    let pose = part_from_parent * parent_from_origin;
    if pose.cast::<f32>().to_homogeneous().iter().all(|c| c.is_finite()) {
        return Ok(pose);
    }
    let found = origin.xyz.iter().chain(origin.rpy.iter()).copied().collect();
    let expected = "an origin that is finite in single precision";
    Err(ObjectError::Number { path: path.to_owned(), owner: owner.to_owned(), expected, found })
}
