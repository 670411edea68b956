//! Which implementation computes a training step.

use std::cell::Cell;

/// Who computes convolutions, batch-norms and point layers in training.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum TrainingEngine {
    /// Our kernels wherever they apply, burn's elsewhere.
    #[default]
    Fast,
    /// burn's own operations only: what the kernels are tested against.
    Burn,
}

thread_local! {
    static CHOSEN: Cell<TrainingEngine> = const { Cell::new(TrainingEngine::Fast) };
}

impl TrainingEngine {
    /// Builds a computation with this engine, on this thread: `TrainingEngine::Burn.scope(|| network.features_at(...))`.
    /// The backward pass follows the forward pass.
    pub fn scope<R>(self, f: impl FnOnce() -> R) -> R {
        /// Restores the engine also when `f` panics.
        struct Restore(TrainingEngine);
        impl Drop for Restore {
            fn drop(&mut self) {
                CHOSEN.set(self.0);
            }
        }
        let _restore = Restore(CHOSEN.replace(self));
        f()
    }

    /// The engine of the innermost [`TrainingEngine::scope`], [`TrainingEngine::Fast`] outside any.
    pub fn current() -> Self {
        CHOSEN.get()
    }
}

impl std::str::FromStr for TrainingEngine {
    type Err = String;
    fn from_str(name: &str) -> Result<Self, Self::Err> {
        match name {
            "fast" => Ok(Self::Fast),
            "burn" => Ok(Self::Burn),
            _ => Err(format!("expected fast or burn, found {name}")),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scopes_nest_and_end() {
        assert_eq!(TrainingEngine::current(), TrainingEngine::Fast);
        TrainingEngine::Burn.scope(|| {
            assert_eq!(TrainingEngine::current(), TrainingEngine::Burn);
            TrainingEngine::Fast.scope(|| assert_eq!(TrainingEngine::current(), TrainingEngine::Fast));
            assert_eq!(TrainingEngine::current(), TrainingEngine::Burn);
        });
        assert_eq!(TrainingEngine::current(), TrainingEngine::Fast);
    }
}
