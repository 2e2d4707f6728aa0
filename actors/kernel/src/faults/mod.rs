//! Fault injection as data: a plan file, a schedule in simulated time, and a log of each fault's outcome.
//!
//! The three parts use no threads and no clock. A driver (live or lock-step) asks the [`FaultSchedule`] for due orders,
//! applies them at the component concerned, and reports what it observes to the [`FaultLog`].

mod batch_in_flight;
mod builder;
mod link_faults;
mod outcome;
mod plan;
mod plan_file;
mod schedule;

pub(crate) use batch_in_flight::{BatchInFlight, second_of};
pub use builder::{FaultAt, secs};
pub use link_faults::{LINK_WAITING_MAX, LinkCounts, LinkFaults, Message};
pub(crate) use outcome::soundness;
pub use outcome::{FaultLog, FaultRow, Measured};
pub use plan::{During, Expect, FaultPlan, FaultPlanError, FaultSpec};
pub use schedule::{FaultSchedule, TargetClass, Targets};

pub use crate::spec::{FaultKind, FaultOrder, FaultRecord};
