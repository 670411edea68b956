//! What hands of the caller's own are worth: those of a planner, say, that the arm can reach.

use burn::tensor::{Device, Tensor, TensorData};
use nalgebra::{Matrix3, Point3};
use rayon::prelude::*;
use where2act_core::{Grasp, ImageSize, Intrinsics, Observation, Orientation6, Pixel, Primitive};
use where2act_model::preprocess::CloudInput;
use where2act_model::{Heads, LinearLayer, ModelConfig, hand_frame};

use crate::backbone::{Backbone, NetworkInput};
use crate::decode::sigmoid;
use crate::dense::on_object;
use crate::predictor::Predictor;
use crate::prepare::Prepared;
use crate::{Error, Options};

/// Farthest that a contact point may be from what is seen, metres: further off nobody knows whether there is a surface.
const FROM_SURFACE: f32 = 0.03;
/// Most that a number of a rotation's product with its transpose may differ from the identity's.
const NO_ROTATION: f32 = 1e-2;
/// So many hands go through the heads at a time: what each sees of a scan takes some 10 kB.
const BLOCK: usize = 1024;

/// What scores hands one by one: the heads, and the layer that the backbone leaves to them.
pub(crate) struct ScoringHeads {
    heads: Heads,
    last: Option<LinearLayer>,
    device: Device,
}

/// A hand in the frame in which the network knows directions and points, what it is to do, and the pixel that shows its contact
/// point, if the input is a picture.
#[derive(Clone, Copy)]
struct Asked {
    primitive: Primitive,
    point: Point3<f32>,
    orientation: Orientation6,
    pixel: Pixel,
}

impl Predictor {
    /// How likely hands of the caller's own are to succeed, each in [0, 1]: for planners that know which hands the arm can
    /// reach. Each comes with what it is to do, in the camera's optical frame, its point being the contact point, metres.
    ///
    /// `None` where that is not on what is seen: beyond the picture's border, off its mask or, by a scan or depth map, 3 cm or
    /// more from it; and for what is no pose, with numbers that are not finite or a matrix that does not rotate.
    ///
    /// The score is the mean, in logits, of what the network says of the observation and of its mirror image, for which the
    /// backbone runs twice. On most sets of `weights/RESULTS.md` it tells random trials apart a little better than one look.
    /// Whether a hand has room is not looked up, as it is for proposals; the network knows what it learnt of that. Of the
    /// options `up`, `seed` and `network_from_metres` matter.
    ///
    /// # Errors
    /// As [`Self::predict`]; and [`Error::Invalid`] for a picture without intrinsics, on which no point can be found.
    pub fn score(
        &self,
        observation: &Observation,
        hands: &[(Primitive, Grasp)],
        options: &Options,
    ) -> Result<Vec<Option<f32>>, Error> {
        let Options { up, seed, network_from_metres, .. } = *options;
        let options = Options { up, seed, network_from_metres, ..Options::default() };
        options.validate()?;
        if matches!(observation, Observation::Image { intrinsics: None, .. }) {
            let expected = "those of the camera, to find contact points in the picture";
            return Err(Error::invalid("intrinsics", expected, "none"));
        }
        let known = &self.config.primitives;
        let output = |(found, _): &(Primitive, Grasp)| {
            let unknown = || Error::UnknownPrimitive { found: *found, known: known.clone() };
            self.config.output_of(*found).ok_or_else(unknown)
        };
        let outputs: Vec<usize> = hands.iter().map(output).collect::<Result<_, Error>>()?;
        let prepare =
            |observation, options| Prepared::new(observation, &self.config, &self.model().name, options);
        let prepared = prepare(observation, &options)?;
        let mut scores = vec![None; hands.len()];
        let seen: Vec<Option<Asked>> = hands
            .par_iter()
            .map(|(primitive, grasp)| seen(observation, &prepared, *primitive, grasp))
            .collect();
        let (slots, asked): (Vec<_>, Vec<Asked>) =
            scores.iter_mut().zip(outputs).zip(seen).filter_map(|(slot, asked)| Some((slot, asked?))).unzip();
        if asked.is_empty() {
            return Ok(scores);
        }
        let logits = |prepared: &Prepared<'_>, asked: &[Asked]| {
            self.scoring.logits(&self.backbone, &self.config, prepared, asked)
        };
        let mirror = mirrored(observation);
        let up = up.map(|up| mirrored_point(&up.into()).coords);
        let in_mirror_up = Options { up, ..options.clone() };
        let in_mirror: Vec<Asked> = asked.iter().map(|asked| asked.mirrored(observation)).collect();
        let (one, other) =
            (logits(&prepared, &asked)?, logits(&prepare(&mirror, &in_mirror_up)?, &in_mirror)?);
        let rows = one.chunks_exact(known.len()).zip(other.chunks_exact(known.len()));
        for ((slot, output), (one, other)) in slots.into_iter().zip(rows) {
            *slot = one.get(output).zip(other.get(output)).map(|(a, b)| sigmoid(0.5 * (a + b)));
        }
        Ok(scores)
    }
}

/// The hand, if it touches what is seen.
fn seen(
    observation: &Observation,
    prepared: &Prepared<'_>,
    primitive: Primitive,
    grasp: &Grasp,
) -> Option<Asked> {
    let Grasp { point, rotation } = *grasp;
    let m = rotation.matrix();
    let turns = (m.transpose() * m - Matrix3::identity()).iter().all(|x| x.abs() < NO_ROTATION);
    if !(turns && m.determinant() > 0.0 && point.iter().all(|x| x.is_finite())) {
        return None;
    }
    let pixel = match observation {
        Observation::Image { size, intrinsics, .. } => {
            pixel_of(&point, intrinsics.as_ref()?, *size).filter(|pixel| on_object(observation, *pixel))?
        }
        Observation::Cloud { .. } => Pixel { u: 0, v: 0 },
    };
    if !prepared.shows(&point, pixel, FROM_SURFACE) {
        return None;
    }
    let gaze_from_camera = prepared.camera_from_gaze.inverse();
    let orientation = Orientation6::from_rotation(&(gaze_from_camera * rotation));
    Some(Asked { primitive, point: gaze_from_camera * point, orientation, pixel })
}

impl Asked {
    /// As the mirror shows it.
    fn mirrored(&self, observation: &Observation) -> Self {
        let Pixel { u, v } = self.pixel;
        let pixel = match observation {
            Observation::Image { size, .. } => Pixel { u: (size.width as u32).saturating_sub(u + 1), v },
            Observation::Cloud { .. } => self.pixel,
        };
        let point = mirrored_point(&self.point);
        Self { point, orientation: self.orientation.mirrored(self.primitive), pixel, ..*self }
    }
}

impl ScoringHeads {
    pub(crate) fn new(heads: Heads, last: Option<LinearLayer>, device: Device) -> Self {
        Self { heads, last, device }
    }

    /// `[hands, primitives]`, row by row.
    fn logits(
        &self,
        backbone: &Backbone,
        config: &ModelConfig,
        prepared: &Prepared<'_>,
        asked: &[Asked],
    ) -> Result<Vec<f32>, Error> {
        let (rows, cloud) = match &prepared.input {
            NetworkInput::Picture { side, .. } => {
                let all = backbone.features(&prepared.input, config)?;
                let width = all.len() / (side * side);
                let row = |asked: &Asked| {
                    let row = prepared.row_of(asked.pixel)?;
                    all.get(row * width..(row + 1) * width)
                };
                (asked.iter().filter_map(row).flatten().copied().collect(), None)
            }
            NetworkInput::Cloud(cloud) => {
                let point = |asked: &Asked| <[f32; 3]>::from(cloud.network_from_metres(&asked.point));
                let targets = [asked.iter().flat_map(point).collect::<Vec<f32>>()];
                let hierarchy = CloudInput::hierarchy(std::slice::from_ref(cloud), &targets, config);
                (backbone.features_of(&hierarchy)?.to_vec(), config.second_look.then_some(cloud))
            }
        };
        let width = rows.len() / asked.len().max(1);
        let blocks = asked.chunks(BLOCK).zip(rows.chunks(BLOCK * width.max(1)));
        let logits: Vec<Vec<f32>> =
            blocks.map(|(asked, rows)| self.of_block(asked, rows, cloud)).collect::<Result<_, Error>>()?;
        Ok(logits.concat())
    }

    /// [`Self::logits`] of some hands, of what the backbone gives at their points and, if there is a second look, of the scan.
    fn of_block(&self, asked: &[Asked], rows: &[f32], cloud: Option<&CloudInput>) -> Result<Vec<f32>, Error> {
        let axes: Vec<f32> = asked.iter().flat_map(|asked| asked.orientation.0).collect();
        let axes = Tensor::<2>::from_data(TensorData::new(axes, [asked.len(), 6]), &self.device);
        let hand_views = cloud.map_or_else(Vec::new, |cloud| {
            let point = |asked: &Asked| cloud.network_from_metres(&asked.point).into();
            let frame = |asked: &Asked| hand_frame(point(asked), &asked.orientation);
            cloud.hand_views(&asked.iter().map(frame).collect::<Vec<_>>())
        });
        let logits = self.heads.logits(self.features(rows, asked.len()), axes, &hand_views).into_data();
        logits.try_into_vec().map_err(|e| Error::Network(format!("{e:?}")))
    }

    /// What the backbone gives at `n` places as features, `[n, features]`.
    fn features(&self, rows: &[f32], n: usize) -> Tensor<2> {
        let tensor = |values: &[f32], rows: usize| {
            let columns = values.len() / rows.max(1);
            Tensor::<2>::from_data(TensorData::new(values.to_vec(), [rows, columns]), &self.device)
        };
        let rows = tensor(rows, n);
        match &self.last {
            Some(last) => rows.matmul(tensor(&last.weights, last.inputs())) + tensor(&last.bias, 1),
            None => rows,
        }
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
            Observation::Cloud { points: points.iter().map(mirrored_point).collect() }
        }
    }
}

/// A picture with every row from right to left.
fn reversed<T: Copy>(pixels: &[T], size: ImageSize) -> Vec<T> {
    pixels.chunks(size.width.max(1)).flat_map(|row| row.iter().rev()).copied().collect()
}

fn mirrored_point(point: &Point3<f32>) -> Point3<f32> {
    Point3::new(-point.x, point.y, point.z)
}

#[cfg(test)]
mod tests {
    use burn::tensor::Device;
    use nalgebra::{Rotation3, Vector3};
    use where2act_core::Seed;
    use where2act_model::preprocess::Roll;
    use where2act_model::{Modality, Network, Weights};

    use super::*;
    use crate::Backend;
    use crate::gaze::{gaze, gaze_at};

    fn predictor_with(
        change: impl FnOnce(&mut ModelConfig),
        modality: Modality,
        backend: Backend,
    ) -> Predictor {
        let mut config = ModelConfig::new(modality, &Primitive::ALL).with_width(0.125).with_points(512);
        (config.alignments, config.ways) = (3, Some(2.0));
        change(&mut config);
        let network = Network::new(&config, Seed(7), &Device::flex());
        Predictor::from_weights(Weights { network, sha256: "0".repeat(64) }, backend).unwrap()
    }

    fn predictor(modality: Modality, second_look: bool, backend: Backend) -> Predictor {
        predictor_with(|config| config.second_look = second_look, modality, backend)
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

    /// The same beside the middle of a larger picture, of which this is a part: 29 degrees off the axis.
    fn step_beside() -> Observation {
        let mut step = step();
        if let Observation::Image { intrinsics: Some(Intrinsics { cx, .. }), .. } = &mut step {
            *cx += 150.0;
        }
        step
    }

    fn scan_of(step: &Observation) -> Observation {
        Observation::Cloud { points: step.foreground_points().into_iter().map(|(_, point)| point).collect() }
    }

    fn scan() -> Observation {
        scan_of(&step())
    }

    fn cases() -> Vec<(Predictor, Observation)> {
        let pictures = [Backend::Fast, Backend::Flex].map(|b| (predictor(Modality::Rgb, false, b), step()));
        let scans = [Backend::Fast, Backend::Flex].map(|b| (predictor(Modality::Cloud, true, b), scan()));
        let once = (predictor(Modality::Cloud, false, Backend::Fast), step());
        let beside = [
            (predictor(Modality::Rgb, false, Backend::Fast), step_beside()),
            (predictor(Modality::Cloud, true, Backend::Fast), scan_of(&step_beside())),
        ];
        pictures.into_iter().chain(scans).chain([once]).chain(beside).collect()
    }

    fn scaled(network_from_metres: f32) -> Options {
        Options { network_from_metres: Some(network_from_metres), ..Options::default() }
    }

    /// The hands that a prediction proposes, all that there are, and their scores.
    fn proposed(
        predictor: &Predictor,
        seen: &Observation,
        options: &Options,
    ) -> Vec<((Primitive, Grasp), f32)> {
        let prediction = predictor.predict(seen, &Options { clearance: false, ..options.clone() }).unwrap();
        let of = prediction.primitives.iter();
        of.flat_map(|of| of.proposals.iter().map(|p| ((of.primitive, p.grasp().unwrap()), p.score))).collect()
    }

    #[test]
    fn a_proposal_s_hand_is_scored_as_the_proposal_was_and_as_its_mirror_image() {
        for (i, (predictor, view)) in cases().into_iter().enumerate() {
            let up = (i % 3 == 1).then(|| Vector3::new(0.9, 0.0, -0.3));
            let options = Options { up, ..scaled(if i % 2 == 0 { 1.0 } else { 0.7 }) };
            let (hands, expected): (Vec<_>, Vec<f32>) =
                proposed(&predictor, &view, &options).into_iter().unzip();
            assert!(hands.len() > 50, "{i}: {}", hands.len());
            // What the network says of one view.
            let logits = |view: &Observation, mirror: bool| -> Vec<f32> {
                let mut options = options.clone();
                if let (Some(up), true) = (&mut options.up, mirror) {
                    up.x = -up.x;
                }
                let prepared = Prepared::new(view, &predictor.config, "", &options).unwrap();
                let asked = |(primitive, grasp): &(Primitive, Grasp)| {
                    let Grasp { point, rotation } = grasp;
                    let orientation = Orientation6::from_rotation(rotation).mirrored(*primitive);
                    let reflected =
                        Grasp { point: mirrored_point(point), rotation: orientation.to_rotation() };
                    seen(view, &prepared, *primitive, if mirror { &reflected } else { grasp }).unwrap()
                };
                let asked: Vec<Asked> = hands.iter().map(asked).collect();
                let all = predictor.scoring.logits(&predictor.backbone, &predictor.config, &prepared, &asked);
                let row = |(row, (primitive, _)): (&[f32], &(Primitive, Grasp))| row[*primitive as usize];
                all.unwrap().chunks(6).zip(&hands).map(row).collect()
            };
            let (one, other) = (logits(&view, false), logits(&mirrored(&view), true));
            for (logit, expected) in one.iter().zip(&expected) {
                assert!((sigmoid(*logit) - expected).abs() < 2e-3, "{i}: {logit} {expected}");
            }
            assert!(one.iter().zip(&other).any(|(a, b)| (a - b).abs() > 1e-3), "{i}: mirrors differ");
            let found = predictor.score(&view, &hands, &options).unwrap();
            assert_eq!(found.len(), hands.len());
            for ((found, a), b) in found.iter().zip(one).zip(other) {
                let mean = sigmoid(0.5 * (a + b));
                assert!((found.unwrap() - mean).abs() < 1e-4, "{i}: {found:?} {mean}");
            }
            for threads in [1, 3] {
                let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
                assert_eq!(pool.install(|| predictor.score(&view, &hands, &options)).unwrap(), found, "{i}");
            }
        }
    }

    #[test]
    fn a_picture_beside_the_middle_is_proposed_for_as_by_a_camera_that_looks_there() {
        let (turn, _) = gaze(&Point3::new((112.0 - 271.0) / 280.0, 0.0, 1.0), None);
        assert!((turn.angle().to_degrees() - 29.6).abs() < 0.1);
        let Observation::Image { size, rgb, intrinsics, mask, .. } = step_beside() else { unreachable!() };
        let predictor = predictor(Modality::Rgb, false, Backend::Fast);
        let [beside, looked_at] = [intrinsics, None].map(|intrinsics| {
            let picture =
                Observation::Image { size, rgb: rgb.clone(), depth: None, intrinsics, mask: mask.clone() };
            predictor.predict(&picture, &Options::default()).unwrap().primitives
        });
        for (found, expected) in beside.iter().zip(&looked_at) {
            assert_eq!(found.proposals.len(), expected.proposals.len());
            for (found, expected) in found.proposals.iter().zip(&expected.proposals) {
                assert_eq!((found.pixel, found.score), (expected.pixel, expected.score));
                for (found, expected) in
                    [(found.approach, expected.approach), (found.forward, expected.forward)]
                {
                    let off = turn * Vector3::from(expected) - Vector3::from(found);
                    assert!(off.norm() < 1e-5, "{off}");
                }
            }
        }
    }

    #[test]
    fn a_scan_beside_the_middle_by_a_rolled_camera_is_seen_as_by_one_that_looks_there_upright() {
        let Observation::Cloud { points } = scan_of(&step_beside()) else { unreachable!() };
        let up = Vector3::new(0.5, -0.4, -0.2);
        let (turn, looked_at) = gaze_at(&points, Some(up));
        let looked_at = looked_at.into_owned();
        assert!(turn.angle() > 0.8 && gaze_at(&looked_at, None).0 == Rotation3::identity());
        let predictor = predictor(Modality::Cloud, true, Backend::Fast);
        let [beside, looked_at] = [(points, Some(up)), (looked_at, None)].map(|(points, up)| {
            let options = Options { up, clearance: false, ..scaled(1.0) };
            predictor.predict(&Observation::Cloud { points }, &options).unwrap().primitives
        });
        for (found, expected) in beside.iter().zip(&looked_at) {
            assert_eq!(found.proposals.len(), expected.proposals.len());
            for (found, expected) in found.proposals.iter().zip(&expected.proposals) {
                assert_eq!((found.pixel, found.score), (expected.pixel, expected.score));
                let (found, expected) = (found.grasp().unwrap(), expected.grasp().unwrap());
                assert!((turn * expected.point - found.point).norm() < 1e-5);
                let off = (turn * expected.rotation).matrix() - found.rotation.matrix();
                assert!(off.amax() < 1e-5, "{off}");
            }
        }
    }

    #[test]
    fn a_picture_by_a_camera_on_its_side_is_proposed_for_as_the_upright_one() {
        let predictor = predictor(Modality::Rgb, false, Backend::Fast);
        let upright = step_beside();
        let Observation::Image { size, rgb, depth, intrinsics, mask } = &upright else { unreachable!() };
        for quarters in 1..4 {
            let angle = quarters as f32 * std::f32::consts::FRAC_PI_2;
            let roll = Roll::new(-angle);
            let turned = roll.size(*size);
            let place = |[x, y]: [f64; 2]| roll.turn_back([x, y], *size);
            let before = |i: usize| {
                let at = [(i % turned.width) as f64 + 0.5, (i / turned.width) as f64 + 0.5];
                let [x, y] = roll.turn(at, *size);
                size.index(Pixel { u: x as u32, v: y as u32 })
            };
            let order: Vec<usize> = (0..turned.pixels()).map(before).collect();
            let camera = intrinsics.unwrap();
            let [cx, cy] = place([camera.cx.into(), camera.cy.into()]).map(|c| c as f32);
            let (fx, fy) = if quarters == 2 { (camera.fx, camera.fy) } else { (camera.fy, camera.fx) };
            let on_its_side = Observation::Image {
                size: turned,
                rgb: rgb.as_ref().map(|rgb| order.iter().map(|&i| rgb[i]).collect()),
                depth: depth.as_ref().map(|depth| order.iter().map(|&i| depth[i]).collect()),
                intrinsics: Some(Intrinsics { fx, fy, cx, cy }),
                mask: mask.as_ref().map(|mask| order.iter().map(|&i| mask[i]).collect()),
            };
            let side_from_upright = Rotation3::from_axis_angle(&Vector3::z_axis(), angle);
            // Level with the camera, which turning to the object then leaves at the top.
            let up = Some(side_from_upright * Vector3::new(0.0, -0.8, 0.0));
            let predict = |view: &Observation, up| {
                let options = Options { up, clearance: false, ..scaled(1.0) };
                predictor.predict(view, &options).unwrap().primitives
            };
            for (found, expected) in predict(&on_its_side, up).iter().zip(predict(&upright, None)) {
                let (found, expected) = (&found.proposals, &expected.proposals);
                assert!(found.len() == expected.len() && !found.is_empty());
                for (found, expected) in found.iter().zip(expected) {
                    let Pixel { u, v } = expected.pixel;
                    let [x, y] = place([f64::from(u) + 0.5, f64::from(v) + 0.5]);
                    assert_eq!(found.pixel, Pixel { u: x as u32, v: y as u32 });
                    // Sines and cosines of quarter turns are not quite 0 and 1.
                    assert!((found.score - expected.score).abs() < 1e-3);
                    let (found, expected) = (found.grasp().unwrap(), expected.grasp().unwrap());
                    assert!((side_from_upright * expected.point - found.point).norm() < 1e-4);
                    let off = (side_from_upright * expected.rotation).matrix() - found.rotation.matrix();
                    assert!(off.amax() < 1e-3, "{off}");
                }
            }
        }
    }

    #[test]
    fn hands_beside_the_middle_have_room_and_come_from_outside_as_the_camera_sees_it() {
        let (view, predictor) = (step_beside(), predictor(Modality::Rgb, false, Backend::Fast));
        let options = Options { top_k: 3000, per_pixel: Some(100), ..scaled(1.0) };
        let prepared = Prepared::new(&view, &predictor.config, "", &options).unwrap();
        let gaze_from_camera = prepared.camera_from_gaze.inverse();
        let (mut hands, mut crowded, mut from_inside) = (0, 0, 0);
        for of in predictor.predict(&view, &options).unwrap().primitives {
            for proposal in of.proposals {
                let Grasp { rotation, .. } = proposal.grasp().unwrap();
                let place = prepared.place(prepared.row_of(proposal.pixel).unwrap() as u32);
                let room = prepared.room(&place, of.primitive).unwrap();
                let fits = |rotation: &Rotation3<f32>| room.fits(of.primitive, rotation);
                let outwards = |rotation: &Rotation3<f32>| {
                    place.normal.is_some_and(|normal| normal.dot(&(rotation * Vector3::z())) > 1e-4)
                };
                assert!(fits(&rotation) && !outwards(&rotation));
                // What a network says is in another frame.
                let said = gaze_from_camera * rotation;
                (hands, crowded) = (hands + 1, crowded + usize::from(!fits(&said)));
                from_inside += usize::from(outwards(&said));
            }
        }
        assert!(hands > 200 && crowded > 10 && from_inside > 10, "{hands} {crowded} {from_inside}");
    }

    #[test]
    fn a_mirror_image_is_scored_as_what_it_shows() {
        // Points of a scan are drawn by their order, which a mirror leaves as it is.
        let of_pictures =
            [step(), step_beside()].map(|view| (predictor(Modality::Rgb, false, Backend::Fast), view));
        let of_scans = [step(), step_beside()]
            .map(|view| (predictor(Modality::Cloud, true, Backend::Fast), scan_of(&view)));
        for (predictor, view) in of_pictures.into_iter().chain(of_scans) {
            assert_eq!(mirrored(&mirrored(&view)), view);
            let hands: Vec<_> =
                proposed(&predictor, &view, &scaled(1.0)).into_iter().map(|(hand, _)| hand).collect();
            let reflected = |(primitive, grasp): &(Primitive, Grasp)| {
                let orientation = Orientation6::from_rotation(&grasp.rotation).mirrored(*primitive);
                (
                    *primitive,
                    Grasp { point: mirrored_point(&grasp.point), rotation: orientation.to_rotation() },
                )
            };
            let reflected: Vec<_> = hands.iter().map(reflected).collect();
            let one = predictor.score(&view, &hands, &scaled(1.0)).unwrap();
            let other = predictor.score(&mirrored(&view), &reflected, &scaled(1.0)).unwrap();
            for ((one, other), (primitive, _)) in one.iter().zip(&other).zip(&hands) {
                assert!((one.unwrap() - other.unwrap()).abs() < 1e-3, "{primitive}: {one:?} {other:?}");
            }
        }
    }

    #[test]
    fn hands_in_the_air_and_what_is_no_hand_have_no_score() {
        let of_pictures = predictor(Modality::Rgb, false, Backend::Fast);
        let of_scans = predictor(Modality::Cloud, true, Backend::Fast);
        for (predictor, view) in [(&of_pictures, step()), (&of_scans, scan()), (&of_scans, step())] {
            let ((primitive, good), _) = proposed(predictor, &view, &scaled(1.0))[0];
            let at = |point: Point3<f32>| (primitive, Grasp { point, ..good });
            let turned = |matrix: Matrix3<f32>| {
                (primitive, Grasp { rotation: Rotation3::from_matrix_unchecked(matrix), ..good })
            };
            let (away, behind) = (at(good.point - Vector3::z() * 0.05), at(Point3::new(0.0, 0.0, -1.0)));
            let beside = at(Point3::new(5.0, 0.0, 1.0));
            let nowhere = [f32::NAN, f32::INFINITY, f32::MAX].map(|z| at(Point3::new(0.0, 0.0, z)));
            let wrong = [0.0, f32::NAN, 1e20].map(|x| turned(Matrix3::repeat(x)));
            let hands = [&[(primitive, good), away, behind, beside][..], &nowhere, &wrong].concat();
            let scores = predictor.score(&view, &hands, &scaled(1.0)).unwrap();
            assert!(scores[0].is_some_and(|score| score > 0.0 && score < 1.0), "{scores:?}");
            assert_eq!(scores.iter().flatten().count(), 1, "{scores:?}");
            assert_eq!(predictor.score(&view, &[], &scaled(1.0)).unwrap(), []);
            assert_eq!(predictor.score(&view, &[away], &scaled(1.0)).unwrap(), [None]);
        }
    }

    #[test]
    fn every_point_of_a_scan_is_seen_and_what_a_mask_hides_is_not() {
        let sparse = predictor_with(|c| c.preprocessing.scan_candidates = 64, Modality::Cloud, Backend::Fast);
        let Observation::Cloud { points } = scan() else { unreachable!() };
        let hand = |point: &Point3<f32>| (Primitive::Pushing, Grasp::new(*point, Vector3::z(), Vector3::x()));
        let hands: Vec<_> = points.iter().step_by(9).map(hand).collect();
        assert!(hands.len() > 2 * BLOCK);
        for view in [scan(), step()] {
            assert!(sparse.score(&view, &hands, &scaled(1.0)).unwrap().iter().all(Option::is_some));
        }
        // The left half alone is the object; with and without depth, in a picture that the network sees smaller, with bars.
        let Observation::Image { size, rgb, depth, intrinsics, .. } = step() else { unreachable!() };
        let (wide, middle) = (ImageSize { width: 448, height: 128 }, intrinsics.unwrap().cx);
        let twice = |values: Vec<f32>| -> Vec<f32> { values.into_iter().flat_map(|x| [x, x]).collect() };
        let intrinsics = intrinsics.map(|i| Intrinsics { fx: 2.0 * i.fx, cx: 2.0 * i.cx, ..i });
        let of_pictures = predictor(Modality::Rgb, false, Backend::Fast);
        for depth in [depth.map(twice), None] {
            let view = Observation::Image {
                size: wide,
                rgb: rgb.as_ref().map(|rgb| rgb.iter().flat_map(|c| [*c, *c]).collect()),
                depth,
                intrinsics,
                mask: Some((0..wide.pixels()).map(|i| ((i % wide.width) as f32) < middle).collect()),
            };
            let scores = of_pictures.score(&view, &hands, &scaled(1.0)).unwrap();
            for (score, (_, grasp)) in scores.iter().zip(&hands) {
                let (u, _) = intrinsics.unwrap().project(&grasp.point).unwrap();
                assert_eq!(score.is_some(), u.floor() < middle, "{u} of {}", size.width);
            }
        }
    }

    #[test]
    fn what_cannot_be_asked_is_refused() {
        let Observation::Image { size, rgb, depth, mask, .. } = step() else { unreachable!() };
        let blind = Observation::Image { size, rgb, depth, mask, intrinsics: None };
        let of_pictures = predictor(Modality::Rgb, false, Backend::Fast);
        let error = of_pictures.score(&blind, &[], &Options::default()).unwrap_err().to_string();
        let expected =
            "intrinsics: expected those of the camera, to find contact points in the picture, found none";
        assert_eq!(error, expected);
        let pushes =
            predictor_with(|c| c.primitives = vec![Primitive::Pushing], Modality::Rgb, Backend::Fast);
        let hand = Grasp::new(Point3::new(0.0, 0.0, 1.0), Vector3::z(), Vector3::x());
        let error = pushes.score(&step(), &[(Primitive::Pulling, hand)], &Options::default()).unwrap_err();
        assert!(matches!(error, Error::UnknownPrimitive { found: Primitive::Pulling, .. }), "{error}");
    }
}
