//! From an observation to what the network sees, and the way back.

use std::collections::BTreeMap;
use std::ops::Range;
use std::sync::OnceLock;

use nalgebra::{Point3, Rotation3, Vector3};
use where2act_core::{ImageSize, Observation, Pixel, Primitive, is_measured};
use where2act_model::preprocess::{
    CloudInput, CloudScale, ImageInput, Letterbox, PreprocessError, Roll, Window,
};
use where2act_model::{Modality, ModelConfig};

use crate::backbone::NetworkInput;
use crate::clearance::{GRIP_REACH, REACH, Room};
use crate::decode::Places;
use crate::dense::{Geometry, on_object, seen_point};
use crate::gaze::{gaze, gaze_at};
use crate::hidden::Directions;
use crate::nearest::NearestIndex;
use crate::predictor::{Place, reads};
use crate::surface::{DepthView, normal};
use crate::{Error, Options};

/// Least distance between candidates, as a share of the network picture's side: 8 of 224 pixels.
const PIXEL_DISTANCE: f32 = 1.0 / 28.0;
/// Least distance between candidates on a scan, network units; objects have a radius of about one.
const POINT_DISTANCE: f32 = 0.06;
/// Points whose plane gives a scan's normal, and how far, network units, they may be.
const NORMAL_POINTS: usize = 16;
const NORMAL_RADIUS: f32 = 0.15;

/// So many of a scan's points in a region stand for it where the network sees none of them.
const REGION_POINTS: usize = 16;

/// Points of a scan around a contact point that are looked at for what is in a hand's way, at most: as many as cells of the index
/// hold that a hand reaches into, of which it reaches half or less.
const OBSTACLES: usize = 8192;

/// An observation, ready for the network.
pub(crate) struct Prepared<'a> {
    pub(crate) input: NetworkInput,
    /// Rows of the network's output that lie on the object.
    pub(crate) places: Places,
    /// The row of the pixel that was asked for.
    pub(crate) asked_row: Option<u32>,
    asked: Option<Pixel>,
    pub(crate) geometry: Geometry,
    /// Pixel of the input for each row of a network for scans.
    pixels: Vec<Pixel>,
    /// Pixel of the input for rows of a network for pictures that show something smaller than they are.
    details: BTreeMap<u32, Pixel>,
    /// Depth map of the input.
    depth: Option<DepthView<'a>>,
    /// Some of a scan's points, evenly, in metres: what surfaces are made of.
    surface: Option<NearestIndex>,
    /// A scan that is no depth map, ...
    scan: Option<&'a [Point3<f32>]>,
    /// ... all its points, once they are asked for, ...
    scan_index: OnceLock<NearestIndex>,
    /// ... and how far away they are in each direction.
    scan_directions: OnceLock<Directions>,
    pub(crate) network_from_metres: f32,
    /// The camera's frame from that in which the network knows directions and points.
    pub(crate) camera_from_gaze: Rotation3<f32>,
}

impl<'a> Prepared<'a> {
    pub(crate) fn new(
        observation: &'a Observation,
        config: &ModelConfig,
        model: &str,
        options: &Options,
    ) -> Result<Self, Error> {
        check(observation)?;
        check_pixel(observation, options.pixel)?;
        check_region(observation, options.region.as_deref())?;
        let needed = match observation {
            Observation::Image { rgb: Some(_), .. } => Modality::Rgb,
            _ => Modality::Cloud,
        };
        // A picture with depth and a camera is both.
        let both = matches!(observation, Observation::Image { depth: Some(_), intrinsics: Some(_), .. });
        match config.modality {
            Modality::Rgb if needed == Modality::Rgb => Self::picture(observation, config, options),
            Modality::Cloud if needed == Modality::Cloud || both => Self::scan(observation, config, options),
            Modality::Cloud if matches!(observation, Observation::Image { depth: Some(_), .. }) => {
                Err(no_intrinsics())
            }
            found => {
                let (needed, found) = (reads(needed), reads(found));
                Err(Error::Modality { model: model.to_owned(), needed, found })
            }
        }
    }

    fn picture(observation: &'a Observation, config: &ModelConfig, options: &Options) -> Result<Self, Error> {
        let Observation::Image { size, rgb: Some(rgb), mask, intrinsics, .. } = observation else {
            return Err(Error::invalid("observation", "a picture", "none"));
        };
        // Without a camera nobody knows how far beside its axis the object is.
        let middle = intrinsics.map_or_else(
            || Point3::new(0.0, 0.0, 1.0),
            |camera| Window::shown(*size, mask.as_deref(), &config.preprocessing).middle(&camera),
        );
        let (camera_from_gaze, roll) = gaze(&middle, options.up);
        let ImageInput { values, letterbox } =
            ImageInput::rolled(*size, rgb, mask.as_deref(), Roll::new(roll), &config.preprocessing)
                .map_err(unusable)?;
        if let Some(pixel) = options.pixel.filter(|pixel| !on_object(observation, *pixel)) {
            return Err(Error::invalid("pixel", "one of the object", format!("{},{}", pixel.u, pixel.v)));
        }
        let side = letterbox.side;
        let network = ImageSize::square(side);
        let wanted =
            |source: &Pixel| in_region(options, size.index(*source)) && on_object(observation, *source);
        let at = |p: Pixel| (network.index(p) as u32, [p.u as f32, p.v as f32, 0.0]);
        let distance = PIXEL_DISTANCE * side as f32;
        let source = |p: Pixel| letterbox.to_source(p).filter(wanted).map(|source| (p, source));
        let on: Vec<(Pixel, Pixel)> = pixels(network).filter_map(source).collect();
        // Where a depth map has a hole, nobody knows how far to go and whether the hand has room.
        let depth = DepthView::of(observation);
        let measured = |at: &(Pixel, Pixel)| depth.is_none_or(|depth| depth.has_contact(at.1));
        let reachable: Vec<(Pixel, Pixel)> = on.iter().copied().filter(measured).collect();
        let on = if reachable.is_empty() { on } else { reachable };
        let mut places = Places::new(on.into_iter().map(|(p, _)| at(p)), distance);
        let mut details = BTreeMap::new();
        if places.rows().is_empty() {
            // No pixel of the network has in its middle what is wanted: those around it stand for it.
            for pixel in pixels(*size).filter(wanted) {
                details.entry(letterbox.network_index(pixel) as u32).or_insert(pixel);
            }
            places = Places::new(details.values().map(|pixel| at(letterbox.to_network(*pixel))), distance);
        }
        if places.rows().is_empty() && options.pixel.is_none() {
            let masked = mask.as_ref().is_some_and(|mask| !mask.contains(&true));
            let what = if masked { "mask" } else { "region" };
            return Err(Error::NothingThere { what });
        }
        Ok(Self {
            input: NetworkInput::Picture { values, side },
            places,
            asked_row: options.pixel.map(|pixel| letterbox.network_index(pixel) as u32),
            asked: options.pixel,
            geometry: Geometry::Grid(letterbox),
            pixels: Vec::new(),
            details,
            depth,
            surface: None,
            scan: None,
            scan_index: OnceLock::new(),
            scan_directions: OnceLock::new(),
            network_from_metres: 1.0,
            camera_from_gaze,
        })
    }

    fn scan(observation: &'a Observation, config: &ModelConfig, options: &Options) -> Result<Self, Error> {
        let scale = options.network_from_metres.map_or(CloudScale::Trained, CloudScale::PerMetre);
        let mut rng = options.seed.child("scan points", 0).rng();
        let (seen, points): (Vec<Pixel>, Vec<_>) = observation.foreground_points().into_iter().unzip();
        let scan = match observation {
            Observation::Cloud { points } => Some(points.as_slice()),
            Observation::Image { .. } => None,
        };
        let (camera_from_gaze, points) = gaze_at(scan.unwrap_or(&points), options.up);
        let gaze_from_camera = camera_from_gaze.inverse();
        let mut input = CloudInput::new(&points, scale, config, &mut rng).map_err(unusable)?;
        let none =
            |p: Pixel| Error::invalid("pixel", "one of the object, with depth", format!("{},{}", p.u, p.v));
        let asked = options.pixel.map(|p| point_at(observation, p).ok_or_else(|| none(p))).transpose()?;
        // The network sees some thousand points: the one that was asked for takes the nearest one's place among them.
        let asked_row = asked.and_then(|p| {
            input.move_nearest_to(&[gaze_from_camera * p]).keys().next().map(|row| *row as u32)
        });
        let pixel = |source: &usize| match seen.get(*source) {
            Some(pixel) => *pixel,
            None => Pixel { u: *source as u32, v: 0 },
        };
        let mut pixels: Vec<Pixel> = input.source.iter().map(pixel).collect();
        // The position in the input's own buffers: of the pixel, or of the scan's point.
        let position = |pixel: &Pixel| match observation {
            Observation::Image { size, .. } => size.index(*pixel),
            Observation::Cloud { .. } => pixel.u as usize,
        };
        let wanted = |pixel: &Pixel| in_region(options, position(pixel));
        if options.pixel.is_none() && !pixels.iter().any(wanted) {
            let (inside, points) = some_of(measured(observation, wanted));
            let points: Vec<_> = points.iter().map(|point| gaze_from_camera * point).collect();
            for (row, i) in input.move_nearest_to(&points) {
                if let Some((of_row, pixel)) = pixels.get_mut(row).zip(inside.get(i)) {
                    *of_row = *pixel;
                }
            }
        }
        let in_metres = |xyz: &[f32; 3]| camera_from_gaze * input.metres_from_network(&Point3::from(*xyz));
        let xyz = input.xyz.as_chunks().0;
        let index = NearestIndex::new(xyz.iter().map(in_metres).collect());
        let surface = NearestIndex::new(input.dense.as_chunks().0.iter().map(in_metres).collect());
        let rows = (0..).zip(xyz).zip(&pixels).filter(|(_, pixel)| wanted(pixel));
        let places = Places::new(rows.map(|((row, xyz), _)| (row, *xyz)), POINT_DISTANCE);
        if places.rows().is_empty() && options.pixel.is_none() {
            return Err(Error::NothingThere { what: "region" });
        }
        Ok(Self {
            network_from_metres: input.scale,
            input: NetworkInput::Cloud(input),
            places,
            asked_row,
            asked: options.pixel,
            geometry: Geometry::Points { index, asked },
            pixels,
            details: BTreeMap::new(),
            depth: DepthView::of(observation),
            surface: Some(surface),
            scan,
            scan_index: OnceLock::new(),
            scan_directions: OnceLock::new(),
            camera_from_gaze,
        })
    }

    /// Rows of the network's output that show the input: all but the letterbox's bars.
    pub(crate) fn shown(&self) -> Vec<Range<usize>> {
        match &self.geometry {
            Geometry::Grid(Letterbox { side, inner, offset: (left, top), .. }) => {
                let start = |row: usize| (top + row) * side + left;
                (0..inner.height).map(|row| start(row)..start(row) + inner.width).collect()
            }
            Geometry::Points { index, .. } => std::iter::once(0..index.points().len()).collect(),
        }
    }

    /// Room for hands at a place, if there is depth: a mask hides nothing that may be in their way.
    pub(crate) fn room(&self, place: &Place, primitive: Primitive) -> Option<Room> {
        let contact = place.point?;
        let grips = primitive == Primitive::Pulling;
        let around = |reach: f32| match (self.depth, self.all_points()) {
            (Some(depth), _) => Some(depth.around_point(&contact, reach)),
            (None, Some(scan)) => Some(scan.within(&contact, reach, OBSTACLES)),
            (None, None) => None,
        };
        let close = if grips { around(GRIP_REACH) } else { None };
        Some(Room::new(around(REACH)?, close.unwrap_or_default(), &contact))
    }

    /// Whether something is seen before a point in the camera's frame. A picture alone hides nothing.
    pub(crate) fn hides(&self, point: &Point3<f32>) -> bool {
        match (self.depth, self.all_points()) {
            (Some(depth), _) => depth.hides(point),
            (None, Some(scan)) => {
                self.scan_directions.get_or_init(|| Directions::new(scan.points())).hides(point)
            }
            (None, None) => false,
        }
    }

    /// All points of a scan that is no depth map.
    fn all_points(&self) -> Option<&NearestIndex> {
        let index =
            |points: &[Point3<f32>]| NearestIndex::new(points.iter().copied().filter(is_measured).collect());
        self.scan.map(|points| self.scan_index.get_or_init(|| index(points)))
    }

    /// Where a row of the network's output is on the input.
    pub(crate) fn place(&self, row: u32) -> Place {
        match &self.geometry {
            Geometry::Grid(letterbox) => {
                let side = letterbox.side as u32;
                let here = Pixel { u: row % side, v: row / side };
                let detail = self.details.get(&row).copied();
                let source = self.asked.or(detail).or_else(|| letterbox.to_source(here));
                let pixel = source.unwrap_or(Pixel { u: 0, v: 0 });
                let point = self.depth.and_then(|d| d.contact(pixel));
                let normal = self.depth.zip(point).and_then(|(d, p)| d.normal(pixel, &p));
                Place { pixel, point, normal }
            }
            Geometry::Points { index, asked } => {
                let own = index.points().get(row as usize).copied();
                let pixel = self.pixels.get(row as usize).copied().unwrap_or(Pixel { u: 0, v: 0 });
                let normal = own.zip(self.surface.as_ref()).and_then(|(p, surface)| {
                    let reach = NORMAL_RADIUS / self.network_from_metres;
                    let near =
                        surface.nearest::<NORMAL_POINTS>(&p).into_iter().filter(|n| n.1 < reach * reach);
                    let near = near.filter_map(|n| surface.points().get(n.0 as usize).copied());
                    normal(&near.collect::<Vec<_>>())
                });
                Place { pixel: self.asked.unwrap_or(pixel), point: asked.or(own), normal }
            }
        }
    }

    /// Whether a point is nearer than `off` metres to what the observation shows: at `pixel` of a depth map, anywhere in a scan. A
    /// picture alone does not tell.
    pub(crate) fn shows(&self, point: &Point3<f32>, pixel: Pixel, off: f32) -> bool {
        match (self.depth, self.all_points()) {
            (Some(depth), _) => depth.contact(pixel).is_some_and(|seen| (seen - point).norm() < off),
            (None, Some(scan)) => scan.nearest::<1>(point).iter().any(|(_, squared)| *squared < off * off),
            (None, None) => true,
        }
    }

    /// Row of the output of a network for pictures that shows a pixel.
    pub(crate) fn row_of(&self, pixel: Pixel) -> Option<usize> {
        match &self.geometry {
            Geometry::Grid(letterbox) => Some(letterbox.network_index(pixel)),
            Geometry::Points { .. } => None,
        }
    }
}

/// All pixels of a picture, row by row.
fn pixels(size: ImageSize) -> impl Iterator<Item = Pixel> {
    (0..size.height as u32).flat_map(move |v| (0..size.width as u32).map(move |u| Pixel { u, v }))
}

fn unusable(error: PreprocessError) -> Error {
    match error {
        PreprocessError::OnePlace(n) => {
            Error::invalid("observation", "points that are apart", format!("{n} in one place"))
        }
        PreprocessError::NoPoints => Error::invalid(
            "observation",
            "finite points on the object",
            "none (is the mask or the depth empty?)",
        ),
        other => Error::invalid("observation", "a picture with pixels", other.to_string()),
    }
}

fn no_intrinsics() -> Error {
    Error::invalid("intrinsics", "those of the depth map", "none")
}

fn check(observation: &Observation) -> Result<(), Error> {
    let Observation::Image { size, rgb, depth, intrinsics, mask } = observation else {
        return check_scan(observation);
    };
    let buffers = [
        ("rgb", rgb.as_ref().map(Vec::len)),
        ("depth", depth.as_ref().map(Vec::len)),
        ("mask", mask.as_ref().map(Vec::len)),
    ];
    let pixels = size.width.checked_mul(size.height);
    for (buffer, found) in buffers {
        if let Some(found) = found
            && Some(found) != pixels
        {
            return Err(Error::BufferSize { buffer, size: *size, found });
        }
    }
    if rgb.is_none() && depth.is_none() {
        return Err(Error::invalid("observation", "a picture or a depth map", "neither"));
    }
    match intrinsics {
        None if rgb.is_none() => Err(no_intrinsics()),
        Some(i) if !i.is_sound() => {
            let found = format!("{},{},{},{}", i.fx, i.fy, i.cx, i.cy);
            Err(Error::invalid("intrinsics", "positive focal lengths", found))
        }
        _ => Ok(()),
    }
}

/// A camera sees nothing behind itself: a scan there is in another frame.
fn check_scan(observation: &Observation) -> Result<(), Error> {
    let Observation::Cloud { points } = observation else { return Ok(()) };
    let measured = points.iter().filter(|point| is_measured(point));
    let (seen, behind) =
        measured.fold((0, 0), |(seen, behind), p| (seen + 1, behind + usize::from(p.z <= 0.0)));
    if 2 * behind <= seen {
        return Ok(());
    }
    let expected = "points in a camera's optical frame (x right, y down, z forward)";
    Err(Error::invalid("observation", expected, format!("{behind} of {seen} behind the camera, at z <= 0")))
}

/// Whether proposals may be at this position of the input's buffers.
fn in_region(options: &Options, position: usize) -> bool {
    options.region.as_ref().is_none_or(|region| region.get(position).copied().unwrap_or(false))
}

fn check_region(observation: &Observation, region: Option<&[bool]>) -> Result<(), Error> {
    let expected = match observation {
        Observation::Image { size, .. } => size.pixels(),
        Observation::Cloud { points } => points.len(),
    };
    match region {
        Some(region) if region.len() != expected => {
            Err(Error::invalid("region", format!("{expected} entries"), region.len().to_string()))
        }
        _ => Ok(()),
    }
}

fn check_pixel(observation: &Observation, pixel: Option<Pixel>) -> Result<(), Error> {
    let Some(pixel) = pixel else { return Ok(()) };
    let (width, height) = match observation {
        Observation::Image { size, .. } => (size.width, size.height),
        Observation::Cloud { points } => (points.len(), 1),
    };
    if (pixel.u as usize) < width && (pixel.v as usize) < height {
        return Ok(());
    }
    let expected = format!("u below {width} and v below {height}");
    Err(Error::invalid("pixel", expected, format!("{},{}", pixel.u, pixel.v)))
}

/// The point measured at a pixel of the object.
fn point_at(observation: &Observation, pixel: Pixel) -> Option<Point3<f32>> {
    match observation {
        Observation::Cloud { points } => points.get(pixel.u as usize).copied().filter(is_measured),
        Observation::Image { .. } => seen_point(observation, pixel),
    }
}

/// The points measured on the object at some of its pixels.
fn measured(observation: &Observation, wanted: impl Fn(&Pixel) -> bool) -> Vec<(Pixel, Point3<f32>)> {
    match observation {
        Observation::Cloud { points } => {
            let pixels = (0..).map(|u| Pixel { u, v: 0 });
            let here = |(pixel, point): &(Pixel, Point3<f32>)| wanted(pixel) && is_measured(point);
            pixels.zip(points.iter().copied()).filter(here).collect()
        }
        Observation::Image { .. } => {
            let mut points = observation.foreground_points();
            points.retain(|(pixel, _)| wanted(pixel));
            points
        }
    }
}

/// At most [`REGION_POINTS`] of some points, from the middle outwards.
fn some_of(mut points: Vec<(Pixel, Point3<f32>)>) -> (Vec<Pixel>, Vec<Point3<f32>>) {
    let sum: Vector3<f32> = points.iter().map(|(_, point)| point.coords).sum();
    let middle = Point3::from(sum / points.len().max(1) as f32);
    let from_middle = |(_, point): &(Pixel, Point3<f32>)| (point - middle).norm_squared();
    points.sort_by(|a, b| from_middle(a).total_cmp(&from_middle(b)));
    let step = points.len().div_ceil(REGION_POINTS).max(1);
    points.into_iter().step_by(step).unzip()
}
