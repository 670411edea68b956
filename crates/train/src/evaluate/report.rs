//! What judging found, as JSON and as a table.

use std::collections::BTreeMap;
use std::fmt::Write;

use serde::{Deserialize, Serialize};
use where2act_core::{Seed, Verdict};
use where2act_infer::{Options, Predictor};

use super::{Contestant, EvaluateConfig, Fate, PrimitiveResult, SceneResult, names};
use crate::metrics::{Rate, Reliability, ScoreMetrics, f_score_interval, reliability};

/// Everything that judging found.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Report {
    /// Name of the weights.
    pub model: String,
    /// SHA-256 of `model.safetensors`.
    pub sha256: String,
    /// What it was judged on.
    pub config: EvaluateConfig,
    /// How pixels and proposals were picked, in words.
    pub rule: String,
    /// Objects of a folder, or categories of generated objects, and how many scenes could not be made of each: in no
    /// start pose did they come to rest with all parts free of each other before a camera that saw a movable one.
    pub without_scene: BTreeMap<String, u64>,
    /// Scenes that were left because someone asked to stop.
    pub unfinished: u64,
    /// Over all scenes.
    pub total: Judgement,
    /// By category, for objects that have one.
    pub categories: BTreeMap<String, Judgement>,
    /// By object.
    pub objects: BTreeMap<String, Judgement>,
}

/// Results over some scenes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Judgement {
    /// Scenes.
    pub scenes: u64,
    /// One row per primitive.
    pub rows: Vec<Row>,
}

/// One primitive's results.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Row {
    /// Which primitive.
    pub primitive: String,
    /// Scenes in which a trial that knows the joint succeeded; only they count for the rates.
    pub possible_scenes: u64,
    /// Success rate of each contestant, in the order of [`Contestant::ALL`].
    pub rates: Vec<(Contestant, Rate)>,
    /// Of these scenes, those in which such a trial succeeded that began in view.
    pub possible_in_view: u64,
    /// The rates in the scenes of [`Self::possible_in_view`].
    pub rates_in_view: Vec<(Contestant, Rate)>,
    /// How many of the best proposals met each fate, in the order of [`Fate::ALL`]; the first are top-k's successes.
    pub fates: Vec<(Fate, u64)>,
    /// The score on random trials in all scenes, possible or not.
    pub score: ScoreMetrics,
    /// 95 % interval of its F-score.
    pub f_score_interval: [f64; 2],
    /// How far the score can be taken for a probability.
    pub reliability: Vec<Reliability>,
    /// Mean distance between score and outcome.
    pub calibration_error: f64,
}

impl Report {
    pub(super) fn new(
        predictor: &Predictor,
        config: &EvaluateConfig,
        scenes: &[SceneResult],
        without_scene: BTreeMap<String, u64>,
    ) -> Self {
        let primitives = names(&predictor.config().primitives);
        let judge = |wanted: &dyn Fn(&SceneResult) -> bool| {
            let mine: Vec<_> = scenes.iter().filter(|scene| wanted(scene)).collect();
            Judgement::new(&primitives, &mine, config.seed)
        };
        let named = |key: &dyn Fn(&SceneResult) -> Option<String>| -> BTreeMap<String, Judgement> {
            let mut keys: Vec<String> = scenes.iter().filter_map(key).collect();
            keys.sort();
            keys.dedup();
            keys.into_iter().map(|k| (k.clone(), judge(&|scene| key(scene).as_ref() == Some(&k)))).collect()
        };
        let options = Options::default();
        let done = scenes.len() as u64 + without_scene.values().sum::<u64>();
        Self {
            model: predictor.model().name.clone(),
            sha256: predictor.model().sha256.clone(),
            config: config.clone(),
            rule: format!(
                "Candidates are the {2} most actionable pixels{place} that keep a distance; {3} proposals at \
                 each{room}, the best four of which are scored once more if the network takes a second look; the \
                 best-scored one per pixel. Top-1 is the best of them, top-k the best {0} (one per pixel), \
                 sampled {0} drawn at random from all of them, whatever their score; a scene without any is a \
                 failure of each. Executed in the fast mode of the \
                 simulator. Scenes in which {1} trials that know the joint do not succeed with a primitive do not \
                 count for it.{held}",
                config.proposals,
                config.informed,
                config.proposals.max(options.candidates),
                options.samples,
                place = if config.anywhere {
                    ", of whatever is seen and has depth, without a mask (where nothing moves a proposal fails; the \
                     trials beside are on movable parts),"
                } else {
                    " of movable parts"
                },
                held = if config.held.straight() {
                    String::new()
                } else {
                    format!(
                        " Cameras are rolled by {} degrees and look {} degrees beside the object{}.",
                        config.held.roll,
                        config.held.beside,
                        if config.up { "; the network is told which way is up" } else { "" },
                    )
                },
                room =
                    if config.clearance { ", without hands that have no room by the depth map" } else { "" },
            ),
            without_scene,
            unfinished: config.scenes.saturating_sub(done),
            total: judge(&|_| true),
            categories: named(&|scene| scene.category.map(|c| c.to_string())),
            objects: named(&|scene| Some(scene.object.clone())),
        }
    }

    /// The report as Markdown.
    #[must_use]
    pub fn to_markdown(&self) -> String {
        let mut text = format!(
            "Weights `{}` ({}), {} scenes, seed {}.\n\n{}Success rate of executed proposals, 95 % intervals: Wilson's, for as many \
             tries as those on some objects are worth, which end alike. \
             {}\n\n",
            self.model,
            self.sha256.get(..12).unwrap_or(&self.sha256),
            self.total.scenes,
            self.config.seed.0,
            self.left_out(),
            self.rule
        );
        text += "| primitive | scenes |";
        for contestant in Contestant::ALL {
            let _ = write!(text, " {} |", contestant.name());
        }
        text += &separator(2 + Contestant::ALL.len());
        for row in &self.total.rows {
            let _ = write!(text, "| {} | {} |", row.primitive, row.possible_scenes);
            for (_, rate) in &row.rates {
                let _ = write!(text, " {} |", rate.show());
            }
            text += "\n";
        }
        text += &self.in_view_table();
        text += &self.fates_table();
        text += "\nThe score of the hands of random trials, of the view and its mirror image (threshold 0.5; \
                 intervals by bootstrap over objects):\n\n";
        text += "| primitive | trials | successes | F-score | precision | recall | average precision | calibration error |\n";
        text += "| --- | --- | --- | --- | --- | --- | --- | --- |\n";
        for Row { primitive, score: s, f_score_interval: [low, high], calibration_error, .. } in
            &self.total.rows
        {
            if s.trials == 0 {
                let _ = writeln!(text, "| {primitive} | 0 | 0 | - | - | - | - | - |");
                continue;
            }
            let _ = writeln!(
                text,
                "| {primitive} | {} | {} | {:.3} ({low:.2}-{high:.2}) | {:.3} | {:.3} | {:.3} | {calibration_error:.3} |",
                s.trials, s.successes, s.f_score, s.precision, s.recall, s.average_precision
            );
        }
        text += &self.reliability_table();
        text += "\nTop-1 by category:\n\n| category | scenes |";
        for row in &self.total.rows {
            let _ = write!(text, " {} |", row.primitive);
        }
        text += &separator(2 + self.total.rows.len());
        for (category, judgement) in &self.categories {
            let _ = write!(text, "| {category} | {} |", judgement.scenes);
            for row in &judgement.rows {
                let top = row.rates.first().map(|(_, rate)| *rate).unwrap_or_default();
                let cell =
                    if top.tries == 0 { "-".to_owned() } else { format!("{}/{}", top.successes, top.tries) };
                let _ = write!(text, " {cell} |");
            }
            text += "\n";
        }
        text
    }

    /// Scenes that are missing from the report or do not count, a paragraph for each reason.
    fn left_out(&self) -> String {
        let mut text = String::new();
        if self.unfinished > 0 {
            let Self { unfinished, config, .. } = self;
            let _ = writeln!(text, "Interrupted: {unfinished} of {} scenes are missing.\n", config.scenes);
        }
        if !self.without_scene.is_empty() {
            let named: Vec<_> =
                self.without_scene.iter().map(|(name, scenes)| format!("{name} ({scenes})")).collect();
            let _ = writeln!(
                text,
                "Scenes that could not be made, because the object cannot be loaded or never came to rest with its \
                 parts free of each other, or no camera saw a movable one: {}.\n",
                named.join(", ")
            );
        }
        let nothing = |judgement: &Judgement| judgement.rows.iter().all(|row| row.possible_scenes == 0);
        let hopeless = self.categories.iter().filter(|(_, judgement)| nothing(judgement));
        let hopeless: Vec<_> = hopeless.map(|(name, of)| format!("{name} ({})", of.scenes)).collect();
        if !hopeless.is_empty() {
            let _ = writeln!(
                text,
                "Categories of which no scene counts for success rates, as none of the {} trials that know the joint succeeds with \
                 any primitive: {}.\n",
                self.config.informed,
                hopeless.join(", ")
            );
        }
        text
    }

    /// What the proposals do where they can do something.
    fn in_view_table(&self) -> String {
        let mut text = "\nThe same in those of these scenes in which a trial that knows the joint succeeds from where the \
             camera sees that nothing is. In the others every such success began behind what is seen, in a shut drawer or beyond \
             a window, where nobody comes from who stands where the camera stands.\n\n| primitive | scenes | top-1 | top-k |"
            .to_owned();
        text += &separator(4);
        for row in &self.total.rows {
            let _ = write!(text, "| {} | {} |", row.primitive, row.possible_in_view);
            let shown = [Contestant::TopOne, Contestant::TopK];
            for (_, rate) in row.rates_in_view.iter().filter(|(contestant, _)| shown.contains(contestant)) {
                let _ = write!(text, " {} |", rate.show());
            }
            text += "\n";
        }
        text
    }

    /// What came of the best proposals.
    fn fates_table(&self) -> String {
        let mut text = format!(
            "\nWhat came of the top-k proposals, %. Without a success: the hand came from behind or touched the object \
             before it moved (no approach); it pushed with the palm or at another part first (wrong touch); the part gives \
             in no direction within {:.0} degrees of the one intended (against the joint); it gives, but slipped or went \
             another way (no hold){}.\n\n| primitive | tries |",
            Verdict::MIN_DIRECTION_COSINE.acos().to_degrees(),
            if self.config.anywhere {
                "; the place was not on a part that moves (nothing moves)"
            } else {
                ""
            },
        );
        let of_all = |fate: Fate| self.total.rows.iter().map(move |row| row.count(fate)).sum::<u64>();
        let rare = [Fate::NothingMoves, Fate::NoProposal, Fate::Unstable];
        let shown: Vec<Fate> =
            Fate::ALL.into_iter().filter(|fate| !rare.contains(fate) || of_all(*fate) > 0).collect();
        for fate in &shown {
            let _ = write!(text, " {} |", fate.name());
        }
        text += &separator(2 + shown.len());
        for row in &self.total.rows {
            let tries: u64 = row.fates.iter().map(|(_, count)| count).sum();
            let _ = write!(text, "| {} | {tries} |", row.primitive);
            for fate in &shown {
                let share = 100.0 * row.count(*fate) as f64 / tries.max(1) as f64;
                let _ = write!(text, " {share:.0} |");
            }
            text += "\n";
        }
        text
    }

    /// How often trials of a score succeed.
    fn reliability_table(&self) -> String {
        let mut text =
            "\nThe same trials by score: mean score, share of successes (successes/trials):\n\n".to_owned();
        text += "| score |";
        for row in &self.total.rows {
            let _ = write!(text, " {} |", row.primitive);
        }
        text += &separator(1 + self.total.rows.len());
        let tenths = self.total.rows.first().map_or(0, |row| row.reliability.len());
        for tenth in 0..tenths {
            let from = tenth as f64 / tenths as f64;
            let _ = write!(text, "| {from:.1}-{:.1} |", from + 1.0 / tenths as f64);
            for Reliability { mean_score, outcome, .. } in
                self.total.rows.iter().filter_map(|row| row.reliability.get(tenth))
            {
                let Rate { successes, tries, rate, .. } = outcome;
                let _ = match tries {
                    0 => write!(text, " - |"),
                    _ => write!(text, " {mean_score:.2}, {:.0} % ({successes}/{tries}) |", 100.0 * rate),
                };
            }
            text += "\n";
        }
        text
    }
}

/// The end of a table's head and the line below it.
fn separator(columns: usize) -> String {
    format!("\n|{}\n", " --- |".repeat(columns))
}

impl Judgement {
    fn new(primitives: &[String], scenes: &[&SceneResult], seed: Seed) -> Self {
        let rows = primitives.iter().enumerate().map(|(p, primitive)| {
            let results: Vec<OfObject<'_>> =
                scenes.iter().map(|scene| (scene.object.as_str(), &scene.primitives[p])).collect();
            row(primitive, &results, seed.child("bootstrap", p as u64))
        });
        Self { scenes: scenes.len() as u64, rows: rows.collect() }
    }
}

impl Row {
    /// Best proposals that met this fate.
    fn count(&self, wanted: Fate) -> u64 {
        self.fates.iter().filter(|(fate, _)| *fate == wanted).map(|(_, count)| count).sum()
    }
}

/// What came of a primitive in a scene, and the scene's object.
type OfObject<'a> = (&'a str, &'a PrimitiveResult);

/// Success rate of each contestant in some scenes.
fn rates(scenes: &[OfObject<'_>]) -> Vec<(Contestant, Rate)> {
    let rate = |contestant: Contestant| {
        let mut objects: BTreeMap<&str, [u64; 2]> = BTreeMap::new();
        for (object, scene) in scenes {
            let [successes, tries] = objects.entry(object).or_default();
            for (_, outcomes) in scene.trials.iter().filter(|(who, _)| *who == contestant) {
                *successes += outcomes.iter().filter(|outcome| **outcome).count() as u64;
                *tries += outcomes.len() as u64;
            }
        }
        (contestant, Rate::of_objects(&objects.into_values().collect::<Vec<_>>()))
    };
    Contestant::ALL.map(rate).to_vec()
}

fn row(primitive: &str, results: &[OfObject<'_>], seed: Seed) -> Row {
    let possible: Vec<OfObject<'_>> = results.iter().copied().filter(|(_, r)| r.possible).collect();
    let in_view: Vec<OfObject<'_>> = possible.iter().copied().filter(|(_, r)| r.possible_in_view).collect();
    let fates = || possible.iter().flat_map(|(_, r)| &r.fates);
    let count = |fate: Fate| fates().filter(|f| **f == fate).count() as u64;
    let mut of_objects: BTreeMap<&str, Vec<(f32, bool)>> = BTreeMap::new();
    for (object, result) in results {
        of_objects.entry(object).or_default().extend(&result.scored);
    }
    let of_objects: Vec<_> = of_objects.into_values().collect();
    let scored = of_objects.concat();
    let (rows, calibration_error) = reliability(&of_objects);
    Row {
        primitive: primitive.to_owned(),
        possible_scenes: possible.len() as u64,
        rates: rates(&possible),
        possible_in_view: in_view.len() as u64,
        rates_in_view: rates(&in_view),
        fates: Fate::ALL.map(|fate| (fate, count(fate))).to_vec(),
        score: ScoreMetrics::new(&scored),
        f_score_interval: f_score_interval(&of_objects, &mut seed.rng()),
        reliability: rows,
        calibration_error,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn impossible_scenes_do_not_count_for_rates_but_for_the_score() {
        let scene = |possible: bool, success: bool| PrimitiveResult {
            possible,
            possible_in_view: success,
            trials: vec![(Contestant::TopOne, vec![success])],
            fates: vec![if success { Fate::Success } else { Fate::NoHold }],
            scored: vec![(0.9, success)],
        };
        let (a, b, c) = (scene(true, true), scene(true, false), scene(false, false));
        let row = row("pushing", &[("a", &a), ("b", &b), ("c", &c)], Seed(0));
        assert_eq!((row.possible_scenes, row.rates[0].1.successes, row.rates[0].1.tries), (2, 1, 2));
        assert_eq!(
            (row.possible_in_view, row.rates_in_view[0].1.successes, row.rates_in_view[0].1.tries),
            (1, 1, 1)
        );
        assert_eq!(row.score.trials, 3);
        assert_eq!(
            (row.count(Fate::Success), row.count(Fate::NoHold), row.count(Fate::NoApproach)),
            (1, 1, 0)
        );
    }
}
