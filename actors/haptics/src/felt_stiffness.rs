//! Online estimate of the stiffness rendered to a hand.
//!
//! Recursive least squares with exponential forgetting of `F = F₀ − K x` along the direction of the force:
//! the slope is minus the covariance of force and position over the variance of the position.

use nalgebra::Vector3;

/// Force below which the hand counts as out of contact \[N\].
const FORCE_MIN: f64 = 0.1;
/// Standard deviation of the position below which the slope is unreliable \[m\].
const SPREAD_MIN: f64 = 2e-5;

/// Speed above which damping dominates the force \[m/s\].
const SPEED_MAX: f64 = 0.03;
/// Speed below which the hand stands still \[m/s\]. What its force does then, as tissue that settles, says nothing of
/// stiffness; and an estimator that forgot what the motion had told would soon be left with that alone.
const SPEED_MIN: f64 = 5e-4;

/// Estimates −dF/dx at the hand.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FeltStiffness {
    window: f64,
    normal: Vector3<f64>,
    weight: f64,
    mean_position: f64,
    mean_force: f64,
    variance: f64,
    covariance: f64,
}

impl FeltStiffness {
    /// An estimator with the forgetting time constant `window` \[s\].
    pub fn new(window: f64) -> Self {
        Self {
            window: window.max(1e-3),
            normal: Vector3::zeros(),
            weight: 0.0,
            mean_position: 0.0,
            mean_force: 0.0,
            variance: 0.0,
            covariance: 0.0,
        }
    }

    /// Resets the estimate.
    pub fn clear(&mut self) {
        *self = Self::new(self.window);
    }

    /// Takes the handle's position \[m\], its velocity \[m/s\] and the force on the hand \[N\] of a tick of `dt` \[s\],
    /// all in the device's frame. Restarts when contact is made or the force rotates by more than about 25°; ignores
    /// ticks while the hand is fast, and while it stands still.
    pub fn update(
        &mut self,
        position: &Vector3<f64>,
        velocity: &Vector3<f64>,
        force: &Vector3<f64>,
        dt: f64,
    ) {
        let size = force.norm();
        if size < FORCE_MIN {
            self.clear();
            return;
        }
        if !(SPEED_MIN..=SPEED_MAX).contains(&velocity.norm()) {
            return;
        }
        if self.weight == 0.0 || force.dot(&self.normal) < 0.9 * size {
            *self = Self { normal: force / size, ..Self::new(self.window) };
        }
        let keep = (1.0 - dt / self.window).max(0.0);
        self.weight = self.weight * keep + 1.0;
        let gain = 1.0 / self.weight;
        let position = position.dot(&self.normal) - self.mean_position;
        let force = force.dot(&self.normal) - self.mean_force;
        self.mean_position += gain * position;
        self.mean_force += gain * force;
        self.variance = (1.0 - gain) * (self.variance + gain * position * position);
        self.covariance = (1.0 - gain) * (self.covariance + gain * position * force);
    }

    /// Stiffness \[N/m\], or `None` out of contact and until the hand has moved enough in it.
    pub fn value(&self) -> Option<f64> {
        (self.variance > SPREAD_MIN * SPREAD_MIN).then(|| -self.covariance / self.variance)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Length of a tick \[s\].
    const DT: f64 = 1e-3;

    /// Displacement \[m\] and speed \[m/s\] of a hand that swings by `amplitude` \[m\].
    fn swing(tick: u32, amplitude: f64) -> (f64, f64) {
        let phase = f64::from(tick) * 0.05;
        (amplitude * phase.sin(), amplitude * phase.cos() * 0.05 / DT)
    }

    #[test]
    fn a_spring_is_measured_and_forgotten_on_release() {
        let mut felt = FeltStiffness::new(0.2);
        let normal = Vector3::new(0.0, 0.6, 0.8);
        for tick in 0..500 {
            let (x, v) = swing(tick, 0.0005);
            let depth = 0.002 + x;
            felt.update(&(normal * -depth), &(normal * -v), &(normal * depth * 800.0), DT);
        }
        assert!((felt.value().unwrap() - 800.0).abs() < 1e-6);
        // A fast tick is ignored, whatever its force.
        felt.update(&Vector3::zeros(), &(normal * 0.5), &(normal * 3.0), 1e-3);
        assert!((felt.value().unwrap() - 800.0).abs() < 1e-6);
        felt.update(&Vector3::zeros(), &Vector3::zeros(), &Vector3::zeros(), 1e-3);
        assert_eq!(felt.value(), None);
    }

    #[test]
    fn a_constant_push_has_no_stiffness() {
        let mut felt = FeltStiffness::new(0.2);
        for tick in 0..500 {
            let (x, v) = swing(tick, 0.0005);
            felt.update(&Vector3::new(x, 0.0, 0.0), &Vector3::new(v, 0.0, 0.0), &Vector3::x(), DT);
        }
        assert!(felt.value().unwrap().abs() < 1e-9);
        let mut still = FeltStiffness::new(0.2);
        still.update(&Vector3::zeros(), &Vector3::zeros(), &Vector3::x(), 1e-3);
        assert_eq!(still.value(), None);
    }

    /// A hand that has pressed and then stands for seconds, on tissue that relaxes and trembles.
    #[test]
    fn what_a_hand_that_stands_still_feels_is_no_stiffness() {
        let mut felt = FeltStiffness::new(0.2);
        let normal = Vector3::z();
        for tick in 0..600 {
            let depth = 0.003 + 1e-5 * f64::from(tick);
            felt.update(&(normal * -depth), &(normal * -0.01), &(normal * depth * 200.0), DT);
        }
        let pressed = felt.value().unwrap();
        assert!((pressed - 200.0).abs() < 1e-6, "{pressed}");
        for tick in 0..3_000 {
            let tremble = 1e-5 * (f64::from(tick) * 0.7).sin();
            let force = 1.8 - 1e-4 * f64::from(tick) + 0.1 * (f64::from(tick) * 0.7).sin();
            felt.update(&(normal * (-0.009 + tremble)), &(normal * 1e-4), &(normal * force), DT);
        }
        assert_eq!(felt.value(), Some(pressed));
    }
}
