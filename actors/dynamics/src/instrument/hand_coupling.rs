//! Coupling between a hand and an instrument that stands where its hand leads it unless something is in the way: a spring
//! and a damper with a bounded force (virtual coupling: Colgate, Stanley, Brown 1995).
//!
//! The instrument's displacement from where it is led has an inertia, its own mass. It moves without turning: the hand
//! holds its direction. Implicit Euler steps are stable for any stiffness and any obstacle.

use nalgebra::{Matrix3, Vector3};
use trocar_scene::Instrument;

/// The coupling of an instrument.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HandCoupling {
    /// Moving mass \[kg\].
    pub mass: f64,
    /// Stiffness \[N/m\].
    pub stiffness: f64,
    /// Damping \[N·s/m\].
    pub damping: f64,
    /// Bound of the force \[N\].
    pub force_max: f64,
}

impl HandCoupling {
    /// Critically damped.
    #[must_use]
    pub fn critically_damped(mass: f64, stiffness: f64, force_max: f64) -> Self {
        Self { mass, stiffness, damping: 2.0 * (mass * stiffness).sqrt(), force_max }
    }

    /// That of an instrument.
    #[must_use]
    pub fn of(instrument: &Instrument, force_max: f64) -> Self {
        Self::critically_damped(instrument.mass, instrument.coupling_stiffness, force_max)
    }

    /// What is invalid in it, if anything.
    #[must_use]
    pub fn wrong(&self) -> Option<&'static str> {
        let positive = |x: f64| x > 0.0 && x.is_finite();
        if !(positive(self.mass) && positive(self.stiffness)) {
            return Some("mass and stiffness have to be above 0");
        }
        let is_right = self.damping >= 0.0 && self.damping.is_finite() && self.force_max >= 0.0;
        (!is_right).then_some("damping and force_max have to be 0 or more")
    }

    /// Force on the hand at the end of a step of `dt` \[s\] in which a displacement `offset` \[m\] changes by `by` \[m\], and
    /// its derivative.
    #[must_use]
    pub fn force(&self, offset: &Vector3<f64>, by: &Vector3<f64>, dt: f64) -> (Vector3<f64>, Matrix3<f64>) {
        let stiffness = self.stiffness + self.damping / dt;
        let force = offset * self.stiffness + by * stiffness;
        let size = force.norm();
        if size <= self.force_max {
            return (force, Matrix3::identity() * stiffness);
        }
        // At its bound only the direction still changes.
        let (along, held) = (force / size, self.force_max / size);
        (force * held, (Matrix3::identity() - along * along.transpose()) * (stiffness * held))
    }

    /// Force that the instrument needs for that change, with the displacement's velocity \[m/s\] before; and its
    /// derivative.
    #[must_use]
    pub fn needed(
        &self,
        [offset, velocity]: [&Vector3<f64>; 2],
        by: &Vector3<f64>,
        dt: f64,
    ) -> (Vector3<f64>, Matrix3<f64>) {
        let (force, stiffness) = self.force(offset, by, dt);
        let inertia = self.mass / (dt * dt);
        (force + (by - velocity * dt) * inertia, stiffness + Matrix3::identity() * inertia)
    }

    /// Change of the displacement in a step in which contacts push the instrument with `force` \[N\], less `stiffness`
    /// \[N/m\] times the difference of the change from `expected` \[m\].
    #[must_use]
    pub fn change(
        &self,
        [offset, velocity]: [&Vector3<f64>; 2],
        (force, stiffness): (&Vector3<f64>, &Matrix3<f64>),
        expected: &Vector3<f64>,
        dt: f64,
    ) -> Vector3<f64> {
        let mut by = Vector3::zeros();
        // The force is the gradient of a convex function, linear up to its bound.
        for _ in 0..4 {
            let (needed, tangent) = self.needed([offset, velocity], &by, dt);
            let lacking = force - stiffness * (by - expected) - needed;
            by += (tangent + stiffness).try_inverse().unwrap_or_default() * lacking;
        }
        by
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Displacement \[m\] and force of the wall \[N\] where it is led 10 mm into an elastic wall, whose force is that of the
    /// last step.
    fn on_wall(stiffness: f64, dt: f64, force_max: f64) -> (f64, f64) {
        let coupling = HandCoupling::critically_damped(0.03, 1000.0, force_max);
        let (mut offset, mut velocity, mut force) = (Vector3::zeros(), Vector3::zeros(), 0.0);
        let wall = 0.01;
        for _ in 0..(0.5 / dt) as usize {
            force = -stiffness * f64::max(wall + offset.x, 0.0);
            let k = if force != 0.0 { Matrix3::identity() * stiffness } else { Matrix3::zeros() };
            let push = Vector3::x() * force;
            let by = coupling.change([&offset, &velocity], (&push, &k), &Vector3::zeros(), dt);
            offset += by;
            velocity = by / dt;
        }
        (offset.x, force)
    }

    #[test]
    fn against_a_wall_of_any_stiffness_it_comes_to_rest_where_two_springs_balance() {
        for stiffness in [10.0, 1e3, 1e5, 1e7] {
            for dt in [2.5e-4, 1e-3, 1e-2] {
                let (offset, force) = on_wall(stiffness, dt, 20.0);
                let wanted = -0.01 * stiffness / (stiffness + 1000.0);
                assert!((offset - wanted).abs() < 1e-6, "{stiffness} N/m, {dt} s: {offset} of {wanted}");
                assert!((force - wanted * 1000.0).abs() < 1e-2, "{stiffness} N/m, {dt} s: {force} N");
            }
        }
        // It pulls with its bound: the wall gives way by that.
        let (offset, force) = on_wall(1e4, 1e-3, 4.0);
        assert!((force + 4.0).abs() < 1e-6 && (offset - (4e-4 - 0.01)).abs() < 1e-6, "{offset} m, {force} N");
    }
}
