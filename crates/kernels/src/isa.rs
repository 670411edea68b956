//! Choosing an instruction set at run time, once, for code written once.

use std::sync::OnceLock;

/// An instruction set that this processor is known to have.
///
/// A value can only be made by asking the processor, so holding one is the proof that the functions compiled
/// for it may be called.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Isa(Level);

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Level {
    Portable,
    #[cfg(target_arch = "x86_64")]
    Avx2,
    #[cfg(target_arch = "x86_64")]
    Avx512,
    /// AVX-512 with products of bf16.
    #[cfg(target_arch = "x86_64")]
    Bf16,
}

impl Isa {
    /// What the target guarantees: SSE2 on x86-64, NEON on AArch64.
    pub const PORTABLE: Self = Self(Level::Portable);

    /// The widest instruction set this processor has, unless the environment variable `WHERE2ACT_ISA` names a narrower
    /// one (`portable`, `avx2`; not `bf16`, which is asked for by [`Self::bf16`]): the switch with which tests and measurements force a path through a whole program.
    /// It is read once.
    pub fn best() -> Self {
        static BEST: OnceLock<Isa> = OnceLock::new();
        *BEST.get_or_init(|| Self::forced(std::env::var("WHERE2ACT_ISA").ok().as_deref()))
    }

    /// The instruction set of that name if this processor has it, else the widest.
    fn forced(name: Option<&str>) -> Self {
        Self::available().into_iter().find(|isa| Some(isa.name()) == name).unwrap_or_else(Self::widest)
    }

    fn widest() -> Self {
        #[cfg(target_arch = "x86_64")]
        {
            // The four AVX-512 parts belong together: with avx512f alone the compiler spills accumulators.
            if is_x86_feature_detected!("avx512f")
                && is_x86_feature_detected!("avx512vl")
                && is_x86_feature_detected!("avx512dq")
                && is_x86_feature_detected!("avx512bw")
                && is_x86_feature_detected!("fma")
            {
                return Self(Level::Avx512);
            }
            if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma") {
                return Self(Level::Avx2);
            }
        }
        Self::PORTABLE
    }

    /// AVX-512 with products of bf16: convolutions round what they multiply to 8 bits and add in f32. `None` where the
    /// processor does not have it or [`Self::best`] is something narrower.
    ///
    /// A Zen 5 of AMD does twice as many of these products a second as of f32, a Xeon of Intel with tiles for bf16 no more
    /// (both measured).
    pub fn bf16() -> Option<Self> {
        #[cfg(target_arch = "x86_64")]
        if Self::best() == Self(Level::Avx512) && is_x86_feature_detected!("avx512bf16") {
            return Some(Self(Level::Bf16));
        }
        None
    }

    /// The same instruction set with all products in f32.
    pub fn exact(self) -> Self {
        match self.0 {
            #[cfg(target_arch = "x86_64")]
            Level::Bf16 => Self(Level::Avx512),
            level => Self(level),
        }
    }

    /// Every instruction set this processor has with products in f32, the narrowest first: what tests and benchmarks walk through.
    pub fn available() -> Vec<Self> {
        let mut all = vec![Self::PORTABLE];
        #[cfg(target_arch = "x86_64")]
        {
            let widest = Self::widest();
            if widest != Self::PORTABLE {
                // A processor with AVX-512 has AVX2 and FMA as well.
                all.push(Self(Level::Avx2));
            }
            if widest == Self(Level::Avx512) {
                all.push(widest);
            }
        }
        all
    }

    /// The name in tables: `portable`, `avx2`, `avx512`, `bf16`.
    pub fn name(self) -> &'static str {
        match self.0 {
            Level::Portable => "portable",
            #[cfg(target_arch = "x86_64")]
            Level::Avx2 => "avx2",
            #[cfg(target_arch = "x86_64")]
            Level::Avx512 => "avx512",
            #[cfg(target_arch = "x86_64")]
            Level::Bf16 => "bf16",
        }
    }

    pub(crate) fn level(self) -> Level {
        self.0
    }
}

/// Compiles one function body for every instruction set. The function gets a first parameter of type [`Isa`]
/// that selects among the copies; the body must be plain code over fixed-width arrays that the compiler vectorises.
macro_rules! per_isa {
    ($(#[$meta:meta])* $vis:vis fn $name:ident $(<const $c:ident: $ct:ty>)? ($($arg:ident: $ty:ty),* $(,)?) $(-> $ret:ty)? $body:block) => {
        $(#[$meta])*
        #[allow(clippy::too_many_arguments, reason = "kernels take slices and sizes")]
        $vis fn $name $(<const $c: $ct>)? (isa: $crate::Isa, $($arg: $ty),*) $(-> $ret)? {
            #[inline(always)]
            #[allow(clippy::too_many_arguments, reason = "kernels take slices and sizes")]
            fn portable $(<const $c: $ct>)? ($($arg: $ty),*) $(-> $ret)? $body

            #[cfg(target_arch = "x86_64")]
            #[target_feature(enable = "avx2,fma")]
            #[allow(clippy::too_many_arguments, reason = "kernels take slices and sizes")]
            fn avx2 $(<const $c: $ct>)? ($($arg: $ty),*) $(-> $ret)? { portable $(::<$c>)? ($($arg),*) }

            #[cfg(target_arch = "x86_64")]
            #[target_feature(enable = "avx512f,avx512vl,avx512dq,avx512bw,fma")]
            #[allow(clippy::too_many_arguments, reason = "kernels take slices and sizes")]
            fn avx512 $(<const $c: $ct>)? ($($arg: $ty),*) $(-> $ret)? { portable $(::<$c>)? ($($arg),*) }

            match isa.level() {
                $crate::isa::Level::Portable => portable $(::<$c>)? ($($arg),*),
                // SAFETY: an `Isa` of this level exists only if the processor has these features.
                #[cfg(target_arch = "x86_64")]
                $crate::isa::Level::Avx2 => unsafe { avx2 $(::<$c>)? ($($arg),*) },
                // SAFETY: as above.
                #[cfg(target_arch = "x86_64")]
                $crate::isa::Level::Avx512 | $crate::isa::Level::Bf16 => unsafe { avx512 $(::<$c>)? ($($arg),*) },
            }
        }
    };
}
pub(crate) use per_isa;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_forces_its_path_and_no_other_does() {
        for isa in Isa::available() {
            assert_eq!(Isa::forced(Some(isa.name())), isa);
        }
        let widest = Isa::available().pop();
        assert_eq!(Some(Isa::forced(None)), widest);
        assert_eq!(Some(Isa::forced(Some("avx1024"))), widest);
    }
}
