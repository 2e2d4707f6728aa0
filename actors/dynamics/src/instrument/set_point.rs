//! Set point of the virtual coupling: follows the hand, and after a gap approaches it at a bounded speed.
//!
//! After a delay or a restart, a world finds the hand some centimetres further on. A coupling to the hand's pose would
//! tear the instrument off what it holds; the set point moves there instead, at the speed of a hand.

use nalgebra::{Isometry3, UnitQuaternion, Vector3};
use trocar_scene::components::Velocity;

/// Maximum speed relative to the hand \[m/s\].
const LINEAR_SPEED: f64 = 0.3;
/// The same for rotation \[rad/s\].
const ANGULAR_SPEED: f64 = 3.0;
/// A new set point starts at the hand if the instrument is within the deflection of a loaded coupling \[m\], \[rad\].
const START_GAP: f64 = 0.004;
const START_TURN: f64 = 0.1;

/// The pose that the coupling pulls towards.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SetPoint {
    pose: Option<Isometry3<f64>>,
}

impl SetPoint {
    /// Pose and velocity for the next step of `step_secs`, for a hand at `wanted` that moves with `velocity`, and an
    /// instrument whose tip is at `tip`.
    ///
    /// A hand without a gap is followed exactly.
    pub fn follow(
        &mut self,
        wanted: &Isometry3<f64>,
        velocity: &Velocity,
        tip: &Isometry3<f64>,
        step_secs: f64,
    ) -> (Isometry3<f64>, Velocity) {
        let from = match self.pose {
            Some(pose) => pose,
            None if is_close(tip, wanted) => *wanted,
            None => *tip,
        };
        let gap = wanted.translation.vector - from.translation.vector;
        let turn = (wanted.rotation * from.rotation.inverse()).scaled_axis();
        let step = bounded(gap, step_secs * (LINEAR_SPEED + 2.0 * velocity.linear.norm()));
        let spin = bounded(turn, step_secs * (ANGULAR_SPEED + 2.0 * velocity.angular.norm()));
        let arrived = step.is_none() && spin.is_none();
        if arrived {
            self.pose = Some(*wanted);
            return (*wanted, *velocity);
        }
        let (step, spin) = (step.unwrap_or(gap), spin.unwrap_or(turn));
        let pose = Isometry3::from_parts(
            (from.translation.vector + step).into(),
            UnitQuaternion::from_scaled_axis(spin) * from.rotation,
        );
        self.pose = Some(pose);
        (pose, Velocity { linear: step / step_secs, angular: spin / step_secs })
    }
}

fn is_close(tip: &Isometry3<f64>, wanted: &Isometry3<f64>) -> bool {
    (tip.translation.vector - wanted.translation.vector).norm() <= START_GAP
        && tip.rotation.angle_to(&wanted.rotation) <= START_TURN
}

/// The vector clamped to length `max`; `None` if it is not longer.
fn bounded(v: Vector3<f64>, max: f64) -> Option<Vector3<f64>> {
    let norm = v.norm();
    (norm > max).then(|| v * (max / norm))
}

#[cfg(test)]
mod tests {
    use super::*;

    const STEP: f64 = 0.001;

    fn moving(x: f64) -> Velocity {
        Velocity { linear: Vector3::new(x, 0.0, 0.0), angular: Vector3::zeros() }
    }

    #[test]
    fn a_hand_without_a_gap_is_followed_to_the_bit() {
        for speed in [0.0, 0.05, 0.8, 3.0] {
            let mut set_point = SetPoint::default();
            for k in 0..200 {
                let wanted = Isometry3::translation(f64::from(k) * speed * STEP, 0.0, 0.0);
                let (pose, velocity) = set_point.follow(&wanted, &moving(speed), &wanted, STEP);
                assert_eq!((pose, velocity), (wanted, moving(speed)));
            }
        }
    }

    #[test]
    fn after_a_gap_it_comes_at_a_bounded_speed_and_arrives() {
        let mut set_point = SetPoint::default();
        let start = Isometry3::identity();
        let _ = set_point.follow(&start, &moving(0.0), &start, STEP);
        let wanted = Isometry3::new(Vector3::new(0.03, 0.0, 0.0), Vector3::new(0.0, 0.0, 0.15));
        let mut last = start;
        for step in 1..=101 {
            let (pose, velocity) = set_point.follow(&wanted, &moving(0.0), &start, STEP);
            let went = (pose.translation.vector - last.translation.vector).norm();
            assert!(went <= LINEAR_SPEED * STEP * 1.000_001, "{went} m in one step");
            assert!(pose.rotation.angle_to(&last.rotation) <= ANGULAR_SPEED * STEP * 1.000_001);
            assert!(step > 100 || velocity.linear.x >= 0.0);
            last = pose;
        }
        assert_eq!(last, wanted);
    }

    #[test]
    fn a_new_one_goes_out_from_the_tip_unless_that_is_where_a_load_holds_it() {
        let wanted = Isometry3::translation(0.02, 0.0, 0.0);
        let far = Isometry3::identity();
        let (pose, _) = SetPoint::default().follow(&wanted, &moving(0.0), &far, STEP);
        assert!(pose.translation.vector.norm() <= LINEAR_SPEED * STEP * 1.000_001);
        let near = Isometry3::translation(0.0175, 0.0, 0.0);
        let (pose, _) = SetPoint::default().follow(&wanted, &moving(0.0), &near, STEP);
        assert_eq!(pose, wanted);
    }
}
