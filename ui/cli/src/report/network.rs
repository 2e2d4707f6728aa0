//! Links of a session over a network: a table, and round trip, age and loss over time.

use trocar::trace::{LinkSecond, LinkTrace};

use super::Report;
use super::scale::Scale;
use super::svg::{Chart, MARGINS};
use super::tables::{Cell, table};

const WIDTH: f64 = 1080.0;
const MS: f64 = 1e3;

/// A quantity of a link over time.
type Of = fn(&LinkSecond) -> f64;

/// Table and charts.
pub fn network(report: &Report) -> String {
    let links = &report.trace.links;
    let head = [
        "station",
        "seconds",
        "round trip [ms]",
        "p99",
        "jitter [ms]",
        "loss [%]",
        "worst",
        "age of what is shown [ms]",
        "datagrams [Hz]",
        "received [kB/s]",
        "sent [kB/s]",
        "over TCP [s]",
        "protected",
    ];
    let rows = links.iter().map(|(name, link)| row(name, link));
    let mut body = table(
        &head,
        rows,
        "Medians of seconds; p99 and worst: of seconds as well. As the end that wrote this report sees each link.",
    );
    body.push_str("<h3>round trip</h3>");
    body.push_str(&chart(report, "Round trip over time", "round trip [ms]", |second| {
        second.link.round_trip * MS
    }));
    body.push_str("<h3>age of what is shown</h3>");
    body.push_str(&chart(report, "Age of what is shown over time", "age [ms]", |second| {
        second.link.age * MS
    }));
    body.push_str("<h3>loss</h3>");
    body.push_str(&chart(report, "Loss over time", "loss [%]", |second| second.link.loss * 100.0));
    body
}

fn row(name: &str, link: &LinkTrace) -> Vec<Cell> {
    let of = |of: Of, share: f64| quantile(link.seconds.iter().map(of).collect(), share);
    let median = |value: Of| Cell::number(of(value, 0.5));
    let over_tcp = link.seconds.iter().filter(|second| second.link.over_tcp).count() as u64;
    let carried = Cell::count(over_tcp);
    let protected = Cell::plain(if link.protected { "yes" } else { "no" }.into());
    vec![
        Cell::text(name),
        Cell::count(link.seconds.len() as u64),
        median(|second| second.link.round_trip * MS),
        Cell::number(of(|second| second.link.round_trip * MS, 0.99)),
        median(|second| second.link.jitter * MS),
        median(|second| second.link.loss * 100.0),
        Cell::number(of(|second| second.link.loss * 100.0, 1.0)),
        median(|second| second.link.age * MS),
        median(|second| second.link.rate),
        median(|second| second.link.bytes_received * 1e-3),
        median(|second| second.link.bytes_sent * 1e-3),
        if over_tcp == 0 { carried } else { carried.warn() },
        if link.protected { protected } else { protected.warn() },
    ]
}

fn quantile(mut values: Vec<f64>, share: f64) -> f64 {
    values.sort_by(f64::total_cmp);
    let last = values.len().saturating_sub(1);
    values.get((share * last as f64).round() as usize).copied().unwrap_or(0.0)
}

fn chart(report: &Report, describe: &str, label: &str, of: Of) -> String {
    const HEIGHT: f64 = 180.0;
    let links = &report.trace.links;
    let all = || links.values().flat_map(|link| &link.seconds);
    let high = all().map(of).fold(0.0, f64::max).max(1e-3);
    let begin = all().map(|second| second.secs).fold(report.trace.secs, f64::min);
    let x = Scale::linear((begin, report.trace.secs.max(begin + 1.0)), MARGINS.left, WIDTH - MARGINS.right);
    let y = Scale::linear((0.0, high), HEIGHT - MARGINS.bottom, MARGINS.top).nice();
    let mut chart = Chart::new(WIDTH, HEIGHT, describe, x, y);
    chart.axes("session time [s]", label, 12, 4);
    for (index, link) in links.values().enumerate() {
        // The colours of hands serve for the first two links, and again for those after them.
        let class = if index % 2 == 0 { "left" } else { "right" };
        chart.line(class, link.seconds.iter().map(|second| (second.secs, of(second))));
    }
    chart.finish()
}
