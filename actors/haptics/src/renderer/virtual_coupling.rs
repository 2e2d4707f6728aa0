//! Virtual coupling: a spring and damper between the device and the simulated instrument.
//!
//! Colgate, Stanley & Brown 1995, "Issues in the haptic display of tool use"; Adams & Hannaford 1999. The
//! instrument's pose is extrapolated with its velocity over a bounded time, since it is as old as the
//! physics' step.

use serde::{Deserialize, Serialize};

use super::{ForceRenderer, RenderInput, freshness};
use crate::spatial::{Twist, Wrench, small_rotation_vector};

/// Age after which the coupling fades \[s\].
const FADE_SECS: f64 = 0.25;

/// Parameters of the coupling.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct VirtualCouplingConfig {
    /// Translational stiffness \[N/m\]; bounded by the device's stable stiffness.
    pub stiffness: f64,
    /// Translational damping \[N·s/m\].
    pub damping: f64,
    /// Rotational stiffness \[N·m/rad\].
    pub angular_stiffness: f64,
    /// Rotational damping \[N·m·s/rad\].
    pub angular_damping: f64,
    /// Longest time over which the instrument's pose is extrapolated \[s\].
    pub horizon_secs: f64,
}

impl Default for VirtualCouplingConfig {
    fn default() -> Self {
        Self {
            stiffness: 800.0,
            damping: 4.0,
            angular_stiffness: 0.0,
            angular_damping: 0.0,
            horizon_secs: 0.02,
        }
    }
}

/// Pulls the hand towards the simulated instrument.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VirtualCoupling {
    config: VirtualCouplingConfig,
}

impl VirtualCoupling {
    /// A coupling with these parameters.
    pub fn new(config: VirtualCouplingConfig) -> Self {
        Self { config }
    }
}

impl ForceRenderer for VirtualCoupling {
    fn render(&mut self, input: &RenderInput<'_>) -> Wrench {
        let Some(simulated) = &input.instrument else { return Wrench::ZERO };
        let age = input.now.since(simulated.at).as_secs_f64();
        let ahead = age.min(self.config.horizon_secs);
        let position = simulated.tip_in_world.translation.vector + simulated.twist.linear * ahead;
        let stretch = position - input.tip_in_world.translation.vector;
        // Beyond the horizon the extrapolated instrument is at rest, and so is its end of the damper.
        let simulated_twist = if age <= self.config.horizon_secs { simulated.twist } else { Twist::ZERO };
        let closing = simulated_twist - input.tip_twist;
        let turn =
            small_rotation_vector(&(simulated.tip_in_world.rotation * input.tip_in_world.rotation.inverse()));
        let wrench = Wrench::new(
            stretch * self.config.stiffness.min(input.stiffness_max)
                + closing.linear * self.config.damping.min(input.damping_max),
            turn * self.config.angular_stiffness + closing.angular * self.config.angular_damping,
        );
        wrench * freshness(age, input.fade_secs(FADE_SECS))
    }
    fn reset(&mut self) {}
    fn name(&self) -> &'static str {
        "virtual_coupling"
    }
}

#[cfg(test)]
mod tests {
    use super::super::SimulatedInstrument;
    use super::super::tests::input_at;
    use super::*;
    use nalgebra::{Isometry3, UnitQuaternion, Vector3};
    use trocar_scene::SimTime;

    fn coupled(config: VirtualCouplingConfig, millis: u64, velocity: Vector3<f64>) -> Wrench {
        let mut input = input_at(Vector3::new(0.001, 0.0, 0.0));
        input.now = SimTime::from_millis(millis);
        let turned = UnitQuaternion::from_scaled_axis(Vector3::new(0.0, 0.0, 0.1));
        input.instrument = Some(SimulatedInstrument {
            tip_in_world: Isometry3::from_parts(Vector3::zeros().into(), turned),
            twist: Twist::new(velocity, Vector3::zeros()),
            at: SimTime::ZERO,
        });
        VirtualCoupling::new(config).render(&input)
    }

    #[test]
    fn spring_damper_and_rotation_pull_to_the_instrument() {
        let config = VirtualCouplingConfig { angular_stiffness: 0.5, ..VirtualCouplingConfig::default() };
        let wrench = coupled(config, 0, Vector3::new(0.1, 0.0, 0.0));
        assert!((wrench.force.x - (-0.8 + 0.4)).abs() < 1e-12);
        assert!((wrench.torque.z - 0.05).abs() < 1e-4);
    }

    #[test]
    fn extrapolation_is_bounded() {
        let config = VirtualCouplingConfig { damping: 0.0, ..VirtualCouplingConfig::default() };
        let velocity = Vector3::new(0.05, 0.0, 0.0);
        // 10 ms ahead the instrument has moved 0.5 mm; from 20 ms on it is taken to stand 1 mm ahead.
        assert!((coupled(config, 10, velocity).force.x + 0.4).abs() < 1e-12);
        assert!(coupled(config, 20, velocity).force.x.abs() < 1e-12);
        assert!(coupled(config, 100, velocity).force.x.abs() < 1e-12);
        assert_eq!(coupled(config, 600, Vector3::zeros()), Wrench::ZERO);
    }

    #[test]
    fn the_device_bounds_the_stiffness() {
        let config =
            VirtualCouplingConfig { stiffness: 1e6, damping: 0.0, ..VirtualCouplingConfig::default() };
        assert!((coupled(config, 0, Vector3::zeros()).force.x + 1e-3 * 2000.0).abs() < 1e-9);
    }

    #[test]
    fn the_pull_of_an_instrument_at_another_station_is_gone_after_100_ms() {
        let pull = |millis, remote| {
            let mut input = input_at(Vector3::new(0.001, 0.0, 0.0));
            input.now = SimTime::from_millis(millis);
            input.remote = remote;
            input.instrument = Some(SimulatedInstrument {
                tip_in_world: Isometry3::identity(),
                twist: Twist::ZERO,
                at: SimTime::ZERO,
            });
            VirtualCoupling::new(VirtualCouplingConfig::default()).render(&input).force.x
        };
        let full = pull(0, false);
        assert!(full < -0.5);
        assert_eq!((pull(50, true), pull(100, true)), (full, 0.0));
        assert_eq!(pull(100, false), full);
    }
}
