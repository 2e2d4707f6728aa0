//! The supervisor tree: specifications as data and a sans-IO core that both drivers use unchanged.

mod child;
mod core;
mod event;
mod inspect;
mod tree;

pub use child::{Backoff, ChildSpec, Exhausted, GroupSpec, Intensity, Node, Restart, RuntimeClass, Strategy};
pub use core::{EXIT_GAVE_UP, INCIDENTS_MAX, SHUTDOWN_CONTROLLERS_MAX, SHUTDOWN_MODEL_MAX, Supervisor};
pub use event::{Action, Cause, ChildId, Event, Health, Incident};
pub use tree::{NODES_MAX, TreeError};
