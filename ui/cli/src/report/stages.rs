//! The stages of each fault: injected, detected, restarted or over, resumed, over the time since its injection.

use trocar::summary::FaultSummary;

use super::Report;
use super::scale::{Scale, short};
use super::svg::Chart;

const WIDTH: f64 = 1080.0;
const LEFT: f64 = 250.0;
const ROW: f64 = 22.0;
const TOP: f64 = 8.0;
/// Earliest time on the axis \[ms\]: earlier events are drawn there.
const FIRST_MS: f64 = 0.1;
/// Most faults that are drawn; the table has all.
const ROWS_MAX: usize = 60;
/// Longest name that fits beside the axis.
const NAME_MAX: usize = 38;

/// The key of the chart.
pub const KEY: &str = "<span class=\"key\"><i class=\"stage detected\"></i>detected <i class=\"stage \
     restarted\"></i>restarted <i class=\"stage over\"></i>over by itself <i class=\"stage \
     resumed\"></i>resumed</span>";

/// One row for every fault that struck, on a logarithmic axis of milliseconds.
pub fn stages(report: &Report) -> String {
    let struck: Vec<&FaultSummary> =
        report.summary.faults.iter().filter(|fault| fault.injected_secs.is_some()).take(ROWS_MAX).collect();
    let longest = struck.iter().flat_map(|fault| marks(fault)).map(|(_, ms)| ms).fold(100.0, f64::max);
    let foot = TOP + struck.len() as f64 * ROW;
    let x = Scale::log((FIRST_MS, longest * 1.5), LEFT, WIDTH - 20.0);
    let rows = Scale::linear((0.0, 1.0), foot, TOP);
    let mut chart = Chart::new(WIDTH, foot + 40.0, "Stages of each fault since its injection", x, rows);
    chart.x_axis("time since the injection [ms]", 8);
    for (row, fault) in struck.iter().enumerate() {
        let middle = TOP + (row as f64 + 0.5) * ROW;
        let name: String = fault.id.chars().take(NAME_MAX).collect();
        chart.text("tick end", (LEFT - 10.0, middle + 4.0), &name);
        let marks = marks(fault);
        let end = marks.iter().map(|(_, ms)| *ms).fold(FIRST_MS, f64::max);
        let class = if fault.resumed_secs.is_some() { "fault" } else { "fault open" };
        let tip = format!("{}: {} {}", fault.id, fault.kind, fault.target);
        let end = if fault.resumed_secs.is_some() { chart.x.clamped(end) } else { WIDTH - 20.0 };
        chart.rect(class, (LEFT, middle - 4.0), (end, middle + 4.0), &tip);
        for (stage, ms) in marks {
            let tip = format!("{}: {stage} after {} ms", fault.id, short(ms));
            let at = chart.x.clamped(ms.max(FIRST_MS));
            // Simultaneous stages are drawn around each other.
            let radius = match stage {
                "detected" => 6.5,
                "resumed" => 3.0,
                _ => 5.0,
            };
            chart.dot(&format!("stage {stage}"), (at, middle), radius, &tip);
        }
    }
    chart.finish()
}

/// Stages by name, with the time since the injection \[ms\].
fn marks(fault: &FaultSummary) -> Vec<(&'static str, f64)> {
    let Some(injected) = fault.injected_secs else { return Vec::new() };
    let stages = [
        ("detected", fault.detected_secs),
        ("restarted", fault.restarted_secs),
        ("over", fault.healed_secs),
        ("resumed", fault.resumed_secs),
    ];
    stages.into_iter().filter_map(|(stage, secs)| Some((stage, (secs? - injected) * 1e3))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stages_are_told_from_the_injection_and_what_did_not_happen_is_left_out() {
        let mut fault = FaultSummary {
            id: "it hangs".to_owned(),
            target: "engine".to_owned(),
            kind: "stall".to_owned(),
            injected_secs: None,
            healed_secs: None,
            detected_secs: Some(2.05),
            restarted_secs: Some(2.051),
            resumed_secs: None,
        };
        assert!(marks(&fault).is_empty(), "it did not strike");
        fault.injected_secs = Some(2.0);
        let marks: Vec<_> = marks(&fault).into_iter().map(|(stage, ms)| (stage, ms.round() as i32)).collect();
        assert_eq!(marks, [("detected", 50), ("restarted", 51)]);
    }
}
