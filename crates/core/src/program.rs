//! What all programs do alike: arguments, log, threads, Ctrl-C, progress, and errors in one line.

use std::error::Error;
use std::io::IsTerminal;
use std::ops::Deref;
use std::process::{ExitCode, Termination};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use clap::Parser;
use clap::error::ErrorKind;
use indicatif::{ProgressBar, ProgressStyle};
use tracing_subscriber::EnvFilter;

use crate::one_line;

/// Why a program cannot begin.
#[derive(Debug, thiserror::Error)]
pub enum ProgramError {
    /// `--jobs 0`.
    #[error("--jobs: expected at least 1, found 0")]
    NoThreads,
    /// The system gives no threads.
    #[error("--jobs: expected so many threads, found: {0}")]
    Threads(#[from] rayon::ThreadPoolBuildError),
    /// The system gives no signals.
    #[error("cannot listen for Ctrl-C: {0}")]
    Signals(#[from] ctrlc::Error),
}

/// Runs the program `name` on its command line: the result of `body`, or one line on stderr and exit code 2 for
/// whatever is wrong. Logs go to stderr, from the level `log` on unless `RUST_LOG` says otherwise; in colour on a terminal.
pub fn run<A: Parser, T: Termination, E: AsRef<dyn Error>>(
    name: &str,
    log: &str,
    body: impl FnOnce(A) -> Result<T, E>,
) -> ExitCode {
    let refuse = |line: &str| {
        eprintln!("{name}: {line}");
        ExitCode::from(2)
    };
    let arguments = match A::try_parse() {
        Ok(arguments) => arguments,
        Err(error) if error.use_stderr() => return refuse(&usage(&error)),
        // Help and version.
        Err(error) => error.exit(),
    };
    let filter = EnvFilter::try_from_default_env().unwrap_or_else(|_| EnvFilter::new(log));
    let no_colour = std::env::var_os("NO_COLOR").is_some_and(|value| !value.is_empty());
    tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_writer(std::io::stderr)
        .with_ansi(std::io::stderr().is_terminal() && !no_colour)
        .without_time()
        .init();
    match body(arguments) {
        Ok(result) => result.report(),
        Err(error) => refuse(&one_line(error.as_ref())),
    }
}

/// An error of the command line as users read it, with the hint where help is.
fn usage(error: &clap::Error) -> String {
    if error.kind() == ErrorKind::DisplayHelpOnMissingArgumentOrSubcommand {
        return "expected a command, found none; try '--help'".to_owned();
    }
    let line = one_line(error);
    line.strip_prefix("error: ").unwrap_or(&line).to_owned()
}

/// A number of the command line that is one.
///
/// # Errors
/// For anything else, `nan` and `inf` too.
pub fn finite(text: &str) -> Result<f32, String> {
    let number = text.trim().parse().ok().filter(|x: &f32| x.is_finite());
    number.ok_or_else(|| "expected a finite number".to_owned())
}

/// Limits the threads of the whole program; `None`: one for every core.
///
/// # Errors
/// For no threads, and if the pool exists already.
pub fn limit_threads(jobs: Option<usize>) -> Result<(), ProgramError> {
    match jobs {
        None => Ok(()),
        Some(0) => Err(ProgramError::NoThreads),
        Some(jobs) => Ok(rayon::ThreadPoolBuilder::new().num_threads(jobs).build_global()?),
    }
}

/// A flag that Ctrl-C sets, or a polite request of the system to end.
///
/// # Errors
/// If the system does not tell, or another listener is there.
pub fn stop_flag() -> Result<Arc<AtomicBool>, ProgramError> {
    let stop = Arc::new(AtomicBool::new(false));
    let flag = Arc::clone(&stop);
    ctrlc::set_handler(move || flag.store(true, Ordering::Relaxed))?;
    Ok(stop)
}

/// Where there is no terminal to draw a bar on, the log says as often how far the work is.
const TELL_EVERY: Duration = Duration::from_secs(60);

/// How far long work is: a bar on stderr, or now and then a line in the log (`RUST_LOG=info`) where there is no terminal.
pub struct Progress {
    bar: ProgressBar,
    told: Mutex<Instant>,
}

impl Progress {
    /// A bar in indicatif's template language; invisible if `quiet` or if nobody looks.
    #[must_use]
    pub fn new(quiet: bool, length: u64, template: &str) -> Self {
        let bar = if quiet { ProgressBar::hidden() } else { ProgressBar::new(length) };
        if let Ok(style) = ProgressStyle::with_template(template) {
            bar.set_style(style.progress_chars("=> "));
        }
        if !bar.is_hidden() {
            bar.enable_steady_tick(Duration::from_secs(1));
        }
        Self { bar, told: Mutex::new(Instant::now()) }
    }

    /// Says in the log how far it is, if there is no bar and a minute has passed since it last did.
    pub fn tell(&self, line: impl FnOnce() -> String) {
        let mut told = self.told.lock().unwrap_or_else(PoisonError::into_inner);
        if self.bar.is_hidden() && told.elapsed() > TELL_EVERY {
            *told = Instant::now();
            tracing::info!("{}", line());
        }
    }

    /// Prints a line above the bar, or to the log where there is none.
    pub fn say(&self, line: &str) {
        if self.bar.is_hidden() {
            tracing::info!("{line}");
        } else {
            self.bar.println(line);
        }
    }
}

impl Deref for Progress {
    type Target = ProgressBar;
    fn deref(&self) -> &ProgressBar {
        &self.bar
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Debug, Parser)]
    #[command(name = "tool", subcommand_required = true, arg_required_else_help = true)]
    struct Arguments {
        #[arg(long, global = true)]
        count: Option<u8>,
        #[command(subcommand)]
        command: Command,
    }

    #[derive(Debug, clap::Subcommand)]
    enum Command {
        Go { place: String },
    }

    #[test]
    fn mistakes_are_told_in_one_line() {
        for (arguments, words) in [
            (vec!["tool"], ["expected a command", "--help"]),
            (vec!["tool", "go"], ["<PLACE>", "Usage: tool go"]),
            (vec!["tool", "og"], ["'og'", "--help"]),
            (vec!["tool", "go", "home", "--count", "300"], ["'300'", "--count"]),
            (vec!["tool", "go", "home", "--far"], ["'--far'", "--help"]),
        ] {
            let line = usage(&Arguments::try_parse_from(&arguments).expect_err("a mistake"));
            assert!(words.iter().all(|word| line.contains(word)), "{line}");
            assert!(!line.contains('\n') && !line.starts_with("error"), "{line}");
        }
    }
}
