//! Faults as data: a plan file, a schedule in simulated time, and what became of each fault.
//!
//! The three parts know no threads and no clock. A driver (live or lock-step) asks the [`FaultSchedule`]
//! what is due, does it at the seam concerned, and tells the [`FaultLog`] what it sees.

mod outcome;
mod plan;
mod schedule;

pub use outcome::{FaultLog, FaultRow, Measured};
pub use plan::{During, Expect, FaultAt, FaultPlan, FaultPlanError, FaultSpec, secs};
pub use schedule::{FaultSchedule, TargetClass, Targets};

pub use crate::spec::{FaultKind, FaultOrder, FaultRecord};
