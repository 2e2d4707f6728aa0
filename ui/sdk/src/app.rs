//! The table of what a program knows: components, and kinds of controllers by the names that scenarios use.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

use thiserror::Error;
use trocar_kernel::spec::{Factory, Fence};
use trocar_kernel::supervision::RuntimeClass;
use trocar_scene::scenario::{ControllerEntry, Scenario, ScenarioError};
use trocar_scene::{Commands, Component, Registry, RegistryBuilder, RegistryError, Snapshot};

use crate::hands::HandPort;
use crate::kinds;
use crate::run::RunOptions;

/// Scenarios that are part of the program: (name, text).
pub const SCENARIOS: [(&str, &str); 2] = [
    ("peg-transfer", include_str!("../../../scenarios/peg-transfer.toml")),
    ("wall", include_str!("../../../scenarios/wall.toml")),
];

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
    /// Changes the scene before the session starts, for exercises that arrange it.
    pub arrange: Option<Arrange>,
}

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

/// Why an application cannot be put together.
#[derive(Debug, Error)]
pub enum AppError {
    /// Two components or kinds of one name.
    #[error(transparent)]
    Registry(#[from] RegistryError),
    /// A kind's name is taken.
    #[error("a controller of kind '{0}' exists already")]
    KindTaken(String),
    /// No such scenario.
    #[error("no scenario is called '{name}', and there is no such file; there are: {known}")]
    UnknownScenario {
        /// What was asked for.
        name: String,
        /// What there is.
        known: String,
    },
    /// The scenario is wrong.
    #[error(transparent)]
    Scenario(#[from] ScenarioError),
}

/// Components and kinds of controllers: Trocar's own, and those that a program adds.
pub struct App {
    registry: Arc<Registry>,
    kinds: BTreeMap<String, (KindInfo, Kind)>,
}

impl App {
    /// Everything that comes with Trocar.
    ///
    /// # Errors
    /// Never in a release: the standard names are distinct, which a test holds.
    pub fn standard() -> Result<Self, AppError> {
        Ok(AppBuilder::standard()?.build())
    }
    /// The components.
    pub fn registry(&self) -> &Arc<Registry> {
        &self.registry
    }
    /// Names of the kinds of controllers, in order.
    pub fn kinds(&self) -> impl Iterator<Item = &str> {
        self.kinds.keys().map(String::as_str)
    }
    /// What people are told about the kind of that name.
    pub fn kind_info(&self, name: &str) -> Option<&KindInfo> {
        self.kinds.get(name).map(|(info, _)| info)
    }
    /// The kind of that name.
    pub(crate) fn kind(&self, name: &str) -> Option<&Kind> {
        self.kinds.get(name).map(|(_, kind)| kind)
    }
    /// Loads a scenario: a name that comes with the program, or a file.
    ///
    /// # Errors
    /// When there is none, or it is wrong; the message names the place.
    pub fn scenario(&self, name_or_file: &str) -> Result<Scenario, AppError> {
        if let Some((name, text)) = SCENARIOS.iter().find(|(name, _)| *name == name_or_file) {
            let file = format!("{name}.toml");
            return Ok(Scenario::parse(Path::new(&file), text, &self.registry)?);
        }
        let path = Path::new(name_or_file);
        if path.exists() || path.extension().is_some() {
            return Ok(Scenario::load(path, &self.registry)?);
        }
        Err(AppError::UnknownScenario {
            name: name_or_file.to_owned(),
            known: SCENARIOS.iter().map(|(name, _)| *name).collect::<Vec<_>>().join(", "),
        })
    }
}

/// Puts an [`App`] together.
pub struct AppBuilder {
    registry: RegistryBuilder,
    kinds: BTreeMap<String, (KindInfo, Kind)>,
}

impl AppBuilder {
    /// Begins with everything that comes with Trocar.
    ///
    /// # Errors
    /// Never in a release: the standard names are distinct, which a test holds.
    pub fn standard() -> Result<Self, AppError> {
        let mut registry = RegistryBuilder::new();
        trocar_scene::components::register(&mut registry)?;
        trocar_engine::register(&mut registry)?;
        trocar_tasks::register(&mut registry)?;
        trocar_input::register(&mut registry)?;
        let mut builder = Self { registry, kinds: BTreeMap::new() };
        for (name, info, kind) in kinds::standard() {
            builder = builder.kind(name, info, kind)?;
        }
        Ok(builder)
    }
    /// Adds a component.
    ///
    /// # Errors
    /// When its name is taken.
    pub fn component<T: Component>(mut self) -> Result<Self, AppError> {
        self.registry.register::<T>()?;
        Ok(self)
    }
    /// Adds a kind of controller.
    ///
    /// # Errors
    /// When its name is taken.
    pub fn kind(mut self, name: impl Into<String>, info: KindInfo, kind: Kind) -> Result<Self, AppError> {
        let name = name.into();
        if self.kinds.contains_key(&name) {
            return Err(AppError::KindTaken(name));
        }
        self.kinds.insert(name, (info, kind));
        Ok(self)
    }
    /// Fixes it.
    pub fn build(self) -> App {
        App { registry: self.registry.build(), kinds: self.kinds }
    }
}
