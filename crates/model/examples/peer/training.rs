//! Training steps on command.

use std::io::{BufRead, Write};
use std::path::Path;
use std::time::Instant;

use anyhow::{Result, bail};
use burn::optim::{AdamConfig, GradientsParams};
use burn::tensor::{Device, Tensor, TensorData};
use where2act_model::{Input, TrainingEngine, Weights};

/// Pixels of each picture that the loss looks at, as many as a view has trials.
const QUERIES: usize = 64;
/// Between them.
const APART: usize = 7919;

/// Steps of Adam on the mean square of the features at some pixels: everything of a training step but the heads, which
/// cost nothing beside the backbone.
pub(super) fn serve(folder: &Path, images: &[f32], batch: usize, engine: TrainingEngine) -> Result<()> {
    let device = Device::flex().autodiff();
    let mut network = Weights::load(folder, &device)?.network;
    let side = network.config().preprocessing.image_side;
    let images = Tensor::<4>::from_data(TensorData::new(images.to_vec(), [batch, 3, side, side]), &device);
    let queries: Vec<_> =
        (0..batch * QUERIES).map(|i| (i / QUERIES, i % QUERIES * APART % (side * side))).collect();
    let mut adam = AdamConfig::new().with_epsilon(1e-8).init();
    let mut step = || {
        let features = engine.scope(|| network.features_at(Input::Images(images.clone()), &queries));
        let loss = features.powi_scalar(2).mean();
        let gradients = GradientsParams::from_grads(loss.backward(), &network);
        network = adam.step(1e-3, network.clone(), gradients);
        loss
    };
    for line in std::io::stdin().lock().lines() {
        let line = line?;
        match line.split_whitespace().collect::<Vec<_>>()[..] {
            ["run", n] => {
                for _ in 0..n.parse()? {
                    let (cpu, wall) = (super::cpu_secs(), Instant::now());
                    drop(step());
                    print!("{} {} ", wall.elapsed().as_secs_f64(), super::cpu_secs() - cpu);
                }
                println!();
            }
            ["loss", n] => {
                for _ in 0..n.parse()? {
                    print!("{} ", step().into_scalar::<f32>());
                }
                println!();
            }
            ["memory"] => println!("{}", super::peak_bytes()),
            _ => bail!("unknown command {line}"),
        }
        std::io::stdout().flush()?;
    }
    Ok(())
}
