//! What hands of the caller's own are worth: those of a planner, say, that the arm can reach.

use burn::tensor::{Device, Tensor, TensorData};
use nalgebra::{Matrix3, Point3, Rotation3, Vector3};
use where2act_core::{Grasp, ImageSize, Intrinsics, Observation, Orientation6, Pixel, Primitive};
use where2act_model::preprocess::CloudInput;
use where2act_model::{Heads, LinearLayer, ModelConfig, hand_frame};

use crate::backbone::{Backbone, NetworkInput};
use crate::decode::sigmoid;
use crate::predictor::Predictor;
use crate::prepare::Prepared;
use crate::{Error, Options};

/// Farthest that a contact point may be from what is seen, metres: further off nobody knows whether there is a surface.
const OFF_SURFACE: f32 = 0.03;

/// What scores hands one by one: the heads, and the layer that the backbone leaves to them.
pub(crate) struct Judge {
    heads: Heads,
    last: Option<LinearLayer>,
    device: Device,
}

impl Judge {
    pub(crate) fn new(heads: Heads, last: Option<LinearLayer>, device: Device) -> Self {
        Self { heads, last, device }
    }

    /// What the backbone gives at `n` places as features, `[n, features]`.
    fn features(&self, rows: Vec<f32>, n: usize) -> Tensor<2> {
        let tensor = |values: Vec<f32>, rows: usize| {
            let columns = values.len() / rows.max(1);
            Tensor::<2>::from_data(TensorData::new(values, [rows, columns]), &self.device)
        };
        let rows = tensor(rows, n);
        match &self.last {
            Some(last) => {
                rows.matmul(tensor(last.weights.clone(), last.inputs())) + tensor(last.bias.clone(), 1)
            }
            None => rows,
        }
    }
}

/// A hand in the camera frame, and the pixel that shows its contact point, if the input is a picture.
#[derive(Clone, Copy)]
struct Asked {
    grasp: Grasp,
    pixel: Pixel,
}

impl Predictor {
    /// How likely hands of the caller's own are to succeed with a primitive, each in [0, 1]: for planners that know which
    /// hands the arm can reach. `None` where the contact point is not on what is seen: beyond the picture's border or, by a
    /// scan or depth map, 3 cm or more beside it; and for what is no pose, with numbers that are not finite.
    ///
    /// The score is the mean, in logits, of what the network says of the observation and of its mirror image: it is right a
    /// little more often than that of a proposal, and takes twice as long. Whether a hand has room is not looked up, as it is
    /// for proposals; the network knows what it learnt of that. Of the options only `seed` and `network_from_metres` matter.
    ///
    /// # Errors
    /// As [`Self::predict`]; and [`Error::Invalid`] for a picture without intrinsics, on which no point can be found.
    pub fn score(
        &self,
        observation: &Observation,
        primitive: Primitive,
        grasps: &[Grasp],
        options: &Options,
    ) -> Result<Vec<Option<f32>>, Error> {
        let options = Options { region: None, pixel: None, ..options.clone() };
        options.validate()?;
        let known = &self.config.primitives;
        let unknown = || Error::UnknownPrimitive { found: primitive, known: known.clone() };
        let output = self.config.output_of(primitive).ok_or_else(unknown)?;
        let prepare = |observation| Prepared::new(observation, &self.config, &self.model().name, &options);
        let prepared = prepare(observation)?;
        let mut scores = vec![None; grasps.len()];
        let found = seen(observation, &prepared, grasps)?;
        let (slots, asked): (Vec<_>, Vec<Asked>) =
            scores.iter_mut().zip(found).filter_map(|(slot, asked)| Some((slot, asked?))).unzip();
        if asked.is_empty() {
            return Ok(scores);
        }
        let of_hands = |prepared: &Prepared<'_>, asked: &[Asked]| {
            let all = self.judge.logits(&self.backbone, &self.config, prepared, asked)?;
            Ok::<Vec<f32>, Error>(all.into_iter().skip(output).step_by(known.len()).collect())
        };
        let mirror = mirrored(observation);
        let in_mirror: Vec<Asked> =
            asked.iter().map(|asked| asked.mirrored(observation, primitive)).collect();
        let both = [of_hands(&prepared, &asked)?, of_hands(&prepare(&mirror)?, &in_mirror)?];
        for (i, slot) in slots.into_iter().enumerate() {
            let mean = both.iter().filter_map(|logits| logits.get(i)).sum::<f32>() / both.len() as f32;
            *slot = Some(sigmoid(mean));
        }
        Ok(scores)
    }
}

impl Asked {
    /// As the mirror shows it.
    fn mirrored(&self, observation: &Observation, primitive: Primitive) -> Self {
        let Pixel { u, v } = self.pixel;
        let pixel = match observation {
            Observation::Image { size, .. } => Pixel { u: (size.width as u32).saturating_sub(u + 1), v },
            Observation::Cloud { .. } => self.pixel,
        };
        Self { grasp: mirrored_grasp(primitive, &self.grasp), pixel }
    }
}

/// The hands that touch what is seen.
fn seen(
    observation: &Observation,
    prepared: &Prepared<'_>,
    grasps: &[Grasp],
) -> Result<Vec<Option<Asked>>, Error> {
    let pixel = |point: &Point3<f32>| match observation {
        Observation::Image { size, intrinsics: Some(intrinsics), .. } => pixel_of(point, intrinsics, *size),
        _ => Some(Pixel { u: 0, v: 0 }),
    };
    if matches!(observation, Observation::Image { intrinsics: None, .. }) {
        let expected = "those of the camera, to find contact points in the picture";
        return Err(Error::invalid("intrinsics", expected, "none"));
    }
    let asked = |grasp: &Grasp| {
        let pixel = pixel(&grasp.point).filter(|_| grasp.rotation.matrix().iter().all(|x| x.is_finite()))?;
        prepared.shows(&grasp.point, pixel, OFF_SURFACE).then_some(Asked { grasp: *grasp, pixel })
    };
    Ok(grasps.iter().map(asked).collect())
}

impl Judge {
    /// `[hands, primitives]`, row by row.
    fn logits(
        &self,
        backbone: &Backbone,
        config: &ModelConfig,
        prepared: &Prepared<'_>,
        asked: &[Asked],
    ) -> Result<Vec<f32>, Error> {
        let (heads, n) = (&self.heads, asked.len());
        let orientations: Vec<Orientation6> =
            asked.iter().map(|asked| Orientation6::from_rotation(&asked.grasp.rotation)).collect();
        let (rows, hand_views) = match &prepared.input {
            NetworkInput::Picture { side, .. } => {
                let all = backbone.features(&prepared.input, config)?;
                let width = all.len() / (side * side);
                let row = |asked: &Asked| {
                    let row = prepared.row_of(asked.pixel);
                    all.get(row * width..(row + 1) * width)
                };
                (asked.iter().filter_map(row).flatten().copied().collect(), Vec::new())
            }
            NetworkInput::Cloud(cloud) => {
                let point = |asked: &Asked| cloud.network_from_metres(&asked.grasp.point).into();
                let points: Vec<[f32; 3]> = asked.iter().map(point).collect();
                let hierarchy =
                    CloudInput::hierarchy(std::slice::from_ref(cloud), &[points.concat()], config);
                let frame = |(point, hand): (&[f32; 3], &Orientation6)| hand_frame(*point, hand);
                let frames: Vec<_> = points.iter().zip(&orientations).map(frame).collect();
                let views = if config.second_look { cloud.hand_views(&frames) } else { Vec::new() };
                (backbone.features_of(&hierarchy)?.to_vec(), views)
            }
        };
        let features = self.features(rows, n);
        let axes: Vec<f32> = orientations.iter().flat_map(|orientation| orientation.0).collect();
        let axes = Tensor::<3>::from_data(TensorData::new(axes, [n, 1, 6]), &self.device);
        let hands = heads.score.hands(features.clone(), axes.clone());
        let logits = match &heads.second_look {
            Some(look) => look.forward(features.clone(), hands, &hand_views),
            None => heads.score.forward_hands(features.clone(), hands),
        };
        let logits = heads.with_ways(logits, features, axes).into_data();
        logits.try_into_vec().map_err(|e| Error::Network(format!("{e:?}")))
    }
}

/// The pixel that shows a point.
fn pixel_of(point: &Point3<f32>, intrinsics: &Intrinsics, size: ImageSize) -> Option<Pixel> {
    let (u, v) = intrinsics.project(point)?;
    let inside = u >= 0.0 && v >= 0.0 && u < size.width as f32 && v < size.height as f32;
    inside.then_some(Pixel { u: u as u32, v: v as u32 })
}

/// An observation as a mirror shows it that swaps left and right.
fn mirrored(observation: &Observation) -> Observation {
    match observation {
        Observation::Image { size, rgb, depth, intrinsics, mask } => Observation::Image {
            size: *size,
            rgb: rgb.as_deref().map(|rgb| reversed(rgb, *size)),
            depth: depth.as_deref().map(|depth| reversed(depth, *size)),
            intrinsics: intrinsics.map(|i| Intrinsics { cx: size.width as f32 - i.cx, ..i }),
            mask: mask.as_deref().map(|mask| reversed(mask, *size)),
        },
        Observation::Cloud { points } => {
            Observation::Cloud { points: points.iter().map(|p| Point3::new(-p.x, p.y, p.z)).collect() }
        }
    }
}

/// A picture with every row from right to left.
fn reversed<T: Copy>(pixels: &[T], size: ImageSize) -> Vec<T> {
    pixels.chunks(size.width.max(1)).flat_map(|row| row.iter().rev()).copied().collect()
}

/// A hand as the mirror shows it. It is its own mirror image in both planes along its approach, so that it is a hand again:
/// for *-up with its forward axis turned round, because a mirror that keeps up and approach swaps the third.
fn mirrored_grasp(primitive: Primitive, grasp: &Grasp) -> Grasp {
    let reflected = |v: Vector3<f32>| Vector3::new(-v.x, v.y, v.z);
    let turn = if matches!(primitive, Primitive::PushingUp | Primitive::PullingUp) { -1.0 } else { 1.0 };
    let (approach, forward) = (reflected(grasp.approach()), reflected(grasp.forward()) * turn);
    let columns = [forward, approach.cross(&forward), approach];
    Grasp {
        point: Point3::new(-grasp.point.x, grasp.point.y, grasp.point.z),
        rotation: Rotation3::from_matrix_unchecked(Matrix3::from_columns(&columns)),
    }
}

#[cfg(test)]
mod tests {
    use burn::tensor::Device;
    use where2act_core::Seed;
    use where2act_model::{Modality, Network, Weights};

    use super::*;
    use crate::Backend;

    fn predictor(modality: Modality, second_look: bool, backend: Backend) -> Predictor {
        let mut config = ModelConfig::new(modality, &Primitive::ALL).with_width(0.125).with_points(512);
        (config.second_look, config.alignments, config.ways) = (second_look, 3, Some(2.0));
        let network = Network::new(&config, Seed(7), &Device::flex());
        Predictor::from_weights(Weights { network, sha256: "0".repeat(64) }, backend).unwrap()
    }

    /// A wall with a step in it and a picture of it, from a camera that looks a little to the left.
    fn step() -> Observation {
        // As wide as the network's square, which then shows every pixel as it is.
        let size = ImageSize { width: 224, height: 128 };
        let at = |i: usize| (i % size.width, i / size.width);
        let colour = |i: usize| [at(i).0 as u8, at(i).1 as u8, (i % 13) as u8 * 19];
        let depth = |i: usize| if at(i).0 < 90 { 1.0 } else { 1.2 + 0.001 * at(i).1 as f32 };
        Observation::Image {
            size,
            rgb: Some((0..size.pixels()).map(colour).collect()),
            depth: Some((0..size.pixels()).map(depth).collect()),
            intrinsics: Some(Intrinsics { fx: 280.0, fy: 280.0, cx: 121.0, cy: 64.0 }),
            mask: None,
        }
    }

    fn scan() -> Observation {
        Observation::Cloud {
            points: step().foreground_points().into_iter().map(|(_, point)| point).collect(),
        }
    }

    fn cases() -> Vec<(Predictor, Observation)> {
        let pictures = [Backend::Fast, Backend::Flex].map(|b| (predictor(Modality::Rgb, false, b), step()));
        let scans = [Backend::Fast, Backend::Flex].map(|b| (predictor(Modality::Cloud, true, b), scan()));
        let once = (predictor(Modality::Cloud, false, Backend::Fast), step());
        pictures.into_iter().chain(scans).chain([once]).collect()
    }

    /// The hands that a prediction proposes for a primitive, with their scores.
    fn proposed(predictor: &Predictor, seen: &Observation, primitive: Primitive) -> Vec<(Grasp, f32)> {
        let options = Options {
            primitives: vec![primitive],
            network_from_metres: Some(1.0),
            clearance: false,
            ..Options::default()
        };
        let prediction = predictor.predict(seen, &options).unwrap();
        let grasp = |p: &where2act_core::Proposal| {
            Grasp::new(p.point.unwrap().into(), p.approach.into(), p.forward.into())
        };
        prediction.primitives[0].proposals.iter().map(|p| (grasp(p), p.score)).collect()
    }

    fn plain() -> Options {
        Options { network_from_metres: Some(1.0), ..Options::default() }
    }

    #[test]
    fn a_proposal_s_hand_is_scored_as_the_proposal_was_and_as_its_mirror_image() {
        for (i, (predictor, view)) in cases().into_iter().enumerate() {
            for (output, primitive) in Primitive::ALL.into_iter().enumerate() {
                let (grasps, expected): (Vec<Grasp>, Vec<f32>) =
                    proposed(&predictor, &view, primitive).into_iter().unzip();
                assert!(grasps.len() >= 5, "{i}, {primitive}: {}", grasps.len());
                // What the network says of one view.
                let prepared = Prepared::new(&view, &predictor.config, "", &plain()).unwrap();
                let asked =
                    |observation: &Observation, prepared: &Prepared<'_>, grasps: &[Grasp]| -> Vec<Asked> {
                        seen(observation, prepared, grasps).unwrap().into_iter().map(Option::unwrap).collect()
                    };
                let logits = |prepared: &Prepared<'_>, asked: &[Asked]| -> Vec<f32> {
                    let all = predictor
                        .judge
                        .logits(&predictor.backbone, &predictor.config, prepared, asked)
                        .unwrap();
                    all.into_iter().skip(output).step_by(Primitive::ALL.len()).collect()
                };
                let own = logits(&prepared, &asked(&view, &prepared, &grasps));
                for (logit, expected) in own.iter().zip(&expected) {
                    assert!(
                        (sigmoid(*logit) - expected).abs() < 2e-3,
                        "{i}, {primitive}: {logit} {expected}"
                    );
                }
                let mirror = mirrored(&view);
                let reflected: Vec<Grasp> = grasps.iter().map(|g| mirrored_grasp(primitive, g)).collect();
                let in_mirror = Prepared::new(&mirror, &predictor.config, "", &plain()).unwrap();
                let other = logits(&in_mirror, &asked(&mirror, &in_mirror, &reflected));
                assert!(own.iter().zip(&other).any(|(a, b)| (a - b).abs() > 1e-3), "{i}: mirrors differ");
                let found = predictor.score(&view, primitive, &grasps, &plain()).unwrap();
                for ((found, a), b) in found.iter().zip(own).zip(other) {
                    let mean = sigmoid(0.5 * (a + b));
                    assert!((found.unwrap() - mean).abs() < 1e-4, "{i}, {primitive}: {found:?} {mean}");
                }
            }
        }
    }

    #[test]
    fn a_mirror_image_is_scored_as_what_it_shows() {
        // Points of a scan are drawn by their order, which a mirror leaves as it is.
        for (predictor, seen) in [
            (predictor(Modality::Rgb, false, Backend::Fast), step()),
            (predictor(Modality::Cloud, true, Backend::Fast), scan()),
        ] {
            assert_eq!(mirrored(&mirrored(&seen)), seen);
            for primitive in Primitive::ALL {
                let grasps: Vec<Grasp> =
                    proposed(&predictor, &seen, primitive).into_iter().map(|(g, _)| g).collect();
                let reflected: Vec<Grasp> = grasps.iter().map(|g| mirrored_grasp(primitive, g)).collect();
                let one = predictor.score(&seen, primitive, &grasps, &plain()).unwrap();
                let other = predictor.score(&mirrored(&seen), primitive, &reflected, &plain()).unwrap();
                for (one, other) in one.iter().zip(&other) {
                    assert!((one.unwrap() - other.unwrap()).abs() < 1e-3, "{primitive}: {one:?} {other:?}");
                }
            }
        }
    }

    #[test]
    fn hands_in_the_air_have_no_score() {
        let of_pictures = predictor(Modality::Rgb, false, Backend::Fast);
        let of_scans = predictor(Modality::Cloud, true, Backend::Fast);
        for (predictor, seen) in [(&of_pictures, step()), (&of_scans, scan()), (&of_scans, step())] {
            let (good, _) = proposed(predictor, &seen, Primitive::Pushing)[0];
            let at = |point: Point3<f32>| Grasp { point, ..good };
            let away = at(good.point - Vector3::z() * 0.05);
            let behind = at(Point3::new(0.0, 0.0, -1.0));
            let beside = at(Point3::new(5.0, 0.0, 1.0));
            let nowhere = at(Point3::new(f32::NAN, 0.0, 1.0));
            let rotation = Rotation3::from_matrix_unchecked(Matrix3::repeat(f32::NAN));
            let hands = [away, good, behind, beside, nowhere, Grasp { rotation, ..good }];
            let scores = predictor.score(&seen, Primitive::Pushing, &hands, &plain()).unwrap();
            assert!(scores[1].is_some_and(|score| score > 0.0 && score < 1.0), "{scores:?}");
            assert_eq!(scores.iter().flatten().count(), 1, "{scores:?}");
            assert_eq!(predictor.score(&seen, Primitive::Pushing, &[], &plain()).unwrap(), []);
            assert_eq!(predictor.score(&seen, Primitive::Pushing, &[away], &plain()).unwrap(), [None]);
        }
        let Observation::Image { size, rgb, depth, mask, .. } = step() else { unreachable!() };
        let blind = Observation::Image { size, rgb, depth, mask, intrinsics: None };
        let error = of_pictures.score(&blind, Primitive::Pushing, &[], &plain()).unwrap_err().to_string();
        let expected =
            "intrinsics: expected those of the camera, to find contact points in the picture, found none";
        assert_eq!(error, expected);
    }
}
