//! Runtimes and rates: tickers, scheduling, statistics, and the host that runs a controller.

pub mod budget;
mod contribution_stats;
pub mod histogram;
pub mod jobs;
pub mod panics;
mod pausable_clock;
pub mod sched;
pub mod stats;
pub mod ticker;

pub use budget::{Budget, Verdict};
pub use contribution_stats::Hits;
pub use histogram::{AtomicHistogram, Bars, Quantiles};
pub use jobs::JobRunner;
pub use panics::guarded;
pub use pausable_clock::PausableClock;
pub use sched::Permission;
pub use stats::{Account, ControllerReport, TickStats};
pub use ticker::{Clock, Due, Schedule, Ticker};
