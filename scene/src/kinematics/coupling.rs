//! Coupling of handle and instrument: through a port, or free in six degrees of freedom.

use nalgebra::{Isometry3, Vector3};

use super::fulcrum::{Fulcrum, Passage};
use super::spatial::{Twist, Wrench};

/// Stiffness of the end stops at the insertion limits, at the handle \[N/m\].
const STOP_STIFFNESS: f64 = 400.0;
/// Damping of the end stops \[N·s/m\].
const STOP_DAMPING: f64 = 2.0;

/// The mechanical path between handle and tip.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum InstrumentCoupling {
    /// Through a remote centre.
    Fulcrum(Fulcrum),
    /// Rigidly: `handle_from_tip`.
    Free(Isometry3<f64>),
}

/// The path linearised at one handle pose: maps motion forwards and load backwards.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Transmission {
    /// Through a remote centre.
    Fulcrum(Passage),
    /// Rigidly.
    Free {
        /// `world_from_tip`.
        tip_in_world: Isometry3<f64>,
        /// From the handle point to the tip, in world \[m\].
        arm_in_world: Vector3<f64>,
    },
}

impl InstrumentCoupling {
    /// Free motion of a straight shaft of `shaft_length` \[m\] along the handle's z axis.
    pub fn free_shaft(shaft_length: f64) -> Self {
        Self::Free(Isometry3::translation(0.0, 0.0, shaft_length))
    }

    /// Evaluates the path at a handle pose; `axis_before` as in [`Fulcrum::pass`].
    pub fn transmit(&self, handle_in_world: &Isometry3<f64>, axis_before: &Vector3<f64>) -> Transmission {
        match self {
            Self::Fulcrum(fulcrum) => Transmission::Fulcrum(fulcrum.pass(handle_in_world, axis_before)),
            Self::Free(handle_from_tip) => Transmission::Free {
                tip_in_world: handle_in_world * handle_from_tip,
                arm_in_world: handle_in_world.rotation * handle_from_tip.translation.vector,
            },
        }
    }

    /// The handle pose that puts the tip at `tip_in_world`.
    pub fn handle_for_tip(&self, tip_in_world: &Isometry3<f64>) -> Isometry3<f64> {
        match self {
            Self::Fulcrum(fulcrum) => fulcrum.handle_for_tip(tip_in_world),
            Self::Free(handle_from_tip) => tip_in_world * handle_from_tip.inverse(),
        }
    }

    /// Wrench of the path itself on the handle (seal friction, end stops), in world; it never adds power over a closed
    /// path.
    pub fn passive_wrench(&self, transmission: &Transmission, handle_twist: &Twist) -> Wrench {
        let (Self::Fulcrum(fulcrum), Transmission::Fulcrum(passage)) = (self, transmission) else {
            return Wrench::ZERO;
        };
        let friction = passage.handle_wrench(&fulcrum.friction(passage, handle_twist));
        if passage.excess == 0.0 {
            return friction;
        }
        let axis = &passage.axis_in_world;
        let outwards = passage.excess * STOP_STIFFNESS + axis.dot(&handle_twist.linear) * STOP_DAMPING;
        // A stop pushes and never pulls: leaving it fast must not stick.
        let outwards = if passage.excess > 0.0 { outwards.max(0.0) } else { outwards.min(0.0) };
        friction + Wrench::new(axis * -outwards, Vector3::zeros())
    }
}

impl Transmission {
    /// `world_from_tip`.
    pub fn tip_in_world(&self) -> &Isometry3<f64> {
        match self {
            Self::Fulcrum(passage) => &passage.tip_in_world,
            Self::Free { tip_in_world, .. } => tip_in_world,
        }
    }
    /// Direction of the shaft, towards the tip, in world.
    pub fn axis_in_world(&self) -> Vector3<f64> {
        match self {
            Self::Fulcrum(passage) => passage.axis_in_world,
            Self::Free { tip_in_world, .. } => tip_in_world.rotation * Vector3::z(),
        }
    }
    /// Velocity of the tip for a velocity of the handle; both in world.
    pub fn tip_twist(&self, handle_twist: &Twist) -> Twist {
        match self {
            Self::Fulcrum(passage) => passage.tip_twist(handle_twist),
            Self::Free { arm_in_world, .. } => handle_twist.at_offset(arm_in_world),
        }
    }
    /// Load at the handle for a load at the tip: same power.
    pub fn handle_wrench(&self, tip_wrench: &Wrench) -> Wrench {
        match self {
            Self::Fulcrum(passage) => passage.handle_wrench(tip_wrench),
            Self::Free { arm_in_world, .. } => tip_wrench.at_offset(&-arm_in_world),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kinematics::fulcrum::PortFriction;
    use nalgebra::UnitQuaternion;

    #[test]
    fn free_motion_carries_power_and_returns() {
        let coupling = InstrumentCoupling::free_shaft(0.2);
        let handle = Isometry3::from_parts(
            Vector3::new(0.1, 0.2, 0.3).into(),
            UnitQuaternion::from_euler_angles(0.4, -0.9, 2.0),
        );
        let transmission = coupling.transmit(&handle, &Vector3::z());
        let back = coupling.handle_for_tip(transmission.tip_in_world());
        assert!((back.translation.vector - handle.translation.vector).norm() < 1e-12);
        let twist = Twist::new(Vector3::new(0.1, 0.0, -0.3), Vector3::new(1.0, 2.0, 0.5));
        let wrench = Wrench::new(Vector3::new(1.0, -2.0, 0.5), Vector3::new(0.1, 0.0, 0.05));
        let at_tip = wrench.power(&transmission.tip_twist(&twist));
        assert!((at_tip - transmission.handle_wrench(&wrench).power(&twist)).abs() < 1e-12);
    }

    #[test]
    fn end_stops_push_back_and_never_pull() {
        let port = Vector3::new(0.0, 0.0, 0.2);
        let fulcrum = Fulcrum::new(port, 0.33, [0.05, 0.20], PortFriction::NONE).unwrap();
        let coupling = InstrumentCoupling::Fulcrum(fulcrum);
        let down = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
        let deep = Isometry3::from_parts((port + Vector3::z() * 0.125).into(), down);
        let transmission = coupling.transmit(&deep, &-Vector3::z());
        let still = coupling.passive_wrench(&transmission, &Twist::ZERO);
        assert!((still.force.z - 0.005 * STOP_STIFFNESS).abs() < 1e-9, "{:?}", still.force);
        let leaving = Twist::new(Vector3::z() * 5.0, Vector3::zeros());
        assert_eq!(coupling.passive_wrench(&transmission, &leaving).force.z, 0.0);
    }
}
