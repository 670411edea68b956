//! The one type most callers need.

use std::fmt;
use std::path::Path;
use std::time::Instant;

use nalgebra::{Point3, Vector3};
use rayon::prelude::*;
use where2act_core::{
    ActionabilitySummary, InputInfo, ModelInfo, Observation, PREDICTION_SCHEMA, Pixel, Prediction, Primitive,
    PrimitivePrediction, Proposal, Timing,
};
use where2act_model::{Modality, ModelConfig};

use crate::backbone::{Backbone, Backend, NetworkInput};
use crate::clearance::Room;
use crate::decode::{Codes, DecodingHeads, LOOKS, Scored, Tried, select, sigmoid};
use crate::dense::DenseMaps;
use crate::pose::proposal;
use crate::prepare::Prepared;
use crate::score::ScoringHeads;
use crate::{Error, Options};

/// A network that is ready to answer. Cheap to share: put it in an `Arc` or lend it to any number of threads.
pub struct Predictor {
    pub(crate) backbone: Backbone,
    heads: DecodingHeads,
    pub(crate) scoring: ScoringHeads,
    pub(crate) config: ModelConfig,
    model: ModelInfo,
}

impl fmt::Debug for Predictor {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Predictor").field("model", &self.model).finish_non_exhaustive()
    }
}

/// A prediction with the dense maps it was made from.
#[derive(Debug)]
pub struct Output<'a> {
    /// Proposals and summaries.
    pub prediction: Prediction,
    /// Actionability everywhere.
    pub maps: DenseMaps<'a>,
}

impl Predictor {
    /// Loads a weights folder (`config.json`, `model.safetensors`, `SHA256SUMS`) and verifies it.
    ///
    /// # Errors
    /// [`Error::Weights`] names the file and what is wrong with it.
    pub fn load(folder: &Path) -> Result<Self, Error> {
        Self::load_with(folder, Backend::default())
    }

    /// As [`Self::load`], on another backend.
    ///
    /// # Errors
    /// As [`Self::load`].
    pub fn load_with(folder: &Path, backend: Backend) -> Result<Self, Error> {
        let weights = where2act_model::Weights::load(folder, &backend.device())
            .map_err(|source| Error::Weights { path: folder.to_owned(), source: Box::new(source) })?;
        Self::from_weights(weights, backend)
    }

    /// The default weights for a kind of input, built into the program.
    ///
    /// # Errors
    /// [`Error::Weights`] if what was built in was damaged already.
    #[cfg(feature = "bundled-weights")]
    pub fn bundled(modality: Modality, backend: Backend) -> Result<Self, Error> {
        let (name, [config, weights]) = crate::weights::bundled(modality);
        let weights = where2act_model::Weights::from_bytes(config, weights, &backend.device())
            .map_err(|source| Error::Weights { path: name.into(), source: Box::new(source) })?;
        Self::from_weights(weights, backend)
    }

    /// From weights in memory.
    ///
    /// # Errors
    /// [`Error::Network`] if the backend fails.
    pub fn from_weights(weights: where2act_model::Weights, backend: Backend) -> Result<Self, Error> {
        let where2act_model::Weights { network, sha256 } = weights;
        let config = network.config().clone();
        let (decoders, device) = (network.heads.clone(), network.device());
        let (backbone, last) = Backbone::new(network, backend)?;
        let heads = DecodingHeads::new(&decoders, &config, last.as_ref())?;
        let model = ModelInfo { name: config.name.clone(), sha256 };
        let scoring = ScoringHeads::new(decoders, last, device);
        Ok(Self { backbone, heads, scoring, config, model })
    }

    /// What the network is.
    #[must_use]
    pub fn config(&self) -> &ModelConfig {
        &self.config
    }

    /// Name and checksum of the weights.
    #[must_use]
    pub fn model(&self) -> &ModelInfo {
        &self.model
    }

    /// What can be done with what is seen. The same input, options, weights and backend give the same bits on one
    /// machine, whatever the number of threads; only the timing differs.
    ///
    /// # Errors
    /// If the observation or the options are of no use to this network.
    pub fn predict(&self, observation: &Observation, options: &Options) -> Result<Prediction, Error> {
        self.predict_dense(observation, options).map(|output| output.prediction)
    }

    /// [`Self::predict`] for several observations, one after the other, each with all cores: memory stays that of one,
    /// and every result is the one [`Self::predict`] gives. An observation that fails does not keep the others.
    pub fn predict_batch(
        &self,
        observations: &[Observation],
        options: &Options,
    ) -> Vec<Result<Prediction, Error>> {
        observations.iter().map(|observation| self.predict(observation, options)).collect()
    }

    /// [`Self::predict`] together with the dense maps.
    ///
    /// # Errors
    /// As [`Self::predict`].
    pub fn predict_dense<'a>(
        &self,
        observation: &'a Observation,
        options: &Options,
    ) -> Result<Output<'a>, Error> {
        options.validate()?;
        let outputs = self.outputs(options)?;
        let start = Instant::now();
        let prepared = Prepared::new(observation, &self.config, &self.model.name, options)?;
        let preprocessed = Instant::now();
        let features = self.backbone.features(&prepared.input, &self.config)?;
        let looked = Instant::now();
        let (logits, codes) = rayon::join(
            || self.heads.actionability(&features, &prepared.shown()),
            || self.heads.codes(options.samples, options.seed),
        );
        let logits = logits?;
        let values = sigmoids(&logits);
        let known = Known {
            prepared: &prepared,
            features: &features,
            logits: &logits,
            values: &values,
            codes: &codes,
        };
        let primitives = outputs
            .into_par_iter()
            .map(|(primitive, output)| self.decode(&known, primitive, output, options))
            .collect::<Result<_, _>>()?;
        let decoded = Instant::now();
        let millis = |from: Instant, to: Instant| to.duration_since(from).as_secs_f64() * 1e3;
        let (width, height) = match observation {
            Observation::Image { size, .. } => (size.width, size.height),
            Observation::Cloud { points } => (points.len(), 1),
        };
        let prediction = Prediction {
            schema: PREDICTION_SCHEMA.to_owned(),
            input: InputInfo {
                source: String::new(),
                kind: kind(observation).to_owned(),
                width,
                height,
                network_from_metres: prepared.network_from_metres,
                intrinsics: match observation {
                    Observation::Image { intrinsics, .. } => *intrinsics,
                    Observation::Cloud { .. } => None,
                },
            },
            model: self.model.clone(),
            frame: "camera_optical".to_owned(),
            units: "metres".to_owned(),
            primitives,
            timing: Timing {
                preprocess: millis(start, preprocessed),
                backbone: millis(preprocessed, looked),
                decode: millis(looked, decoded),
                total: millis(start, Instant::now()),
            },
        };
        let maps = DenseMaps {
            observation,
            primitives: self.config.primitives.clone(),
            values,
            geometry: prepared.geometry,
        };
        Ok(Output { prediction, maps })
    }

    /// The heads' outputs that are asked for.
    fn outputs(&self, options: &Options) -> Result<Vec<(Primitive, usize)>, Error> {
        let known = &self.config.primitives;
        let wanted = if options.primitives.is_empty() { known } else { &options.primitives };
        wanted
            .iter()
            .map(|&found| {
                let output = self.config.output_of(found);
                output
                    .map(|o| (found, o))
                    .ok_or_else(|| Error::UnknownPrimitive { found, known: known.clone() })
            })
            .collect()
    }

    fn decode(
        &self,
        known: &Known<'_>,
        primitive: Primitive,
        output: usize,
        options: &Options,
    ) -> Result<PrimitivePrediction, Error> {
        let Known { prepared, features, logits, values, codes } = known;
        let count = logits.len() / self.config.primitives.len();
        let own = output * count..(output + 1) * count;
        let logits = logits.get(own.clone()).unwrap_or_default();
        let values = values.get(own).unwrap_or_default();
        let logit = |row: u32| logits.get(row as usize).copied().unwrap_or(f32::NEG_INFINITY);
        let value = |row: u32| values.get(row as usize).copied().unwrap_or(0.0);
        let candidates: Vec<u32> = match prepared.asked_row {
            Some(row) => vec![row],
            None => prepared.places.best(logit, options.candidates_at_least()),
        };
        let places: Vec<_> = candidates.iter().map(|&row| prepared.place(row)).collect();
        let room = |place: &Place| if options.clearance { prepared.room(place, primitive) } else { None };
        let rooms: Vec<Option<Room>> = places.iter().map(room).collect();
        let in_camera = |hand: &Scored| prepared.camera_from_gaze * hand.rotation;
        let fits = |hand: &Scored| {
            rooms.get(hand.candidate).and_then(Option::as_ref).is_none_or(|room| {
                let rotation = in_camera(hand);
                room.fits(primitive, &rotation)
                    && room.begins_in_view(&rotation, |point| prepared.hides(point))
            })
        };
        let tried = self.heads.propose(features, &candidates, output, codes)?;
        let looking = match &prepared.input {
            NetworkInput::Cloud(cloud) => self.heads.second_look.as_ref().zip(Some(cloud)),
            NetworkInput::Picture { .. } => None,
        };
        let best_alone =
            looking.is_none() && rooms.iter().all(Option::is_none) && options.proposals_per_pixel() == 1;
        let mut scored = Vec::new();
        for (candidate, (place, tried)) in places.iter().zip(tried).enumerate() {
            let normal = place.normal.map(|normal| prepared.camera_from_gaze.inverse() * normal);
            scored.extend(possible(&tried, normal, best_alone).into_iter().map(|sample| {
                let (rotation, score) = (tried.rotation(sample), tried.scores.get(sample).copied());
                Scored { candidate, pixel: place.pixel, rotation, score: score.unwrap_or(0.0) }
            }));
        }
        if let Some((look, cloud)) = looking {
            let each =
                options.per_pixel.unwrap_or(if options.pixel.is_some() { options.samples } else { LOOKS });
            let each = each.max(LOOKS);
            let promising = Options {
                top_k: each * candidates.len(),
                per_pixel: Some(each),
                min_score: f32::NEG_INFINITY,
                ..Options::default()
            };
            scored = look.score(features, cloud, &candidates, select(&scored, &promising, fits), output)?;
        }
        let chosen = select(&scored, options, fits);
        let proposals: Vec<Proposal> = chosen
            .into_iter()
            .enumerate()
            .filter_map(|(i, s)| {
                let place = places.get(s.candidate)?;
                let actionability = candidates.get(s.candidate).map_or(0.0, |&row| value(row));
                let numbers = (s.score, actionability);
                Some(Proposal {
                    rank: i + 1,
                    ..proposal(primitive, s.pixel, place.point, &in_camera(&s), numbers)
                })
            })
            .collect();
        let actionability = summary(prepared.places.rows(), value);
        Ok(PrimitivePrediction { primitive, actionability, proposals })
    }
}

/// Samples whose hand does not come out of the surface, of which this is the normal in the hands' frame - trials that try count as
/// failures - or the best of them.
fn possible(tried: &Tried, normal: Option<Vector3<f32>>, best_alone: bool) -> Vec<usize> {
    let outwards = |sample: usize| normal.is_some_and(|normal| normal.dot(&tried.approach(sample)) > 0.0);
    let score = |sample: usize| tried.scores.get(sample).copied().unwrap_or(f32::NEG_INFINITY);
    let all = (0..tried.scores.len()).filter(|&sample| !outwards(sample));
    if best_alone {
        // Of equal ones the first, as `select` has it.
        all.reduce(|a, b| if score(b) > score(a) { b } else { a }).into_iter().collect()
    } else {
        all.collect()
    }
}

/// [`sigmoid`] of every logit, in plain loops over slices, which the compiler makes vectors of.
fn sigmoids(logits: &[f32]) -> Vec<f32> {
    const BLOCK: usize = 4096;
    let mut values = vec![0.0; logits.len()];
    let blocks = values.par_chunks_mut(BLOCK).zip(logits.par_chunks(BLOCK));
    blocks.for_each(|(values, logits)| {
        values.iter_mut().zip(logits).for_each(|(value, &logit)| *value = sigmoid(logit));
    });
    values
}

/// Greatest and mean value of some rows.
fn summary(rows: &[u32], value: impl Fn(u32) -> f32) -> ActionabilitySummary {
    // Eight sums, so that no addition waits for the one before it: 37 us instead of 140 for a picture's rows.
    let (mut greatest, mut sums) = ([0.0f32; 8], [0.0f64; 8]);
    for some in rows.chunks(8) {
        for ((greatest, sum), &row) in greatest.iter_mut().zip(&mut sums).zip(some) {
            let value = value(row);
            *greatest = greatest.max(value);
            *sum += f64::from(value);
        }
    }
    let mean = (sums.iter().sum::<f64>() / rows.len().max(1) as f64) as f32;
    ActionabilitySummary { max: greatest.into_iter().fold(0.0, f32::max), mean, map: None }
}

/// What decoding of every primitive starts from.
struct Known<'a> {
    prepared: &'a Prepared<'a>,
    features: &'a [f32],
    /// `[primitives, rows]`, as the values.
    logits: &'a [f32],
    values: &'a [f32],
    codes: &'a Codes,
}

/// The word for an observation in [`InputInfo::kind`].
fn kind(observation: &Observation) -> &'static str {
    match observation {
        Observation::Cloud { .. } => "cloud",
        // Depth gives points only with a camera.
        Observation::Image { rgb: Some(_), depth: Some(_), intrinsics: Some(_), .. } => "rgbd",
        Observation::Image { rgb: Some(_), .. } => "rgb",
        Observation::Image { .. } => "depth",
    }
}

/// What a network of some modality reads, in words.
pub(crate) fn reads(modality: Modality) -> &'static str {
    match modality {
        Modality::Rgb => "pictures",
        Modality::Cloud => "scans and depth maps",
    }
}

/// Where a candidate is on the input.
pub(crate) struct Place {
    pub(crate) pixel: Pixel,
    /// In metres.
    pub(crate) point: Option<Point3<f32>>,
    /// Of the surface, towards the camera.
    pub(crate) normal: Option<Vector3<f32>>,
}
