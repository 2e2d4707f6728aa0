//! Tele-surgery: master and slave over time, the round trip of the packets, and what both come to. The first and the last
//! chart are figures 18 and 19 of the paper.

use std::fmt::Write as _;

use trocar::decimate::Series;
use trocar::summary::TeleoperationFigures;
use trocar::trace::TeleoperationTrace;

use super::Report;
use super::scale::{Scale, short};
use super::svg::{Chart, MARGINS};
use super::tables::{Cell, table};
use crate::escape::escape;

/// The colours of the two lines.
pub const KEY: &str =
    "<span class=\"key\"><i class=\"left\"></i>master <i class=\"right\"></i>slave, round trip</span>";
const MASTER: &str = "left";
const SLAVE: &str = "right";
const WIDTH: f64 = 1080.0;
const MM: f64 = 1e3;
const MS: f64 = 1e3;
/// Length of the part that is drawn large \[s\].
const PART_SECS: f64 = 3.0;

/// Charts and table of every master and its slave.
pub fn teleoperation(report: &Report) -> String {
    let mut body = String::new();
    for (side, trace) in &report.trace.teleoperations {
        let whole = (begin(trace), report.trace.secs);
        let fastest = fastest(trace);
        let part = (fastest - 0.5 * PART_SECS).max(whole.0);
        let part = (part, (part + PART_SECS).min(whole.1));
        let _ = write!(
            body,
            "<h3>{side}: x of the tips of master and slave</h3>{}\
             <h3>{side}: the same around the fastest motion</h3>{}",
            positions(trace, whole, "X positions of master and slave over time"),
            positions(trace, part, "X positions of master and slave in three seconds"),
        );
        if !trace.felt_force.is_empty() {
            let what = "Force on the master's hand and at the slave over time";
            let lines = lines(&trace.felt_force, &trace.slave_force, whole, ("force [N]", what), 1.0);
            let _ = write!(body, "<h3>{side}: force on the master's hand, and at the slave</h3>{lines}");
        }
        if !trace.round_trip.is_empty() {
            let _ = write!(
                body,
                "<h3>{side}: round trip of the packets</h3>{}",
                round_trips(trace, whole, mean(report, side))
            );
        }
    }
    for (hand, figures) in &report.summary.teleoperation {
        body.push_str(&told(hand, figures));
    }
    body
}

/// The mean round trip of the hand of this side, if only one hand can be meant \[s\].
fn mean(report: &Report, side: &str) -> Option<f64> {
    let all = &report.summary.teleoperation;
    all.get(side).or_else(|| all.values().next().filter(|_| all.len() == 1))?.round_trip_mean
}

fn begin(trace: &TeleoperationTrace) -> f64 {
    trace.master_x.iter().next().map_or(0.0, |(secs, _)| secs)
}

/// When the master moves fastest \[s\].
fn fastest(trace: &TeleoperationTrace) -> f64 {
    let points: Vec<(f64, f64)> = trace.master_x.iter().map(|(secs, extent)| (secs, extent.last)).collect();
    let speed = |pair: &[(f64, f64)]| {
        let ((from, x), (to, next)) = (pair[0], pair[1]);
        (next - x).abs() / (to - from).max(1e-6)
    };
    let fastest = points.windows(2).max_by(|a, b| speed(a).total_cmp(&speed(b)));
    fastest.map_or(0.0, |pair| pair[0].0)
}

fn positions(trace: &TeleoperationTrace, span: (f64, f64), describe: &str) -> String {
    lines(&trace.master_x, &trace.slave_x, span, ("x [mm]", describe), MM)
}

/// A line of the master and one of the slave, each times `unit`, with the name of the axis and a description.
fn lines(
    master: &Series,
    slave: &Series,
    (from, to): (f64, f64),
    (axis, describe): (&str, &str),
    unit: f64,
) -> String {
    const HEIGHT: f64 = 260.0;
    let within = |series: &Series| -> Vec<(f64, f64)> {
        let inside = series.iter().filter(|(secs, _)| (from..=to).contains(secs));
        inside.map(|(secs, extent)| (secs, extent.last * unit)).collect()
    };
    let (master, slave) = (within(master), within(slave));
    let all = || master.iter().chain(&slave).map(|(_, value)| *value);
    let (low, high) = (all().fold(f64::INFINITY, f64::min), all().fold(f64::NEG_INFINITY, f64::max));
    if !(low.is_finite() && high.is_finite()) {
        return String::new();
    }
    let x = Scale::linear((from, to.max(from + 0.1)), MARGINS.left, WIDTH - MARGINS.right);
    let y = Scale::linear((low, high.max(low + 1.0)), HEIGHT - MARGINS.bottom, MARGINS.top).nice();
    let mut chart = Chart::new(WIDTH, HEIGHT, describe, x, y);
    chart.axes("session time [s]", axis, 12, 9);
    chart.line(MASTER, master).line(SLAVE, slave);
    chart.finish()
}

fn round_trips(trace: &TeleoperationTrace, (from, to): (f64, f64), mean: Option<f64>) -> String {
    const HEIGHT: f64 = 220.0;
    let points: Vec<(f64, f64)> =
        trace.round_trip.iter().map(|(secs, extent)| (secs, extent.last * MS)).collect();
    let all = || points.iter().map(|(_, trip)| *trip);
    let (low, high) = (all().fold(f64::INFINITY, f64::min), all().fold(0.0, f64::max));
    let margin = (0.05 * (high - low)).max(0.5);
    let x = Scale::linear((from, to.max(from + 1.0)), MARGINS.left, WIDTH - MARGINS.right);
    let range = ((low - margin).max(0.0), high + margin);
    let y = Scale::linear(range, HEIGHT - MARGINS.bottom, MARGINS.top).nice();
    let mut chart = Chart::new(WIDTH, HEIGHT, "Round trip of the packets over time", x, y);
    chart.axes("session time [s]", "round trip [ms]", 12, 5);
    chart.line(SLAVE, points);
    if let Some(mean) = mean {
        let (left, right) = chart.x.pixels();
        let at = chart.y.clamped(mean * MS);
        chart.segment("mean", (left, at), (right, at));
    }
    chart.finish()
}

/// The figures of a hand.
fn told(hand: &str, figures: &TeleoperationFigures) -> String {
    let ms = |value: Option<f64>| value.map(|value| format!("{} ms", short(value * MS)));
    let mm = |value: Option<f64>| value.map(|value| format!("{} mm", short(value * MM)));
    let rows: [(&str, Option<String>); 19] = [
        ("round trip, mean", figures.round_trip_mean.map(|trip| format!("{:.2} ms", trip * MS))),
        ("round trip, shortest", ms(figures.round_trip_min)),
        ("round trip, of 99 %", ms(figures.round_trip_p99)),
        ("round trip, longest", ms(figures.round_trip_max)),
        ("from the trace's delay, of 99 %", ms(figures.delay_error_p99)),
        ("from the trace's delay, the worst", ms(figures.delay_error_max)),
        ("slave from master at the same time, RMS", mm(figures.rms)),
        ("slave from master a constant lag before, RMS", mm(figures.constant_lag_rms)),
        ("that lag", ms(figures.constant_lag)),
        ("slave from the pose whose time stamp it applies, RMS", mm(figures.applied_error_rms)),
        ("the same, the worst", mm(figures.applied_error_max)),
        ("range along x", mm(Some(figures.x_range))),
        ("fastest motion of the master", Some(format!("{} mm/s", short(figures.speed_max * MM)))),
        ("in contact", Some(format!("{:.0} % of the time", 100.0 * figures.contact_share))),
        (
            "packets sent, received, overtaken, refused",
            Some(format!("{}, {}, {}, {}", figures.sent, figures.received, figures.late, figures.refused)),
        ),
        ("steps in which a limit held the slave back", Some(figures.limited.to_string())),
        ("current on at the slave", Some(format!("{} s", short(figures.energised)))),
        ("felt of the force at the slave", figures.felt_share.map(|share| format!("{:.0} %", 100.0 * share))),
        ("emergency stops, silences of 100 ms", Some(format!("{}, {}", figures.stops, figures.silences))),
    ];
    let rows = rows
        .into_iter()
        .map(|(what, value)| vec![Cell::text(what), Cell::plain(value.unwrap_or_else(|| "–".to_owned()))]);
    format!("<h3>{}: in numbers</h3>{}", escape(hand), table(&["", ""], rows, ""))
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use super::*;
    use trocar::summary::{Mode, RunSummary};
    use trocar::trace::RunTrace;

    fn html(summary: &RunSummary, trace: &RunTrace) -> String {
        teleoperation(&Report {
            title: "Tele",
            summary,
            trace,
            lateness: &[],
            health: &[],
            incidents: &[],
            failures: &[],
            force_limits: &BTreeMap::new(),
        })
    }

    #[test]
    fn both_figures_of_the_paper_are_drawn_with_their_numbers() {
        let mut trace = RunTrace::new();
        let one = trace.teleoperations.entry("right".to_owned()).or_default();
        for step in 0..500 {
            let secs = f64::from(step) * 0.02;
            let x = |secs: f64| 0.04 * secs.sin();
            one.master_x.push(secs, x(secs).into());
            one.slave_x.push(secs, x(secs - 0.15).into());
            one.round_trip.push(secs, (0.15 + 0.005 * (9.0 * secs).sin()).into());
        }
        trace.secs = 10.0;
        let mut summary = RunSummary::new("tele-liver", Mode::Lockstep, 1);
        let figures = TeleoperationFigures {
            round_trip_mean: Some(0.150_57),
            applied_error_max: Some(3e-9),
            ..TeleoperationFigures::default()
        };
        summary.teleoperation.insert("right".to_owned(), figures);
        let html = html(&summary, &trace);
        assert_eq!(html.matches("<svg").count(), 3);
        // Two lines in each of the first two, one and its mean in the last.
        assert_eq!(html.matches("class=\"line left\"").count(), 2);
        assert_eq!(html.matches("class=\"line right\"").count(), 3);
        assert_eq!(html.matches("class=\"mean\"").count(), 1);
        assert!(html.contains("150.57 ms") && html.contains("in numbers"), "{html}");
        assert!(!html.contains("NaN") && !html.contains("inf"), "{html}");
        assert!(!html.contains("force on"), "no forces are fed back: {html}");
        // What is not known is not told as a number.
        assert!(html.contains("–"), "{html}");
    }

    #[test]
    fn the_force_on_the_hand_is_drawn_beside_that_at_the_slave() {
        let mut trace = RunTrace::new();
        let one = trace.teleoperations.entry("right".to_owned()).or_default();
        for step in 0..500 {
            let secs = f64::from(step) * 0.02;
            let force = |secs: f64| secs.sin().max(0.0);
            one.slave_force.push(secs, force(secs).into());
            one.felt_force.push(secs, force(secs - 0.1).into());
        }
        trace.secs = 10.0;
        let mut summary = RunSummary::new("tele-palpation", Mode::Lockstep, 1);
        let figures = TeleoperationFigures { felt_share: Some(0.936), ..TeleoperationFigures::default() };
        summary.teleoperation.insert("right".to_owned(), figures);
        let html = html(&summary, &trace);
        assert!(html.contains("force on the master's hand"), "{html}");
        assert!(html.contains("force [N]") && html.contains("94 %"), "{html}");
        assert_eq!(html.matches("<svg").count(), 1);
    }

    #[test]
    fn a_slave_that_never_moved_has_no_line_and_no_nonsense() {
        let mut trace = RunTrace::new();
        trace.teleoperations.entry("left".to_owned()).or_default().master_x.push(0.0, 0.0.into());
        let summary = RunSummary::new("tele-liver", Mode::Live, 1);
        let html = html(&summary, &trace);
        assert!(!html.contains("NaN") && !html.contains("inf") && !html.contains("line right"), "{html}");
    }
}
