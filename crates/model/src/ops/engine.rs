//! Which implementation computes a training step.

use std::cell::Cell;

use where2act_kernels::Isa;

/// Who computes convolutions, batch-norms and point layers in training.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum TrainingEngine {
    /// Our kernels wherever they apply, burn's elsewhere.
    #[default]
    Fast,
    /// The same with convolutions that multiply in bf16 and add in f32, gradients too, where the processor has it in AVX-512
    /// ([`Isa::bf16`]), in f32 elsewhere. Weights, activations and what the optimiser remembers stay f32.
    Bf16,
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

    /// The instruction set of its convolutions.
    pub(super) fn isa(self) -> Isa {
        if self == Self::Bf16 { Isa::bf16().unwrap_or_else(Isa::best) } else { Isa::best() }
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
            "bf16" => Ok(Self::Bf16),
            "burn" => Ok(Self::Burn),
            _ => Err(format!("expected fast, bf16 or burn, found {name}")),
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
