//! Haptics configuration of a hand: scenario parameters and errors.

use serde::{Deserialize, Serialize};
use thiserror::Error;
use trocar_scene::ControllerError;
use trocar_scene::kinematics::hand_rig::HandRigError;

use crate::playout::PLAYOUT_SECS_MAX;
use crate::renderer::RendererConfig;

/// Parameters of the haptics of one hand. Device limits come from the device's capabilities.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct HapticsConfig {
    /// Which renderer, with its parameters.
    pub renderer: RendererConfig,
    /// Whether the driver keeps the force passive; its energy observer runs either way.
    pub passivity: bool,
    /// Whether another station simulates the scene. What it says of forces has then waited in a network, and is rendered
    /// for as long as [`REMOTE_FADE_SECS`](crate::renderer::REMOTE_FADE_SECS) says, by every renderer. Geometry is not
    /// affected, since it is evaluated at the hand's present pose.
    pub remote_scene: bool,
    /// How long after the hand was there its instrument is moved \[s\]: among peers, all of whom move it then.
    pub playout_secs: f64,
    /// Time constant with which the felt stiffness is estimated \[s\].
    pub felt_window_secs: f64,
    /// Time between two writes of [`HapticStatus`](trocar_scene::HapticStatus) \[s\]; also the most that a restarted
    /// controller may have lost.
    pub status_period_secs: f64,
}

impl Default for HapticsConfig {
    fn default() -> Self {
        Self {
            renderer: RendererConfig::default(),
            passivity: true,
            remote_scene: false,
            playout_secs: 0.0,
            felt_window_secs: 0.25,
            status_period_secs: 0.01,
        }
    }
}

impl HapticsConfig {
    /// Refuses parameters that are out of range.
    ///
    /// # Errors
    /// [`HapticsError::Config`] names the parameter and its range.
    pub fn check(&self) -> Result<(), HapticsError> {
        let range = |field, value: f64, min: f64, max: f64| {
            // NaN fails every range check.
            if (min..=max).contains(&value) {
                Ok(())
            } else {
                Err(HapticsError::Config { field, value, min, max })
            }
        };
        range("playout_secs", self.playout_secs, 0.0, PLAYOUT_SECS_MAX)?;
        range("felt_window_secs", self.felt_window_secs, 0.01, 10.0)?;
        range("status_period_secs", self.status_period_secs, 0.0, 1.0)?;
        match &self.renderer {
            RendererConfig::ZeroOrderHold => Ok(()),
            RendererConfig::VirtualCoupling(coupling) => {
                range("stiffness", coupling.stiffness, 0.0, 1e5)?;
                range("damping", coupling.damping, 0.0, 1e3)?;
                range("angular_stiffness", coupling.angular_stiffness, 0.0, 100.0)?;
                range("angular_damping", coupling.angular_damping, 0.0, 1.0)?;
                range("horizon_secs", coupling.horizon_secs, 0.0, 1.0)
            }
            RendererConfig::Proxy(proxy) => {
                range("stiffness", proxy.stiffness, 1.0, 1e5)?;
                range("damping_ratio", proxy.damping_ratio, 0.0, 5.0)?;
                range("blend_secs[0]", proxy.blend_secs[0], 1e-4, 1.0)?;
                range("blend_secs[1]", proxy.blend_secs[1], proxy.blend_secs[0], 1.0)
            }
        }
    }
}

/// Why a hand's haptics cannot run.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum HapticsError {
    /// The scene does not describe the hand.
    #[error("haptics: {0}")]
    Rig(#[from] HandRigError),
    /// A parameter is out of range.
    #[error("haptics: {field} = {value} is out of range ({min} to {max})")]
    Config {
        /// The parameter.
        field: &'static str,
        /// Its value.
        value: f64,
        /// Smallest valid value.
        min: f64,
        /// Largest valid value.
        max: f64,
    },
}

impl From<HapticsError> for ControllerError {
    fn from(error: HapticsError) -> Self {
        match error {
            HapticsError::Rig(_) => ControllerError::Scene(error.to_string()),
            HapticsError::Config { .. } => ControllerError::Failed(error.to_string()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::renderer::{ProxyConfig, VirtualCouplingConfig};

    #[test]
    fn defaults_pass_and_bad_parameters_are_named() {
        HapticsConfig::default().check().unwrap();
        let of = |renderer| HapticsConfig { renderer, ..HapticsConfig::default() }.check();
        of(RendererConfig::ZeroOrderHold).unwrap();
        of(RendererConfig::VirtualCoupling(VirtualCouplingConfig::default())).unwrap();
        let coupling = VirtualCouplingConfig { stiffness: f64::NAN, ..VirtualCouplingConfig::default() };
        assert!(of(RendererConfig::VirtualCoupling(coupling)).unwrap_err().to_string().contains("stiffness"));
        let proxy = ProxyConfig { blend_secs: [0.02, 0.01], ..ProxyConfig::default() };
        let text = of(RendererConfig::Proxy(proxy)).unwrap_err().to_string();
        assert_eq!(text, "haptics: blend_secs[1] = 0.01 is out of range (0.02 to 1)");
    }

    #[test]
    fn a_scenario_may_set_parts_and_no_unknown_keys() {
        let config: HapticsConfig =
            serde_json::from_str(r#"{"renderer":{"kind":"held"},"passivity":false}"#).unwrap();
        assert_eq!((config.renderer, config.passivity), (RendererConfig::ZeroOrderHold, false));
        assert!(serde_json::from_str::<HapticsConfig>(r#"{"stiffness":1}"#).is_err());
    }
}
