//! Counting what came of trials.

use std::fmt;

use where2act_core::{Policy, Primitive, Trial};

/// Trials of one kind.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Count {
    /// All.
    pub trials: u64,
    /// Not invalid.
    pub valid: u64,
    /// Successful.
    pub successes: u64,
}

impl Count {
    /// Share of successes; 0 for none of none.
    #[must_use]
    pub fn rate(&self) -> f64 {
        self.successes as f64 / self.trials.max(1) as f64
    }

    fn add(&mut self, other: Count) {
        self.trials += other.trials;
        self.valid += other.valid;
        self.successes += other.successes;
    }
}

/// Trials by primitive and policy.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Tally {
    counts: [[Count; POLICIES.len()]; Primitive::ALL.len()],
}

const POLICIES: [Policy; 3] = [Policy::Random, Policy::Guided, Policy::Adaptive];

impl Tally {
    /// Counts trials.
    pub fn add<'a>(&mut self, trials: impl IntoIterator<Item = &'a Trial>) {
        for trial in trials {
            self.counts[trial.primitive as usize][trial.policy as usize].add(Count {
                trials: 1,
                valid: u64::from(trial.verdict.invalid.is_none()),
                successes: u64::from(trial.verdict.success),
            });
        }
    }

    /// Adds another tally.
    pub fn merge(&mut self, other: &Tally) {
        for (mine, theirs) in self.counts.iter_mut().flatten().zip(other.counts.iter().flatten()) {
            mine.add(*theirs);
        }
    }

    /// Trials of a primitive by a policy; by all of them without one.
    #[must_use]
    pub fn count(&self, primitive: Primitive, policy: Option<Policy>) -> Count {
        let row = &self.counts[primitive as usize];
        match policy {
            Some(policy) => row[policy as usize],
            None => row.iter().fold(Count::default(), |mut sum, c| {
                sum.add(*c);
                sum
            }),
        }
    }

    /// All trials.
    #[must_use]
    pub fn total(&self) -> Count {
        Primitive::ALL.iter().fold(Count::default(), |mut sum, &p| {
            sum.add(self.count(p, None));
            sum
        })
    }

    /// Successes of every primitive, for a progress bar.
    #[must_use]
    pub fn successes(&self) -> String {
        Primitive::ALL.map(|p| self.count(p, None).successes.to_string()).join("/")
    }
}

impl fmt::Display for Tally {
    /// A table: a row for every primitive and policy that occur.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            f,
            "{:<14} {:<9} {:>8} {:>8} {:>10} {:>8}",
            "primitive", "policy", "trials", "valid", "successes", "rate"
        )?;
        for primitive in Primitive::ALL {
            for policy in POLICIES {
                let count = self.count(primitive, Some(policy));
                if count.trials > 0 {
                    let policy = format!("{policy:?}").to_lowercase();
                    let Count { trials, valid, successes } = count;
                    let rate = 100.0 * count.rate();
                    writeln!(
                        f,
                        "{primitive:<14} {policy:<9} {trials:>8} {valid:>8} {successes:>10} {rate:>7.1}%"
                    )?;
                }
            }
        }
        Ok(())
    }
}
