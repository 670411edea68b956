//! What can be wrong with an object, in one line each.

use std::io;
use std::path::{Path, PathBuf};

use where2act_core::UnknownCategory;

/// Why an object could not be loaded or written. Every message is one line that names the file, what was expected
/// and what was found.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the messages say what the fields are")]
pub enum ObjectError {
    /// Nothing is at this path, and it does not read as `CATEGORY:SEED` either.
    #[error(
        "{spec}: expected a URDF file, a folder with mobility.urdf or one other .urdf file, or CATEGORY:SEED, perhaps with ~N at its end, found none of these"
    )]
    NotFound { spec: String },
    /// A folder without `mobility.urdf` holds several `.urdf` files or none.
    #[error("{}: expected mobility.urdf or exactly one .urdf file, found {found}", path.display())]
    AmbiguousFolder { path: PathBuf, found: usize },
    /// The part after the colon of `CATEGORY:SEED` is no number.
    #[error("{spec}: expected CATEGORY:SEED with a whole number as seed, found {found:?}")]
    BadSeed { spec: String, found: String },
    /// The part before the colon is none of the 15 categories.
    #[error(transparent)]
    UnknownCategory(#[from] UnknownCategory),
    /// The file system refused.
    #[error("{}: expected a readable file, found: {source}", path.display())]
    Read { path: PathBuf, source: io::Error },
    /// The file system refused.
    #[error("{}: expected to write here, found: {source}", path.display())]
    Write { path: PathBuf, source: io::Error },
    /// Larger than any object that could be simulated.
    #[error("{}: expected at most {limit} {unit}, found {found}", path.display())]
    TooLarge { path: PathBuf, limit: u64, found: u64, unit: &'static str },
    /// Not XML, or XML that is not URDF.
    #[error("{}: expected a valid URDF, found: {message}", path.display())]
    Xml { path: PathBuf, message: String },
    /// Two links or two joints share a name.
    #[error("{}: expected unique {what} names, found {name:?} twice", path.display())]
    DuplicateName { path: PathBuf, what: &'static str, name: String },
    /// A joint refers to a link that is not there.
    #[error("{}: joint {joint:?}: expected a known {end} link, found {link:?}", path.display())]
    UnknownLink { path: PathBuf, joint: String, end: &'static str, link: String },
    /// A link is the child of two joints.
    #[error("{}: link {link:?}: expected one parent joint, found {first:?} and {second:?}", path.display())]
    TwoParents { path: PathBuf, link: String, first: String, second: String },
    /// Following parents leads back to the start.
    #[error("{}: expected a tree of links, found a joint loop through {link:?}", path.display())]
    Loop { path: PathBuf, link: String },
    /// Several links have no parent.
    #[error("{}: expected one root link, found {first:?} and {second:?}", path.display())]
    SeveralRoots { path: PathBuf, first: String, second: String },
    /// A kind of joint that has not exactly one degree of freedom, or depends on another joint.
    #[error("{}: joint {joint:?}: expected fixed, revolute, continuous or prismatic, found {found}", path.display())]
    JointKind { path: PathBuf, joint: String, found: &'static str },
    /// Reversed, infinite or NaN limits.
    #[error("{}: joint {joint:?}: expected finite limits with lower <= upper, found {lower:?} and {upper:?}", path.display())]
    Limits { path: PathBuf, joint: String, lower: f64, upper: f64 },
    /// A hinge that turns round and round: degrees, most likely.
    #[error("{}: joint {joint:?}: expected limits in radians, at most {most} apart, found {range} (a joint without end is continuous)", path.display())]
    Turns { path: PathBuf, joint: String, range: f32, most: f32 },
    /// A joint that takes its part out of sight: millimetres, most likely.
    #[error("{}: joint {joint:?}: expected limits in metres or radians that keep the object within {furthest} m of the origin, found a part {reach} m away at {q}", path.display())]
    Opens { path: PathBuf, joint: String, q: f32, furthest: f32, reach: f32 },
    /// An axis without a direction, or too long to find it.
    #[error("{}: joint {joint:?}: expected an axis with a direction and a finite length, found {axis:?}", path.display())]
    Axis { path: PathBuf, joint: String, axis: [f64; 3] },
    /// A pose, scale or size in the URDF is not a finite number, or a size is not positive.
    #[error("{}: {owner}: expected {expected}, found {found:?}", path.display())]
    Number { path: PathBuf, owner: String, expected: &'static str, found: Vec<f64> },
    /// Nothing can move.
    #[error("{}: expected at least one movable joint, found none among {joints}", path.display())]
    NoMovableJoint { path: PathBuf, joints: usize },
    /// Nothing can be seen or touched.
    #[error("{}: expected links with geometry, found {found}", path.display())]
    Empty { path: PathBuf, found: &'static str },
    /// Millimetres or inches, or far from the origin.
    #[error("{}: expected metres and an object within {furthest} m of the origin, at least {smallest} m in radius, found one of {radius} m radius that reaches {reach} m", path.display())]
    Size { path: PathBuf, furthest: f32, smallest: f32, radius: f32, reach: f32 },
    /// A mesh that the URDF names does not exist.
    #[error("{}: expected the mesh of link {link:?} there, found no such file", mesh.display())]
    MissingMesh { mesh: PathBuf, link: String },
    /// A mesh in a format that is not read.
    #[error("{}: expected a mesh in .obj or .stl format, found {found:?}", path.display())]
    MeshFormat { path: PathBuf, found: String },
    /// A mesh that cannot be parsed, or whose indices point nowhere.
    #[error("{}: expected a valid mesh, found: {message}", path.display())]
    Mesh { path: PathBuf, message: String },
    /// NaN or infinity in a mesh.
    #[error("{}: expected finite coordinates, found {found} in vertex {vertex}", path.display())]
    MeshNotFinite { path: PathBuf, vertex: usize, found: f32 },
}

impl ObjectError {
    pub(super) fn read(path: &Path, source: io::Error) -> Self {
        Self::Read { path: path.to_owned(), source }
    }

    pub(super) fn mesh(path: &Path, message: impl ToString) -> Self {
        Self::Mesh { path: path.to_owned(), message: one_line(&message.to_string()) }
    }
}

/// Messages of parsers come with line breaks; ours do not.
pub(super) fn one_line(message: &str) -> String {
    message.split_whitespace().collect::<Vec<_>>().join(" ")
}
