//! Exact discretisation of a damped oscillator under a force held over the step (zero-order hold).
//!
//! `m ẍ + b ẋ + k x = F`, in state space with the force as a third, constant state, has the transition matrix
//! `exp(A h)` (Van Loan, "Computing integrals involving the matrix exponential", 1978). The matrix is summed by scaling and
//! squaring, which covers the under-, critically and over-damped cases, `k = 0` and `b = 0` alike, and uses only
//! additions and multiplications: bit-identical on every machine.

use nalgebra::Matrix3;

/// Parameters of a one-dimensional damped oscillator.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Oscillator {
    /// Mass \[kg\], above zero.
    pub mass: f64,
    /// Viscous damping [N·s/m].
    pub damping: f64,
    /// Stiffness towards the origin [N/m].
    pub stiffness: f64,
}

/// Transition of one step of fixed length; linear in position, velocity and acceleration by the force.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Transition {
    /// Position from position, velocity and acceleration.
    pub position: [f64; 3],
    /// Velocity from position, velocity and acceleration.
    pub velocity: [f64; 3],
}

/// Terms of the series: with a norm below 1/2 the remainder is below 1e-19.
const TERMS: u32 = 14;
/// Bound on the squarings; a norm of 2^40 is beyond every valid parameter of a hand.
const SQUARINGS_MAX: u32 = 64;

impl Oscillator {
    pub(crate) fn transition(&self, step_secs: f64) -> Transition {
        let rate = Matrix3::new(
            0.0,
            1.0,
            0.0,
            -self.stiffness / self.mass,
            -self.damping / self.mass,
            1.0,
            0.0,
            0.0,
            0.0,
        );
        let mut scaled = rate * step_secs;
        let mut squarings = 0;
        while scaled.amax() > 0.125 && squarings < SQUARINGS_MAX {
            scaled *= 0.5;
            squarings += 1;
        }
        // Horner's scheme of 1 + A (1 + A/2 (1 + A/3 (…))).
        let mut sum = Matrix3::identity();
        for term in (1..=TERMS).rev() {
            sum = Matrix3::identity() + scaled * sum / f64::from(term);
        }
        for _ in 0..squarings {
            sum *= sum;
        }
        Transition {
            position: [sum[(0, 0)], sum[(0, 1)], sum[(0, 2)]],
            velocity: [sum[(1, 0)], sum[(1, 1)], sum[(1, 2)]],
        }
    }
}

impl Transition {
    /// Applies the step to one axis: position \[m\], velocity [m/s], acceleration by the force [m/s²].
    pub fn apply(&self, position: f64, velocity: f64, acceleration: f64) -> (f64, f64) {
        let [px, pv, pa] = self.position;
        let [vx, vv, va] = self.velocity;
        (px * position + pv * velocity + pa * acceleration, vx * position + vv * velocity + va * acceleration)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Free response from `x0` at rest, by the textbook's formulas for the three cases.
    fn closed_form(oscillator: &Oscillator, x0: f64, t: f64) -> f64 {
        let Oscillator { mass, damping, stiffness } = *oscillator;
        let sigma = damping / (2.0 * mass);
        let discriminant = stiffness / mass - sigma * sigma;
        let decay = (-sigma * t).exp();
        if discriminant > 1e-9 {
            let omega = discriminant.sqrt();
            x0 * decay * ((omega * t).cos() + sigma / omega * (omega * t).sin())
        } else if discriminant < -1e-9 {
            let omega = (-discriminant).sqrt();
            x0 * decay * ((omega * t).cosh() + sigma / omega * (omega * t).sinh())
        } else {
            x0 * decay * (1.0 + sigma * t)
        }
    }

    #[test]
    fn free_response_matches_the_closed_form_in_every_regime() {
        for (damping, stiffness) in [(6.0, 500.0), (2.0 * (0.2_f64 * 500.0).sqrt(), 500.0), (60.0, 500.0)] {
            let oscillator = Oscillator { mass: 0.2, damping, stiffness };
            let step = oscillator.transition(0.25e-3);
            let (mut x, mut v) = (0.01, 0.0);
            for n in 1..=2000 {
                (x, v) = step.apply(x, v, 0.0);
                let expected = closed_form(&oscillator, 0.01, f64::from(n) * 0.25e-3);
                assert!((x - expected).abs() < 1e-13, "b {damping}: {x} instead of {expected}");
            }
        }
    }

    #[test]
    fn without_spring_and_damper_it_is_a_thrown_stone() {
        let (x, v) =
            Oscillator { mass: 2.0, damping: 0.0, stiffness: 0.0 }.transition(0.3).apply(1.0, 2.0, 5.0);
        assert!((x - (1.0 + 0.6 + 0.5 * 5.0 * 0.09)).abs() < 1e-14);
        assert!((v - 3.5).abs() < 1e-14);
    }

    #[test]
    fn one_long_step_equals_many_short_ones_however_stiff() {
        let oscillator = Oscillator { mass: 0.045, damping: 30.0, stiffness: 2e4 };
        let long = oscillator.transition(0.05).apply(0.01, -0.3, 7.0);
        let step = oscillator.transition(0.05 / 4096.0);
        let short = (0..4096).fold((0.01, -0.3), |(x, v), _| step.apply(x, v, 7.0));
        assert!((long.0 - short.0).abs() < 1e-12 && (long.1 - short.1).abs() < 1e-10);
    }
}
