//! `trocar bench`: measures figures beside the lower bounds of this machine.

mod allocation;
mod build;
mod collision;
pub mod counting;
mod exercise;
mod idle;
mod markdown;
mod memory;
mod network;
mod peer;
mod plot;
mod recording;
mod session;
mod simulator;
mod viewer;

use indicatif::{ProgressBar, ProgressStyle};
use trocar::summary::{BenchResult, BenchSummary, Better, Exit};
use trocar_scene::output_file;

use crate::args::BenchArgs;
use crate::doctor::machine;
use crate::failure::{Failure, did_you_mean};
use crate::output::{self, replace};
use crate::report::short;

/// Suites by name, and their contents.
pub const SUITES: [(&str, &str); 9] = [
    (
        "kernel",
        "rates of the kernel and of the live exercise, reads and writes, allocations, speed of lock-step, sessions",
    ),
    ("session", "steps per second of sessions side by side, branches, new beginnings"),
    (
        "viewer",
        "frames beside a bare loop, what is sent, what nothing new costs, hands while a rasteriser is at full load",
    ),
    (
        "collision",
        "surfaces against each other beside coal and FCL (--peers), a shaft, a proxy, detectors live, growth with the number of triangles",
    ),
    (
        "simulator",
        "finite elements beside MuJoCo, position-based bodies beside pypbd, a rod beside PyElastica, a sheet beside Bullet (--peers), cloth, thread, heat, liquid, growth",
    ),
    (
        "recording",
        "what a minute of each scenario takes, what recording costs the hands, opening and seeking in an hour's file; takes about ten minutes",
    ),
    (
        "network",
        "hands between stations beside bare datagrams, 16 stations at one host, joins, a pulled liver's bytes, a stranger's flood; takes about three minutes",
    ),
    ("memory", "what sessions hold over an hour of simulated time; takes about ten minutes"),
    (
        "build",
        "a cold build of the program from its sources, its size and the disk that it takes; takes about ten minutes",
    ),
];

/// Suites with growth figures, and the quantity on their axis.
const GROWING: [(&str, &str); 2] = [("collision", "triangles"), ("simulator", "elements")];

/// A measurement of one or a few figures, and its name while it runs.
type Part = (&'static str, fn() -> Result<Vec<BenchResult>, Failure>);

type Measure<'a> = &'a dyn Fn() -> Result<Vec<BenchResult>, Failure>;

/// The parts of the suite `kernel`.
const KERNEL: [Part; 6] = [
    ("rates, reads and writes of the kernel", kernel),
    ("allocations of a haptic tick", allocation::haptic_ticks),
    ("the exercise in lock-step", exercise::lockstep),
    ("sessions side by side, branches and new beginnings", session::sessions),
    ("the exercise live, beside bare timer loops", exercise::live),
    ("a paused session", idle::paused),
];

/// The part of it that is the suite `session`.
const SESSION: [Part; 1] = [KERNEL[3]];

/// The parts of the suite `viewer`.
const VIEWER: [Part; 5] = [
    ("frames beside a bare loop", viewer::frames),
    ("a mesh that deforms", viewer::uploads),
    ("a picture that does not change", viewer::idle),
    ("the exercise live, drawn without a pause", viewer::full_load),
    ("frames of a graphics card", viewer::card),
];

/// The parts of the suite `build`.
const BUILD: [Part; 1] = [("a cold build of the program", build::cold)];

/// The parts of the suite `recording`.
const RECORDING: [Part; 3] = [
    ("a minute of each scenario", recording::sizes),
    ("the exercise live, with and without a recording", recording::hands),
    ("an hour's file", recording::hour),
];

/// The parts of the suite `network`.
const NETWORK: [Part; 10] = [
    ("sealing, and allocations of a hands link", network::sealing),
    ("round trips beside bare datagrams", network::round_trip),
    ("a path that loses a fifth", network::lossy_sender),
    ("1, 4 and 16 stations", network::stations),
    ("joins and returns", network::joins),
    ("a liver that is pulled", network::liver),
    ("three architectures", network::architectures),
    ("a thin client", network::thin_client),
    ("a slave's forces", network::force_feedback),
    ("a stranger's flood", network::flood),
];

/// The parts of the suite `memory`.
const MEMORY: [Part; 2] = [
    ("an hour of the exercise, again and again", memory::exercises),
    ("an hour of one session", memory::session),
];

/// The kernel's own figures.
fn kernel() -> Result<Vec<BenchResult>, Failure> {
    trocar_kernel::bench::kernel(trocar_kernel::bench::Effort::Full).map_err(Failure::internal)
}

/// Runs a suite.
pub fn bench(args: &BenchArgs) -> Result<Exit, Failure> {
    let mut summary = BenchSummary::new(machine());
    let mut is_measured = false;
    let result = attempt(args, &mut summary, &mut is_measured);
    if let Err(failure) = &result {
        summary.error = Some(failure.message.clone());
    }
    if args.json {
        output::print_json(&summary)?;
    } else if is_measured {
        // Also when a file could not be written: the figures took minutes.
        let text = if args.markdown { markdown::table(&args.suite, &summary) } else { text(&summary) };
        match output::takes_stdout(false, [args.plot.as_deref()])? {
            true => output::tell(&text),
            false => output::print_text(&text)?,
        }
    }
    result?;
    Ok(if summary.missed().next().is_none() { Exit::Ok } else { Exit::Failed })
}

fn attempt(args: &BenchArgs, summary: &mut BenchSummary, is_measured: &mut bool) -> Result<(), Failure> {
    output::takes_stdout(args.json, [args.plot.as_deref()])?;
    let growing = GROWING.iter().find(|(suite, _)| *suite == args.suite);
    if args.plot.is_some() && growing.is_none() {
        return Err(Failure::usage(format!(
            "--plot: '{}' has nothing that grows; 'collision' and 'simulator' have",
            args.suite
        )));
    }
    // Looked at and read before minutes of measuring.
    let replace = replace(args.force);
    args.plot.as_deref().map_or(Ok(()), |file| output_file::check(file, replace))?;
    let page = args.into.as_deref().map(|file| markdown::Page::read(file, &args.suite)).transpose()?;
    measure(args, summary)?;
    *is_measured = true;
    let written = page.map_or(Ok(()), |page| page.write(&markdown::table(&args.suite, summary)));
    if let (Some(file), Some((_, of))) = (&args.plot, growing)
        && let Some(svg) = plot::growth(&summary.results, of)
    {
        output_file::write(file, svg.as_bytes(), replace)?;
    }
    written
}

fn measure(args: &BenchArgs, summary: &mut BenchSummary) -> Result<(), Failure> {
    let names = || SUITES.iter().map(|(name, _)| *name);
    if !names().any(|name| name == args.suite) {
        let known = names().collect::<Vec<_>>().join(", ");
        let hint = did_you_mean(&args.suite, names());
        return Err(Failure::usage(format!("no suite is called '{}'; there are: {known}{hint}", args.suite)));
    }
    let collision: [(&'static str, Measure<'_>); 4] = [
        ("surfaces against each other", &|| collision::queries(args.peers.as_deref())),
        ("a shaft and a proxy", &collision::touch),
        ("detectors live beside two hands", &collision::live),
        ("growth with the number of triangles", &collision::growth),
    ];
    let simulator: [(&'static str, Measure<'_>); 7] = [
        ("finite elements", &|| simulator::elements(args.peers.as_deref())),
        ("cloth and position-based bodies", &|| simulator::soft(args.peers.as_deref())),
        ("thread, heat and liquid", &|| simulator::flows(args.peers.as_deref())),
        ("two rates in one scene, live", &simulator::live),
        ("what bears, live", &simulator::bearing),
        ("every scene, live", &simulator::scenes),
        ("growth with size", &simulator::growth),
    ];
    let parts: &[Part] = match args.suite.as_str() {
        "collision" => return run(&collision, summary),
        "simulator" => return run(&simulator, summary),
        "session" => &SESSION,
        "viewer" => &VIEWER,
        "recording" => &RECORDING,
        "network" => &NETWORK,
        "memory" => &MEMORY,
        "build" => &BUILD,
        _ => &KERNEL,
    };
    let parts: Vec<_> = parts.iter().map(|(what, part)| (*what, part as Measure)).collect();
    run(&parts, summary)
}

/// Measures one part after the other.
fn run(parts: &[(&'static str, Measure<'_>)], summary: &mut BenchSummary) -> Result<(), Failure> {
    let bar = ProgressBar::new(parts.len() as u64);
    let style = ProgressStyle::with_template("{bar:24} {pos} of {len}  {msg}  {elapsed}");
    bar.set_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()));
    for (what, part) in parts {
        bar.set_message(*what);
        summary.results.extend(part()?);
        bar.inc(1);
    }
    bar.finish_and_clear();
    Ok(())
}

pub fn text(summary: &BenchSummary) -> String {
    let machine = &summary.machine;
    let mut lines = vec![
        format!(
            "{} × {}, governor {}, real-time priority {}",
            machine.cores,
            machine.cpu,
            machine.governor.as_deref().unwrap_or("not told"),
            if machine.fifo { "granted" } else { "refused" }
        ),
        String::new(),
    ];
    let rows: Vec<Vec<String>> = summary
        .results
        .iter()
        .map(|row| {
            let holds =
                if row.holds { console::style("yes").green() } else { console::style("NO").red().bold() };
            cells(row).into_iter().chain([holds.to_string()]).collect()
        })
        .collect();
    lines.extend(output::columns(&HEAD, &rows));
    lines.join("\n")
}

/// Columns of every table of figures.
const HEAD: [&str; 8] = ["figure", "value", "unit", "spread", "floor", "ratio", "bar", "holds"];

/// The cells of all columns but the last.
fn cells(row: &BenchResult) -> [String; 7] {
    let number = |value: Option<f64>| value.map_or("–".to_owned(), short);
    let sign = match row.better {
        Better::Lower => "≤",
        Better::Higher => "≥",
    };
    [
        row.name.clone(),
        short(row.value),
        row.unit.clone(),
        format!("{:.0} %", 100.0 * row.spread),
        number(row.floor),
        number(row.ratio),
        row.bar.map_or("–".to_owned(), |bar| format!("{sign} {}", short(bar))),
    ]
}
