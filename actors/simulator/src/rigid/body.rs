//! Rigid-body state by momenta, and time integrators.

use nalgebra::{Matrix3, Point3, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};

/// Time integrator.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Integrator {
    /// Positions by the velocities before the step: that of the framework's paper. Gains energy; for short steps.
    ExplicitEuler,
    /// Positions by the velocities after the step; rotations by the implicit midpoint of Euler's equations, which
    /// conserves energy and momentum of a free body.
    #[default]
    Symplectic,
    /// Fourth-order Runge–Kutta; with the forces at the beginning.
    RungeKutta4,
}

/// State of a body. Momenta are the state; velocities are derived.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct RigidState {
    /// Centre of mass \[m\].
    pub position: Point3<f64>,
    /// `world_from_body`.
    pub rotation: UnitQuaternion<f64>,
    /// Linear momentum \[kg·m/s\].
    pub momentum: Vector3<f64>,
    /// Angular momentum about the centre of mass, in world axes \[kg·m²/s\].
    pub angular_momentum: Vector3<f64>,
}

/// Mass properties of a body.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct RigidMass {
    /// Mass \[kg\].
    pub mass: f64,
    /// Principal moments of inertia, about the axes of the body's frame \[kg·m²\].
    pub inertia: Vector3<f64>,
}

impl RigidMass {
    /// Velocity of the centre of mass \[m/s\].
    #[must_use]
    pub fn velocity(&self, state: &RigidState) -> Vector3<f64> {
        state.momentum / self.mass
    }

    /// Angular velocity, in world axes \[rad/s\].
    #[must_use]
    pub fn angular_velocity(&self, state: &RigidState) -> Vector3<f64> {
        self.turned(&state.rotation, &state.angular_momentum)
    }

    fn turned(&self, rotation: &UnitQuaternion<f64>, angular_momentum: &Vector3<f64>) -> Vector3<f64> {
        rotation * (rotation.inverse() * angular_momentum).component_div(&self.inertia)
    }

    /// Inverse of the inertia in world axes \[1/(kg·m²)\].
    #[must_use]
    pub fn inverse_inertia_in_world(&self, rotation: &UnitQuaternion<f64>) -> Matrix3<f64> {
        let turn = rotation.to_rotation_matrix();
        turn.matrix()
            * Matrix3::from_diagonal(&self.inertia.map(|moment| 1.0 / moment))
            * turn.matrix().transpose()
    }

    /// Kinetic energy \[J\].
    #[must_use]
    pub fn kinetic_energy(&self, state: &RigidState) -> f64 {
        let turning = state.angular_momentum.dot(&self.angular_velocity(state));
        (state.momentum.norm_squared() / self.mass + turning) / 2.0
    }

    /// Position and rotation after `dt` at constant momenta; rotations stay normalised.
    pub(super) fn moved(&self, state: &RigidState, dt: f64, integrator: Integrator) -> RigidState {
        let rotation = match integrator {
            Integrator::ExplicitEuler => {
                // The derivative of the quaternion, ½ ω q, as in the paper.
                let spin = self.angular_velocity(state);
                let quaternion = state.rotation.quaternion();
                let rate = nalgebra::Quaternion::from_imag(spin) * quaternion * 0.5;
                UnitQuaternion::new_normalize(quaternion + rate * dt)
            }
            Integrator::Symplectic => self.midpoint(state, dt),
            Integrator::RungeKutta4 => {
                let rate = |rotation: &UnitQuaternion<f64>| self.turned(rotation, &state.angular_momentum);
                let turn = |by: Vector3<f64>| UnitQuaternion::from_scaled_axis(by) * state.rotation;
                // In the Lie algebra of rotations, with the first term of the inverse differential (Munthe-Kaas, 1998).
                let bent = |at: Vector3<f64>, rate: Vector3<f64>| {
                    rate - at.cross(&rate) / 2.0 + at.cross(&at.cross(&rate)) / 12.0
                };
                let k1 = rate(&state.rotation);
                let at = k1 * (dt / 2.0);
                let k2 = bent(at, rate(&turn(at)));
                let at = k2 * (dt / 2.0);
                let k3 = bent(at, rate(&turn(at)));
                let at = k3 * dt;
                let k4 = bent(at, rate(&turn(at)));
                turn((k1 + k2 * 2.0 + k3 * 2.0 + k4) * (dt / 6.0))
            }
        };
        RigidState { position: state.position + self.velocity(state) * dt, rotation, ..*state }
    }

    /// The rotation by the angular velocity for which the body-frame momentum at the midpoint matches the world's.
    fn midpoint(&self, state: &RigidState, dt: f64) -> UnitQuaternion<f64> {
        let mut spin = self.angular_velocity(state);
        for _ in 0..MIDPOINT_ITERATIONS {
            let middle = UnitQuaternion::from_scaled_axis(spin * (dt / 2.0)) * state.rotation;
            let next = self.turned(&middle, &state.angular_momentum);
            let change = (next - spin).norm();
            spin = next;
            if change <= 1e-15 * spin.norm() {
                break;
            }
        }
        UnitQuaternion::from_scaled_axis(spin * dt) * state.rotation
    }
}

const MIDPOINT_ITERATIONS: u32 = 20;
