//! Newer trials on train scenes, up to a number; older ones are forgotten first.

use std::collections::{HashSet, VecDeque};

use serde::{Deserialize, Serialize};
use where2act_core::{Primitive, Trial};

use crate::dataset::SceneId;

/// A bounded buffer of trials by scene.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Replay {
    capacity: usize,
    /// In the order they came.
    held: VecDeque<(SceneId, Vec<Trial>)>,
}

impl Replay {
    /// An empty buffer for so many trials.
    #[must_use]
    pub fn new(capacity: usize) -> Self {
        Self { capacity, ..Self::default() }
    }

    /// Adds trials of a scene and forgets the oldest beyond the capacity.
    pub fn add(&mut self, scene: SceneId, trials: Vec<Trial>) {
        self.held.push_back((scene, trials));
        while self.len() > self.capacity {
            self.held.pop_front();
        }
    }

    /// Adds what another buffer holds and this one does not.
    pub fn extend(&mut self, other: Self) {
        for (scene, mut trials) in other.held {
            trials.retain(|new| self.trials(scene).all(|held| held != *new));
            self.add(scene, trials);
        }
    }

    /// Trials held for a scene.
    pub fn trials(&self, scene: SceneId) -> impl Iterator<Item = Trial> + '_ {
        self.held.iter().filter(move |(id, _)| *id == scene).flat_map(|(_, trials)| trials.iter().copied())
    }

    /// Scenes with trials of any of these primitives.
    #[must_use]
    pub fn scenes(&self, primitives: &[Primitive]) -> HashSet<SceneId> {
        let wanted = |trials: &[Trial]| trials.iter().any(|trial| primitives.contains(&trial.primitive));
        self.held.iter().filter(|(_, trials)| wanted(trials)).map(|(id, _)| *id).collect()
    }

    /// Scenes of the last additions, each once.
    #[must_use]
    pub fn newest(&self, additions: usize) -> Vec<SceneId> {
        let mut seen = HashSet::new();
        let last = self.held.iter().rev().take(additions).map(|(id, _)| *id);
        last.filter(|id| seen.insert(*id)).collect()
    }

    /// Trials held in all.
    #[must_use]
    pub fn len(&self) -> usize {
        self.held.iter().map(|(_, trials)| trials.len()).sum()
    }

    /// Whether there are none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.held.iter().all(|(_, trials)| trials.is_empty())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Point3, Vector3};
    use where2act_core::{Grasp, Pixel, Policy, Verdict};

    fn trial(u: u32) -> Trial {
        Trial {
            primitive: Primitive::Pushing,
            policy: Policy::Adaptive,
            pixel: Pixel { u, v: 0 },
            link: 1,
            grasp_in_camera: Grasp::new(Point3::origin(), Vector3::z(), Vector3::x()),
            verdict: Verdict {
                invalid: None,
                q_start: 0.0,
                q_end: 0.0,
                motion: Vector3::zeros(),
                success: false,
            },
        }
    }

    #[test]
    fn the_oldest_are_forgotten_first() {
        let (a, b) = (SceneId { shard: 0, scene: 0 }, SceneId { shard: 0, scene: 1 });
        let mut replay = Replay::new(5);
        replay.add(a, vec![trial(1), trial(2)]);
        replay.add(b, vec![trial(3), trial(4)]);
        replay.add(a, vec![trial(5), trial(6)]);
        assert_eq!(replay.len(), 4);
        assert_eq!(replay.trials(a).map(|t| t.pixel.u).collect::<Vec<_>>(), vec![5, 6]);
        assert_eq!(replay.trials(b).count(), 2);
        assert_eq!(replay.scenes(&[Primitive::Pushing, Primitive::Pulling]), [a, b].into());
        assert!(replay.scenes(&[Primitive::Pulling]).is_empty());
        assert_eq!((replay.newest(1), replay.newest(2), replay.newest(9)), (vec![a], vec![a, b], vec![a, b]));
        let mut smaller = Replay::new(3);
        smaller.extend(replay.clone());
        assert_eq!((smaller.len(), smaller.trials(a).count()), (2, 2));
        let mut both = Replay::new(100);
        both.add(b, vec![trial(4), trial(7)]);
        both.extend(replay);
        assert_eq!(both.trials(b).map(|t| t.pixel.u).collect::<Vec<_>>(), vec![4, 7, 3], "none twice");
    }
}
