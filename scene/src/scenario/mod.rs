//! Scenario files: a scene, the controllers that act on it, the hands, and the exercise, in one TOML document.
//!
//! ```toml
//! schema = 1
//! name = "wall"
//! title = "A wall to push against"
//!
//! [[entity]]
//! name = "wall"
//! pose = { translation = [0.0, 0.0, -0.01] }       # any registered component, by its name
//! shape = { box = { half_extents = [0.1, 0.1, 0.01] } }
//!
//! [[controller]]
//! name = "engine"
//! kind = "rapier"
//! rate_hz = 500
//!
//! [[hand]]
//! name = "right"
//! device = "virtual"
//! ```
//!
//! Unknown keys are refused everywhere, so that a typing mistake is an error rather than a default. Tables called
//! `params` (and the tables `task` and `network`) are interpreted by the code they belong to, with [`Params::parse`], and its errors
//! still name the line. Strings under a key `file` are paths; they must stay below the folder of the scenario. Those of
//! meshes may also lead into folders that the caller allows ([`Assets`]).

mod document;
mod error;
mod joints;
mod load;
mod mesh_source;
mod procedural_mesh;
mod provenance;
mod schema;
mod tissue_defaults;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use nalgebra::Vector3;

pub use document::Params;
pub use error::ScenarioError;
pub use schema::json_schema;

use crate::commands::Commands;
use crate::component::ComponentError;
use crate::confined_path::Assets;
use crate::entity::Entity;
use crate::registry::Registry;
use crate::store::Store;
use crate::time::SimTime;
use mesh_source::LoadedMesh;

/// Version of the format that this code reads.
pub const SCHEMA_VERSION: i64 = 1;
/// Largest scenario file \[bytes\].
pub const FILE_BYTES_MAX: u64 = 16 << 20;
/// Largest number of entities.
pub const ENTITIES_MAX: usize = 100_000;
/// Largest number of controllers.
pub const CONTROLLERS_MAX: usize = 256;
/// Largest number of hands.
pub const HANDS_MAX: usize = 16;
/// Slowest and fastest controller \[Hz\].
pub const RATE_HZ: std::ops::RangeInclusive<f64> = 1.0..=10_000.0;

/// A scenario that has been read and checked.
#[derive(Clone, Debug)]
pub struct Scenario {
    /// The file it came from, for messages.
    pub file: PathBuf,
    /// Short name.
    pub name: String,
    /// One-line title for display.
    pub title: String,
    /// What it is about.
    pub description: String,
    /// Acceleration of gravity in world \[m/s²\].
    pub gravity_in_world: Vector3<f64>,
    /// The controllers, in the order of the file.
    pub controllers: Vec<ControllerEntry>,
    /// The hands, in the order of the file.
    pub hands: Vec<HandEntry>,
    /// The exercise's parameters.
    pub task: Params,
    /// How stations share the scene.
    pub network: Params,
    source: Arc<document::Source>,
    names: Arc<BTreeMap<String, Entity>>,
    meshes: BTreeMap<Entity, LoadedMesh>,
}

/// A controller of a scenario.
#[derive(Clone, Debug)]
pub struct ControllerEntry {
    /// Name of the writer, such as `haptics.left`.
    pub name: String,
    /// Its kind: a name in the program's table of kinds.
    pub kind: String,
    /// Ticks per second \[Hz\].
    pub rate_hz: f64,
    /// Its parameters.
    pub params: Params,
}

/// A hand of a scenario.
#[derive(Clone, Debug)]
pub struct HandEntry {
    /// Name, such as `left`: what `--hand NAME=SPEC` refers to.
    pub name: String,
    /// The entity with the `hand` component.
    pub entity: Entity,
    /// Which device, such as `virtual`; may be overridden on the command line.
    pub device: String,
    /// The device's parameters.
    pub params: Params,
    /// The force renderer: a table with its `kind` and parameters; empty for the default.
    pub renderer: Params,
}

impl Scenario {
    /// Reads and checks a scenario file, and the meshes that it refers to.
    ///
    /// # Errors
    /// Names file, line, column, key and valid choices.
    pub fn load(file: &Path, registry: &Arc<Registry>) -> Result<Self, ScenarioError> {
        load::load(file, registry, &Assets::default())
    }

    /// Reads and checks a scenario in memory; `file` gives its nominal path.
    ///
    /// # Errors
    /// Names file, line, column, key and valid choices.
    pub fn parse(file: &Path, text: &str, registry: &Arc<Registry>) -> Result<Self, ScenarioError> {
        load::parse(file, text.to_owned(), registry, &Assets::default())
    }

    /// Like [`Scenario::load`], with folders besides the scenario's own from which meshes may be read.
    ///
    /// # Errors
    /// Names file, line, column, key and valid choices.
    pub fn load_with(file: &Path, registry: &Arc<Registry>, assets: &Assets) -> Result<Self, ScenarioError> {
        load::load(file, registry, assets)
    }

    /// Like [`Scenario::parse`], with folders besides the scenario's own from which meshes may be read.
    ///
    /// # Errors
    /// Names file, line, column, key and valid choices.
    pub fn parse_with(
        file: &Path,
        text: &str,
        registry: &Arc<Registry>,
        assets: &Assets,
    ) -> Result<Self, ScenarioError> {
        load::parse(file, text.to_owned(), registry, assets)
    }

    /// Reads a scenario whose scene comes from another station: controllers, hands, exercise and the names of entities. Of
    /// what the entities are made nothing is read, so no mesh need be here; [`Self::spawn`] makes the scene without meshes.
    ///
    /// # Errors
    /// Names file, line, column, key and valid choices.
    pub fn outline(file: &Path, text: &str) -> Result<Self, ScenarioError> {
        load::outline(file, text.to_owned()).map(|(scenario, _)| scenario)
    }

    /// The folder that contains the files it refers to.
    pub fn folder(&self) -> &Path {
        self.source.file.parent().unwrap_or(Path::new(""))
    }

    /// The text of the file.
    pub fn text(&self) -> &str {
        &self.source.text
    }

    /// The entities' names. Entities are numbered in the order of the file.
    pub fn entities(&self) -> &BTreeMap<String, Entity> {
        &self.names
    }

    /// The entity of that name.
    pub fn entity(&self, name: &str) -> Option<Entity> {
        self.names.get(name).copied()
    }

    /// The commands that create the scenario's entities, for a registry with at least the components that the
    /// file was checked against.
    ///
    /// # Errors
    /// When a different registry refuses a value.
    pub fn commands(&self, registry: &Arc<Registry>) -> Result<Commands, ScenarioError> {
        let document = self.source.parse()?;
        load::commands(&self.source, &document, registry, &self.names, &self.meshes)
    }

    /// A scene with the scenario's entities, at time zero and revision 1.
    ///
    /// # Errors
    /// When a different registry refuses a value.
    pub fn spawn(&self, registry: &Arc<Registry>) -> Result<Store, ScenarioError> {
        let mut store = Store::new(registry.clone());
        let mut commands = self.commands(registry)?;
        commands.seal();
        store.apply(&mut commands, SimTime::ZERO);
        Ok(store)
    }

    /// An error in this file found by a later stage, such as an unknown kind of controller. `key` is a table's name,
    /// `index` its number in the array. It stands at the key, or the text in quotes, that the reason names, if the
    /// table has one, and else at the table.
    pub fn error_at(&self, key: &str, index: usize, reason: impl Into<String>) -> ScenarioError {
        let reason = reason.into();
        let span = self.source.parse().ok().and_then(|document| {
            let item = document.get_ref().get(key)?.get_ref().get(index)?;
            Some(document::named_in(item, &reason).unwrap_or_else(|| item.span()))
        });
        self.source.error(span.unwrap_or(0..0), key, reason)
    }
}

/// A component's error without its kind, for messages.
fn reason(error: &ComponentError) -> String {
    error.to_string()
}
