//! Parameters and errors of a proxy.

use thiserror::Error;

/// Parameters of a proxy.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ProxyConfig {
    /// Radius \[m\]; 0 for the god-object.
    pub radius: f64,
    /// Distance from the surface at which it is kept \[m\]: imperceptible, but above rounding; 1e-5 by default.
    pub skin: f64,
    /// Coulomb friction while it sticks.
    pub static_friction: f64,
    /// Coulomb friction while it slides; not more than the static one.
    pub dynamic_friction: f64,
}

impl Default for ProxyConfig {
    fn default() -> Self {
        Self { radius: 0.002, skin: 1e-5, static_friction: 0.0, dynamic_friction: 0.0 }
    }
}

/// Why a proxy or a step is invalid.
#[derive(Clone, Copy, Debug, Error, PartialEq)]
pub enum ProxyError {
    /// A parameter is out of range.
    #[error("{what} of {value}: {valid} is valid")]
    Parameter {
        /// The parameter.
        what: &'static str,
        /// Its value.
        value: f64,
        /// Its valid range.
        valid: &'static str,
    },
    /// The device's position is not finite.
    #[error("the device is at {0:?}: finite numbers are valid")]
    NotFinite([f64; 3]),
}

impl ProxyConfig {
    pub(super) fn check(&self) -> Result<(), ProxyError> {
        let length = "0 or more, and finite,";
        let parameter = |what, value: f64, valid, is_valid: bool| {
            if is_valid { Ok(()) } else { Err(ProxyError::Parameter { what, value, valid }) }
        };
        let is_length = |value: f64| value >= 0.0 && value.is_finite();
        parameter("a radius", self.radius, length, is_length(self.radius))?;
        parameter("a skin", self.skin, "more than 0, and finite,", is_length(self.skin) && self.skin > 0.0)?;
        parameter("static friction", self.static_friction, length, is_length(self.static_friction))?;
        let is_less = is_length(self.dynamic_friction) && self.dynamic_friction <= self.static_friction;
        parameter("dynamic friction", self.dynamic_friction, "0 to the static friction", is_less)
    }
}
