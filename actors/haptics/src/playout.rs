//! Playout: an instrument's target, a fixed time after the hand was there.
//!
//! Among peers each computes the scene for itself, and so all move an instrument by its hand at the same time, which is that
//! much later than the hand was there. What the hand feels is rendered at its present pose and waits for nobody.

use std::collections::VecDeque;

use trocar_scene::{InstrumentTarget, SimTime};

/// Longest time that a target waits \[s\].
pub const PLAYOUT_SECS_MAX: f64 = 1.0;
/// Most targets that wait: those of the longest time at the highest rate.
const WAITING_MAX: usize = 10_240;

/// The targets of one instrument that wait for their time.
#[derive(Clone, Debug)]
pub(crate) struct TargetPlayout {
    delay: SimTime,
    /// By the time at which the hand was there, ascending.
    waiting: VecDeque<(SimTime, InstrumentTarget)>,
}

impl TargetPlayout {
    pub fn new(delay: SimTime) -> Self {
        let most = (delay.as_secs_f64() / PLAYOUT_SECS_MAX * WAITING_MAX as f64).ceil() as usize;
        Self { delay, waiting: VecDeque::with_capacity(most.min(WAITING_MAX)) }
    }

    /// Takes the target of a hand that was there at `measured_at`, and returns the one whose time has come at `now`.
    /// `None` before that of the first.
    pub fn pass(
        &mut self,
        now: SimTime,
        measured_at: SimTime,
        target: InstrumentTarget,
    ) -> Option<InstrumentTarget> {
        if self.delay == SimTime::ZERO {
            return Some(target);
        }
        if self.waiting.back().is_none_or(|(newest, _)| *newest < measured_at) {
            if self.waiting.len() == self.waiting.capacity() {
                self.waiting.pop_front();
            }
            self.waiting.push_back((measured_at, target));
        }
        let at = SimTime(now.as_nanos().checked_sub(self.delay.as_nanos())?);
        while self.waiting.get(1).is_some_and(|(next, _)| *next <= at) {
            self.waiting.pop_front();
        }
        self.waiting.front().filter(|(first, _)| *first <= at).map(|(_, target)| *target)
    }

    /// Whoever moves the hand has let it go.
    pub fn clear(&mut self) {
        self.waiting.clear();
    }
}

#[cfg(test)]
mod tests {
    use trocar_scene::Pose;

    use super::*;

    fn target(x: f64) -> InstrumentTarget {
        InstrumentTarget { tip_in_world: Pose::at(x, 0.0, 0.0), ..InstrumentTarget::default() }
    }

    fn passed(playout: &mut TargetPlayout, now: u64, measured: u64) -> Option<f64> {
        let (now, measured_at) = (SimTime::from_millis(now), SimTime::from_millis(measured));
        playout
            .pass(now, measured_at, target(measured as f64))
            .map(|target| target.tip_in_world.translation.x)
    }

    #[test]
    fn a_hand_that_is_here_moves_the_instrument_when_one_that_came_late_does() {
        let delay = SimTime::from_millis(100);
        let (mut here, mut late) = (TargetPlayout::new(delay), TargetPlayout::new(delay));
        for now in 1..400 {
            let own = passed(&mut here, now, now);
            // Its own station's playout has brought it after just that time.
            let other = (now >= 100).then(|| passed(&mut late, now, now - 100)).flatten();
            let expected = (now >= 101).then(|| (now - 100) as f64);
            assert_eq!(own, expected, "{now}");
            assert!(now < 101 || other == expected, "{now}: {other:?}");
        }
        assert!(here.waiting.len() <= 102 && late.waiting.len() <= 2);
    }

    #[test]
    fn without_a_delay_nothing_waits() {
        let mut playout = TargetPlayout::new(SimTime::ZERO);
        assert_eq!(passed(&mut playout, 5, 5), Some(5.0));
        assert!(playout.waiting.is_empty());
    }
}
