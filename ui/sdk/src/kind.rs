//! A kind of controller: what it is made from, and how it is built and scheduled.

use std::sync::Arc;

use trocar_kernel::spec::{Factory, Fence};
use trocar_kernel::supervision::RuntimeClass;
use trocar_scene::scenario::{ControllerEntry, Params, Scenario, ScenarioError};
use trocar_scene::{Commands, Snapshot};

use crate::hands::HandPort;
use crate::options::RunOptions;

/// What a kind of controller is made from: its place in the scenario, the hands, the options of the run.
pub struct KindContext<'a> {
    /// Its table in the scenario.
    pub entry: &'a ControllerEntry,
    /// The scenario.
    pub scenario: &'a Scenario,
    /// The opened hands.
    pub hands: &'a [HandPort],
    /// What the user asked for.
    pub options: &'a RunOptions,
}

/// How a controller is built and scheduled.
pub struct Blueprint {
    /// Which priority and branch of the supervisor tree it gets.
    pub class: RuntimeClass,
    /// Builds it, at the start and after every failure.
    pub factory: Factory,
    /// Who must refuse its earlier lives.
    pub fences: Vec<Arc<dyn Fence>>,
    /// Makes it serve the hands of another session instead: of a branch of this one, or of the same one begun again.
    /// `None` for a controller that has nothing to do with hands, which is as good for any session.
    pub for_hands: Option<ForHands>,
    /// Changes the scene before the session starts, for exercises that arrange it.
    pub arrange: Option<Arrange>,
}

/// A controller's factory and fences for these hands; `None` when the one that it serves is not among them.
pub type ForHands = Arc<dyn Fn(&[HandPort]) -> Option<(Factory, Vec<Arc<dyn Fence>>)> + Send + Sync>;

/// Writes to the scene as the scenario has spawned it.
pub type Arrange = Box<dyn FnOnce(&Snapshot, &mut Commands)>;

/// What people are told about a kind of controller.
#[derive(Clone, Debug, PartialEq)]
pub struct KindInfo {
    /// What it does, in a line.
    pub about: String,
    /// The rate at which it is usually run \[Hz\]; the scenario decides.
    pub rate_hz: f64,
}

impl KindInfo {
    /// A line about it, and its usual rate \[Hz\].
    pub fn new(about: impl Into<String>, rate_hz: f64) -> Self {
        Self { about: about.into(), rate_hz }
    }
}

/// Makes the blueprint of one kind of controller.
pub type Kind = Arc<dyn Fn(&KindContext<'_>) -> Result<Blueprint, ScenarioError> + Send + Sync>;

/// A controller without a place in a file.
pub(crate) fn joining(name: &str, kind: &str, rate_hz: f64) -> ControllerEntry {
    let params = Params::none(format!("controller '{name}'"));
    ControllerEntry { name: name.to_owned(), kind: kind.to_owned(), rate_hz, params }
}
