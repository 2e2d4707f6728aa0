//! The surgical scene: entities, components and snapshots, and the interface of controllers.
//!
//! The scene is a set of [`Entity`]s with [`Component`]s in [`Column`]s. A [`Snapshot`] is the scene at one
//! [`Revision`]: shared, complete, immutable. Behaviours implement [`Controller`]: one step reads a snapshot and fills
//! [`Commands`], which the holder of the [`Store`] validates against the controller's declared [`Access`] and applies
//! atomically.
//!
//! What is absent here: threads, clocks, sockets, actors, physics, rendering, unsafe code.
#![forbid(unsafe_code)]

// The derive names this crate as other crates do.
extern crate self as trocar_scene;

pub mod access;
pub mod annotation;
pub mod column;
pub mod commands;
pub mod component;
pub mod components;
pub mod confined_path;
pub mod controller;
pub mod disjoint_sets;
mod document_decoder;
pub mod document_value;
pub mod entity;
pub mod entity_mesh;
pub mod event;
pub mod kinematics;
pub mod mesh;
pub mod organs;
pub mod output_file;
mod polygon;
pub mod puts;
pub mod random;
pub mod readable;
pub mod registry;
pub mod scenario;
pub mod shapes;
pub mod snapshot;
pub mod soft_body;
pub mod store;
pub mod time;
pub mod tissue;
pub mod values;

pub use access::{Access, AccessOverlap, EntitySet, WriterRules};
pub use column::{Column, ErasedColumn, Rows};
pub use commands::{
    Batch, CommandError, Commands, Condition, Provenance, PutSection, SectionMap, Transfer, WriterId,
};
pub use component::{Component, ComponentError, RecordPolicy, Sampling};
pub use components::*;
pub use controller::{BuildContext, Controller, ControllerError, Job, JobOutput, JobWork, Jobs, Tick};
pub use document_value::{DocumentError, DocumentValue};
pub use entity::{Entity, EntityAllocator, SCENARIO_SPAWNER, with_entity_names};
pub use entity_mesh::EntityMesh;
pub use event::{Event, EventLog, Events};
pub use puts::{ErasedPuts, Puts};
pub use registry::{ComponentEntry, ComponentId, Registry, RegistryBuilder, RegistryError};
pub use scenario::{ControllerEntry, HandEntry, Params, Scenario, ScenarioError};
pub use snapshot::Snapshot;
pub use soft_body::SoftAbilities;
pub use store::{Refusal, Store};
pub use time::{Revision, SimTime};
pub use trocar_scene_derive::Component;
#[doc(hidden)]
pub use trocar_scene_derive::ComponentOfTrocar;
pub use values::leaves::{LeafKind, LeafRun, Leaves};
pub use values::{finite, varint};
