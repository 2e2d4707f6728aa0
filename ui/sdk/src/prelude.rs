//! What most programs need: `use trocar::prelude::*;`.

pub use serde::{Deserialize, Serialize};
pub use trocar_scene::components::*;
pub use trocar_scene::{
    Access, BuildContext, Commands, Component, ComponentError, Controller, ControllerError, Entity,
    EntitySet, Event, Revision, Scenario, SimTime, Snapshot, Tick,
};

pub use crate::app::App;
pub use crate::run::{RunOptions, run};
pub use crate::session::Session;
