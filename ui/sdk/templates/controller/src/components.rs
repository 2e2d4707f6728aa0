//! The components of this behaviour. Any plain serialisable type with a name can be a component.

use trocar::prelude::*;

/// On an organ: how it follows the breath. Set by the scenario.
#[derive(Clone, Debug, Serialize, Deserialize, Component)]
#[component(name = "breathes")]
#[serde(deny_unknown_fields)]
pub struct Breathes {
    /// Height of its origin at the end of expiration, in its parent's frame \[m\].
    pub rest_height: f64,
    /// Its share of the excursion, 0 to 1.
    pub share: f64,
}

/// On the controller's own entity: the state of respiration. All that is needed to continue after a failure.
#[derive(Clone, Debug, Serialize, Deserialize, Component)]
#[component(name = "respiration")]
pub struct Respiration {
    /// Phase of the present breath, 0 to 1.
    pub phase: f64,
    /// Depth of the present breath; 1 is the average.
    pub depth: f64,
    /// Depth of the next breath, once it has been planned.
    pub next_depth: Option<f64>,
    /// Completed breaths.
    pub breaths: u32,
    /// Remaining time of a breath hold \[s\].
    pub held_secs: f64,
}

impl Default for Respiration {
    fn default() -> Self {
        Self { phase: 0.0, depth: 1.0, next_depth: None, breaths: 0, held_secs: 0.0 }
    }
}

/// Share of the tidal volume at a phase, 0 to 1: a raised cosine, smooth from one breath to the next.
pub fn lift(phase: f64) -> f64 {
    0.5 - 0.5 * (std::f64::consts::TAU * phase).cos()
}
