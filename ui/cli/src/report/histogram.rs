//! Histograms of the lateness of ticks: one small histogram per controller, both axes logarithmic to show the tail.

use super::Lateness;
use super::scale::{Scale, short};
use super::svg::Chart;

const WIDTH: f64 = 350.0;
const HEIGHT: f64 = 170.0;
/// From this lateness on a tick counts as late \[µs\].
const LATE_US: f64 = 1_000.0;

/// The histogram of one controller; `None` when it never ran.
pub fn histogram(lateness: &Lateness) -> Option<String> {
    let most = lateness.counts.iter().copied().max().filter(|most| *most > 0)?;
    let first = lateness.upper_us.first().copied().unwrap_or(1.0).max(1e-3);
    let last = lateness.upper_us.last().copied().unwrap_or(1e5).max(first * 10.0);
    let x = Scale::log((0.5 * first, 2.5 * last), 62.0, WIDTH - 8.0);
    // Half a count below one, so that a single tick has a bar.
    let y = Scale::log((0.5, most as f64 * 1.3), HEIGHT - 36.0, 8.0);
    let mut chart = Chart::new(WIDTH, HEIGHT, &format!("Lateness of {}", lateness.name), x, y);
    chart.axes("late by [µs]", "ticks", 3, 3);
    let bottom = y.pixels().0;
    let mut low = 0.5 * first;
    for (i, count) in lateness.counts.iter().enumerate() {
        let high = lateness.upper_us.get(i).copied().unwrap_or(2.5 * last);
        if *count > 0 {
            let class = if low >= LATE_US { "bar late" } else { "bar" };
            let tip = match lateness.upper_us.get(i) {
                Some(high) => format!("{count} ticks less than {} µs late", short(*high)),
                None => format!("{count} ticks more than {} µs late", short(last)),
            };
            let corner = (x.pixel(low) + 0.7, y.clamped(*count as f64));
            chart.rect(class, corner, (x.pixel(high) - 0.7, bottom), &tip);
        }
        low = high;
    }
    let late = x.pixel(LATE_US);
    chart.segment("limit", (late, bottom), (late, y.pixels().1));
    Some(chart.finish())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_filled_bar_is_drawn_and_an_idle_controller_is_not() {
        let upper_us = vec![1.0, 10.0, 100.0, 1_000.0, 10_000.0];
        let counts = vec![0, 99_000, 12, 0, 1, 1];
        let svg = histogram(&Lateness { name: "engine".into(), upper_us: upper_us.clone(), counts }).unwrap();
        assert_eq!(svg.matches("<rect").count(), 4);
        assert_eq!(svg.matches("bar late").count(), 2);
        let idle = Lateness { name: "idle".into(), upper_us, counts: vec![0; 6] };
        assert!(histogram(&idle).is_none());
    }
}
