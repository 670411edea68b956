//! The mean of weights that grew from the same ones:
//!
//! ```text
//! cargo run --example average -- runs/a/last runs/b/last --out weights/mean
//! ```
//!
//! The network is described as the first one's `config.json` says; the card names the folders.

use std::path::PathBuf;

use anyhow::{Result, bail};
use burn::tensor::Device;
use where2act_model::{Precision, Weights, save_weights};

fn main() -> Result<()> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let [folders @ .., flag, out] = args.as_slice() else {
        bail!("expected FOLDER FOLDER ... --out FOLDER, found {args:?}");
    };
    if flag != "--out" || folders.len() < 2 {
        bail!("expected FOLDER FOLDER ... --out FOLDER, found {args:?}");
    }
    let mut networks = Vec::new();
    let mut card = String::from("# Mean of weights\n\n");
    for folder in folders {
        let Weights { network, sha256 } = Weights::load(&PathBuf::from(folder), &Device::flex())?;
        card += &format!("- {folder}, {sha256}\n");
        networks.push(network);
    }
    let first = networks.remove(0);
    let sha256 = save_weights(&PathBuf::from(out), &first.averaged(&networks)?, &card, Precision::F16)?;
    println!("{out}: {sha256}");
    Ok(())
}
