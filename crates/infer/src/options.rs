//! What a caller may ask for.

use nalgebra::Vector3;
use where2act_core::{Pixel, Primitive, Seed};

use crate::Error;

/// How to predict. The default asks for ten proposals of every primitive the network knows.
#[derive(Clone, Debug, PartialEq)]
pub struct Options {
    /// Which primitives, each once, in this order; empty = all of the network's. Default: empty.
    pub primitives: Vec<Primitive>,
    /// Proposals to return per primitive, best first. Default: 10.
    pub top_k: usize,
    /// Orientations to try at every candidate, [`Options::MAX_HANDS`] at all together. Published: 100.
    pub samples: usize,
    /// Candidate pixels per primitive: the most actionable ones that keep a distance; more if `top_k` proposals need them.
    /// Default: 32.
    pub candidates: usize,
    /// Proposals to return per pixel, at least [`Options::MIN_ANGLE`] apart. Default: 1, or `top_k` with `pixel`.
    pub per_pixel: Option<usize>,
    /// Proposals below this score are left out. Default: 0.
    pub min_score: f32,
    /// Ask for this pixel of the input only (for scans: `u` is the point's index), whatever the region: "what can I do here?"
    pub pixel: Option<Pixel>,
    /// Where proposals may be, one entry per pixel of the input or point of the scan: say, the parts that move. The
    /// network still sees everything, or what is around the mask. One pixel or point of the object is enough: where a network for
    /// scans, which sees some thousand points, spread evenly, sees none of the region, the nearest move there. `None` = anywhere
    /// on the object.
    pub region: Option<Vec<bool>>,
    /// Whether hands are left out that have no room: those that would overlap something a scan or a depth map shows, with palm
    /// or fingers at the start, with the palm until the finger tips touch or, for pulling, with the open fingers before they
    /// close; and those that would begin behind something seen. There may be fewer proposals then than asked for, or none.
    /// Default: true.
    pub clearance: bool,
    /// Which way is up, in the camera's frame, of any length: what an IMU or the arm's pose tells of a camera that is not held
    /// upright, such as one at a wrist. Networks learnt from upright cameras, so they see scans and pictures turned by as much, and
    /// what they say of them is turned back. Heeded unless the camera looks straight up or down.
    /// Default: `None`, an upright camera.
    pub up: Option<Vector3<f32>>,
    /// Root of the randomness of the proposals. The same seed and input give the same bits.
    pub seed: Seed,
    /// Network units per metre of a depth map or scan, which is how the object's size is made one the network knows.
    /// `None` keeps metres for objects of a size seen in training and scales others to the nearest such size; 1 keeps
    /// metres always. Contact points come back in metres either way, and the hand keeps its real size.
    pub network_from_metres: Option<f32>,
}

impl Options {
    /// Smallest angle between two proposals at one pixel, radians: 15 degrees.
    pub const MIN_ANGLE: f32 = std::f32::consts::PI / 12.0;
    /// Most proposals, samples or candidates that may be asked for.
    pub const MAX_COUNT: usize = 10_000;
    /// Most hands that may be tried for a primitive, samples times candidates: a hundred bytes each.
    pub const MAX_HANDS: usize = 1_000_000;

    /// Proposals at one pixel, at most.
    pub(crate) fn proposals_per_pixel(&self) -> usize {
        self.per_pixel.unwrap_or(if self.pixel.is_some() { self.top_k } else { 1 })
    }

    /// Candidates to look at: those asked for, and no fewer than `top_k` proposals need.
    pub(crate) fn candidates_at_least(&self) -> usize {
        if self.pixel.is_some() {
            return 1;
        }
        self.candidates.max(self.top_k.div_ceil(self.proposals_per_pixel().max(1)))
    }

    /// Checks every number, and that no primitive is asked for twice.
    ///
    /// # Errors
    /// The first field that is out of range.
    pub fn validate(&self) -> Result<(), Error> {
        let mut others = self.primitives.iter();
        while let Some(primitive) = others.next() {
            if others.as_slice().contains(primitive) {
                return Err(Error::invalid("primitives", "each once", format!("{primitive} twice")));
            }
        }
        let counts = [
            ("top_k", self.top_k),
            ("samples", self.samples),
            ("candidates", self.candidates),
            ("per_pixel", self.per_pixel.unwrap_or(1)),
        ];
        for (what, n) in counts {
            if !(1..=Self::MAX_COUNT).contains(&n) {
                return Err(Error::invalid(
                    what,
                    format!("a number in 1..={}", Self::MAX_COUNT),
                    n.to_string(),
                ));
            }
        }
        let (samples, candidates) = (self.samples, self.candidates_at_least());
        if samples * candidates > Self::MAX_HANDS {
            let expected = format!("up to {} hands, samples times candidates (or top_k)", Self::MAX_HANDS);
            return Err(Error::invalid("samples", expected, format!("{samples} x {candidates}")));
        }
        if self.min_score.is_nan() {
            return Err(Error::invalid("min_score", "a number", "NaN"));
        }
        if let Some(up) = self.up
            && !(up.norm().is_normal() && up.iter().all(|x| x.is_finite()))
        {
            let found = format!("{}, {}, {}", up.x, up.y, up.z);
            return Err(Error::invalid("up", "a direction, three numbers not all 0", found));
        }
        match self.network_from_metres {
            Some(s) if !(s.is_finite() && (1e-6..=1e6).contains(&s)) => {
                Err(Error::invalid("network_from_metres", "a number in [1e-6, 1e6]", s.to_string()))
            }
            _ => Ok(()),
        }
    }
}

impl Default for Options {
    fn default() -> Self {
        Self {
            primitives: Vec::new(),
            top_k: 10,
            samples: 100,
            candidates: 32,
            per_pixel: None,
            min_score: 0.0,
            pixel: None,
            region: None,
            clearance: true,
            up: None,
            seed: Seed(0),
            network_from_metres: None,
        }
    }
}
