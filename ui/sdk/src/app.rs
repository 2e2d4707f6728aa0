//! The application: the registry of components, and the kinds of controllers and devices by the names that scenarios
//! use.

pub(crate) mod actors;

use std::collections::BTreeMap;
use std::collections::btree_map::Entry;
use std::path::Path;
use std::sync::{Arc, OnceLock};

use serde::de::DeserializeOwned;
use thiserror::Error;
use trocar_kernel::supervision::RuntimeClass;
use trocar_scene::confined_path::Assets;
use trocar_scene::scenario::{ControllerEntry, RATE_HZ, Scenario, ScenarioError};
use trocar_scene::{
    BuildContext, Component, Controller, ControllerError, Registry, RegistryBuilder, RegistryError,
};

use self::actors::ActorKind;
use crate::device_kinds::DeviceKind;
use crate::kind::joining;
pub use crate::kind::{Arrange, Blueprint, ForHands, Kind, KindContext, KindInfo};
use crate::kinds;
use crate::network::{ITP_ABOUT, ITP_USAGE, ItpRobots};

/// Built-in scenarios: (name, text).
pub const SCENARIOS: [(&str, &str); 17] = [
    ("peg-transfer", include_str!("../../../scenarios/peg-transfer.toml")),
    ("wall", include_str!("../../../scenarios/wall.toml")),
    ("collision-gallery", include_str!("../../../scenarios/collision-gallery.toml")),
    ("cautery", include_str!("../../../scenarios/cautery.toml")),
    ("instruments", include_str!("../../../scenarios/instruments.toml")),
    ("bleeding", include_str!("../../../scenarios/bleeding.toml")),
    ("cloth-cut", include_str!("../../../scenarios/cloth-cut.toml")),
    ("fem-liver", include_str!("../../../scenarios/fem-liver.toml")),
    ("knot", include_str!("../../../scenarios/knot.toml")),
    ("needle-tissue", include_str!("../../../scenarios/needle-tissue.toml")),
    ("soft-stomach", include_str!("../../../scenarios/soft-stomach.toml")),
    ("tube-loop", include_str!("../../../scenarios/tube-loop.toml")),
    ("omentum", include_str!("../../../scenarios/omentum.toml")),
    ("band", include_str!("../../../scenarios/band.toml")),
    ("two-rates", include_str!("../../../scenarios/two-rates.toml")),
    ("tele-liver", include_str!("../../../scenarios/tele-liver.toml")),
    ("tele-palpation", include_str!("../../../scenarios/tele-palpation.toml")),
];

/// A name that an [`App`] cannot register. The `App` keeps the error until a scenario is loaded.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum SetupError {
    /// Two components have the same name.
    #[error(transparent)]
    Registry(#[from] RegistryError),
    /// A kind's name is taken.
    #[error("a controller of kind '{0}' exists already")]
    KindTaken(String),
    /// A device's name is taken.
    #[error("a device of kind '{0}' exists already")]
    DeviceTaken(String),
    /// A device's name with letters that are hard to type.
    #[error("'{0}' cannot name a device; valid: lower-case letters, digits, '-' and '_'")]
    DeviceName(String),
    /// An actor's name is taken.
    #[error("an actor '{0}' exists already")]
    ActorTaken(String),
    /// A rate outside the range of controllers.
    #[error(
        "controller '{name}': {rate_hz} Hz is out of range ({} to {} Hz)",
        RATE_HZ.start(),
        RATE_HZ.end()
    )]
    Rate {
        /// The controller.
        name: String,
        /// Its rate.
        rate_hz: f64,
    },
}

/// Why a scenario cannot be loaded.
#[derive(Debug, Error)]
pub enum AppError {
    /// The application's registrations conflict.
    #[error(transparent)]
    Setup(#[from] SetupError),
    /// No such scenario.
    #[error("no scenario is called '{name}', and there is no such file; there are: {known}")]
    UnknownScenario {
        /// The name that was asked for.
        name: String,
        /// The valid names.
        known: String,
    },
    /// The scenario is invalid.
    #[error(transparent)]
    Scenario(#[from] ScenarioError),
}

/// Components and kinds of controllers: Trocar's own, and those that a program adds.
///
/// Registration chains and never fails on the spot; errors are returned when the first scenario is loaded.
///
/// ```
/// use serde::{Deserialize, Serialize};
/// use trocar::prelude::*;
///
/// #[derive(Clone, Serialize, Deserialize, Component)]
/// #[component(name = "pulse")]
/// struct Pulse { per_minute: f64 }
///
/// let app = App::new().component::<Pulse>();
/// assert!(app.registry().by_name("pulse").is_ok());
/// assert!(app.scenario("peg-transfer").is_ok());
/// ```
pub struct App {
    components: RegistryBuilder,
    /// Built on first use.
    registry: OnceLock<Arc<Registry>>,
    kinds: BTreeMap<String, Kind>,
    about: BTreeMap<String, KindInfo>,
    joining: Vec<ControllerEntry>,
    pub(crate) devices: BTreeMap<String, DeviceKind>,
    pub(crate) actors: Vec<ActorKind>,
    pub(crate) wrong: Option<SetupError>,
    assets: Assets,
}

impl Default for App {
    fn default() -> Self {
        Self::new()
    }
}

impl App {
    /// Everything that comes with Trocar.
    pub fn new() -> Self {
        let mut components = RegistryBuilder::new();
        let standard = [
            trocar_scene::components::register,
            trocar_engine::register,
            trocar_collision::controller::register,
            trocar_simulator::controller::register,
            trocar_tasks::register,
            trocar_input::register,
        ];
        let wrong = standard.into_iter().find_map(|register| register(&mut components).err());
        let robots = ItpRobots::default();
        let (mut kinds, mut about) = (BTreeMap::new(), BTreeMap::new());
        for (name, info, kind) in kinds::standard() {
            kinds.insert(name.to_owned(), kind);
            about.insert(name.to_owned(), info);
        }
        Self {
            components,
            registry: OnceLock::new(),
            kinds,
            about,
            joining: Vec::new(),
            devices: BTreeMap::new(),
            actors: Vec::new(),
            wrong: wrong.map(SetupError::Registry),
            assets: Assets::default(),
        }
        .device_with(ITP_USAGE, ITP_ABOUT, move |text| robots.device(text))
    }

    /// Adds a component; scenario files and recordings refer to it by its NAME.
    #[must_use]
    pub fn component<T: Component>(mut self) -> Self {
        if let Err(error) = self.components.register::<T>() {
            self.wrong.get_or_insert(error.into());
        }
        self.registry = OnceLock::new();
        self
    }

    /// Adds a kind of controller that needs no data to be built.
    #[must_use]
    pub fn controller<C: Controller + Default>(self, kind: &str) -> Self {
        self.controller_with(kind, |(): &(), _| Ok(C::default()))
    }

    /// Adds a kind of controller that is built, at the start and after every failure, from the scene and from its
    /// `params` in the scenario. `P` is `()` for none, or a struct whose defaults apply to missing keys.
    #[must_use]
    pub fn controller_with<C, P>(
        self,
        kind: &str,
        build: impl Fn(&P, &BuildContext<'_>) -> Result<C, ControllerError> + Send + Sync + 'static,
    ) -> Self
    where
        C: Controller,
        P: DeserializeOwned + Default + Send + Sync + 'static,
    {
        let build = Arc::new(build);
        let blueprint = move |context: &KindContext<'_>| {
            let params: P = kinds::parse_or_default(&context.entry.params)?;
            let build = build.clone();
            Ok(kinds::plain(RuntimeClass::Task, move |context| build(&params, context)))
        };
        self.kind(kind, Arc::new(blueprint))
    }

    /// Adds a kind of controller that chooses its own scheduling and fences.
    #[must_use]
    pub fn kind(mut self, name: impl Into<String>, kind: Kind) -> Self {
        match self.kinds.entry(name.into()) {
            Entry::Occupied(taken) => {
                self.wrong.get_or_insert(SetupError::KindTaken(taken.key().clone()));
            }
            Entry::Vacant(free) => {
                free.insert(kind);
            }
        }
        self
    }

    /// Describes a kind of controller for `trocar list controllers`: what it does, in a line, and its usual rate
    /// \[Hz\].
    #[must_use]
    pub fn about(mut self, kind: impl Into<String>, info: KindInfo) -> Self {
        self.about.insert(kind.into(), info);
        self
    }

    /// Adds a controller of this kind and name to every session, at `rate_hz`, whatever the scenario says. A scenario
    /// that already has a controller of that name keeps its own.
    #[must_use]
    pub fn joins(mut self, kind: &str, rate_hz: f64) -> Self {
        if RATE_HZ.contains(&rate_hz) {
            self.joining.push(joining(kind, kind, rate_hz));
        } else {
            self.wrong.get_or_insert(SetupError::Rate { name: kind.to_owned(), rate_hz });
        }
        self
    }

    /// The components.
    pub fn registry(&self) -> &Arc<Registry> {
        self.registry.get_or_init(|| self.components.clone().build())
    }
    /// Names of the kinds of controllers.
    pub fn kinds(&self) -> impl Iterator<Item = &str> {
        self.kinds.keys().map(String::as_str)
    }
    /// The description of that kind, if it has one.
    pub fn kind_info(&self, name: &str) -> Option<&KindInfo> {
        self.about.get(name)
    }
    /// The kind of that name, for use or to wrap it.
    pub fn kind_of(&self, name: &str) -> Option<&Kind> {
        self.kinds.get(name)
    }

    /// Folders besides a scenario's own from which its meshes may be read.
    #[must_use]
    pub fn assets(mut self, assets: Assets) -> Self {
        self.assets = assets;
        self
    }

    /// Loads a scenario: a built-in name, or a file. The controllers that join every session are appended to it.
    ///
    /// # Errors
    /// When the application's registrations conflict, or the scenario does not exist or is invalid; the message names
    /// the place.
    pub fn scenario(&self, name_or_file: &str) -> Result<Scenario, AppError> {
        self.check()?;
        if let Some((name, text)) = SCENARIOS.iter().find(|(name, _)| *name == name_or_file) {
            return self.scenario_from(Path::new(&format!("{name}.toml")), text);
        }
        let path = Path::new(name_or_file);
        if path.exists() || path.extension().is_some() {
            return Ok(self.joined(Scenario::load_with(path, self.registry(), &self.assets)?));
        }
        Err(AppError::UnknownScenario {
            name: name_or_file.to_owned(),
            known: SCENARIOS.iter().map(|(name, _)| *name).collect::<Vec<_>>().join(", "),
        })
    }

    /// Parses a scenario from memory; `file` is its name in messages, and the folder for its relative paths.
    ///
    /// # Errors
    /// As [`Self::scenario`].
    pub fn scenario_from(&self, file: &Path, text: &str) -> Result<Scenario, AppError> {
        self.check()?;
        Ok(self.joined(Scenario::parse_with(file, text, self.registry(), &self.assets)?))
    }

    fn check(&self) -> Result<(), SetupError> {
        self.wrong.clone().map_or(Ok(()), Err)
    }

    fn joined(&self, mut scenario: Scenario) -> Scenario {
        for entry in &self.joining {
            if !scenario.controllers.iter().any(|known| known.name == entry.name) {
                scenario.controllers.push(entry.clone());
            }
        }
        scenario
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use trocar_scene::{Access, Commands, Snapshot, Tick};

    #[derive(Default)]
    struct Idle;
    impl Controller for Idle {
        fn access(&self) -> Access {
            Access::new()
        }
        fn tick(&mut self, _: &Tick<'_>, _: &Snapshot, _: &mut Commands) -> Result<(), ControllerError> {
            Ok(())
        }
    }

    #[test]
    fn what_is_wrong_with_an_app_is_said_when_a_scenario_is_asked_for() {
        assert!(App::new().scenario("wall").is_ok());
        let twice = App::new().controller::<Idle>("idle").controller::<Idle>("idle");
        assert!(twice.scenario("wall").unwrap_err().to_string().contains("'idle' exists already"));
        let fast = App::new().controller::<Idle>("idle").joins("idle", 1e9);
        assert!(fast.scenario("wall").unwrap_err().to_string().contains("1 to 10000 Hz"));
        assert!(App::new().scenario("wal").unwrap_err().to_string().contains("peg-transfer, wall"));
    }

    #[test]
    fn a_controller_that_joins_stands_at_the_end_once() {
        let app = App::new().controller::<Idle>("idle").joins("idle", 10.0).joins("idle", 20.0);
        let names: Vec<(String, f64)> = app
            .scenario("wall")
            .unwrap()
            .controllers
            .iter()
            .map(|entry| (entry.name.clone(), entry.rate_hz))
            .collect();
        assert_eq!(names[2..], [("idle".to_owned(), 10.0)]);
    }
}
