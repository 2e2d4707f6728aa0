//! Motion limiter: follows a goal pose at a bounded speed, without overshoot.
//!
//! Uses only additions, multiplications, divisions and square roots: bit-identical on every machine.

use nalgebra::{Isometry3, Quaternion, UnitQuaternion, Vector3};

/// Longest step that is counted \[s\]: a driver that was held up gets no larger jump.
pub const STEP_MAX_SECS: f64 = 0.005;
/// Cut-off of the first-order low pass of the velocity that is told \[Hz\], as in the virtual hand.
pub const VELOCITY_CUTOFF_HZ: f64 = 100.0;

/// Greatest speeds of a step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Caps {
    /// Of the motion [m/s].
    pub linear_speed: f64,
    /// Of the turn [rad/s].
    pub angular_speed: f64,
}

/// A pose that follows another. What it tells of its velocity is its own motion, whatever the goal's sender claims.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MotionLimiter {
    pose_in_device: Isometry3<f64>,
    // Low-passed.
    linear_velocity: Vector3<f64>,
    angular_velocity: Vector3<f64>,
    // Of the latest step.
    speed: Caps,
}

impl MotionLimiter {
    /// At rest at a pose.
    pub fn at_rest(pose_in_device: Isometry3<f64>) -> Self {
        Self {
            pose_in_device,
            linear_velocity: Vector3::zeros(),
            angular_velocity: Vector3::zeros(),
            speed: Caps { linear_speed: 0.0, angular_speed: 0.0 },
        }
    }

    /// At a pose, where the velocity that is told decays from these, each shortened to its cap.
    pub fn from_motion(
        pose_in_device: Isometry3<f64>,
        linear_velocity: Vector3<f64>,
        angular_velocity: Vector3<f64>,
        caps: Caps,
    ) -> Self {
        Self {
            linear_velocity: shortened(linear_velocity, caps.linear_speed),
            angular_velocity: shortened(angular_velocity, caps.angular_speed),
            ..Self::at_rest(pose_in_device)
        }
    }

    /// The pose.
    pub fn pose_in_device(&self) -> &Isometry3<f64> {
        &self.pose_in_device
    }

    /// Velocity along the device's axes [m/s].
    pub fn linear_velocity(&self) -> &Vector3<f64> {
        &self.linear_velocity
    }

    /// Angular velocity along the device's axes [rad/s].
    pub fn angular_velocity(&self) -> &Vector3<f64> {
        &self.angular_velocity
    }

    /// Speeds of the latest step, before the low pass.
    pub fn speed(&self) -> Caps {
        self.speed
    }

    /// One step of `step_secs` to the goal, or as far as the caps allow. True when a cap acted.
    pub fn step(&mut self, goal_in_device: &Isometry3<f64>, caps: Caps, step_secs: f64) -> bool {
        let step_secs = step_secs.min(STEP_MAX_SECS);
        if step_secs <= 0.0 {
            return false;
        }
        let (moved, capped_motion) = self.translate(goal_in_device, caps.linear_speed * step_secs);
        let (turned, capped_turn) = self.rotate(goal_in_device, caps.angular_speed * step_secs);
        self.speed =
            Caps { linear_speed: moved.norm() / step_secs, angular_speed: turned.norm() / step_secs };
        let lag = 1.0 / (2.0 * std::f64::consts::PI * VELOCITY_CUTOFF_HZ);
        let blend = step_secs / (lag + step_secs);
        self.linear_velocity += blend * (moved / step_secs - self.linear_velocity);
        self.angular_velocity += blend * (turned / step_secs - self.angular_velocity);
        capped_motion || capped_turn
    }

    fn translate(&mut self, goal: &Isometry3<f64>, most: f64) -> (Vector3<f64>, bool) {
        let before = self.pose_in_device.translation.vector;
        let goal = goal.translation.vector;
        let way = goal - before;
        let distance = way.norm();
        let after = if distance <= most {
            goal
        } else {
            // Rounding must not carry it over the goal, which may lie on the workspace's wall.
            (before + way * (most / distance)).sup(&before.inf(&goal)).inf(&before.sup(&goal))
        };
        self.pose_in_device.translation.vector = after;
        (after - before, distance > most)
    }

    /// Turns, and returns the turn as a rotation vector \[rad\]. The tangent of half the angle stands for the angle: no
    /// larger than the cap allows, and equal to it for the small angles of a step.
    fn rotate(&mut self, goal: &Isometry3<f64>, most: f64) -> (Vector3<f64>, bool) {
        let before = self.pose_in_device.rotation;
        let left = goal.rotation.into_inner() * before.into_inner().conjugate();
        let (cosine, axis) = if left.w < 0.0 { (-left.w, -left.imag()) } else { (left.w, left.imag()) };
        let sine = axis.norm();
        if sine <= 0.0 {
            return (Vector3::zeros(), false);
        }
        // Infinite at half a turn, which the cap cuts.
        let half_wanted = sine / cosine;
        let half_most = 0.5 * most;
        let half = if half_wanted <= half_most { half_wanted } else { half_most };
        if half <= 0.0 {
            return (Vector3::zeros(), true);
        }
        if half_wanted <= half_most {
            self.pose_in_device.rotation = goal.rotation;
        } else {
            let step = Quaternion::from_parts(1.0, axis * (half / sine));
            self.pose_in_device.rotation = UnitQuaternion::new_normalize(step * before.into_inner());
        }
        (axis * (2.0 * half / sine), half_wanted > half_most)
    }
}

/// A vector shortened to a length of at most `limit`; zero if it is no number.
pub(super) fn shortened(vector: Vector3<f64>, limit: f64) -> Vector3<f64> {
    let largest = vector.amax();
    if !vector.iter().all(|x| x.is_finite()) || largest <= 0.0 {
        return Vector3::zeros();
    }
    // Divided by the largest component first: the square of a huge one overflows.
    let length = (vector / largest).norm();
    if length * largest <= limit { vector } else { vector / largest * (limit / length) }
}

#[cfg(test)]
mod tests {
    use super::*;

    const CAPS: Caps = Caps { linear_speed: 1.0, angular_speed: 10.0 };

    fn pose(position: [f64; 3], turn: [f64; 3]) -> Isometry3<f64> {
        let rotation = UnitQuaternion::from_scaled_axis(Vector3::from(turn));
        Isometry3::from_parts(Vector3::from(position).into(), rotation)
    }

    #[test]
    fn a_goal_within_reach_is_met_exactly() {
        let goal = pose([0.0005, 0.0, 0.0], [0.0, 0.0, 0.009]);
        let mut motion = MotionLimiter::at_rest(Isometry3::identity());
        assert!(!motion.step(&goal, CAPS, 1e-3));
        assert_eq!(*motion.pose_in_device(), goal);
        assert!((motion.speed().linear_speed - 0.5).abs() < 1e-12);
        assert!((motion.speed().angular_speed - 9.0).abs() < 1e-3);
    }

    #[test]
    fn a_jump_becomes_an_approach_at_the_greatest_speed_without_overshoot() {
        let goal = pose([0.1, 0.0, 0.0], [0.0, 3.0, 0.0]);
        let mut motion = MotionLimiter::at_rest(Isometry3::identity());
        let mut before = *motion.pose_in_device();
        for step in 1..=400 {
            let capped = motion.step(&goal, CAPS, 1e-3);
            let now = *motion.pose_in_device();
            assert!((now.translation.vector - before.translation.vector).norm() <= 1e-3 + 1e-12);
            assert!(now.rotation.angle_to(&before.rotation) <= 1e-2 + 1e-9);
            assert!(now.translation.vector.x <= 0.1);
            assert!(motion.linear_velocity().norm() <= 1.0 + 1e-12);
            assert_eq!(capped, step <= 300, "step {step}");
            before = now;
        }
        assert_eq!(before, goal);
        assert!(motion.linear_velocity().norm() < 1e-9);
    }

    #[test]
    fn a_half_turn_is_turned_and_finite() {
        let half = Isometry3::from_parts(
            Vector3::zeros().into(),
            UnitQuaternion::new_unchecked(Quaternion::new(0.0, 1.0, 0.0, 0.0)),
        );
        let mut motion = MotionLimiter::at_rest(Isometry3::identity());
        for _ in 0..400 {
            motion.step(&half, CAPS, 1e-3);
            assert!(motion.angular_velocity().norm() <= 10.0 + 1e-12);
        }
        assert!(motion.pose_in_device().rotation.angle_to(&half.rotation) < 1e-7);
    }

    #[test]
    fn a_late_step_gets_no_larger_jump() {
        let mut motion = MotionLimiter::at_rest(Isometry3::identity());
        motion.step(&pose([1.0, 0.0, 0.0], [0.0; 3]), CAPS, 3.0);
        assert!((motion.pose_in_device().translation.vector.x - STEP_MAX_SECS).abs() < 1e-12);
    }

    #[test]
    fn a_huge_vector_is_shortened_and_none_becomes_nothing() {
        assert!((shortened(Vector3::repeat(1e308), 2.0).norm() - 2.0).abs() < 1e-12);
        assert_eq!(shortened(Vector3::new(f64::NAN, 1.0, 0.0), 2.0), Vector3::zeros());
        assert_eq!(shortened(Vector3::x(), 2.0), Vector3::x());
        assert_eq!(shortened(Vector3::x(), 0.0), Vector3::zeros());
    }
}
