//! Receiver belief: what the other side may hold, with which probability, and whether that is still good
//! enough.
//!
//! Error-resilient perceptual coding (Brandi, Kammerl and Steinbach, "Error-resilient perceptual coding for
//! networked haptic interaction", 2010). A sender that transmits changes only does not know which of its
//! datagrams got lost, so it keeps the last ones as candidates. The newest that arrived is what the receiver
//! holds: the newest candidate with probability `1 − p` where `p` is the loss, the one before it with
//! `p (1 − p)`, and so on. The sum over the candidates from which the hand differs noticeably is the probability that
//! the receiver is wrong; when it exceeds a bound, the hand is sent again. An echo makes a candidate certain,
//! and those before it meaningless.
//!
//! Losses count as independent. Through a burst of them the receiver is wrong for as long as the burst lasts
//! and until the next heartbeat, or the next change.

use trocar_scene::SimTime;

use super::deadband::{Deadband, Deviation};
use crate::datagram::HANDS_MAX;
use crate::hand_sample::HandSample;

/// Datagrams that are kept. With half of them lost, the chance that none of them arrived is 1 in 65,536.
pub const CANDIDATES: usize = 16;
/// Least and greatest loss that is reckoned with.
const LOSS: [f64; 2] = [1e-3, 0.5];
/// Loss before any is known.
const LOSS_FIRST: f64 = 0.01;
/// A probability up to which the receiver may be wrong about a quantity with a band: at less loss than this,
/// a hand is sent once.
pub const WRONG_BANDS: f64 = 0.05;
/// The same of buttons, what is held, and whether a device is connected.
pub const WRONG_DISCRETE: f64 = 1e-3;

/// A datagram that the receiver may hold.
#[derive(Clone, Copy, Debug)]
struct Candidate {
    sent_at: SimTime,
    samples: [HandSample; HANDS_MAX],
    count: usize,
    /// Known to have arrived, or not to have.
    arrived: Option<bool>,
}

/// What the receiver is probably wrong about.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Wrong {
    /// Probability that a quantity with a band, or one without, differs noticeably.
    pub noticed: f64,
    /// Probability that one without a band differs.
    pub discrete: f64,
}

impl Wrong {
    /// Whether either is more than may be.
    pub fn is_too_likely(&self) -> bool {
        self.noticed > WRONG_BANDS || self.discrete > WRONG_DISCRETE
    }
}

/// What the receiver of all hands of a station may hold. Does not allocate after it was made.
#[derive(Clone, Debug)]
pub struct ReceiverBelief {
    /// A ring.
    candidates: Box<[Candidate; CANDIDATES]>,
    /// Place of the newest candidate.
    newest: usize,
    count: usize,
    loss: f64,
}

impl Default for ReceiverBelief {
    fn default() -> Self {
        let samples = [HandSample::unknown(0); HANDS_MAX];
        let none = Candidate { sent_at: SimTime::ZERO, samples, count: 0, arrived: None };
        Self { candidates: Box::new([none; CANDIDATES]), newest: 0, count: 0, loss: LOSS_FIRST }
    }
}

impl ReceiverBelief {
    /// The share of datagrams that is lost, as reported; a quarter of each report counts.
    pub fn note_loss(&mut self, loss: f64) {
        if loss.is_finite() {
            self.loss = (self.loss + 0.25 * (loss - self.loss)).clamp(LOSS[0], LOSS[1]);
        }
    }

    /// The loss that is reckoned with.
    pub fn loss(&self) -> f64 {
        self.loss
    }

    /// A datagram with these hands was sent at `now`, which must not decrease. Hands beyond [`HANDS_MAX`] do
    /// not travel.
    pub fn sent(&mut self, now: SimTime, samples: &[HandSample]) {
        self.newest = (self.newest + 1) % CANDIDATES;
        self.count = (self.count + 1).min(CANDIDATES);
        let candidate = &mut self.candidates[self.newest];
        candidate.count = samples.len().min(HANDS_MAX);
        candidate.samples[..candidate.count].copy_from_slice(&samples[..candidate.count]);
        (candidate.sent_at, candidate.arrived) = (now, None);
    }

    /// An echo says that the newest datagram that has arrived was sent at `sent_at`. Those sent later, up to
    /// `lost_before`, would have arrived as well, and are lost.
    pub fn acknowledge(&mut self, sent_at: SimTime, lost_before: SimTime) {
        for index in 0..self.count {
            let candidate = self.at_mut(index);
            if candidate.sent_at == sent_at {
                candidate.arrived = Some(true);
                // What was sent before it is no longer held.
                self.count = index + 1;
                return;
            }
            if candidate.sent_at < sent_at {
                return;
            }
            if candidate.sent_at <= lost_before && candidate.arrived.is_none() {
                candidate.arrived = Some(false);
            }
        }
    }

    /// How probably the receiver is wrong about these hands.
    pub fn wrong(&self, deadband: &Deadband, samples: &[HandSample]) -> Wrong {
        let mut wrong = Wrong::default();
        // Probability that nothing newer has arrived.
        let mut left = 1.0;
        for index in 0..self.count {
            let candidate = self.at(index);
            let arrives = candidate.arrived.map_or(1.0 - self.loss, f64::from);
            if arrives > 0.0 {
                let (noticed, discrete) = candidate.deviates(deadband, samples);
                let held = left * arrives;
                wrong.noticed += if noticed { held } else { 0.0 };
                wrong.discrete += if discrete { held } else { 0.0 };
                left -= held;
            }
            // What is older cannot make up for it.
            if left <= WRONG_DISCRETE * 0.1 {
                return wrong;
            }
        }
        Wrong { noticed: wrong.noticed + left, discrete: wrong.discrete + left }
    }

    /// Whether these hands differ from the last ones that were sent in something that has no band.
    pub fn is_discretely_new(&self, samples: &[HandSample]) -> bool {
        self.count == 0 || self.at(0).deviates(&Deadband::default(), samples).1
    }

    /// The candidate that was sent `index` datagrams before the newest.
    fn at(&self, index: usize) -> &Candidate {
        &self.candidates[(self.newest + CANDIDATES - index) % CANDIDATES]
    }

    fn at_mut(&mut self, index: usize) -> &mut Candidate {
        &mut self.candidates[(self.newest + CANDIDATES - index) % CANDIDATES]
    }
}

impl Candidate {
    /// Whether a hand differs noticeably, and whether in something that has no band.
    fn deviates(&self, deadband: &Deadband, samples: &[HandSample]) -> (bool, bool) {
        let held = &self.samples[..self.count];
        if held.len() != samples.len().min(HANDS_MAX) {
            return (true, true);
        }
        let mut noticed = false;
        for (sample, held) in samples.iter().zip(held) {
            if sample.hand != held.hand {
                return (true, true);
            }
            match deadband.deviation(sample, held) {
                Deviation::Discrete => return (true, true),
                deviation => noticed |= deviation.is_noticed(),
            }
        }
        (noticed, false)
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;

    use super::*;

    const MS: fn(u64) -> SimTime = SimTime::from_millis;

    fn force(newtons: f64) -> [HandSample; 1] {
        let mut sample = HandSample::unknown(0);
        sample.wrench.force = Vector3::new(newtons, 0.0, 0.0);
        [sample]
    }

    fn belief(loss: f64) -> ReceiverBelief {
        let mut belief = ReceiverBelief::default();
        (0..100).for_each(|_| belief.note_loss(loss));
        belief
    }

    fn noticed(belief: &ReceiverBelief, newtons: f64) -> f64 {
        let wrong = belief.wrong(&Deadband::default(), &force(newtons));
        assert!(wrong.discrete <= wrong.noticed + 1e-12 && wrong.noticed <= 1.0 + 1e-12, "{wrong:?}");
        wrong.noticed
    }

    #[test]
    fn a_receiver_that_was_sent_nothing_is_certainly_wrong() {
        assert_eq!(noticed(&belief(0.2), 0.0), 1.0);
        assert!(belief(0.2).is_discretely_new(&force(0.0)));
    }

    #[test]
    fn each_datagram_divides_the_doubt_by_the_loss() {
        let mut belief = belief(0.2);
        for (at, doubt) in [(1, 0.2), (2, 0.04), (3, 0.008)] {
            belief.sent(MS(at), &force(1.0));
            assert!((noticed(&belief, 1.05) - doubt).abs() < 1e-9);
            assert!((noticed(&belief, 1.2) - 1.0).abs() < 1e-3);
        }
        // What was sent before the step is held with the probability that the newest got lost.
        belief.sent(MS(4), &force(2.0));
        assert!((noticed(&belief, 1.0) - 0.8).abs() < 1e-2);
        assert!((noticed(&belief, 2.0) - 0.2).abs() < 1e-2);
    }

    #[test]
    fn an_echo_ends_the_doubt_about_all_that_was_before() {
        let mut belief = belief(0.2);
        belief.sent(MS(1), &force(1.0));
        belief.sent(MS(2), &force(2.0));
        belief.sent(MS(3), &force(2.0));
        belief.acknowledge(MS(2), MS(0));
        assert_eq!(noticed(&belief, 2.0), 0.0);
        // The first one has not been sent again.
        belief.acknowledge(MS(1), MS(0));
        assert_eq!(noticed(&belief, 2.0), 0.0);
        assert!((noticed(&belief, 1.0) - 1.0).abs() < 1e-12);
    }

    #[test]
    fn what_should_have_arrived_and_was_not_echoed_is_lost() {
        let mut belief = belief(0.01);
        belief.sent(MS(1), &force(1.0));
        belief.sent(MS(2), &force(2.0));
        belief.sent(MS(10), &force(3.0));
        assert!(noticed(&belief, 3.0) < 0.011);
        belief.acknowledge(MS(1), MS(5));
        assert!((noticed(&belief, 2.0) - 1.0).abs() < 1e-9, "the second one is lost");
        assert!((noticed(&belief, 1.0) - 0.99).abs() < 1e-9, "the third one may be");
        belief.acknowledge(MS(1), MS(20));
        assert_eq!(noticed(&belief, 1.0), 0.0, "it is what is held");
    }

    #[test]
    fn a_button_is_certain_to_a_thousandth() {
        let mut belief = belief(0.2);
        let deadband = Deadband::default();
        belief.sent(MS(0), &force(0.0));
        let mut pressed = force(0.0);
        pressed[0].state.buttons = 1;
        assert!(belief.is_discretely_new(&pressed));
        let mut sends = 0;
        while belief.wrong(&deadband, &pressed).is_too_likely() {
            sends += 1;
            belief.sent(MS(sends), &pressed);
        }
        assert_eq!(sends, 5, "0.2 to the power of 5 is 0.0003");
        assert!(!belief.is_discretely_new(&pressed));
    }

    #[test]
    fn the_candidates_are_bounded_and_a_hand_more_or_less_is_news() {
        let mut belief = belief(0.5);
        (0..1_000).for_each(|at| belief.sent(MS(at), &force(1.0 + (at % 2) as f64)));
        let doubt = noticed(&belief, 2.0);
        assert!((doubt - 1.0 / 3.0).abs() < 1e-3, "{doubt}");
        assert!(belief.is_discretely_new(&[force(2.0)[0], HandSample::unknown(1)]));
        assert!(belief.is_discretely_new(&[]));
    }
}
