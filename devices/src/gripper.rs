//! Model of the fingers at a gripper: a first-order lag with a speed limit.

/// Follows a target opening angle.
///
/// The lag is integrated by the backward Euler rule, which is stable for every step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FingerFollower {
    /// Time constant of the lag \[s\].
    pub time_constant: f64,
    /// Fastest change of the angle [rad/s].
    pub speed_max: f64,
    /// Widest opening \[rad\]; 0 is closed.
    pub angle_max: f64,
}

impl FingerFollower {
    /// The angle \[rad\] after `step_secs`, starting at `angle` and moving towards `target`.
    pub fn step(&self, angle: f64, target: f64, step_secs: f64) -> f64 {
        let target = target.max(0.0).min(self.angle_max);
        let change = (target - angle) * step_secs / (self.time_constant + step_secs);
        let limit = self.speed_max * step_secs;
        angle + change.max(-limit).min(limit)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const FINGERS: FingerFollower = FingerFollower { time_constant: 0.03, speed_max: 5.0, angle_max: 1.0 };

    #[test]
    fn a_small_change_follows_the_lag() {
        let mut angle = 0.5;
        for _ in 0..300 {
            angle = FINGERS.step(angle, 0.55, 1e-4);
        }
        let expected = 0.55 - 0.05 * (-1.0_f64).exp();
        assert!((angle - expected).abs() < 1e-4);
    }

    #[test]
    fn a_big_change_is_limited_in_speed_and_range() {
        let mut angle = 0.0;
        for step in 1..=150 {
            angle = FINGERS.step(angle, 50.0, 1e-3);
            assert!(angle <= f64::from(step) * 5e-3 + 1e-12);
        }
        assert!(angle > 0.5);
        for _ in 0..1000 {
            angle = FINGERS.step(angle, 50.0, 1e-3);
        }
        assert!((angle - 1.0).abs() < 1e-9 && angle <= 1.0);
    }
}
