//! Weights and a picture or scan in, actions out: the crate that robot software embeds.
//!
//! ```no_run
//! use std::path::Path;
//! use where2act_core::{ImageSize, Intrinsics, Observation};
//! use where2act_infer::{Error, Options, Predictor};
//!
//! # fn main() -> Result<(), Error> {
//! let predictor = Predictor::load(Path::new("weights/cloud"))?;
//! let size = ImageSize { width: 640, height: 480 };
//! let depth = vec![0.8; size.pixels()]; // metres, from the camera's driver
//! // OpenCV's and ROS's cx and cy count from the middle of the first pixel: 0.5 less than here.
//! let intrinsics = Some(Intrinsics { fx: 615.1, fy: 615.4, cx: 319.7 + 0.5, cy: 239.3 + 0.5 });
//! let observation = Observation::Image { size, rgb: None, depth: Some(depth), intrinsics, mask: None };
//!
//! let prediction = predictor.predict(&observation, &Options::default())?;
//! for of in &prediction.primitives {
//!     if let Some(best) = of.proposals.first() {
//!         println!("{}: {:.2} at {:?}, {} poses", of.primitive, best.score, best.point, best.waypoints.len());
//!     }
//! }
//! # Ok(())
//! # }
//! ```
//!
//! A [`Predictor`] is `Send + Sync` and holds no locks while it computes: share one between threads. It uses rayon's current
//! pool, threads keep scratch memory from one prediction to the next, and `WHERE2ACT_ISA`, an environment variable that may
//! name a narrower instruction set, is read once in a process.
//! It prints nothing and panics on no input; what went wrong is an [`Error`] that says what was expected and found.
//! The same input, options and weights give the same bits on one machine, whatever the number of threads.
//!
//! # Frames
//!
//! Every point, direction and pose is in the camera's optical frame, as in OpenCV and ROS, in metres:
//!
//! ```text
//!     camera (optical)                        hand
//!
//!          z (into the picture)                y  left: the fingers open along it
//!         /                                    ^  _____
//!        /                                     | |     |======   finger
//!       o-----> x (right, as u)                o-|- - -|- - - -> z  approach, along the fingers
//!       |                                        |_____|======   finger
//!       |
//!       v                               x, forward, points into the page
//!     y (down, as v)                    o: where the hand is mounted, 0.112 m behind the finger tips
//! ```
//!
//! This is the frame of the link `panda_hand` in Franka's URDF. The flange itself, `panda_link8`, has the same origin and is
//! turned by 45 degrees about z.
//!
//! In pictures the corner of the first pixel is at (0, 0), its centre at (0.5, 0.5), and [`where2act_core::Intrinsics`] go by
//! that. In OpenCV and ROS the centre is at (0, 0): add 0.5 to `cx` and `cy` of a camera that was calibrated there.
//!
//! A proposal's `rotation` has the columns forward, left, approach: it maps hand coordinates to camera coordinates.
//! `hand_pose` and `waypoints` are 4x4 matrices of the hand frame, `camera_from_hand`, by rows. To drive a robot,
//! multiply from the left with your `base_from_camera`. The hand starts 0.15 m behind the contact point:
//!
//! ```text
//!     hand frame            finger tips      contact point, surface
//!         o=====================>  . . . . . *|
//!         |<------ 0.112 m ---->|             |
//!         |<----------- 0.15 m ------------->||      waypoint 0: hand_pose
//!                 |<------- 0.10 m --------->||      waypoint 1 (0.11 m for pushing-up and -left)
//! ```
//!
//! Then pulling closes the fingers and goes back to 0.15 m; the *-up and *-left primitives move 0.05 m along the
//! hand's y and x; pushing is done. `close_at` says at which waypoint the fingers close.
//!
//! # Hands of your own
//!
//! A planner that knows which hands the arm can reach asks what each is worth. Hands are given in the camera's frame, in metres,
//! by their contact points; where nothing is seen there is no score:
//!
//! ```no_run
//! # use where2act_core::{Grasp, Observation, Primitive};
//! # use where2act_infer::{Error, Options, Predictor};
//! # fn best(predictor: &Predictor, observation: &Observation, reachable: &[Grasp]) -> Result<Option<usize>, Error> {
//! let hands: Vec<_> = reachable.iter().map(|grasp| (Primitive::Pulling, *grasp)).collect();
//! let scores = predictor.score(observation, &hands, &Options::default())?;
//! let known = scores.iter().enumerate().filter_map(|(i, score)| Some((i, (*score)?)));
//! let best = known.max_by(|a, b| a.1.total_cmp(&b.1)).map(|(i, _)| i);
//! # Ok(best)
//! # }
//! ```
//!
//! # Room for the hand
//!
//! Hands that would overlap something that the scan or the depth map shows (up to some 4,000 points around each are looked at),
//! masked or not, are left out: with palm or fingers at the start, with the palm until the finger tips touch or, for pulling,
//! with the open fingers before they close. So are hands that would begin behind something seen: nobody knows what is there.
//! Hence there may be fewer proposals than asked for, or none. What else the camera does not see is not considered, nor is the
//! arm behind the hand.
//! [`Options::clearance`] switches it off.
//!
//! # Sizes
//!
//! The networks know objects that fit a sphere of about 1 m and a hand of real size. A depth map or scan of an object
//! of such a size keeps its metres. A smaller or larger one is centred and scaled to the nearest size seen in training
//! ([`where2act_core::InputInfo::network_from_metres`] says by how much), and contact points are scaled back. Only the
//! points: the lengths of the hand's motion stay those of the real hand. `Options::network_from_metres` overrides it.
//! Without depth there is no scale, and proposals are pixels and orientations only.
//!
//! # Objects beside the middle
//!
//! In training cameras look at the object. One more than 8 degrees off the camera's axis is seen as by a camera turned to it by the
//! shortest way, and what is proposed is turned back. For a picture that takes intrinsics, a mask, and a network that looks at the
//! square around it; without intrinsics directions stay those of the camera that looks there. `weights/EXPERIMENTS.md` says what
//! becomes of objects beside the axis and of cameras that are not upright ("Cameras that are not held as in training").
//!
//! # Features
//!
//! `bundled-weights` builds the workspace's `weights/rgb` and `weights/cloud` into the program, for installations of one
//! file: `Predictor::bundled(Modality::Cloud, Backend::default())` instead of
//! [`Predictor::load`]. `predict` built with it needs no weights folder, and still takes another one from `--weights`.
#![cfg_attr(
    not(test),
    deny(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::indexing_slicing)
)]
#![cfg_attr(not(test), deny(clippy::print_stdout, clippy::print_stderr))]

mod backbone;
mod clearance;
mod decode;
mod dense;
mod draw;
mod error;
mod gaze;
mod hidden;
mod nearest;
mod options;
mod pose;
mod predictor;
mod prepare;
pub mod read;
mod score;
#[cfg(test)]
mod snapshots;
mod surface;
mod weights;
pub mod write;

pub use backbone::Backend;
pub use dense::DenseMaps;
pub use draw::{draw_overlay, draw_sheet, heat_colour, heat_end};
pub use error::{Error, Malformed, ReadError};
pub use options::Options;
pub use predictor::{Output, Predictor};
pub use weights::find_weights;
pub use where2act_model::{Modality, ModelConfig, Weights};
