//! Critically damped coupling between a hand and its instrument (Colgate, Stanley, Brown 1995): a spring and damper in
//! six degrees of freedom, discretised for a fixed step.
//!
//! The spring is explicit and the damper an exact exponential decay, so the force at rest is exactly stiffness times
//! displacement for any step length. Both are limited to what is stable with the instrument's inertia at that step, and
//! the wrench is bounded, so no jump of the target makes it unstable.

use nalgebra::{ComplexField, Isometry3, Vector3};
use trocar_scene::components::Velocity;
use trocar_scene::kinematics::spatial::Wrench;

/// Maximum phase advance of the spring per step \[rad\]; the explicit scheme is stable below 2, with the damper below
/// 1.
const PHASE_MAX: f64 = 0.5;

/// The coupling of one instrument.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CriticallyDampedCoupling {
    /// Linear stiffness \[N/m\].
    stiffness: f64,
    /// Linear damping, already reduced for the step \[N·s/m\].
    damping: f64,
    /// Squared radius of gyration about the instrument's x, y and z \[m²\].
    gyration_squared: Vector3<f64>,
    /// Bound of the force \[N\].
    force_max: f64,
    /// Bound of the torque \[N·m\].
    torque_max: f64,
}

impl CriticallyDampedCoupling {
    /// A critically damped coupling for an instrument of `mass` \[kg\] with radii of `gyration` about its
    /// own x, y and z \[m\], at `stiffness` \[N/m\], for steps of `step_secs`.
    ///
    /// Rotations get the natural frequency of the translation. A stiffness that is unstable for the mass at that step
    /// is reduced: [`stiffness`](Self::stiffness) returns the value in effect.
    pub fn new(mass: f64, gyration: Vector3<f64>, stiffness: f64, force_max: f64, step_secs: f64) -> Self {
        let stiffness = stiffness.min(mass * (PHASE_MAX / step_secs).powi(2));
        let critical = 2.0 * (stiffness * mass).sqrt();
        // Exact decay of the velocity over one step, as an equivalent explicit coefficient.
        let damping = mass / step_secs * (1.0 - ComplexField::exp(-critical * step_secs / mass));
        let lever = gyration.max();
        Self {
            stiffness,
            damping,
            gyration_squared: gyration.component_mul(&gyration),
            force_max,
            torque_max: force_max * lever,
        }
    }

    /// The linear stiffness in effect \[N/m\].
    pub fn stiffness(&self) -> f64 {
        self.stiffness
    }

    /// The linear damping in effect \[N·s/m\].
    pub fn damping(&self) -> f64 {
        self.damping
    }

    /// The wrench on the instrument about its tip, in world axes, that pulls `actual` towards `target` (both
    /// `world_from_instrument`, with the velocities of the tip).
    pub fn wrench(
        &self,
        target: &Isometry3<f64>,
        target_velocity: &Velocity,
        actual: &Isometry3<f64>,
        actual_velocity: &Velocity,
    ) -> Wrench {
        let stretch = target.translation.vector - actual.translation.vector;
        let slip = target_velocity.linear - actual_velocity.linear;
        let force = stretch * self.stiffness + slip * self.damping;

        // Rotation from actual to target, in the instrument's frame, where its inertia is diagonal.
        let turn = (actual.rotation.inverse() * target.rotation).scaled_axis();
        let spin = actual.rotation.inverse() * (target_velocity.angular - actual_velocity.angular);
        let torque_in_instrument =
            (turn * self.stiffness + spin * self.damping).component_mul(&self.gyration_squared);
        Wrench {
            force: bounded(force, self.force_max),
            torque: bounded(actual.rotation * torque_in_instrument, self.torque_max),
        }
    }
}

/// Clamps the norm of a vector to `max`.
fn bounded(v: Vector3<f64>, max: f64) -> Vector3<f64> {
    let norm = v.norm();
    if norm > max { v * (max / norm) } else { v }
}

#[cfg(test)]
mod tests {
    use super::*;

    const STEP: f64 = 0.001;

    fn coupling(stiffness: f64) -> CriticallyDampedCoupling {
        CriticallyDampedCoupling::new(0.03, Vector3::new(0.03, 0.03, 0.008), stiffness, 20.0, STEP)
    }

    /// A free point mass on the coupling, by the solver's semi-implicit Euler.
    fn settle(coupling: &CriticallyDampedCoupling, jump: f64, steps: usize) -> (f64, f64) {
        let (mut x, mut v, mut overshoot) = (0.0, 0.0, 0.0f64);
        let target = Isometry3::translation(jump, 0.0, 0.0);
        for _ in 0..steps {
            let velocity = Velocity { linear: Vector3::new(v, 0.0, 0.0), angular: Vector3::zeros() };
            let wrench = coupling.wrench(
                &target,
                &Velocity::default(),
                &Isometry3::translation(x, 0.0, 0.0),
                &velocity,
            );
            v += wrench.force.x / 0.03 * STEP;
            x += v * STEP;
            overshoot = overshoot.max((x - jump) / jump);
        }
        ((x - jump).abs(), overshoot)
    }

    #[test]
    fn settles_on_its_target_nearly_without_overshoot() {
        let (error, overshoot) = settle(&coupling(1000.0), 0.001, 100);
        assert!(error < 1e-6, "{error} m left after 0.1 s");
        assert!(overshoot < 0.06, "overshoot of {overshoot}");
    }

    #[test]
    fn any_stiffness_and_any_jump_stay_bounded() {
        for stiffness in [1.0, 1e3, 1e5, 1e9] {
            for jump in [1e-6, 1e-3, 0.1, 10.0] {
                let (error, overshoot) = settle(&coupling(stiffness), jump, 20_000);
                assert!(overshoot < 1.0, "k {stiffness}, jump {jump}: overshoot {overshoot}");
                assert!(error < jump, "k {stiffness}, jump {jump}: {error} m away");
            }
        }
    }

    #[test]
    fn force_in_rest_is_stiffness_times_displacement() {
        let wrench = coupling(1000.0).wrench(
            &Isometry3::translation(0.0, 0.0, -0.002),
            &Velocity::default(),
            &Isometry3::identity(),
            &Velocity::default(),
        );
        assert!((wrench.force - Vector3::new(0.0, 0.0, -2.0)).norm() < 1e-12);
        assert_eq!(wrench.torque, Vector3::zeros());
    }

    #[test]
    fn torque_turns_towards_the_target_about_world_axes() {
        let actual = Isometry3::new(Vector3::zeros(), Vector3::new(0.0, 0.0, 1.0));
        let target = Isometry3::new(Vector3::zeros(), Vector3::new(0.02, 0.0, 0.0)) * actual;
        let wrench = coupling(1000.0).wrench(&target, &Velocity::default(), &actual, &Velocity::default());
        // The transverse moments are equal, so the torque stays along the rotation axis.
        assert!((wrench.torque - Vector3::new(0.02 * 1000.0 * 0.03f64.powi(2), 0.0, 0.0)).norm() < 1e-9);
    }
}
