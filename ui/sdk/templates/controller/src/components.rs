//! What this behaviour adds to the scene. Any plain serialisable type with a name can be a component.

use trocar::prelude::*;

/// On an organ: how it follows the breath. Stands in the scenario.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Breathes {
    /// Height of its origin after breathing out, in its parent's frame \[m\].
    pub rest_height: f64,
    /// Its share of the excursion, 0 to 1.
    pub share: f64,
}

impl Component for Breathes {
    const NAME: &'static str = "breathes";
}

/// On the controller's own entity: where the breath stands. Everything that is needed to go on after a failure.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Respiration {
    /// Of the present breath, 0 to 1.
    pub phase: f64,
    /// Of the present breath; 1 is the average.
    pub depth: f64,
    /// Of the next one, once it has been planned.
    pub next_depth: Option<f64>,
    /// Breaths that are over.
    pub breaths: u32,
    /// For so long it holds its breath \[s\].
    pub held_secs: f64,
}

impl Default for Respiration {
    fn default() -> Self {
        Self { phase: 0.0, depth: 1.0, next_depth: None, breaths: 0, held_secs: 0.0 }
    }
}

impl Component for Respiration {
    const NAME: &'static str = "respiration";
}

/// How much of a breath is in at a phase, 0 to 1: a raised cosine, smooth where one breath follows another.
pub fn lift(phase: f64) -> f64 {
    0.5 - 0.5 * (std::f64::consts::TAU * phase).cos()
}
