//! Runtimes and rates: tickers, scheduling, statistics, and the host that runs a controller.

pub mod budget;
pub mod histogram;
mod hits;
pub mod jobs;
pub mod panics;
pub mod sched;
mod standstill;
pub mod stats;
pub mod ticker;

pub use budget::{Budget, Verdict};
pub use histogram::{AtomicHistogram, Bars, Quantiles};
pub use hits::Hits;
pub use jobs::JobRunner;
pub use panics::guarded;
pub use sched::Permission;
pub use standstill::Standstill;
pub use stats::{Account, ControllerReport, TickStats};
pub use ticker::{Clock, Due, Schedule, Ticker};
