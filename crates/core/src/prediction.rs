//! What a network says about an observation: the contents of `prediction.json`.

use nalgebra::{Isometry3, Matrix3, Matrix4, Point3, Rotation3, Translation3, UnitQuaternion};
use serde::{Deserialize, Serialize};

use crate::{Grasp, Intrinsics, Pixel, Primitive};

/// Name and version of the JSON layout.
pub const PREDICTION_SCHEMA: &str = "where2act.prediction/1";

/// Everything `predict` says about one input.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Prediction {
    /// Always [`PREDICTION_SCHEMA`].
    pub schema: String,
    /// What was looked at.
    pub input: InputInfo,
    /// Which weights answered.
    pub model: ModelInfo,
    /// Frame of every point, direction and pose below: always `camera_optical`.
    pub frame: String,
    /// Units of every length: always `metres`.
    pub units: String,
    /// One entry per primitive asked for.
    pub primitives: Vec<PrimitivePrediction>,
    /// Milliseconds by stage.
    pub timing: Timing,
}

/// The input of a prediction.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct InputInfo {
    /// File name as given; empty for in-memory observations.
    pub source: String,
    /// `rgb`, `rgbd`, `depth` or `cloud`. A picture whose depth has no intrinsics, and so gives no points, is `rgb`.
    pub kind: String,
    /// Width in pixels, or the number of points of a scan.
    pub width: usize,
    /// Height in pixels, or 1 for a scan.
    pub height: usize,
    /// Network units per metre: how a scan was scaled to the unit-sized objects the network knows.
    pub network_from_metres: f32,
    /// The camera that relates pixels and points; `None` if it is not known and for scans.
    #[serde(default)]
    pub intrinsics: Option<Intrinsics>,
}

/// The weights of a prediction.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ModelInfo {
    /// Name in the weights folder's configuration.
    pub name: String,
    /// SHA-256 of `model.safetensors`.
    pub sha256: String,
}

/// One primitive's share of a prediction.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PrimitivePrediction {
    /// Which primitive.
    pub primitive: Primitive,
    /// The dense map in numbers.
    pub actionability: ActionabilitySummary,
    /// Best first.
    pub proposals: Vec<Proposal>,
}

/// A dense actionability map, summarised where proposals may be: over the object, what of it is in the region if there is one,
/// and, of a picture with depth, where that was measured.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ActionabilitySummary {
    /// Largest value.
    pub max: f32,
    /// Mean.
    pub mean: f32,
    /// File beside the JSON that holds the whole map (npy, f32, at the input's resolution); `None` in memory.
    pub map: Option<String>,
}

/// A concrete thing to try. Directions are unit vectors in the camera's optical frame; of a picture without intrinsics, whose object
/// is beside the middle, in that of the camera turned to the object.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Proposal {
    /// 1 is best.
    pub rank: usize,
    /// Pixel of the input; for scans, `u` is the point's index and `v` 0.
    pub pixel: Pixel,
    /// Contact point; `None` without depth. Where a picture's pixel has none, that of the object's nearest pixel with depth,
    /// at most 4 columns and rows away; `None` too if there is no such pixel, which only happens where one pixel was asked for
    /// or all that may be proposed at lie in holes of the depth map. Such hands are not checked for room.
    pub point: Option<[f32; 3]>,
    /// The hand's z axis.
    pub approach: [f32; 3],
    /// The hand's x axis.
    pub forward: [f32; 3],
    /// Hand rotation, rows of the matrix whose columns are forward, left, approach.
    pub rotation: [[f32; 3]; 3],
    /// The same rotation.
    pub quaternion_xyzw: [f32; 4],
    /// Hand pose at the start of the primitive, 4x4 by rows, where nalgebra's arrays go by columns: see [`Self::poses`]. `None`
    /// without a contact point.
    pub hand_pose: Option<[[f32; 4]; 4]>,
    /// Hand poses to visit, the start included; empty without a contact point.
    pub waypoints: Vec<[[f32; 4]; 4]>,
    /// Opening of the fingers at the start, metres.
    pub gripper_width: f32,
    /// Index of the waypoint at which the fingers close; `None` if they stay as they are.
    #[serde(default)]
    pub close_at: Option<usize>,
    /// How promising it is, in [0, 1], higher is better. A ranking: training balances successes and failures, so it is not
    /// the share of tries that succeed (`evaluate` reports how far the two are apart).
    pub score: f32,
    /// Actionability of the pixel in [0, 1].
    pub actionability: f32,
}

impl Proposal {
    /// The hand at the contact point; `None` without one.
    #[must_use]
    pub fn grasp(&self) -> Option<Grasp> {
        let rotation = Rotation3::from_matrix_unchecked(Matrix3::from(self.rotation).transpose());
        self.point.map(|point| Grasp { point: Point3::from(point), rotation })
    }

    /// The waypoints, `camera_from_hand`.
    pub fn poses(&self) -> impl Iterator<Item = Isometry3<f32>> {
        self.waypoints.iter().map(|rows| {
            let matrix = Matrix4::from(*rows).transpose();
            let translation = Translation3::from(matrix.fixed_view::<3, 1>(0, 3).into_owned());
            let rotation = Rotation3::from_matrix_unchecked(matrix.fixed_view::<3, 3>(0, 0).into_owned());
            Isometry3::from_parts(translation, UnitQuaternion::from_rotation_matrix(&rotation))
        })
    }
}

/// Milliseconds by stage.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Timing {
    /// From the observation in memory to what the network reads. Reading and decoding files comes before all of this.
    pub preprocess: f64,
    /// The backbone's forward pass.
    pub backbone: f64,
    /// Actionability, proposals, scores, selection.
    pub decode: f64,
    /// All of it.
    pub total: f64,
}
