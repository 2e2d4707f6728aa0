//! The tables of the report.

use std::collections::BTreeSet;
use std::fmt::Write as _;

use trocar::summary::{ControllerSummary, FaultSummary};

use super::Report;
use super::scale::short;
use crate::escape::escape;
use crate::output::in_words;

/// Rates, lateness, step times and losses of every controller.
pub fn controllers(report: &Report) -> String {
    let head = [
        "controller",
        "target",
        "achieved",
        "on time",
        "late p50",
        "p99",
        "p99.9",
        "max",
        "step p50",
        "p99",
        "max",
        "missed",
        "dropped",
        "lost",
        "rejected",
        "conflicts",
        "restarts",
        "hits",
        "max",
        "in ticks",
    ];
    let rows = report.summary.controllers.iter().map(controller_row);
    table(
        &head,
        rows,
        "Rates in Hz, lateness and step time in µs; on time: share of the scheduled ticks that started less than 1 ms late. \
         Hits: contacts in the collision list per tick, on average.",
    )
}

fn controller_row(row: &ControllerSummary) -> Vec<Cell> {
    let mut cells = vec![Cell::text(&row.name), Cell::number(row.target_hz), Cell::number(row.achieved_hz)];
    let share = Cell::plain(format!("{:.2} %", 100.0 * row.on_time));
    cells.push(if row.on_time < 0.99 { share.warn() } else { share });
    let late = &row.lateness_us;
    cells.extend([late.p50, late.p99, late.p999, late.max].map(Cell::number));
    cells.extend([row.step_us.p50, row.step_us.p99, row.step_us.max].map(Cell::number));
    cells.extend(
        [row.missed, row.dropped, row.lost, row.rejected, row.conflicts, u64::from(row.restarts)]
            .map(Cell::count),
    );
    cells.extend(match &row.hits {
        Some(hits) => [Cell::number(hits.mean), Cell::count(hits.max), Cell::count(hits.ticks)],
        None => [(); 3].map(|()| Cell::plain("–".into())),
    });
    cells
}

/// Tuned values.
pub fn tuned(report: &Report) -> String {
    let value = |value: &serde_json::Value| match value {
        serde_json::Value::String(word) => Cell::text(word),
        other => Cell::plain(other.to_string()),
    };
    let rows = report.summary.tuned.iter().map(|(field, tuned)| vec![Cell::text(field), value(tuned)]);
    table(&["field", "value"], rows, "")
}

/// The outcome of each fault.
pub fn faults(report: &Report) -> String {
    let head = [
        "fault",
        "target",
        "kind",
        "injected [s]",
        "detected",
        "restarted",
        "over",
        "resumed",
        "recovery [ms]",
    ];
    table(
        &head,
        report.summary.faults.iter().map(fault_row),
        "Over: when the fault ended by itself. Recovery is counted from there, or from the injection if somebody had \
         to be restarted, to the first good work.",
    )
}

fn fault_row(row: &FaultSummary) -> Vec<Cell> {
    let secs = |time: Option<f64>| Cell::plain(time.map_or("–".into(), |secs| format!("{secs:.3}")));
    let last = match row.recovery_secs().map(|secs| secs * 1e3) {
        Some(millis) => Cell::plain(format!("{millis:.1}")),
        None if row.is_under_way() => Cell::plain("to the end".into()),
        None if row.injected_secs.is_some() => Cell::plain("not recovered".into()).warn(),
        None => Cell::plain("–".into()),
    };
    vec![
        Cell::text(&row.id),
        Cell::text(&row.target),
        Cell::text(&row.kind),
        secs(row.injected_secs),
        secs(row.detected_secs),
        secs(row.restarted_secs),
        secs(row.healed_secs),
        secs(row.resumed_secs),
        last,
    ]
}

/// Motion metrics: a row per metric, a column per hand.
pub fn metrics(report: &Report) -> String {
    let metrics = &report.summary.task.metrics;
    let names: BTreeSet<&String> = metrics.values().flat_map(|values| values.keys()).collect();
    let head: Vec<&str> = ["metric"].into_iter().chain(metrics.keys().map(String::as_str)).collect();
    let rows = names.into_iter().map(|name| {
        let values = metrics
            .values()
            .map(|values| values.get(name).map_or(Cell::plain("–".into()), |v| Cell::number(*v)));
        [Cell::text(&metric_label(name))].into_iter().chain(values).collect()
    });
    table(&head, rows, "")
}

/// `path_length_m` → `path length [m]`, `organ.contact_force_n.largest` → `organ.contact force [N], largest`.
fn metric_label(name: &str) -> String {
    const UNITS: [(&str, &str); 7] = [
        ("_n_per_m", " [N/m]"),
        ("_m_per_s", " [m/s]"),
        ("_secs", " [s]"),
        ("_rad", " [rad]"),
        ("_n", " [N]"),
        ("_j", " [J]"),
        ("_m", " [m]"),
    ];
    let which = name.rsplit_once('.').filter(|(_, which)| ["largest", "smallest", "mean"].contains(which));
    let (name, which) = which.map_or((name, String::new()), |(name, which)| (name, format!(", {which}")));
    let (stem, unit) = UNITS
        .iter()
        .find_map(|(suffix, unit)| Some((name.strip_suffix(suffix)?, *unit)))
        .unwrap_or((name, ""));
    format!("{}{unit}{which}", stem.replace('_', " "))
}

/// Errors of the trainee.
pub fn errors(report: &Report) -> String {
    let rows =
        report.summary.task.errors.iter().map(|error| {
            vec![Cell::words(&in_words(&error.kind)), Cell::plain(format!("{:.2}", error.at_secs))]
        });
    table(&["error", "at [s]"], rows, "")
}

/// Supervised children and the failures that the supervisor detected.
pub fn health(report: &Report) -> String {
    let rows = report.health.iter().map(|child| {
        let health = Cell::text(&child.health);
        let calm = matches!(child.health.as_str(), "healthy" | "stopped" | "held");
        vec![Cell::text(&child.name), if calm { health } else { health.warn() }, Cell::count(child.restarts)]
    });
    let mut out = table(&["child", "health", "restarts"], rows, "");
    if !report.incidents.is_empty() {
        let rows = report.incidents.iter().map(|incident| {
            vec![
                Cell::plain(format!("{:.3}", incident.secs)),
                Cell::text(&incident.child),
                Cell::words(&incident.what),
                Cell::words(&incident.outcome),
            ]
        });
        out.push_str(&table(&["at [s]", "child", "what happened", "what was done"], rows, ""));
    }
    out
}

/// One cell: escaped content and its class.
pub struct Cell {
    html: String,
    class: &'static str,
}

impl Cell {
    pub fn text(text: &str) -> Self {
        Self { html: escape(text), class: "" }
    }
    /// A sentence, which is wrapped.
    fn words(text: &str) -> Self {
        Self { html: escape(text), class: "words" }
    }
    pub fn plain(text: String) -> Self {
        Self { html: escape(&text), class: "num" }
    }
    pub fn number(value: f64) -> Self {
        Self::plain(short(value))
    }
    pub fn count(value: u64) -> Self {
        Self { html: value.to_string(), class: if value == 0 { "num zero" } else { "num" } }
    }
    pub fn warn(mut self) -> Self {
        self.class = if self.class == "num" { "num warn" } else { "warn" };
        self
    }
}

pub fn table(head: &[&str], rows: impl Iterator<Item = Vec<Cell>>, caption: &str) -> String {
    let mut out = String::from("<div class=\"scroll\"><table><thead><tr>");
    for name in head {
        let _ = write!(out, "<th>{}</th>", escape(name));
    }
    out.push_str("</tr></thead><tbody>");
    for row in rows {
        out.push_str("<tr>");
        for cell in row {
            let _ = write!(out, "<td class=\"{}\">{}</td>", cell.class, cell.html);
        }
        out.push_str("</tr>");
    }
    out.push_str("</tbody></table></div>");
    if !caption.is_empty() {
        let _ = write!(out, "<p class=\"caption\">{}</p>", escape(caption));
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn metric_names_show_their_unit() {
        assert_eq!(metric_label("path_length_m"), "path length [m]");
        assert_eq!(metric_label("mean_speed_m_per_s"), "mean speed [m/s]");
        assert_eq!(metric_label("idle_secs"), "idle [s]");
        assert_eq!(metric_label("economy"), "economy");
        assert_eq!(metric_label("organ.contact_force_n.largest"), "organ.contact force [N], largest");
        assert_eq!(metric_label("hand.felt_stiffness_n_per_m.mean"), "hand.felt stiffness [N/m], mean");
    }
}
