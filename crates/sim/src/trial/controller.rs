//! Drives a hand through the stages of a motion.

use nalgebra::{Isometry3, Vector3};
use where2act_core::{Invalid, Motion, Stage};

use super::{Mode, Moment, Observer, Rules};
use crate::physics::{Hand, World};
use crate::scene::SettledScene;

/// Time between two corrections of the hand's velocity: 100 steps at 500 Hz (published).
const CORRECTION_SECS: f32 = 0.2;
/// Window over which a wait must show motion to go on (fast mode), and the least motion: metres, radians, and
/// tenths of radians for the hand's turn. Velocities would not do: contacts jitter.
const QUIET_SECS: f32 = 0.2;
const QUIET_MOTION: f32 = 2e-5;

/// A world with a hand in it that follows a motion.
pub(super) struct Controller<'a> {
    pub(super) world: World,
    hand: Hand,
    mode: Mode,
    motion: Motion,
    steps: usize,
    observer: Option<Observer<'a>>,
}

impl<'a> Controller<'a> {
    pub(super) fn new(
        scene: &SettledScene,
        mode: Mode,
        motion: Motion,
        observer: Option<Observer<'a>>,
    ) -> Self {
        let mut world = scene.world(mode.hz());
        let hand = world.add_hand(&motion.start, motion.fingers);
        Self { world, hand, mode, motion, steps: 0, observer }
    }

    /// Goes through all stages, or as far as the rules allow.
    pub(super) fn follow(&mut self, rules: &mut Rules) -> Result<(), Invalid> {
        self.observe();
        if self.world.overlaps(&self.hand) {
            return Err(Invalid::InitialContact);
        }
        self.step(rules)?;
        let stages = std::mem::take(&mut self.motion.stages);
        for (number, stage) in stages.iter().enumerate() {
            match stage {
                Stage::Move { hand, secs } => {
                    let skipped = if number == 0 && self.mode == Mode::Fast {
                        self.skip_free_air(hand, *secs)
                    } else {
                        0
                    };
                    self.go(hand, skipped..self.count(*secs), rules)?;
                }
                Stage::Wait { secs } => self.wait(*secs, rules)?,
                Stage::Close { secs } => {
                    self.hand.set_opening(&mut self.world, 0.0);
                    self.wait(*secs, rules)?;
                }
            }
        }
        Ok(())
    }

    fn count(&self, secs: f32) -> usize {
        (secs * self.mode.hz()).round() as usize
    }

    fn step(&mut self, rules: &mut Rules) -> Result<(), Invalid> {
        self.world.step();
        self.steps += 1;
        self.observe();
        rules.check(&self.world, self.steps == 1)
    }

    /// Moves to `goal` so as to be there after the last of `steps`.
    fn go(
        &mut self,
        goal: &Isometry3<f32>,
        steps: std::ops::Range<usize>,
        rules: &mut Rules,
    ) -> Result<(), Invalid> {
        let between = self.count(CORRECTION_SECS);
        for step in steps.clone() {
            if step % between == 0 {
                let left = (steps.end - step) as f32 * self.world.dt();
                let now = self.world.hand_pose(&self.hand).hand;
                let linear = (goal.translation.vector - now.translation.vector) / left;
                let angular = (goal.rotation * now.rotation.inverse()).scaled_axis() / left;
                self.hand.set_velocity(
                    &mut self.world,
                    [linear.x, linear.y, linear.z, angular.x, angular.y, angular.z],
                );
            }
            self.hand.advance_target(&mut self.world);
            self.step(rules)?;
        }
        Ok(())
    }

    /// Stands still; in fast mode only as long as anything moves.
    fn wait(&mut self, secs: f32, rules: &mut Rules) -> Result<(), Invalid> {
        self.hand.set_velocity(&mut self.world, [0.0; 6]);
        let window = self.count(QUIET_SECS);
        let mut before = self.coordinates();
        for step in 1..=self.count(secs) {
            self.step(rules)?;
            if self.mode == Mode::Fast && step % window == 0 {
                let now = self.coordinates();
                if before.iter().zip(&now).all(|(a, b)| (a - b).abs() < QUIET_MOTION) {
                    break;
                }
                before = now;
            }
        }
        Ok(())
    }

    /// Jumps over the part of the approach that meets nothing; returns the steps it saves.
    fn skip_free_air(&mut self, goal: &Isometry3<f32>, secs: f32) -> usize {
        let (steps, between) = (self.count(secs), self.count(CORRECTION_SECS));
        let way: Vector3<f32> = goal.translation.vector - self.motion.start.translation.vector;
        let free = self.hand.free_share(&self.world, &way);
        let corrections = (free * steps as f32) as usize / between;
        let skipped = (corrections * between).min(steps - between);
        if skipped > 0 {
            let share = skipped as f32 / steps as f32;
            self.hand.jump(&mut self.world, &(way * share), &(way / secs));
        }
        skipped
    }

    /// Everything that can move, in metres and radians.
    fn coordinates(&self) -> Vec<f32> {
        let pose = self.world.hand_pose(&self.hand);
        let mut all = self.world.all_q();
        for part in [pose.hand, pose.fingers[0], pose.fingers[1]] {
            all.extend(part.translation.vector.iter());
            all.extend((part.rotation.scaled_axis() * 0.1).iter());
        }
        all
    }

    pub(super) fn observe(&mut self) {
        let Some(observer) = &mut self.observer else { return };
        if self.steps.is_multiple_of(observer.every.max(1)) {
            let pose = self.world.hand_pose(&self.hand);
            (observer.look)(&Moment {
                step: self.steps,
                world_from_links: self.world.world_from_links(),
                world_from_hand: pose.hand,
                world_from_fingers: pose.fingers,
            });
        }
    }
}
