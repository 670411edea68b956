//! A robot loop: look, ask, act. `cargo run --example embed -- weights/cloud`

use std::path::Path;

use where2act_core::{Intrinsics, Observation, Primitive};
use where2act_infer::{Error, Options, Predictor};

fn main() -> Result<(), Error> {
    let weights = std::env::args().nth(1).unwrap_or_else(|| "weights/cloud".to_owned());
    let predictor = Predictor::load(Path::new(&weights))?;
    let options = Options { primitives: vec![Primitive::Pulling], min_score: 0.5, ..Options::default() };
    for frame in 0..3 {
        let observation = camera(frame);
        let prediction = predictor.predict(&observation, &options)?;
        let Some(best) = prediction.primitives.iter().flat_map(|p| &p.proposals).next() else {
            println!("frame {frame}: nothing worth pulling");
            continue;
        };
        println!("frame {frame}: opening the fingers to {} m, score {:.2}", best.gripper_width, best.score);
        for (i, camera_from_hand) in best.poses().enumerate() {
            let to = camera_from_hand.translation.vector;
            println!("  drive the hand's frame (panda_hand) to {:.3} {:.3} {:.3}", to.x, to.y, to.z);
            if best.close_at == Some(i) {
                println!("  close the fingers");
            }
        }
    }
    Ok(())
}

/// Stands for a depth camera: a box with a handle, half a metre away.
fn camera(frame: usize) -> Observation {
    let size = where2act_core::ImageSize { width: 320, height: 240 };
    let depth = |i: usize| match (i % 320, i / 320) {
        (140..180, 110..130) => 0.50 + 0.01 * frame as f32,
        (60..260, 40..200) => 0.55 + 0.01 * frame as f32,
        _ => 0.0,
    };
    let depth = Some((0..size.pixels()).map(depth).collect());
    Observation::Image {
        size,
        rgb: None,
        depth,
        intrinsics: Some(Intrinsics::from_fov(size, 0.75)),
        mask: None,
    }
}
