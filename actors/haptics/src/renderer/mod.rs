//! Force renderers, for simulations slower than the haptic rate.
//!
//! In each haptic tick a renderer computes the wrench on the hand *at the tip*, given the device's pose of the tip.
//! Renderers differ in their input from the simulation:
//!
//! | renderer | takes | fit for |
//! |---|---|---|
//! | [`ZeroOrderHold`] | the last force | physics at the hand's own rate |
//! | [`VirtualCoupling`] | the instrument's pose | physics from about 500 Hz |
//! | [`Proxy`] | planes with compliance, evaluated at the device's present pose | any rate |

mod proxy;
mod virtual_coupling;
mod zero_order_hold;

pub use proxy::{Proxy, ProxyConfig};
pub use virtual_coupling::{VirtualCoupling, VirtualCouplingConfig};
pub use zero_order_hold::ZeroOrderHold;

use nalgebra::{Isometry3, Vector3};
use serde::{Deserialize, Serialize};
use trocar_scene::{InstrumentForce, LocalContactModel, SimTime};

use crate::spatial::{Twist, Wrench};

/// Input of a renderer in a tick. Poses and velocities in world, at the tip.
#[derive(Clone, Copy, Debug)]
pub struct RenderInput<'a> {
    /// Time of the tick.
    pub now: SimTime,
    /// Time between ticks \[s\].
    pub dt: f64,
    /// Tip pose by the device: `world_from_tip`.
    pub tip_in_world: Isometry3<f64>,
    /// Its velocity.
    pub tip_twist: Twist,
    /// Largest stable stiffness at the tip, through the current lever \[N/m\].
    pub stiffness_max: f64,
    /// Largest stable damping at the tip, through the current lever \[N·s/m\].
    pub damping_max: f64,
    /// Apparent mass of the device at the tip, through the current lever \[kg\].
    pub apparent_mass: f64,
    /// Net energy put in by the hand \[J\], available to forces that grow by themselves.
    pub energy_available: f64,
    /// The simulated instrument.
    pub instrument: Option<SimulatedInstrument>,
    /// The simulation's force; its time is never after it was first seen here.
    pub instrument_force: Option<&'a InstrumentForce>,
    /// The simulation's local contact model.
    pub contact_model: Option<&'a LocalContactModel>,
    /// Whether the simulation is at another station, so that its forces have waited in a network.
    pub remote: bool,
}

/// Age after which a force of a simulation at another station fades \[s\]; it is zero at twice that age. Its rows are
/// renewed every 20 ms at least, so that a lost one is no fade. Simulations of this station may run at 10 Hz and have
/// longer times, which are each renderer's own.
pub const REMOTE_FADE_SECS: f64 = 0.05;

impl RenderInput<'_> {
    /// Time after which a force fades \[s\] that fades after `local_secs` when the simulation is here.
    pub(crate) fn fade_secs(&self, local_secs: f64) -> f64 {
        if self.remote { local_secs.min(REMOTE_FADE_SECS) } else { local_secs }
    }

    /// A force of the time `at` that is rendered as it stands, beside geometry that is evaluated at the present pose and
    /// may be older: faded if it has waited in a network.
    pub(crate) fn waited(&self, force: Vector3<f64>, at: SimTime) -> Vector3<f64> {
        if !self.remote {
            return force;
        }
        force * freshness(self.now.since(at).as_secs_f64(), REMOTE_FADE_SECS)
    }
}

/// The simulation's own instrument.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SimulatedInstrument {
    /// `world_from_tip` at `at`.
    pub tip_in_world: Isometry3<f64>,
    /// Its velocity, in world.
    pub twist: Twist,
    /// Time of the pose.
    pub at: SimTime,
}

/// Turns the simulation's state into a wrench on the hand, at the tip, in world.
pub trait ForceRenderer: Send {
    /// One haptic tick. Allocates nothing; finite input gives finite output.
    fn render(&mut self, input: &RenderInput<'_>) -> Wrench;
    /// Clears contacts and blends.
    fn reset(&mut self);
    /// The name under which a scenario selects it.
    fn name(&self) -> &'static str;
}

/// Which renderer a hand uses, with its parameters.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", tag = "kind")]
pub enum RendererConfig {
    /// The simulation's last force, held (the paper's method).
    #[serde(rename = "held")]
    ZeroOrderHold,
    /// A spring and damper to the simulated instrument.
    VirtualCoupling(VirtualCouplingConfig),
    /// A constraint proxy on the simulation's local contact model.
    Proxy(ProxyConfig),
}

impl Default for RendererConfig {
    fn default() -> Self {
        Self::Proxy(ProxyConfig::default())
    }
}

impl RendererConfig {
    /// Makes the renderer.
    pub fn build(&self) -> Box<dyn ForceRenderer> {
        match self {
            Self::ZeroOrderHold => Box::new(ZeroOrderHold),
            Self::VirtualCoupling(config) => Box::new(VirtualCoupling::new(*config)),
            Self::Proxy(config) => Box::new(Proxy::new(*config)),
        }
    }
}

/// Weight of simulation output of age `age_secs`: 1 up to `fade_secs`, then decreasing to 0 at twice that time, so that
/// a dead simulation does not press on a hand for ever.
pub(crate) fn freshness(age_secs: f64, fade_secs: f64) -> f64 {
    (2.0 - age_secs / fade_secs).clamp(0.0, 1.0)
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    /// A resting tip at `tip` at time zero, 1 kHz, nothing published.
    pub(crate) fn input_at(tip: Vector3<f64>) -> RenderInput<'static> {
        RenderInput {
            now: SimTime::ZERO,
            dt: 1e-3,
            tip_in_world: Isometry3::from_parts(tip.into(), nalgebra::UnitQuaternion::identity()),
            tip_twist: Twist::ZERO,
            stiffness_max: 2000.0,
            damping_max: 10.0,
            apparent_mass: 0.045,
            energy_available: f64::INFINITY,
            instrument: None,
            instrument_force: None,
            contact_model: None,
            remote: false,
        }
    }

    #[test]
    fn every_renderer_is_selected_by_its_name() {
        for (text, name) in [
            (r#"{"kind":"held"}"#, "held"),
            (r#"{"kind":"virtual_coupling","stiffness":500.0}"#, "virtual_coupling"),
            (r#"{"kind":"proxy","damping_ratio":1.0}"#, "proxy"),
        ] {
            let config: RendererConfig = serde_json::from_str(text).unwrap();
            assert_eq!(config.build().name(), name);
        }
        assert!(serde_json::from_str::<RendererConfig>(r#"{"kind":"magic"}"#).is_err());
    }
}
