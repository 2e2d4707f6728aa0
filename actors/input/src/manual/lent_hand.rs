//! A hand that was handed over to another station: this one's person follows it, so that it goes on from where it is when it
//! comes back, and not to where the person left it.

use nalgebra::Vector3;
use trocar_scene::{
    DeviceState, Entity, MentorAnswer, SimTime, Snapshot, StationRole, TakeOverRequest, TakeOverStep,
};

/// How long a hand that has come has to be at rest: it is brought to where the other side has it.
const REST: SimTime = SimTime::from_millis(60);
/// Longest time for that, and the least.
const SETTLING_MAX: SimTime = SimTime::from_millis(2_500);
const SETTLING_MIN: SimTime = SimTime::from_millis(150);
/// What counts as rest within a tick \[m\].
const STILL: f64 = 2e-6;

/// Whether a hand's person has to follow it.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct LentHand {
    is_elsewhere: bool,
    /// Since when it has been here again, and is brought to its place.
    settling_since: Option<SimTime>,
    /// Where it was, and since when it has been there.
    rest: Option<(Vector3<f64>, SimTime)>,
}

impl LentHand {
    /// Whether the person follows the hand now, as its device shows it.
    pub fn is_followed(&mut self, now: SimTime, is_elsewhere: bool, state: &DeviceState) -> bool {
        if self.is_elsewhere && !is_elsewhere {
            (self.settling_since, self.rest) = (Some(now), None);
        }
        self.is_elsewhere = is_elsewhere;
        if is_elsewhere {
            return true;
        }
        let Some(since) = self.settling_since else { return false };
        let place = state.handle_in_device.translation;
        let rests_since = match self.rest {
            Some((before, since)) if (place - before).norm() <= STILL => since,
            _ => now,
        };
        self.rest = Some((place, rests_since));
        let settles_for = now.since(since);
        let is_at_rest = settles_for >= SETTLING_MIN && now.since(rests_since) >= REST;
        if is_at_rest || settles_for >= SETTLING_MAX {
            self.settling_since = None;
        }
        self.settling_since.is_some()
    }
}

/// Whether another station moves the hand: it was handed over, or this is a mentor's station and it was not.
pub(super) fn is_elsewhere(scene: &Snapshot, hand: Entity, station: u16) -> bool {
    match scene.get::<TakeOverRequest>(hand) {
        Some(TakeOverRequest { by, step: TakeOverStep::Accepted, .. }) => by.station != station,
        _ => {
            let own = MentorAnswer::of(scene).filter(|answer| answer.station == station);
            own.is_some_and(|answer| answer.role == Some(StationRole::Mentor))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(x: f64) -> DeviceState {
        let mut state = DeviceState::default();
        state.handle_in_device.translation.x = x;
        state
    }

    #[test]
    fn a_hand_that_comes_back_is_followed_until_it_is_at_rest_where_it_is_brought() {
        let mut lent = LentHand::default();
        let mut now = SimTime::ZERO;
        let mut tick = |is_elsewhere, x: f64| {
            now += SimTime::from_millis(10);
            lent.is_followed(now, is_elsewhere, &at(x))
        };
        assert!(!tick(false, 0.0), "it was never away");
        assert!((0..100).all(|step| tick(true, f64::from(step) * 1e-3)));
        // Back, and on its way for 300 ms.
        assert!((0..30).all(|step| tick(false, 0.1 + f64::from(step) * 1e-3)));
        let rested = (0..20).take_while(|_| tick(false, 0.2)).count();
        assert_eq!(rested, 6, "60 ms after its last motion");
        assert!(!tick(false, 0.3), "from then on the person leads");
    }

    #[test]
    fn one_that_never_rests_is_the_persons_in_the_end() {
        let mut lent = LentHand::default();
        let mut now = SimTime::ZERO;
        lent.is_followed(now, true, &at(0.0));
        let mut moves = || {
            now += SimTime::from_millis(10);
            lent.is_followed(now, false, &at(now.as_secs_f64()))
        };
        let followed = (0..1_000).take_while(|_| moves()).count();
        assert_eq!(followed, 250);
    }
}
