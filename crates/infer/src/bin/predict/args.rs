//! The command line.

use std::path::PathBuf;

use anyhow::{Result, bail};
use clap::{Parser, ValueEnum};
use nalgebra::Vector3;
use where2act_core::{Intrinsics, Pixel, Primitive, Seed};
use where2act_infer::{Backend, Error, Options};
use where2act_kernels::Isa;
use where2act_model::EngineError;

use crate::inputs::Input;

const EXAMPLES: &str = "\
Examples:
  predict cabinet.jpg
  predict cabinet.png --depth depth.png --intrinsics 615.1,615.4,320.2,239.8
  predict cabinet.png --depth depth.png --fov 42 --weights weights/cloud
  predict depth.png --fov 42 --primitive pulling --primitive pushing
  predict scan.ply --object-scale 1.5
  predict kitchen.jpg --box 210,80,400,520
  predict photos/ --out results/
  predict cabinet.jpg --pixel 310,188 --json | jq '.primitives[0].proposals[0]'

Scores rank proposals: higher is better. A score is not the share of tries that succeed.

Directions and poses are in the camera's optical frame: x right, y down, z forward, metres. The hand's z axis is the \
approach, its x axis is forward, and the fingers open along y. Without depth there are directions, but no points and poses; \
those of an object beside the middle of a picture need --fov or --intrinsics, or a photo's EXIF block, to be in that frame. \
Scans are in the same frame: a camera at (0, 0, 0) looks along z.

With --depth the picture decides, and the depth gives points in metres and leaves out hands without room. With --weights \
weights/cloud the depth decides, whose proposals succeed more often.

A depth map or scan is centred and, if its object is smaller or larger than those seen in training, scaled for the network; \
--object-scale or --keep-scale overrule that. Points come back in the input's metres; the hand keeps its real size.";

/// Says what a gripper can do with what is seen, where, how, and what to try first.
#[derive(Debug, Parser)]
#[command(version, after_help = EXAMPLES)]
pub(crate) struct Args {
    /// Pictures (png, jpg, webp), depth maps (16-bit grey png, or npy [height, width]; with --intrinsics or --fov), scans (ply,
    /// pcd, or npy [points, 3 or more]; in the camera's optical frame, metres), or folders of these.
    #[arg(required = true)]
    pub(crate) input: Vec<PathBuf>,
    /// Depth map of the picture: 16-bit grey png, or npy [height, width] in metres. The picture decides all the same, unless
    /// --weights are for scans.
    #[arg(long, value_name = "F")]
    pub(crate) depth: Option<PathBuf>,
    /// Metres per unit of integer depth.
    #[arg(long, value_name = "S", default_value_t = 0.001, allow_negative_numbers = true)]
    pub(crate) depth_scale: f32,
    /// Focal lengths and principal point of the picture or depth map, pixels from its corner: add 0.5 to CX and CY of OpenCV
    /// or ROS, which count from the middle of the first pixel.
    #[arg(
        long,
        value_name = "FX,FY,CX,CY",
        value_delimiter = ',',
        allow_hyphen_values = true,
        conflicts_with = "fov"
    )]
    intrinsics: Vec<f32>,
    /// Vertical field of view of the picture or depth map, degrees, with the axis in the middle. Of a picture alone it tells, with
    /// --mask or --box, how far beside the axis the object is. Default for masked pictures: what the EXIF block says.
    #[arg(long, value_name = "DEG", allow_negative_numbers = true)]
    pub(crate) fov: Option<f32>,
    /// Which way is up, in the frame of a camera that is not held upright, such as one at a wrist: -1,0,0 if the picture's left is
    /// up. The network then looks at the picture or scan as if it were upright. Default: 0,-1,0.
    #[arg(long, value_name = "X,Y,Z", value_delimiter = ',', allow_hyphen_values = true)]
    up: Vec<f32>,
    /// Picture whose pixels brighter than half are the object, all of it: everything else is painted white, and networks like
    /// weights/rgb look at the square around the object. Default: what is not transparent, if the input is a cut-out.
    #[arg(long, value_name = "F")]
    pub(crate) mask: Option<PathBuf>,
    /// Rectangle around the object instead of a mask, pixels of the picture as it is shown, upright. What is outside is painted
    /// white, what else is inside is taken for the object.
    #[arg(
        long = "box",
        value_name = "LEFT,TOP,WIDTH,HEIGHT",
        value_delimiter = ',',
        allow_hyphen_values = true,
        conflicts_with = "mask"
    )]
    rectangle: Vec<i64>,
    /// Primitive to predict; several times for several. Default: all.
    #[arg(long = "primitive", value_name = "P")]
    primitives: Vec<Primitive>,
    /// Proposals per primitive.
    #[arg(long, value_name = "K", default_value_t = 10)]
    top_k: usize,
    /// Orientations tried at every candidate.
    #[arg(long, value_name = "N", default_value_t = 100)]
    samples: usize,
    /// Candidate pixels per primitive; more if --top-k needs them.
    #[arg(long, value_name = "N", default_value_t = 32)]
    candidates: usize,
    /// Leave out proposals with a lower score.
    #[arg(long, value_name = "S", default_value_t = 0.0, allow_negative_numbers = true)]
    min_score: f32,
    /// Only this pixel: what can be done here? For scans: the index of a point and 0.
    #[arg(long, value_name = "U,V", value_delimiter = ',')]
    pixel: Vec<u32>,
    /// Keep hands that have no room: those that would touch something, by the scan or depth map, before they should, those that
    /// would begin behind what is seen, and those that cannot close around what they would pull.
    #[arg(long)]
    no_clearance: bool,
    /// Network units per metre, for depth maps and scans.
    #[arg(long, value_name = "S", conflicts_with = "keep_scale", allow_negative_numbers = true)]
    object_scale: Option<f32>,
    /// The same as --object-scale 1.
    #[arg(long)]
    keep_scale: bool,
    /// Weights folder, or a folder with rgb/ and cloud/. Default: weights/ of the working directory or workspace.
    #[arg(long, value_name = "DIR")]
    pub(crate) weights: Option<PathBuf>,
    /// Folder for the results; several inputs, and those of a folder, get a folder each in it. An earlier prediction in it is
    /// replaced. Default: predictions/NAME (none with --json).
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Print the prediction as JSON, one line per input.
    #[arg(long)]
    pub(crate) json: bool,
    /// Write no overlays and no contact sheet.
    #[arg(long)]
    pub(crate) no_pictures: bool,
    /// What computes the network: kernels of this project, or burn.
    #[arg(long, value_enum, default_value_t = EngineArg::Fast)]
    engine: EngineArg,
    /// Backend of burn; implies --engine burn. ndarray needs a build with `--features ndarray`.
    #[arg(long, value_enum)]
    device: Option<DeviceArg>,
    /// What the network for pictures multiplies in. bf16 is less exact, needs AVX-512 with bf16 and is faster on AMD's
    /// processors that have it.
    #[arg(long, value_enum, default_value_t = PrecisionArg::F32)]
    precision: PrecisionArg,
    /// Root of all randomness.
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Threads. Default: all cores.
    #[arg(long, value_name = "N")]
    pub(crate) jobs: Option<usize>,
    /// Print neither table nor progress.
    #[arg(long, short)]
    pub(crate) quiet: bool,
}

/// What computes the network.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum EngineArg {
    /// this project's own kernels
    Fast,
    /// burn
    Burn,
}

/// What convolutions multiply in.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum PrecisionArg {
    /// significands of 24 bits
    F32,
    /// significands of 8 bits
    Bf16,
}

/// burn's backends for CPUs.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum DeviceArg {
    /// the faster one
    Flex,
    /// the slower one, for comparison
    #[cfg(feature = "ndarray")]
    Ndarray,
}

impl Args {
    /// What clap cannot check.
    pub(crate) fn check(&self) -> Result<()> {
        if ![0, 4].contains(&self.intrinsics.len()) {
            bail!("--intrinsics: expected four numbers FX,FY,CX,CY, found {}", self.intrinsics.len());
        }
        if ![0, 4].contains(&self.rectangle.len()) {
            bail!("--box: expected four numbers LEFT,TOP,WIDTH,HEIGHT, found {}", self.rectangle.len());
        }
        if ![0, 3].contains(&self.up.len()) {
            bail!("--up: expected three numbers X,Y,Z, found {}", self.up.len());
        }
        if ![0, 2].contains(&self.pixel.len()) {
            bail!("--pixel: expected two numbers U,V, found {}", self.pixel.len());
        }
        if let Some(fov) = self.fov
            && !(fov > 0.0 && fov < 180.0)
        {
            bail!("--fov: expected degrees in (0, 180), found {fov}");
        }
        if !(self.depth_scale > 0.0 && self.depth_scale.is_finite()) {
            bail!("--depth-scale: expected metres per unit above 0, found {}", self.depth_scale);
        }
        if self.jobs == Some(0) {
            bail!("--jobs: expected at least 1, found 0");
        }
        if self.precision == PrecisionArg::Bf16 {
            if self.backend() != Backend::Bf16 {
                bail!("--precision: bf16 is computed by --engine fast, not by burn");
            }
            Isa::bf16().ok_or(EngineError::NoBf16).map_err(|e| anyhow::anyhow!("--{e}"))?;
        }
        self.options().validate().map_err(|error| match error {
            Error::Invalid { what, expected, found } => {
                let flag =
                    if what == "network_from_metres" { "object-scale" } else { &what.replace('_', "-") };
                anyhow::anyhow!("--{flag}: expected {expected}, found {found}")
            }
            other => other.into(),
        })
    }

    pub(crate) fn backend(&self) -> Backend {
        match (self.engine, self.device) {
            (EngineArg::Fast, None) => match self.precision {
                PrecisionArg::F32 => Backend::Fast,
                PrecisionArg::Bf16 => Backend::Bf16,
            },
            #[cfg(feature = "ndarray")]
            (_, Some(DeviceArg::Ndarray)) => Backend::Ndarray,
            (EngineArg::Burn, None) | (_, Some(DeviceArg::Flex)) => Backend::Flex,
        }
    }

    pub(crate) fn options(&self) -> Options {
        Options {
            primitives: self.primitives.clone(),
            top_k: self.top_k,
            samples: self.samples,
            candidates: self.candidates,
            min_score: self.min_score,
            pixel: if let [u, v] = *self.pixel.as_slice() { Some(Pixel { u, v }) } else { None },
            clearance: !self.no_clearance,
            up: self.up(),
            seed: Seed(self.seed),
            network_from_metres: if self.keep_scale { Some(1.0) } else { self.object_scale },
            ..Options::default()
        }
    }

    /// Which way is up in the camera's frame.
    fn up(&self) -> Option<Vector3<f32>> {
        Some(Vector3::from(<[f32; 3]>::try_from(self.up.as_slice()).ok()?))
    }

    /// Whether a camera is described.
    pub(crate) fn has_camera(&self) -> bool {
        self.fov.is_some() || self.given_intrinsics().is_some()
    }

    /// The intrinsics given as such; a field of view needs the picture's size.
    pub(crate) fn given_intrinsics(&self) -> Option<Intrinsics> {
        match *self.intrinsics.as_slice() {
            [fx, fy, cx, cy] => Some(Intrinsics { fx, fy, cx, cy }),
            _ => None,
        }
    }

    /// The rectangle around the object: left, top, width and height.
    pub(crate) fn rectangle(&self) -> Option<[i64; 4]> {
        self.rectangle.as_slice().try_into().ok()
    }

    /// Where the results of each input go: its own folder, unless it is one file and `--out` names it.
    pub(crate) fn out_folders(&self, inputs: &[Input]) -> Vec<Option<PathBuf>> {
        let root = match (&self.out, self.json) {
            (Some(out), _) if matches!(self.input.as_slice(), [one] if !one.is_dir()) => {
                return vec![Some(out.clone())];
            }
            (Some(out), _) => out.clone(),
            (None, true) => return vec![None; inputs.len()],
            (None, false) => PathBuf::from("predictions"),
        };
        let mut used = std::collections::HashSet::new();
        inputs
            .iter()
            .map(|input| {
                let stem = input.path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
                // Inputs of the same name in different folders, or with different endings.
                let names = std::iter::once(stem.clone()).chain((2..).map(|n| format!("{stem}-{n}")));
                names.into_iter().find(|name| used.insert(name.clone())).map(|name| root.join(name))
            })
            .collect()
    }
}
