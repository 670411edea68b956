//! `trial --batch`.

use std::io::Write;
use std::path::Path;
use std::sync::Arc;

use anyhow::{Context, Result};
use where2act_core::program::Progress;
use where2act_core::write_whole;
use where2act_sim::object::Object;
use where2act_sim::{Agreement, Batch};

use crate::Cli;

pub(crate) fn run(cli: &Cli, table: &Path, object: Arc<Object>) -> Result<()> {
    let text = std::fs::read_to_string(table)
        .with_context(|| format!("{}: expected a readable table", table.display()))?;
    let batch = Batch::parse(&text, object).with_context(|| table.display().to_string())?;
    let template = "{bar:30} {pos}/{len} trials, {per_sec}, {eta} left";
    let bar = Progress::new(cli.quiet, batch.len() as u64, template);
    let outcomes = batch.run(cli.hz, !cli.no_settle, || bar.inc(1));
    bar.finish_and_clear();
    let written = batch.to_tsv(&outcomes);
    match &cli.out {
        Some(out) => write_whole(out, |w| w.write_all(written.as_bytes()))
            .with_context(|| format!("{}: expected to write the outcomes here", out.display()))?,
        None => std::io::stdout().lock().write_all(written.as_bytes())?,
    }
    let Agreement { valid, success } = batch.agreement(&outcomes);
    for (what, (all, agreeing)) in [("valid", valid), ("success", success)] {
        if all > 0 && !cli.quiet {
            eprintln!("{what}: {agreeing} of {all} as in {}", table.display());
        }
    }
    Ok(())
}
