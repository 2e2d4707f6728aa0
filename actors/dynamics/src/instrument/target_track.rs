//! Interpolation of a hand's target between its last two samples, and bounded extrapolation beyond the newest, so that
//! the coupling sees no steps.

use nalgebra::{Isometry3, UnitQuaternion};
use trocar_scene::components::{InstrumentTarget, Velocity};
use trocar_scene::time::SimTime;

/// Two samples further apart than this are not interpolated \[s\].
const GAP_SECS_MAX: f64 = 0.25;

/// The last two target samples of a hand.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct TargetTrack {
    newest: Option<InstrumentTarget>,
    previous: Option<InstrumentTarget>,
}

impl TargetTrack {
    /// Adds a sample; one that is not newer replaces the newest.
    pub fn push(&mut self, sample: InstrumentTarget) {
        match self.newest {
            Some(newest) if sample.sampled_at > newest.sampled_at => {
                self.previous = Some(newest);
                self.newest = Some(sample);
            }
            _ => self.newest = Some(sample),
        }
    }

    /// From the last two samples.
    pub fn of(previous: Option<InstrumentTarget>, newest: Option<InstrumentTarget>) -> Self {
        Self { newest, previous }
    }

    /// The sample before the newest.
    pub fn previous(&self) -> Option<&InstrumentTarget> {
        self.previous.as_ref()
    }

    /// The newest sample.
    pub fn newest(&self) -> Option<&InstrumentTarget> {
        self.newest.as_ref()
    }

    /// Interpolated pose and velocity at `time`; `None` before the first sample.
    ///
    /// The newest sample is extrapolated for at most `extrapolation_secs_max`, then held with zero velocity.
    pub fn at(&self, time: SimTime, extrapolation_secs_max: f64) -> Option<(Isometry3<f64>, Velocity)> {
        let newest = self.newest?;
        let ahead = seconds_between(newest.sampled_at, time);
        if ahead >= 0.0 {
            let held = ahead > extrapolation_secs_max;
            let velocity = if held { Velocity::default() } else { newest.velocity_in_world };
            return Some((carried(&newest, ahead.min(extrapolation_secs_max)), velocity));
        }
        let Some(previous) = self.previous else {
            return Some((carried(&newest, ahead.max(-extrapolation_secs_max)), newest.velocity_in_world));
        };
        let span = seconds_between(previous.sampled_at, newest.sampled_at);
        if span > GAP_SECS_MAX {
            return Some((newest.tip_in_world.isometry(), newest.velocity_in_world));
        }
        let share = (1.0 + ahead / span).clamp(0.0, 1.0);
        let (a, b) = (previous.tip_in_world, newest.tip_in_world);
        let step = b.translation - a.translation;
        // Samples of one hand are close: it took the shorter arc.
        let turn = (b.rotation * a.rotation.inverse()).scaled_axis();
        let pose = Isometry3::from_parts(
            (a.translation + step * share).into(),
            UnitQuaternion::from_scaled_axis(turn * share) * a.rotation,
        );
        Some((pose, Velocity { linear: step / span, angular: turn / span }))
    }
}

/// The sample extrapolated along its velocity for `secs`.
fn carried(sample: &InstrumentTarget, secs: f64) -> Isometry3<f64> {
    let (pose, velocity) = (&sample.tip_in_world, &sample.velocity_in_world);
    Isometry3::from_parts(
        (pose.translation + velocity.linear * secs).into(),
        UnitQuaternion::from_scaled_axis(velocity.angular * secs) * pose.rotation,
    )
}

/// `to − from` \[s\], negative when `to` is earlier.
fn seconds_between(from: SimTime, to: SimTime) -> f64 {
    if to >= from { to.since(from).as_secs_f64() } else { -from.since(to).as_secs_f64() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;
    use trocar_scene::components::Pose;

    fn sample(millis: u64, x: f64, speed: f64) -> InstrumentTarget {
        InstrumentTarget {
            tip_in_world: Pose::at(x, 0.0, 0.0),
            velocity_in_world: Velocity { linear: Vector3::new(speed, 0.0, 0.0), angular: Vector3::zeros() },
            jaw_angle: 0.0,
            sampled_at: SimTime::from_millis(millis),
        }
    }

    fn x_at(track: &TargetTrack, micros: u64) -> f64 {
        track.at(SimTime::from_micros(micros), 0.02).unwrap().0.translation.x
    }

    #[test]
    fn nothing_before_the_first_sample() {
        assert_eq!(TargetTrack::default().at(SimTime::ZERO, 0.02), None);
    }

    #[test]
    fn follows_a_uniform_motion_exactly_at_any_rate() {
        for period in [1u64, 2, 10, 100] {
            let mut track = TargetTrack::default();
            for k in 0..20 {
                track.push(sample(1000 + k * period, (k * period) as f64 * 1e-4, 0.1));
                for half_millis in 0..=4 {
                    let micros = (1000 + k * period) * 1000 + half_millis * 500;
                    let expected = (micros as f64 * 1e-6 - 1.0) * 0.1;
                    assert!((x_at(&track, micros) - expected).abs() < 1e-12);
                }
            }
        }
    }

    #[test]
    fn a_dead_hand_stops_within_the_bound() {
        let mut track = TargetTrack::default();
        track.push(sample(0, 0.0, 0.1));
        let (pose, velocity) = track.at(SimTime::from_millis(5000), 0.02).unwrap();
        assert!((pose.translation.x - 0.002).abs() < 1e-12);
        assert_eq!(velocity, Velocity::default());
    }

    #[test]
    fn interpolates_between_the_last_two() {
        let mut track = TargetTrack::default();
        track.push(sample(100, 0.0, 0.0));
        track.push(sample(200, 0.01, 0.0));
        assert!((x_at(&track, 150_000) - 0.005).abs() < 1e-12);
        assert!((x_at(&track, 50_000) - 0.0).abs() < 1e-12);
    }
}
