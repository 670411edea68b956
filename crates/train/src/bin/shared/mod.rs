//! What `train` and `evaluate` have in common: their start, progress on the terminal, judging weights.

use std::io::Write;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use anyhow::{Context, bail};
use where2act_core::program::{self, Progress};
use where2act_core::write_whole;
use where2act_infer::Predictor;
use where2act_train::evaluate::{EvaluateConfig, evaluate};

/// Flags of every program that computes for long.
#[derive(clap::Args)]
pub(crate) struct Work {
    /// Threads. Default: all cores.
    #[arg(long)]
    jobs: Option<usize>,
    /// No progress on the terminal.
    #[arg(long)]
    pub(crate) quiet: bool,
}

impl Work {
    /// Sets up threads and signals. The flag that is returned is set by Ctrl-C and SIGTERM.
    pub(crate) fn begin(&self) -> anyhow::Result<Arc<AtomicBool>> {
        program::limit_threads(self.jobs)?;
        Ok(program::stop_flag()?)
    }

    /// How far `what` is, on the terminal or in the log.
    pub(crate) fn progress(&self, length: u64, what: &str) -> Progress {
        let template = format!("{what} [{{bar:30}}] {{pos}}/{{len}} ({{per_sec}}, {{eta}} left) {{msg}}");
        Progress::new(self.quiet, length, &template)
    }

    /// Judges weights, and writes and prints the report: JSON at `out`, a Markdown table of the same name beside it. A
    /// report of fewer scenes than wanted, because someone asked to stop, is written too, but is an error.
    pub(crate) fn judge(
        &self,
        weights: &Path,
        config: &EvaluateConfig,
        stop: &AtomicBool,
        out: &Path,
    ) -> anyhow::Result<()> {
        let predictor = Predictor::load(weights)?;
        // Judging takes minutes: a report that cannot be written is found out first.
        let markdown = out.with_extension("md");
        if markdown == out {
            bail!("--out {}: expected another ending than .md, as the table gets that", out.display());
        }
        for path in [out, &markdown] {
            check_writable(path).with_context(|| format!("--out {}", path.display()))?;
        }
        let bar = self.progress(config.scenes, "evaluating");
        let judged = |done| {
            bar.set_position(done);
            bar.tell(|| format!("{done} of {} scenes judged", config.scenes));
        };
        let report = evaluate(&predictor, config, stop, &judged)?;
        bar.finish_and_clear();
        let table = report.to_markdown();
        write_whole(out, |w| Ok(serde_json::to_writer_pretty(w, &report)?))
            .with_context(|| out.display().to_string())?;
        write_whole(&markdown, |w| w.write_all(table.as_bytes()))
            .with_context(|| markdown.display().to_string())?;
        println!("{table}");
        if report.unfinished > 0 {
            let done = config.scenes - report.unfinished;
            bail!("interrupted after {done} of {} scenes; {} is about these", config.scenes, out.display());
        }
        Ok(())
    }
}

/// Whether a file could be written here; a file that is there already stays as it is.
fn check_writable(path: &Path) -> std::io::Result<()> {
    if path.is_dir() {
        return Err(std::io::ErrorKind::IsADirectory.into());
    }
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    std::fs::create_dir_all(folder)?;
    tempfile::tempfile_in(folder).map(drop)
}
