//! Playout: a hand of another station, as it was a fixed time ago.
//!
//! Among peers each computes the scene for itself, and so all have to move each instrument at the same time. Every hand moves
//! it that much later than it was measured, its own peer's as well as the others', and a sample that comes within that time
//! comes soon enough. Between two samples the hand is interpolated, so that gaps of the path and of the deadband do no
//! harm. (The playout buffer of voice over packet networks: Ramjee, Kurose, Towsley, Schulzrinne, "Adaptive playout
//! mechanisms for packetized audio applications in wide-area networks", 1994.)

use std::collections::VecDeque;

use trocar_devices::DeviceState;
use trocar_scene::SimTime;

use crate::hand_sample::HandSample;

/// Most samples that wait: a second of them.
pub const WAITING_MAX: usize = 1_024;

/// What is played of a hand now.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Played {
    /// When the newest datagram with the hand arrived.
    pub arrived_at: SimTime,
    /// The hand; its age is that at which it is played.
    pub sample: HandSample,
}

/// The samples of one hand that wait for their time. Does not allocate after it was made.
#[derive(Clone, Debug)]
pub struct Playout {
    delay: SimTime,
    /// By the time of their measurement on this session's clock, ascending.
    waiting: VecDeque<(SimTime, HandSample)>,
    arrived_at: SimTime,
    late: u64,
}

impl Playout {
    /// Plays samples this long after they were measured.
    pub fn new(delay: SimTime) -> Self {
        Self { delay, waiting: VecDeque::with_capacity(WAITING_MAX), arrived_at: SimTime::ZERO, late: 0 }
    }

    /// Samples that came after their time.
    pub fn late(&self) -> u64 {
        self.late
    }

    /// Nothing waits any more: the hand is another's.
    pub fn clear(&mut self) {
        self.waiting.clear();
    }

    /// A sample came at `now` that was measured at `measured_at`, both by this session's clock. One that is not newer than
    /// those before has no effect.
    pub fn push(&mut self, now: SimTime, measured_at: SimTime, sample: &HandSample) {
        if self.waiting.back().is_some_and(|(newest, _)| *newest >= measured_at) {
            return;
        }
        self.late += u64::from(measured_at + self.delay < now);
        if self.waiting.len() == WAITING_MAX {
            self.waiting.pop_front();
        }
        self.waiting.push_back((measured_at, *sample));
        self.arrived_at = now;
    }

    /// The hand as it was the delay before `now`, which must not decrease; `None` before anything is known of that time.
    pub fn play(&mut self, now: SimTime) -> Option<Played> {
        let at = SimTime(now.as_nanos().checked_sub(self.delay.as_nanos())?);
        while self.waiting.get(1).is_some_and(|(next, _)| *next <= at) {
            self.waiting.pop_front();
        }
        let (measured_at, sample) = self.waiting.front().filter(|(first, _)| *first <= at)?;
        let (measured_at, sample) = match self.waiting.get(1) {
            Some((next_at, next)) => {
                let share = at.since(*measured_at).as_secs_f64() / next_at.since(*measured_at).as_secs_f64();
                (at, between(sample, next, share))
            }
            None => (*measured_at, *sample),
        };
        let age_us = u32::try_from(now.since(measured_at).as_nanos() / 1_000).unwrap_or(u32::MAX);
        Some(Played { arrived_at: self.arrived_at, sample: HandSample { age_us, ..sample } })
    }
}

/// The hand at this share of the way from one sample to the next. What has no middle is the earlier one's.
fn between(first: &HandSample, next: &HandSample, share: f64) -> HandSample {
    let (a, b) = (&first.state, &next.state);
    if !(a.connected && b.connected) {
        return *first;
    }
    // Of opposite rotations neither way is the shorter one.
    let rotation = a.pose_in_device.rotation.try_slerp(&b.pose_in_device.rotation, share, 1e-9);
    let mut pose_in_device = a.pose_in_device;
    pose_in_device.rotation = rotation.unwrap_or(a.pose_in_device.rotation);
    let [from, to] = [a, b].map(|state| state.pose_in_device.translation.vector);
    pose_in_device.translation.vector = from.lerp(&to, share);
    let state = DeviceState {
        pose_in_device,
        linear_velocity: a.linear_velocity.lerp(&b.linear_velocity, share),
        angular_velocity: a.angular_velocity.lerp(&b.angular_velocity, share),
        gripper: a.gripper + share * (b.gripper - a.gripper),
        ..*a
    };
    HandSample { state, ..*first }
}

#[cfg(test)]
mod tests {
    use nalgebra::{Translation3, UnitQuaternion, Vector3};

    use super::*;

    fn ms(millis: u64) -> SimTime {
        SimTime::from_millis(millis)
    }

    /// A hand at `x`, turned by as many radians about z.
    fn hand(x: f64) -> HandSample {
        let mut sample = HandSample::unknown(3);
        sample.state.connected = true;
        sample.state.pose_in_device = nalgebra::Isometry3::from_parts(
            Translation3::new(x, 0.0, 0.0),
            UnitQuaternion::from_axis_angle(&Vector3::z_axis(), x),
        );
        sample.state.gripper = x;
        sample
    }

    fn played(playout: &mut Playout, at: SimTime) -> Option<(f64, f64, u32)> {
        let Played { sample, .. } = playout.play(at)?;
        let state = &sample.state;
        Some((state.pose_in_device.translation.x, state.pose_in_device.rotation.angle(), sample.age_us))
    }

    #[test]
    fn a_hand_is_played_the_delay_after_it_was_measured_however_its_samples_came() {
        let mut playout = Playout::new(ms(100));
        // Measured every 10 ms; they come after 75 ms, in bursts, and one is lost.
        for (arrives, measured) in [(90, 10), (90, 0), (99, 20), (120, 40), (120, 50)] {
            playout.push(ms(arrives), ms(measured), &hand(measured as f64 * 1e-3));
        }
        assert_eq!(playout.play(ms(105)).map(|played| played.sample.hand), None, "nothing is known of 5 ms");
        for at in [110, 117, 120, 130, 145, 150] {
            let (x, angle, age) = played(&mut playout, ms(at)).expect("it is known");
            let expected = (at - 100) as f64 * 1e-3;
            assert!((x - expected).abs() < 1e-12 && (angle - expected).abs() < 1e-9, "{at}: {x} {angle}");
            assert_eq!(age, 100_000);
        }
        // Nothing newer came: it stays, and its age grows.
        assert_eq!(played(&mut playout, ms(190)).map(|(x, _, age)| (x, age)), Some((0.05, 140_000)));
        assert_eq!(playout.late(), 0);
    }

    #[test]
    fn a_sample_that_comes_after_its_time_is_played_at_once_and_counted() {
        let mut playout = Playout::new(ms(100));
        playout.push(ms(300), ms(100), &hand(0.1));
        playout.push(ms(301), ms(101), &hand(0.2));
        assert_eq!(played(&mut playout, ms(301)).map(|(x, _, age)| (x, age)), Some((0.2, 200_000)));
        assert_eq!(playout.late(), 2);
        playout.push(ms(302), ms(101), &hand(0.3));
        assert_eq!(played(&mut playout, ms(302)).map(|(x, _, _)| x), Some(0.2), "the same time again");
    }

    #[test]
    fn what_waits_is_bounded_and_the_newest_is_kept() {
        let mut playout = Playout::new(ms(100));
        for at in 0..3 * WAITING_MAX as u64 {
            playout.push(SimTime::ZERO, ms(at), &hand(at as f64 * 1e-3));
        }
        assert_eq!(playout.waiting.len(), WAITING_MAX);
        let newest = (3 * WAITING_MAX - 1) as f64 * 1e-3;
        assert_eq!(played(&mut playout, ms(10_000)).map(|(x, _, _)| x), Some(newest));
    }

    #[test]
    fn a_hand_that_was_unplugged_between_two_samples_is_not_interpolated() {
        let mut playout = Playout::new(ms(10));
        let unplugged = HandSample { state: hand(0.0).state.unplugged(), ..hand(0.0) };
        playout.push(ms(0), ms(0), &unplugged);
        playout.push(ms(10), ms(10), &hand(1.0));
        let state = playout.play(ms(15)).expect("it is known").sample.state;
        assert!(!state.connected && state.pose_in_device.translation.x == 0.0);
        playout.clear();
        assert_eq!(playout.play(ms(16)), None);
    }
}
