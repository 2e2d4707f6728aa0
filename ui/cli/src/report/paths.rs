//! Paths of the instruments' tips, from above and from the front, at one scale, with the places of dropped objects.

use trocar::trace::RunTrace;

use super::scale::Scale;
use super::svg::{Chart, MARGINS};
use super::{Report, hand_class};

const WIDTH: f64 = 1080.0;
/// Millimetres per metre: paths are read in millimetres.
const MM: f64 = 1e3;

/// Which two axes of the world a view shows.
struct View {
    describe: &'static str,
    across: usize,
    up: usize,
    across_label: &'static str,
    up_label: &'static str,
}

const TOP: View = View {
    describe: "Paths of the tips from above",
    across: 0,
    up: 1,
    across_label: "x, to the right [mm]",
    up_label: "y, away [mm]",
};
const FRONT: View = View {
    describe: "Paths of the tips from the front",
    across: 0,
    up: 2,
    across_label: "x, to the right [mm]",
    up_label: "z, up [mm]",
};

/// From above (x, y).
pub fn top(report: &Report) -> String {
    view(report, &TOP)
}
/// From the front (x, z).
pub fn front(report: &Report) -> String {
    view(report, &FRONT)
}

fn view(report: &Report, view: &View) -> String {
    let across = extent(report.trace, view.across);
    let up = extent(report.trace, view.up);
    let plot_width = WIDTH - MARGINS.left - MARGINS.right;
    // One scale for both axes.
    let pixels_per_mm = plot_width / (across.1 - across.0);
    let plot_height = ((up.1 - up.0) * pixels_per_mm).clamp(120.0, 620.0);
    let pixels_per_mm = pixels_per_mm.min(plot_height / (up.1 - up.0));
    let height = plot_height + MARGINS.top + MARGINS.bottom;
    let spare = 0.5 * (plot_width / pixels_per_mm - (across.1 - across.0));
    let x = Scale::linear((across.0 - spare, across.1 + spare), MARGINS.left, WIDTH - MARGINS.right);
    let y = Scale::linear(up, height - MARGINS.bottom, MARGINS.top);
    let mut chart = Chart::new(WIDTH, height, view.describe, x, y);
    chart.axes(view.across_label, view.up_label, 12, (plot_height / 60.0) as usize);
    for outline in &report.trace.outlines {
        let points = outline.points_in_world.iter().map(|p| (p[view.across] * MM, p[view.up] * MM));
        chart.line("outline", points);
    }
    for (side, hand) in &report.trace.hands {
        let points = hand.tip_in_world.iter().map(|(_, p)| (p[view.across] * MM, p[view.up] * MM));
        chart.line(&format!("path {}", hand_class(side)), points);
    }
    for error in &report.trace.errors {
        if let Some(point) = error.position_in_world {
            let at = (x.clamped(point[view.across] * MM), y.clamped(point[view.up] * MM));
            let subject = error.subject.as_deref().unwrap_or("");
            chart.cross("bad", at, &format!("{} {subject} at {:.1} s", error.what, error.secs));
        }
    }
    chart.finish()
}

/// Range of one coordinate over everything drawn, with a margin \[mm\].
fn extent(trace: &RunTrace, axis: usize) -> (f64, f64) {
    let tips = trace.hands.values().flat_map(|hand| hand.tip_in_world.iter().map(|(_, point)| point[axis]));
    let others = trace.outlines.iter().flat_map(|outline| outline.points_in_world.iter().map(|p| p[axis]));
    let (low, high) = tips
        .chain(others)
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), value| (low.min(value), high.max(value)));
    if low.is_finite() && high.is_finite() {
        let margin = (0.04 * (high - low)).max(0.004);
        ((low - margin) * MM, (high + margin) * MM)
    } else {
        (-100.0, 100.0)
    }
}
