//! Which configurations can be used.

use std::path::{Path, PathBuf};

use where2act_core::shard::DEPTH_SIDE;
use where2act_model::Modality;
use where2act_sim::collect::ObjectSet;

use super::{AdaptiveConfig, Arithmetic, Decay, NetworkConfig, ScheduleConfig, TeacherConfig, TrainConfig};

/// A configuration that cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum ConfigError {
    /// It cannot be read.
    #[error("{}: {source}", path.display())]
    Io {
        /// Which file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// It is not TOML, or has unknown or missing fields.
    #[error("{}: {why}", path.display())]
    Syntax {
        /// Which file.
        path: PathBuf,
        /// Where and why.
        why: String,
    },
    /// A value makes no sense.
    #[error("configuration: {field} is {found}, expected {expected}")]
    Value {
        /// Which field.
        field: &'static str,
        /// What it is.
        found: String,
        /// What it should be.
        expected: &'static str,
    },
    /// A file is its own base, or that of one of its bases.
    #[error("{}: base goes round in a circle", .0.display())]
    Circle(PathBuf),
    /// The network's part makes no sense.
    #[error(transparent)]
    Network(#[from] where2act_model::ConfigError),
}

impl ConfigError {
    pub(super) fn syntax(path: &Path, error: &toml::de::Error) -> Self {
        let why = error.to_string().split_whitespace().collect::<Vec<_>>().join(" ");
        Self::Syntax { path: path.to_owned(), why }
    }
}

type Checked = Result<(), ConfigError>;

fn check(ok: bool, field: &'static str, found: impl ToString, expected: &'static str) -> Checked {
    if ok { Ok(()) } else { Err(ConfigError::Value { field, found: found.to_string(), expected }) }
}

fn check_share(field: &'static str, share: f32) -> Checked {
    check((0.0..=1.0).contains(&share), field, share, "0 to 1")
}

impl TrainConfig {
    /// Checks every value.
    ///
    /// # Errors
    /// [`ConfigError::Value`] for the first that makes no sense.
    pub fn validate(&self) -> Result<(), ConfigError> {
        self.model().validate()?;
        check(!self.name.is_empty(), "name", "\"\"", "at least one letter")?;
        let sees = self.network.close_up.is_none() || self.network.modality == Modality::Rgb;
        check(sees, "network.close_up", "a margin", "none, as it is for pictures")?;
        let side = self.network.image_side;
        check(side <= DEPTH_SIDE, "network.image_side", side, "at most 448, the side of what is rendered")?;
        self.check_encoder()?;
        self.check_teacher()?;
        self.check_batch()?;
        self.check_schedule()?;
        self.check_loss()?;
        self.check_trials()
    }

    fn check_encoder(&self) -> Checked {
        let Some(encoder) = &self.encoder else { return Ok(()) };
        check(self.from.is_none(), "encoder", encoder.display(), "no file, as from names all weights")?;
        let NetworkConfig { modality, width, .. } = self.network;
        let of_pictures = modality == Modality::Rgb;
        check(of_pictures, "network.modality", "cloud", "rgb, as encoder is a ResNet-18")?;
        check(width == 1.0, "network.width", width, "1, as encoder is a ResNet-18")
    }

    fn check_teacher(&self) -> Checked {
        let Some(TeacherConfig { weights, places, weight }) = &self.teacher else { return Ok(()) };
        let of_pictures = self.network.modality == Modality::Rgb;
        check(of_pictures, "teacher.weights", weights.display(), "none, as only pictures are taught")?;
        check((1..=10_000).contains(places), "teacher.places", places, "1 to 10000")?;
        check(*weight > 0.0 && weight.is_finite(), "teacher.weight", weight, "more than 0")
    }

    fn check_batch(&self) -> Checked {
        let batch = &self.batch;
        check((1..=1024).contains(&batch.views), "batch.views", batch.views, "1 to 1024")?;
        let trials = batch.trials_per_view;
        check((1..=100_000).contains(&trials), "batch.trials_per_view", trials, "1 to 100000")?;
        for (field, share) in [
            ("batch.flipped", batch.flipped),
            ("batch.fixed", batch.fixed),
            ("batch.mirrored", batch.mirrored),
            ("batch.rolled", batch.rolled),
            ("batch.measured", batch.measured),
        ] {
            check_share(field, share)?;
        }
        let looks = batch.looks_per_view;
        let asked = looks > 0 || self.schedule.look_steps == 0;
        check(asked, "batch.looks_per_view", looks, "at least 1, as schedule.look_steps asks for looks")
    }

    fn check_schedule(&self) -> Checked {
        let ScheduleConfig { score_steps, joint_steps, epoch_steps, rate, trial_rate, weight_decay, .. } =
            self.schedule;
        let of_pictures = self.network.modality == Modality::Rgb;
        let precise = self.schedule.precision == Arithmetic::F32 || of_pictures;
        check(precise, "schedule.precision", "bf16", "f32, as it is for scans")?;
        check(self.steps() > 0, "schedule", "0 steps", "at least one step")?;
        // Proposals and actionability are learnt with all heads alone: without such steps there is nothing to keep.
        let kept = joint_steps > 0 || score_steps == 0;
        check(kept, "schedule.joint_steps", 0, "at least 1 after schedule.score_steps")?;
        check(epoch_steps > 0, "schedule.epoch_steps", 0, "at least 1")?;
        let falls = (0.0..1.0).contains(&weight_decay);
        check(falls, "schedule.weight_decay", weight_decay, "0 or more and less than 1")?;
        if let Decay::Step { steps, factor } = self.schedule.decay {
            check(steps > 0, "schedule.decay.step.steps", 0, "at least 1")?;
            let falls = factor > 0.0 && factor <= 1.0;
            check(falls, "schedule.decay.step.factor", factor, "more than 0, at most 1")?;
        }
        for (field, rate) in [("schedule.rate", rate), ("schedule.trial_rate", trial_rate.unwrap_or(rate))] {
            check(rate > 0.0 && rate < 1.0, field, rate, "more than 0 and less than 1")?;
        }
        Ok(())
    }

    fn check_loss(&self) -> Checked {
        let (loss, looks) = (&self.loss, self.schedule.look_steps);
        for (field, weight) in [
            ("loss.score", loss.score),
            ("loss.geodesic", loss.geodesic),
            ("loss.kl", loss.kl),
            ("loss.actionability", loss.actionability),
            ("loss.motion", loss.motion),
            ("loss.normal", loss.normal),
        ] {
            check(weight >= 0.0 && weight.is_finite(), field, weight, "0 or more")?;
        }
        check((1..=10_000).contains(&loss.proposals), "loss.proposals", loss.proposals, "1 to 10000")?;
        check(loss.best <= loss.proposals, "loss.best", loss.best, "at most loss.proposals")?;
        let asks = loss.motion + loss.normal > 0.0 || looks == 0;
        check(asks, "schedule.look_steps", looks, "0 without loss.motion or loss.normal")?;
        let answers = loss.motion == 0.0 || self.network.ways.is_some();
        check(answers, "network.ways", "none", "a number, as loss.motion asks for ways")?;
        // A head that never learns would have a say in every score.
        let learns = loss.motion > 0.0 || self.network.ways.is_none_or(|ways| ways == 0.0);
        check(learns, "loss.motion", 0, "more than 0, as network.ways counts in scores")
    }

    fn check_trials(&self) -> Checked {
        let AdaptiveConfig { enabled, trials, own, buffer, newest, .. } = self.adaptive;
        check_share("adaptive.own", own)?;
        check_share("adaptive.newest", newest)?;
        check(!enabled || buffer >= trials, "adaptive.buffer", buffer, "at least adaptive.trials")?;
        check_share("collect.guided", self.collect.guided)?;
        check_share("collect.close", self.collect.close)?;
        let objects = self.collect.look_objects;
        let fits = (1..=ObjectSet::TEST_SEEDS.start).contains(&objects);
        check(fits, "collect.look_objects", objects, "at least 1, and none that judges")?;
        check(self.collect.scenes > 0, "collect.scenes", 0, "at least 1")
    }
}

#[cfg(test)]
mod tests {
    use crate::config::tests::{load, minimal};

    #[test]
    fn a_wrong_value_or_an_unknown_field_is_named() {
        for (extra, named) in [
            ("[batch]\nviews = 0\n", "batch.views"),
            ("[batch]\nvievs = 3\n", "vievs"),
            ("[loss]\nkl = -1.0\n", "loss.kl"),
            ("look_steps = 3\n", "schedule.look_steps"),
            ("[collect]\nguided = 2.0\n", "collect.guided"),
            ("[collect]\nclose = -0.5\n", "collect.close"),
            ("[batch]\nflipped = 3.0\n", "batch.flipped"),
            ("look_steps = 3\n[loss]\nnormal = 1.0\n[batch]\nlooks_per_view = 0\n", "batch.looks_per_view"),
            ("weight_decay = -1.0\n", "schedule.weight_decay"),
            ("decay = { step = { steps = 3, factor = 1.5 } }\n", "schedule.decay.step.factor"),
            ("decay = { step = { steps = 0, factor = 0.9 } }\n", "schedule.decay.step.steps"),
            ("[adaptive]\nenabled = true\nbuffer = 3\n", "adaptive.buffer"),
            ("[collect]\nlook_objects = 0\n", "collect.look_objects"),
            ("[collect]\nlook_objects = 1000001\n", "collect.look_objects"),
            ("[collect]\nscenes = 0\n", "collect.scenes"),
            ("[adaptive]\nnewest = 1.5\n", "adaptive.newest"),
        ] {
            let error = load(&(minimal() + extra)).unwrap_err().to_string();
            assert!(error.contains(named) && !error.contains('\n'), "{error}");
        }
        for (side, named) in [(480, "network.image_side"), (225, "a multiple of 32")] {
            let error = load(&minimal().replace("[network]\n", &format!("[network]\nimage_side = {side}\n")));
            assert!(error.as_ref().is_err_and(|e| e.to_string().contains(named)), "{error:?}");
        }
        let close_up_of_scans = minimal().replace("[network]\n", "[network]\nclose_up = 1.1\n");
        let error = load(&close_up_of_scans).unwrap_err().to_string();
        assert!(error.contains("network.close_up"), "{error}");
    }
}
