//! Charts of values over time: forces at the driver, energy at the device's port, opening of the jaws.

use trocar::decimate::Series;
use trocar::trace::HandTrace;

use super::scale::{Scale, short};
use super::svg::{Chart, MARGINS};
use super::{Report, hand_class};

const WIDTH: f64 = 1080.0;

/// The series of a hand to be drawn.
type Of = fn(&HandTrace) -> &Series;

/// Magnitude of the rendered force of each hand, with the devices' limits.
pub fn forces(report: &Report) -> String {
    let mut chart = chart(report, 250.0, "Force at the driver over time", |hand| &hand.applied_force, true);
    chart.axes("session time [s]", "force [N]", 12, 5);
    draw(&mut chart, report, |hand| &hand.applied_force);
    let mut limits: Vec<f64> = report.force_limits.values().copied().collect();
    limits.sort_by(f64::total_cmp);
    limits.dedup();
    let top = chart.y.range().1;
    for limit in limits.into_iter().filter(|limit| *limit <= top) {
        chart.level("limit", limit, &format!("device limit {} N", short(limit)));
    }
    chart.finish()
}

/// Energy that went through each device's port; never negative when the touch is passive.
pub fn energy(report: &Report) -> String {
    let mut chart = chart(report, 200.0, "Energy at the devices over time", |hand| &hand.energy, true);
    chart.axes("session time [s]", "energy [J]", 12, 4);
    draw(&mut chart, report, |hand| &hand.energy);
    chart.finish()
}

/// Opening of each instrument's jaws.
pub fn jaws(report: &Report) -> String {
    let mut chart = chart(report, 180.0, "Opening of the jaws over time", |hand| &hand.jaw_angle, true);
    chart.axes("session time [s]", "jaw angle [rad]", 12, 4);
    draw(&mut chart, report, |hand| &hand.jaw_angle);
    chart.finish()
}

/// Whether any hand has data for this series.
pub fn any(report: &Report, of: Of) -> bool {
    report.trace.hands.values().any(|hand| !of(hand).is_empty())
}

fn chart(report: &Report, height: f64, describe: &str, of: Of, from_zero: bool) -> Chart {
    let ranges = report.trace.hands.values().filter_map(|hand| of(hand).range());
    let (low, high) = ranges
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), range| (low.min(range.0), high.max(range.1)));
    let low = if from_zero { low.min(0.0) } else { low };
    let x = Scale::linear((0.0, report.trace.secs), MARGINS.left, WIDTH - MARGINS.right);
    let y = Scale::linear((low, high), height - MARGINS.bottom, MARGINS.top).nice();
    Chart::new(WIDTH, height, describe, x, y)
}

fn draw(chart: &mut Chart, report: &Report, of: Of) {
    for (side, hand) in &report.trace.hands {
        let series = of(hand);
        let band: Vec<(f64, f64, f64)> =
            series.iter().map(|(secs, extent)| (secs, extent.min, extent.max)).collect();
        chart.band(hand_class(side), &band);
        chart.line(hand_class(side), series.iter().map(|(secs, extent)| (secs, extent.last)));
    }
}
