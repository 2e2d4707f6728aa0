//! The report of a run: one HTML file that needs nothing else, in light and dark.

mod histogram;
mod network;
mod page;
mod paths;
mod scale;
mod series;
mod stages;
mod svg;
mod tables;
mod teleoperation;
mod timeline;

use std::collections::BTreeMap;

use trocar::summary::RunSummary;
use trocar::trace::RunTrace;

pub use page::html;
pub use scale::{Scale, short};
pub use svg::Chart;

/// The contents of a report.
pub struct Report<'a> {
    /// Title of the scenario.
    pub title: &'a str,
    /// The result.
    pub summary: &'a RunSummary,
    /// Time series of the run.
    pub trace: &'a RunTrace,
    /// Lateness of each controller's ticks.
    pub lateness: &'a [Lateness],
    /// Health of the supervised children.
    pub health: &'a [Health],
    /// Failures that the supervisor detected, in order.
    pub incidents: &'a [Incident],
    /// Expectations of the fault plan that were missed, one sentence each.
    pub failures: &'a [String],
    /// Largest force of each hand's device \[N\].
    pub force_limits: &'a BTreeMap<String, f64>,
}

/// Histogram of the lateness of one controller.
#[derive(Clone, Debug, Default)]
pub struct Lateness {
    /// The controller.
    pub name: String,
    /// Upper edges of the bars \[µs\].
    pub upper_us: Vec<f64>,
    /// Counts; one more than edges, for values above the last edge.
    pub counts: Vec<u64>,
}

/// A supervised child.
#[derive(Clone, Debug, Default)]
pub struct Health {
    /// Its name.
    pub name: String,
    /// `healthy`, `late`, `restarting`, …
    pub health: String,
    /// Restarts.
    pub restarts: u64,
}

/// A failure that the supervisor detected.
#[derive(Clone, Debug, Default)]
pub struct Incident {
    /// Time \[s\].
    pub secs: f64,
    /// The child.
    pub child: String,
    /// The failure.
    pub what: String,
    /// The supervisor's response.
    pub outcome: String,
}

/// Style class of a hand's lines and dots.
fn hand_class(side: &str) -> &'static str {
    if side == "left" { "left" } else { "right" }
}
