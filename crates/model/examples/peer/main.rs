//! Our side of `benches/peers`: makes random weights, or runs a weights folder on command.
//!
//! `peer make DIR WIDTH` writes a weights folder with a random network.
//! `peer serve DIR INPUT BATCH ISA` loads it and reads commands from stdin: `run N` prints the wall and CPU seconds of
//! N predictions, `save FILE` writes the features as raw f32, `memory` prints the peak in bytes, `stages` the times of one.
//! `peer train DIR INPUT BATCH ENGINE` trains it, with our kernels (`fast`) or burn's own operations (`burn`), and knows
//! `run N`, `memory`, and `loss N`, which prints the losses of the next N steps.

mod training;

use std::io::{BufRead, Write};
use std::path::Path;
use std::time::Instant;

use anyhow::{Context, Result, bail};
use burn::tensor::Device;
use where2act_core::{Primitive, Seed};
use where2act_kernels::Isa;
use where2act_model::{Engine, Modality, ModelConfig, Network, Precision, Weights, save_weights};

/// The program; `peer_tuned` is the same with another allocator.
pub(crate) fn main() -> Result<()> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let args: Vec<&str> = args.iter().map(String::as_str).collect();
    match args[..] {
        ["make", folder, width] => make(Path::new(folder), width.parse()?),
        ["serve", folder, input, batch, isa] => {
            serve(Path::new(folder), Path::new(input), batch.parse()?, isa)
        }
        ["train", folder, input, batch, engine] => {
            let engine = engine.parse().map_err(anyhow::Error::msg)?;
            training::serve(Path::new(folder), &read(Path::new(input))?, batch.parse()?, engine)
        }
        _ => bail!(
            "usage: peer make DIR WIDTH | peer serve DIR INPUT BATCH ISA | peer train DIR INPUT BATCH ENGINE"
        ),
    }
}

fn make(folder: &Path, width: f32) -> Result<()> {
    let config = ModelConfig::new(Modality::Rgb, &Primitive::ALL).with_width(width);
    let network = Network::new(&config, Seed(1), &Device::flex());
    std::fs::create_dir_all(folder)?;
    save_weights(folder, &network, "Random weights, for timing.\n", Precision::F32)?;
    Ok(())
}

fn serve(folder: &Path, input: &Path, batch: usize, isa: &str) -> Result<()> {
    let isa = match isa {
        "best" => Isa::best(),
        _ => {
            let mut all = Isa::available().into_iter().chain(Isa::bf16());
            all.find(|i| i.name() == isa).with_context(|| format!("{isa}: this processor lacks it"))?
        }
    };
    let weights = Weights::load(folder, &Device::flex())?;
    let side = weights.network.config().preprocessing.image_side;
    let engine = Engine::compile_for(isa, &weights.network)?;
    drop(weights);
    let images = read(input)?;
    let shape = [batch, side, side];
    for line in std::io::stdin().lock().lines() {
        let line = line?;
        match line.split_whitespace().collect::<Vec<_>>()[..] {
            ["run", n] => {
                for _ in 0..n.parse()? {
                    let (cpu, wall) = (cpu_secs(), Instant::now());
                    let features = engine.features_rgb(&images, shape)?;
                    print!("{} {} ", wall.elapsed().as_secs_f64(), cpu_secs() - cpu);
                    drop(features);
                }
                println!();
            }
            ["save", file] => {
                let features = engine.features_rgb(&images, shape)?;
                let bytes: Vec<u8> = features.iter().flat_map(|x| x.to_le_bytes()).collect();
                std::fs::write(file, bytes)?;
                println!("saved");
            }
            ["memory"] => println!("{}", peak_bytes()),
            ["stages"] => {
                let stages = engine.stages_rgb(&images, shape)?;
                let text: Vec<_> = stages
                    .iter()
                    .map(|(name, t)| format!("{name} {:.2} ms", t.as_secs_f64() * 1e3))
                    .collect();
                println!("{}", text.join(", "));
            }
            _ => bail!("unknown command {line}"),
        }
        std::io::stdout().flush()?;
    }
    Ok(())
}

fn read(input: &Path) -> Result<Vec<f32>> {
    let bytes = std::fs::read(input).with_context(|| input.display().to_string())?;
    Ok(bytes.as_chunks::<4>().0.iter().map(|b| f32::from_le_bytes(*b)).collect())
}

/// CPU seconds of all threads (Linux; 0 elsewhere).
fn cpu_secs() -> f64 {
    let Ok(tasks) = std::fs::read_dir("/proc/self/task") else { return 0.0 };
    let nanos = tasks.flatten().filter_map(|task| {
        let text = std::fs::read_to_string(task.path().join("schedstat")).ok()?;
        text.split(' ').next()?.parse::<f64>().ok()
    });
    nanos.sum::<f64>() * 1e-9
}

/// Peak resident memory (Linux; 0 elsewhere).
fn peak_bytes() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"));
    line.and_then(|line| line.split_whitespace().next()?.parse::<u64>().ok()).map_or(0, |kib| kib * 1024)
}
