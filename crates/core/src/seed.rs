//! Randomness is passed in and derived, never global.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

/// The root of all randomness of a piece of work. Every scene and trial derives its own generator from it, so
/// results do not depend on threads, on resumption or on how work is split over machines.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Seed(pub u64);

impl Seed {
    /// The seed of a named, numbered part of the work: `seed.child("scene", 17)`.
    #[must_use]
    pub fn child(self, purpose: &str, index: u64) -> Self {
        let mut state = mix(self.0 ^ 0x9e37_79b9_7f4a_7c15);
        for byte in purpose.bytes() {
            state = mix(state ^ u64::from(byte));
        }
        Self(mix(state ^ index))
    }

    /// The generator for this seed. ChaCha's output is specified, so it stays the same over versions and machines.
    #[must_use]
    pub fn rng(self) -> ChaCha8Rng {
        ChaCha8Rng::seed_from_u64(self.0)
    }
}

/// The finaliser of SplitMix64 (Steele, Lea and Flood, 2014) after one step of its counter.
fn mix(x: u64) -> u64 {
    let x = x.wrapping_add(0x9e37_79b9_7f4a_7c15);
    let x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    x ^ (x >> 31)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::Rng;

    #[test]
    fn children_differ_by_purpose_and_index_and_stay_the_same() {
        let seed = Seed(1);
        let mut seen: Vec<u64> = (0..1000).map(|i| seed.child("scene", i).0).collect();
        seen.extend((0..1000).map(|i| seed.child("trial", i).0));
        seen.sort_unstable();
        seen.dedup();
        assert_eq!(seen.len(), 2000);
        assert_eq!(seed.child("scene", 3).rng().next_u64(), seed.child("scene", 3).rng().next_u64());
    }
}
