//! `trial` of one interaction.

use std::io::Write;
use std::sync::Arc;

use anyhow::{Context, Result, bail};
use nalgebra::{Point3, Vector3};
use serde_json::json;
use where2act_core::{Camera, Grasp, Pixel, Verdict};
use where2act_sim::object::Object;
use where2act_sim::render::{Look, front_camera, render};
use where2act_sim::{Attempt, Observer, Scene, SettledScene, SurfacePoint};

use crate::{Cli, gif};

/// How far from the surface a given point may be, metres.
const POINT_SLACK: f32 = 0.01;

pub(crate) fn run(cli: &Cli, object: Arc<Object>) -> Result<()> {
    let q = positions(cli, &object)?;
    let scene = Scene::new(Arc::clone(&object), q).context("start positions")?;
    let settled = if cli.no_settle { scene.assume_settled() } else { scene.settle() };
    let settled = settled.with_context(|| cli.object.clone())?;
    let attempt = attempt(cli, &settled)?;

    let mut moments = Vec::new();
    let mut look = |moment: &_| moments.push(Clone::clone(moment));
    let observer =
        cli.gif.as_ref().map(|_| Observer { every: (cli.hz.hz() / 20.0) as usize, look: &mut look });
    let verdict = settled.attempt(&attempt, cli.hz, observer);
    if let Some(path) = &cli.gif {
        gif::write(path, &settled, &attempt, &moments)?;
    }
    report(cli, &object, &attempt, &verdict)
}

/// Start positions: closed, then `--q`, then `--joint`.
fn positions(cli: &Cli, object: &Object) -> Result<Vec<f32>> {
    let mut q = cli.q.clone().unwrap_or_else(|| object.closed());
    if q.len() != object.movable().len() {
        bail!("--q: expected {} numbers, found {}", object.movable().len(), q.len());
    }
    for (name, value) in &cli.joint {
        let by_joint = object.movable().find(|link| object.joint(*link).name == *name);
        let link = by_joint.or_else(|| object.find_link(name)).filter(|link| *link > 0);
        let link =
            link.with_context(|| format!("--joint {name}: expected one of {}", movable_names(object)))?;
        q[link - 1] = *value;
    }
    Ok(q)
}

fn movable_names(object: &Object) -> String {
    let names: Vec<_> = object.movable().map(|link| object.links[link].name.as_str()).collect();
    names.join(", ")
}

fn attempt(cli: &Cli, settled: &SettledScene) -> Result<Attempt> {
    let object = settled.object();
    let target = match &cli.target {
        Some(name) => Some(object.find_link(name).filter(|link| *link > 0).with_context(|| {
            format!("--target {name}: expected a movable link: {}", movable_names(object))
        })?),
        None => None,
    };
    let surface = match (cli.pixel, cli.point) {
        (Some(pixel), _) => seen_at(cli, settled, pixel)?,
        (None, Some(point)) => near(settled, Point3::from(point), target)?,
        (None, None) => bail!("--point: expected a point or --pixel, found neither"),
    };
    let primitive = cli.primitive.context("--primitive: expected one, found none")?;
    let approach = cli.approach.unwrap_or(-surface.normal_in_world);
    let forward = cli.forward.unwrap_or_else(|| horizontal(&approach));
    if approach.cross(&forward).norm() <= 1e-6 * approach.norm() * forward.norm() {
        bail!("--approach, --forward: expected two directions that are not parallel");
    }
    let link = target.unwrap_or(surface.link);
    let grasp_in_world = Grasp::new(surface.point_in_world, approach, forward);
    Ok(Attempt { primitive, link, grasp_in_world, normal_in_world: Some(surface.normal_in_world) })
}

/// A horizontal direction at right angles to the approach.
fn horizontal(approach: &Vector3<f32>) -> Vector3<f32> {
    Vector3::z().cross(approach).try_normalize(1e-3 * approach.norm()).unwrap_or(Vector3::x())
}

/// The camera of `objects render`, at the published distance.
fn seen_at(cli: &Cli, settled: &SettledScene, pixel: Pixel) -> Result<SurfacePoint> {
    let side = Camera::PUBLISHED_SIDE;
    if pixel.u as usize >= side || pixel.v as usize >= side {
        bail!("--pixel {},{}: expected columns and rows below {side}", pixel.u, pixel.v);
    }
    let poses = settled.world_from_links();
    let angles = [cli.azimuth, cli.elevation].map(f32::to_radians);
    let camera = front_camera(settled.object(), &poses, angles, side);
    let view = render(settled.object(), &poses, &camera, &Look::default());
    let seen = view.link_at(pixel).zip(view.point_in_world(pixel)).zip(view.normal_in_world(pixel));
    let Some(((link, point_in_world), normal_in_world)) = seen else {
        bail!("--pixel {},{}: expected the object, found background", pixel.u, pixel.v);
    };
    Ok(SurfacePoint { link, point_in_world, normal_in_world, distance: 0.0 })
}

fn near(settled: &SettledScene, point: Point3<f32>, target: Option<usize>) -> Result<SurfacePoint> {
    let at = format!("--point {},{},{}", point.x, point.y, point.z);
    match settled.nearest_surface(&point, target) {
        Some(found) if found.distance <= POINT_SLACK => Ok(SurfacePoint { point_in_world: point, ..found }),
        Some(found) => bail!(
            "{at}: expected a point on the surface, found it {:.3} m away from {}",
            found.distance,
            settled.object().links[found.link].name
        ),
        None => bail!("{at}: expected a point on the surface, found no surface"),
    }
}

fn report(cli: &Cli, object: &Object, attempt: &Attempt, verdict: &Verdict) -> Result<()> {
    let mut out = std::io::stdout().lock();
    let reason = verdict.invalid.map(|reason| reason.to_string());
    let grasp = &attempt.grasp_in_world;
    let list = |v: Vector3<f32>| [v.x, v.y, v.z];
    if cli.json {
        // Rows of 4x4 matrices `world_from_hand`, as in the predictions of `predict`, but in the world.
        let rows = |pose: nalgebra::Isometry3<f32>| <[[f32; 4]; 4]>::from(pose.to_homogeneous().transpose());
        let waypoints: Vec<_> = attempt.primitive.motion(grasp).waypoints().map(rows).collect();
        let all = json!({
            "object": object.name,
            "primitive": attempt.primitive,
            "link": object.links[attempt.link].name,
            "point": list(grasp.point.coords),
            "approach": list(grasp.approach()),
            "forward": list(grasp.forward()),
            "waypoints": waypoints,
            "valid": verdict.invalid.is_none(),
            "reason": reason,
            "q_start": verdict.q_start,
            "q_end": verdict.q_end,
            "motion": list(verdict.motion),
            "success": verdict.success,
        });
        writeln!(out, "{all:#}")?;
        return Ok(());
    }
    let yes = |is: bool| if is { "yes" } else { "no" };
    writeln!(out, "object   {}", object.name)?;
    writeln!(out, "link     {} ({})", object.links[attempt.link].name, object.links[attempt.link].label)?;
    writeln!(out, "point    {}", row(grasp.point.coords))?;
    writeln!(out, "approach {}", row(grasp.approach()))?;
    writeln!(out, "forward  {}", row(grasp.forward()))?;
    writeln!(
        out,
        "valid    {}{}",
        yes(reason.is_none()),
        reason.map_or_else(String::new, |r| format!(" ({r})"))
    )?;
    writeln!(out, "q        {:.4} -> {:.4}", verdict.q_start, verdict.q_end)?;
    writeln!(out, "motion   {}", row(verdict.motion))?;
    writeln!(out, "success  {}", yes(verdict.success))?;
    Ok(())
}

fn row(v: Vector3<f32>) -> String {
    format!("{:.4} {:.4} {:.4}", v.x, v.y, v.z)
}
