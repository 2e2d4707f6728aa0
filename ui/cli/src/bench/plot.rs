//! Growth plots: figures named `…_growth_WHAT_SIZE` as lines over the size, both axes logarithmic.

use std::collections::BTreeMap;

use trocar::summary::BenchResult;

use crate::report::{Chart, Scale};

const SIZE: [f64; 2] = [760.0, 520.0];
/// Room for labels: left, top, right (the names of the lines), below.
const MARGIN: [f64; 4] = [64.0, 24.0, 110.0, 48.0];
/// The picture is self-contained, so it includes its style sheet. The colours are distinct for colour-blind readers
/// (Okabe, Ito, "Color universal design", 2008).
const STYLE: &str = "<style>svg{background:#fff;font:13px sans-serif}.grid{stroke:#ddd}.line{fill:none;stroke-width:2}\
                     .end{text-anchor:end}.mid{text-anchor:middle}\
                     .c0{stroke:#0072b2}.c1{stroke:#d55e00}.c2{stroke:#009e73}.c3{stroke:#cc79a7}\
                     .c4{stroke:#56b4e9}.c5{stroke:#e69f00}.c6{stroke:#000}.c7{stroke:#999}\
                     text,circle{stroke:none}\
                     text.c0,circle.c0{fill:#0072b2}text.c1,circle.c1{fill:#d55e00}text.c2,circle.c2{fill:#009e73}\
                     text.c3,circle.c3{fill:#cc79a7}text.c4,circle.c4{fill:#56b4e9}text.c5,circle.c5{fill:#e69f00}\
                     text.c6,circle.c6{fill:#000}text.c7,circle.c7{fill:#999}\
                     .dashed{stroke-dasharray:6 4}.dotted{stroke-dasharray:1.5 3}</style>";
const CLASSES: [&str; 8] = ["c0", "c1", "c2", "c3", "c4", "c5", "c6", "c7"];

/// Width of a letter and height of a line of text, in pixels.
const LETTER: f64 = 7.5;
const LEADING: f64 = 13.0;

/// Sizes and times of one kind of work, smallest first.
type Line = Vec<(f64, f64)>;

/// The lines of a suite; empty for a suite without growth figures.
fn lines(rows: &[BenchResult]) -> BTreeMap<&str, Line> {
    let mut lines: BTreeMap<&str, Line> = BTreeMap::new();
    for row in rows {
        let Some((_, rest)) = row.name.split_once("_growth_") else { continue };
        let Some((what, size)) = rest.rsplit_once('_') else { continue };
        if let Ok(size) = size.parse::<f64>()
            && size > 0.0
            && row.value > 0.0
        {
            lines.entry(what).or_default().push((size, row.value));
        }
    }
    lines.values_mut().for_each(|line| line.sort_by(|a, b| a.0.total_cmp(&b.0)));
    lines
}

/// Whole decades around the values.
fn decades(values: impl Iterator<Item = f64>) -> (f64, f64) {
    let (low, high) =
        values.fold((f64::INFINITY, 0.0_f64), |(low, high), value| (low.min(value), high.max(value)));
    let low = low.log10().floor();
    (10f64.powf(low), 10f64.powf(high.log10().ceil().max(low + 1.0)))
}

/// The name of a line, at its right end.
struct Name<'a> {
    class: String,
    what: &'a str,
    at: (f64, f64),
}

/// Moves names down, from the top on, until none overlaps another.
fn apart(mut names: Vec<Name<'_>>) -> Vec<Name<'_>> {
    names.sort_by(|a, b| a.at.1.total_cmp(&b.at.1));
    let width = |name: &Name<'_>| LETTER * name.what.len() as f64;
    for index in 1..names.len() {
        let (placed, rest) = names.split_at_mut(index);
        let name = &mut rest[0];
        // Every name in the way is above it afterwards, and there are few.
        for _ in 0..placed.len() {
            let covers = |other: &&Name<'_>| {
                (name.at.1 - other.at.1).abs() < LEADING
                    && name.at.0 < other.at.0 + width(other)
                    && other.at.0 < name.at.0 + width(name)
            };
            let Some(lower) = placed.iter().filter(covers).map(|other| other.at.1).reduce(f64::max) else {
                break;
            };
            name.at.1 = lower + LEADING;
        }
    }
    names
}

/// The picture as SVG, over the number of `of`; `None` without growth figures.
pub fn growth(rows: &[BenchResult], of: &str) -> Option<String> {
    let lines = lines(rows);
    let unit = &rows.iter().find(|row| row.name.contains("_growth_"))?.unit;
    let points = || lines.values().flatten();
    points().next()?;
    let [left, top, right, below] = MARGIN;
    let x = Scale::log(decades(points().map(|point| point.0)), left, SIZE[0] - right);
    let y = Scale::log(decades(points().map(|point| point.1)), SIZE[1] - below, top);
    let mut chart = Chart::new(SIZE[0], SIZE[1], "cost against size", x, y);
    chart.axes(of, unit, 10, 10);
    let mut names = Vec::new();
    for (index, (what, line)) in lines.iter().enumerate() {
        // The second line of a colour is dashed, the third dotted.
        let colour = CLASSES[index % CLASSES.len()];
        let class = &match index / CLASSES.len() {
            0 => colour.to_owned(),
            1 => format!("{colour} dashed"),
            _ => format!("{colour} dotted"),
        };
        chart.line(class, line.iter().copied());
        for (size, time) in line {
            chart.dot(class, (x.pixel(*size), y.pixel(*time)), 3.0, &format!("{what}: {time:.3} {unit}"));
        }
        if let Some((size, time)) = line.last() {
            names.push(Name { class: class.clone(), what, at: (x.pixel(*size) + 8.0, y.pixel(*time) + 4.0) });
        }
    }
    for Name { class, what, at } in apart(names) {
        chart.text(&class, at, what);
    }
    let svg = chart.finish();
    // After the opening tag.
    let opened = svg.find('>')? + 1;
    Some(format!("{}{STYLE}{}\n", &svg[..opened], &svg[opened..]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use trocar::summary::Better;

    #[test]
    fn each_kind_of_work_is_a_line_that_rises_as_its_figures_do() {
        let row =
            |name: &str, value: f64| BenchResult::on_value(name, "µs", (value, 0.0), None, Better::Lower);
        let rows = [
            row("collision_first_980_mean", 1.0),
            row("collision_growth_build_10000", 500.0),
            row("collision_growth_build_1000", 40.0),
            row("collision_growth_first_1000", 4.0),
            row("collision_growth_first_10000", 5.0),
        ];
        let svg = growth(&rows, "triangles").expect("it grows");
        let path = svg.split("<path class=\"line c0\" d=\"M").nth(1).and_then(|rest| rest.split('"').next());
        let heights: Vec<f64> = path
            .expect("a line")
            .split('L')
            .map(|point| point.split_once(' ').expect("a place").1.parse().expect("a number"))
            .collect();
        assert_eq!((svg.matches("<path").count(), svg.matches("<circle").count()), (2, 4));
        assert!(heights[0] > heights[1] + 100.0, "smaller sizes first, larger costs above: {heights:?}");
        assert!(
            svg.contains(">build</text>") && svg.contains(">1000</text>") && svg.contains(">10000</text>")
        );
        assert_eq!(growth(&rows[..1], "triangles"), None);
        let name = |what, x, y| Name { class: String::new(), what, at: (x, y) };
        let found =
            apart(vec![name("under", 5.0, 12.0), name("over", 0.0, 10.0), name("beside", 300.0, 11.0)]);
        let places: Vec<_> = found.iter().map(|name| (name.what, name.at.1)).collect();
        assert_eq!(places, [("over", 10.0), ("beside", 11.0), ("under", 23.0)]);
        assert_eq!(growth(&[row("a_growth_b_0", 1.0), row("a_growth_b_10", 0.0)], "triangles"), None);
    }
}
