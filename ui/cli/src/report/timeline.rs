//! The timeline: phases of the exercise, grasps of each hand, errors, faults and restarts.

use super::Report;
use super::hand_class;
use super::scale::Scale;
use super::svg::Chart;

const WIDTH: f64 = 1080.0;
const LEFT: f64 = 96.0;
const ROW: f64 = 30.0;
const TOP: f64 = 8.0;
/// Width that a letter of a label takes \[px\].
const LETTER: f64 = 6.4;

/// Rows over a common time axis.
pub fn timeline(report: &Report) -> String {
    let faults = !report.summary.faults.is_empty() || !report.incidents.is_empty();
    let hands = report.trace.hands.len();
    let rows = 2 + hands + usize::from(faults);
    let height = TOP + rows as f64 * ROW + 40.0;
    let x = Scale::linear((0.0, report.trace.secs), LEFT, WIDTH - 14.0);
    let y = Scale::linear((0.0, rows as f64), TOP, TOP + rows as f64 * ROW);
    // The vertical scale counts rows downwards; the axis wants its foot first.
    let foot = Scale::linear((0.0, 1.0), TOP + rows as f64 * ROW, TOP);
    let mut chart = Chart::new(WIDTH, height, "Phases, holds, errors and faults over time", x, foot);
    chart.x_axis("session time [s]", 12);
    let place = |row: usize| (y.pixel(row as f64) + 4.0, y.pixel(row as f64 + 1.0) - 4.0);
    phases(&mut chart, report, place(0));
    for (row, (side, hand)) in report.trace.hands.iter().enumerate() {
        let (top, bottom) = place(row + 1);
        label(&mut chart, &format!("{side} holds"), (top, bottom));
        for (from, to) in &hand.held {
            let tip = format!("{side} held something from {from:.2} s to {to:.2} s");
            let class = format!("hold {}", hand_class(side));
            chart.rect(&class, (x.pixel(*from), top), (x.pixel(*to), bottom), &tip);
        }
    }
    let (top, bottom) = place(hands + 1);
    label(&mut chart, "errors", (top, bottom));
    for error in &report.trace.errors {
        let subject = error.subject.as_deref().unwrap_or("");
        let tip = format!("{} {subject} at {:.2} s", error.what, error.secs);
        chart.cross("bad", (x.pixel(error.secs), 0.5 * (top + bottom)), &tip);
    }
    if faults {
        fault_track(&mut chart, report, place(hands + 2));
    }
    chart.finish()
}

fn label(chart: &mut Chart, text: &str, (top, bottom): (f64, f64)) {
    chart.text("tick end", (LEFT - 8.0, 0.5 * (top + bottom) + 4.0), text);
}

fn phases(chart: &mut Chart, report: &Report, (top, bottom): (f64, f64)) {
    label(chart, "phase", (top, bottom));
    let phases = &report.trace.phases;
    let ends = phases.iter().skip(1).map(|mark| mark.secs).chain([report.trace.secs]);
    let mut kinds: Vec<&str> = Vec::new();
    for (phase, end) in phases.iter().zip(ends) {
        let kind = match kinds.iter().position(|known| *known == phase.what) {
            Some(kind) => kind,
            None => {
                kinds.push(&phase.what);
                kinds.len() - 1
            }
        };
        let (from, to) = (chart.x.pixel(phase.secs), chart.x.pixel(end));
        let tip = format!("{} from {:.2} s to {end:.2} s", phase.what, phase.secs);
        chart.rect(&format!("phase p{}", kind % 6), (from, top), (to, bottom), &tip);
        if to - from > LETTER * phase.what.chars().count() as f64 + 6.0 {
            chart.text("onphase", (from + 5.0, 0.5 * (top + bottom) + 4.0), &phase.what);
        }
    }
}

/// From injected to resumed: duration, detection, and restart of the target.
fn fault_track(chart: &mut Chart, report: &Report, (top, bottom): (f64, f64)) {
    label(chart, "faults", (top, bottom));
    let middle = 0.5 * (top + bottom);
    for fault in &report.summary.faults {
        let Some(injected) = fault.injected_secs else { continue };
        let over = fault.resumed_secs.unwrap_or(report.trace.secs);
        let stage = |what: &str, secs: Option<f64>| secs.map(|secs| format!(", {what} at {secs:.3} s"));
        let stages = [
            ("detected", fault.detected_secs),
            ("restarted", fault.restarted_secs),
            ("over", fault.healed_secs),
            ("resumed", fault.resumed_secs),
        ];
        let stages: String = stages.into_iter().filter_map(|(what, secs)| stage(what, secs)).collect();
        let tip = format!("{}: {} {} at {injected:.3} s{stages}", fault.id, fault.kind, fault.target);
        let class = if fault.resumed_secs.is_some() { "fault" } else { "fault open" };
        // At least wide enough for the pointer.
        let to = chart.x.pixel(over).max(chart.x.pixel(injected) + 3.0);
        chart.rect(class, (chart.x.pixel(injected), top + 3.0), (to, bottom - 3.0), &tip);
        chart.cross("bad", (chart.x.pixel(injected), middle), &tip);
    }
    for incident in report.incidents {
        let tip =
            format!("{}: {} at {:.3} s, {}", incident.child, incident.what, incident.secs, incident.outcome);
        chart.dot("incident", (chart.x.pixel(incident.secs), middle), 3.0, &tip);
    }
}
