//! The terminal display of a running session: a table of rates live, a progress bar in virtual time.
//!
//! Everything goes to stderr, and only when that is a terminal.

use std::time::{Duration, Instant};

use console::{Term, style};
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use trocar::run::{Progress, RunOptions};
use trocar::session::{doubts, frozen_now};
use trocar_kernel::runtime::ControllerReport;
use trocar_scene::scenario::Scenario;
use trocar_scene::{DeviceState, Hand, LinkState, Measured, Snapshot, Station, TaskState, Teleoperation};

use crate::escape::printable;
use crate::output::columns;
use crate::report::short;

/// Redraw interval of the table.
const REDRAW: Duration = Duration::from_millis(250);
/// Resolution of the progress bar.
const BAR_STEPS: u64 = 1000;

/// A session's display on the terminal.
pub struct Display {
    kind: Kind,
    title: String,
}

enum Kind {
    Silent,
    Table { term: Term, lines: usize, drawn: Option<Instant>, before: Vec<(u64, f64)> },
    Bar { bar: ProgressBar, seconds: Option<f64> },
}

impl Display {
    /// The display for this terminal; none when `silent` or when stderr is no terminal.
    pub fn new(scenario: &Scenario, options: &RunOptions, silent: bool) -> Self {
        let term = Term::stderr();
        let kind = if silent || !term.is_term() {
            Kind::Silent
        } else if options.lockstep {
            let bar = ProgressBar::with_draw_target(Some(BAR_STEPS), ProgressDrawTarget::stderr());
            let template = "{spinner} {bar:32} {msg}  {elapsed} on the wall";
            bar.set_style(
                ProgressStyle::with_template(template).unwrap_or_else(|_| ProgressStyle::default_bar()),
            );
            Kind::Bar { bar, seconds: options.seconds }
        } else {
            Kind::Table { term, lines: 0, drawn: None, before: Vec::new() }
        };
        Self { kind, title: printable(&scenario.name) }
    }

    /// Whether nothing is shown.
    pub fn is_silent(&self) -> bool {
        matches!(self.kind, Kind::Silent)
    }

    /// Shows the state of the session; returns at once between two redraws.
    pub fn update(&mut self, progress: &Progress<'_>) {
        match &mut self.kind {
            Kind::Silent => {}
            Kind::Bar { bar, seconds } => {
                let task = progress.scene.iter::<TaskState>().next().map(|(_, task)| task);
                let now = progress.now.as_secs_f64();
                let by_task = task.map_or(0.0, |task| f64::from(task.done) / f64::from(task.steps.max(1)));
                let by_time = seconds.map_or(0.0, |seconds| now / seconds);
                bar.set_position((by_task.max(by_time) * BAR_STEPS as f64) as u64);
                let speed = now / progress.wall_secs.max(1e-6);
                let steps =
                    task.map_or(String::new(), |task| format!("{} of {} steps, ", task.done, task.steps));
                bar.set_message(format!("{steps}{now:.1} s simulated ({speed:.1}×)"));
            }
            Kind::Table { term, lines, drawn, before } => {
                if drawn.is_some_and(|drawn| drawn.elapsed() < REDRAW) {
                    return;
                }
                let reports = progress.session.reports();
                let width = usize::from(term.size().1).max(20);
                let now = progress.now.as_secs_f64();
                let text: Vec<String> = table(&self.title, progress, &reports, before, now)
                    .into_iter()
                    .map(|line| console::truncate_str(&line, width - 1, "…").into_owned())
                    .collect();
                *before = reports.iter().map(|row| (row.scheduled - row.missed, now)).collect();
                // A closed terminal ends the table, not the session.
                let _ = term.clear_last_lines(*lines);
                let _ = term.write_line(&text.join("\n"));
                *lines = text.len();
                *drawn = Some(Instant::now());
            }
        }
    }

    /// Clears the display.
    pub fn clear(&mut self) {
        match &mut self.kind {
            Kind::Silent => {}
            Kind::Bar { bar, .. } => bar.finish_and_clear(),
            Kind::Table { term, lines, .. } => {
                let _ = term.clear_last_lines(*lines);
                *lines = 0;
            }
        }
    }
}

fn table(
    title: &str,
    progress: &Progress<'_>,
    reports: &[ControllerReport],
    before: &[(u64, f64)],
    now: f64,
) -> Vec<String> {
    let mut first = format!("{}  {now:.1} s", style(title).bold().for_stderr());
    if let Some((_, task)) = progress.scene.iter::<TaskState>().next() {
        let phase = printable(&task.phase);
        first.push_str(&format!(
            "  {} of {} steps  {phase}  {} errors",
            task.done,
            task.steps,
            task.errors.len()
        ));
    }
    let mut lines = vec![first, String::new()];
    let head = [
        "controller",
        "target Hz",
        "now Hz",
        "mean Hz",
        "on time",
        "late p50 µs",
        "p99",
        "step p50 µs",
        "p99",
        "missed",
        "dropped",
        "rejected",
        "restarts",
        "hits",
        "mean",
    ];
    let rows: Vec<Vec<String>> =
        reports.iter().enumerate().map(|(i, row)| rate_row(row, before.get(i), now)).collect();
    let mut table = columns(&head, &rows).into_iter();
    if let Some(head) = table.next() {
        lines.push(style(head).dim().for_stderr().to_string());
    }
    lines.extend(table);
    lines.push(String::new());
    lines.extend(progress.scene.iter::<Hand>().filter_map(|(entity, hand)| {
        let force = progress.scene.get::<DeviceState>(entity)?.applied_force.norm();
        Some(format!("{:<5} {:>5.2} N {}", hand.side.as_str(), force, gauge(force)))
    }));
    lines.extend(stations(progress.scene));
    lines.extend(slaves(progress.scene));
    lines.extend(waiting(progress.scene).map(|(body, share)| {
        format!(
            "{}: its inverse is being computed  {} {:>3.0} %",
            printable(body),
            blocks(share),
            100.0 * share
        )
    }));
    let losses =
        progress.session.losses().into_iter().chain(frozen_now(progress.scene)).chain(doubts(progress.scene));
    lines.extend(losses.map(|loss| {
        let line = printable(&loss);
        style(line).yellow().for_stderr().to_string()
    }));
    lines
}

fn rate_row(row: &ControllerReport, before: Option<&(u64, f64)>, now: f64) -> Vec<String> {
    let ran = row.scheduled - row.missed;
    let lately = before.filter(|(_, at)| now > *at).map_or("–".to_owned(), |(count, at)| {
        format!("{:.0}", (ran.saturating_sub(*count)) as f64 / (now - at))
    });
    vec![
        printable(&row.name),
        short(row.target_hz),
        lately,
        format!("{:.1}", row.achieved_hz),
        format!("{:.2} %", row.on_time * 100.0),
        short(row.lateness_us.p50),
        short(row.lateness_us.p99),
        short(row.step_us.p50),
        short(row.step_us.p99),
        row.missed.to_string(),
        row.dropped.to_string(),
        row.rejected.to_string(),
        row.restarts.to_string(),
        row.hits.map_or("–".to_owned(), |hits| hits.now.to_string()),
        row.hits.map_or("–".to_owned(), |hits| format!("{:.1}", hits.mean)),
    ]
}

/// Who is in a session over a network, and how the links do.
fn stations(scene: &Snapshot) -> Vec<String> {
    let own = scene.iter::<Station>().map(|(entity, _)| entity.station()).max().unwrap_or(0);
    let rows = scene.iter::<Station>().filter(|(entity, _)| entity.station() == own);
    let line = |(_, station): (_, &Station)| {
        let name = printable(&station.name);
        let hands =
            if station.hands.is_empty() { String::new() } else { format!(" {}", station.hands.join(", ")) };
        if !station.here {
            return style(format!("{name}: away{hands}")).yellow().for_stderr().to_string();
        }
        let LinkState { round_trip, jitter, loss, age, rate, bytes_received, bytes_sent, over_tcp } =
            station.link;
        let seal = if station.protected { "" } else { "  unprotected" };
        let way = if over_tcp { "  over TCP: datagrams do not arrive" } else { "" };
        format!(
            "{name}:{hands}  {:.1} ms round trip ± {:.1}  {:.1} % lost  {:.0} ms old  {rate:.0} Hz  {:.0} kB/s in  \
             {:.0} kB/s out{way}{seal}",
            round_trip * 1e3,
            jitter * 1e3,
            loss * 100.0,
            age * 1e3,
            bytes_received * 1e-3,
            bytes_sent * 1e-3,
        )
    };
    rows.map(line).collect()
}

/// What the slaves of a tele-operation do.
fn slaves(scene: &Snapshot) -> Vec<String> {
    let line = |(hand, row): (_, &Teleoperation)| {
        format!(
            "slave of {}: {}  {} packets of {}",
            printable(&scene.name(hand)),
            row.words(),
            row.figures.received,
            row.figures.sent,
        )
    };
    scene.iter::<Teleoperation>().map(line).collect()
}

/// Bodies that wait for a precomputation, and the share of it that is done.
pub fn waiting(scene: &Snapshot) -> impl Iterator<Item = (&str, f64)> {
    let measured = scene.iter::<Measured>().flat_map(|(_, measured)| &measured.values);
    let shares =
        measured.filter_map(|(what, share)| Some((what.strip_suffix(".precomputed_share")?, *share)));
    shares.filter(|(_, share)| *share < 1.0)
}

/// A bar of up to 20 blocks for a force of up to 3.3 N.
fn gauge(newtons: f64) -> String {
    blocks(newtons / 3.3)
}

/// A bar of 20 blocks for a share.
fn blocks(share: f64) -> String {
    let blocks = (share * 20.0).round().clamp(0.0, 20.0) as usize;
    format!("{}{}", "█".repeat(blocks), "·".repeat(20 - blocks))
}
