//! What most programs need: `use trocar::prelude::*;`.

pub use serde::{Deserialize, Serialize};
pub use trocar_kernel::Submitted;
pub use trocar_kernel::faults::{FaultPlan, secs};
pub use trocar_kernel::live::Guest;
pub use trocar_scene::components::*;
pub use trocar_scene::{
    Access, BuildContext, Commands, ComponentError, Controller, ControllerError, Entity, EntitySet, Event,
    Job, RecordPolicy, Revision, Scenario, SimTime, Snapshot, Tick,
};

pub use crate::app::{App, KindInfo};
pub use crate::branching::BranchError;
pub use crate::open::{OpenError, SessionBuilder};
pub use crate::run::{RunOptions, run, start};
pub use crate::scene::Component;
pub use crate::session::Session;
