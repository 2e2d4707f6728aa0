//! A kind of controller: its inputs, and how it is built and scheduled.

use std::sync::Arc;

use trocar_kernel::spec::{Factory, Fence};
use trocar_kernel::supervision::RuntimeClass;
use trocar_scene::scenario::{ControllerEntry, Params, Scenario, ScenarioError};
use trocar_scene::{Commands, Snapshot};

use crate::hands::HandPort;
use crate::options::RunOptions;

/// Inputs of a kind of controller: its entry in the scenario, the hands, the options of the run.
pub struct KindContext<'a> {
    /// Its entry in the scenario.
    pub entry: &'a ControllerEntry,
    /// The scenario.
    pub scenario: &'a Scenario,
    /// The opened hands.
    pub hands: &'a [HandPort],
    /// The options of the run.
    pub options: &'a RunOptions,
}

/// How a controller is built and scheduled.
pub struct Blueprint {
    /// Its priority and branch of the supervisor tree.
    pub class: RuntimeClass,
    /// Builds it, at the start and after every failure.
    pub factory: Factory,
    /// The fences that must refuse its earlier instances.
    pub fences: Vec<Arc<dyn Fence>>,
    /// Rebinds it to the hands of another session: a branch of this one, or the same one after a reset. `None` for a
    /// controller without hands, which serves any session unchanged.
    pub for_hands: Option<ForHands>,
    /// Changes the scene before the session starts, for exercises that set it up.
    pub arrange: Option<Arrange>,
}

/// A controller's factory and fences for these hands; `None` when its own hand is not among them.
pub type ForHands = Arc<dyn Fn(&[HandPort]) -> Option<(Factory, Vec<Arc<dyn Fence>>)> + Send + Sync>;

/// Writes to the scene just after the scenario has spawned it.
pub type Arrange = Box<dyn FnOnce(&Snapshot, &mut Commands)>;

/// The description of a kind of controller for users.
#[derive(Clone, Debug, PartialEq)]
pub struct KindInfo {
    /// What it does, in a line.
    pub about: String,
    /// Its usual rate \[Hz\]; the scenario decides.
    pub rate_hz: f64,
    /// Whether it computes how things move that hands can meet: among peers each runs it. Others run at the founder alone.
    pub simulates: bool,
}

impl KindInfo {
    /// A one-line description and its usual rate \[Hz\].
    pub fn new(about: impl Into<String>, rate_hz: f64) -> Self {
        Self { about: about.into(), rate_hz, simulates: false }
    }

    /// The same of a kind that every peer runs.
    #[must_use]
    pub fn simulating(self) -> Self {
        Self { simulates: true, ..self }
    }
}

/// Makes the blueprint of one kind of controller.
pub type Kind = Arc<dyn Fn(&KindContext<'_>) -> Result<Blueprint, ScenarioError> + Send + Sync>;

/// A controller that joins without an entry in a file.
pub(crate) fn joining(name: &str, kind: &str, rate_hz: f64) -> ControllerEntry {
    let params = Params::none(format!("controller '{name}'"));
    ControllerEntry { name: name.to_owned(), kind: kind.to_owned(), rate_hz, params }
}
