//! `trocar run`: a scenario from start to end, with a table while it runs and a report after it.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use trocar::app::App;
use trocar::plans::{PLANS, PlanError};
use trocar::play::Bindings;
use trocar::run::{RunOptions, RunOutcome};
use trocar::summary::{Exit, Mode, RunSummary};
use trocar_kernel::faults::FaultPlan;
use trocar_kernel::supervision::{Cause, Incident};
use trocar_scene::Snapshot;
use trocar_scene::scenario::Scenario;

use crate::args::{RunArgs, SessionArgs};
use crate::escape::printable;
use crate::failure::{Failure, did_you_mean};
use crate::live_table::{Display, waiting};
use crate::output;
use crate::pictures::Photographer;
use crate::report::{self, Report, short};
use crate::startup::{self, READING, Startup};
use crate::tune::{self, TuningService};
use crate::window::{self, Next, SessionHost, Show};

/// Runs the scenario of the command line, in a window where there is a display.
pub fn run(app: &App, args: &RunArgs) -> Result<Exit, Failure> {
    let by_default = !(args.json || args.lockstep || args.pictures.are_asked_for());
    let Some(windows) = window::connect(&args.window, by_default)? else {
        return told(args, attempt(app, args, 1, None));
    };
    let bindings = match &args.bindings {
        Some(file) => bindings(file)?,
        None => Bindings::default(),
    };
    // Errors in the scenario are reported before a window opens.
    let startup = Startup::new(&args.session.scenario, READING, args.json);
    let (scenario, _) = tune::scenario(app, &args.session)?;
    let show = Show {
        title: if scenario.title.is_empty() { scenario.name.clone() } else { scenario.title.clone() },
        folder: Some(scenario.folder().to_owned()),
        first: Arc::new(scenario.spawn(app.registry()).map_err(Failure::invalid)?.snapshot()),
        play: args.play.then_some(bindings),
    };
    drop(startup);
    window::with_session(windows, &args.pictures, show, |mut host| {
        let mut number = 0_u32;
        loop {
            number = number.saturating_add(1);
            let outcome = attempt(app, args, number, Some(&mut host));
            let (verdict, bad) = match &outcome {
                Ok((summary, exit)) => (verdict(summary), *exit != Exit::Ok),
                Err(failure) => (failure.message.clone(), true),
            };
            let next = host.wait(verdict, bad);
            let told = told(args, outcome);
            if next == Next::End {
                return told;
            }
            if let Err(failure) = told {
                crate::say(&failure.message);
            }
        }
    })
}

/// The result as a note for the window.
fn verdict(summary: &RunSummary) -> String {
    let task = &summary.task;
    if !task.is_exercise() {
        return "it has ended; Backspace: once more".to_owned();
    }
    let how = if task.completed { "completed" } else { "not completed" };
    let score = task.score.map_or(String::new(), |score| format!(", score {score:.1}"));
    let disturbed = summary.too_slow().map_or(String::new(), |slow| format!(" (disturbed: {slow})"));
    format!("{how}{score}{disturbed}; Backspace: once more")
}

fn bindings(file: &Path) -> Result<Bindings, Failure> {
    let text = std::fs::read_to_string(file)
        .map_err(|error| Failure::invalid(format!("{}: {error}", file.display())))?;
    Bindings::parse(&text).map_err(|error| Failure::invalid(format!("{}: {error}", file.display())))
}

/// Prints the result of a run.
fn told(args: &RunArgs, outcome: Result<(RunSummary, Exit), Failure>) -> Result<Exit, Failure> {
    match outcome {
        Ok((summary, exit)) => {
            if args.json {
                output::print_json(&summary)?;
            }
            Ok(exit)
        }
        Err(failure) if args.json => {
            let mode = if args.lockstep { Mode::Lockstep } else { Mode::Live };
            let mut summary = RunSummary::new(&args.session.scenario, mode, args.session.seed);
            summary.error = Some(failure.message.clone());
            output::print_json(&summary)?;
            Err(failure)
        }
        Err(failure) => Err(failure),
    }
}

/// One session from start to end: the first one, or a repetition.
fn attempt(
    app: &App,
    args: &RunArgs,
    number: u32,
    mut host: Option<&mut SessionHost>,
) -> Result<(RunSummary, Exit), Failure> {
    let startup = Startup::new(&args.session.scenario, READING, args.json);
    let (scenario, tuner) = tune::scenario(app, &args.session)?;
    let stem = file_stem(&scenario);
    let record = (!args.no_record).then(|| {
        numbered(args.record.clone().unwrap_or_else(|| PathBuf::from(format!("{stem}.mcap"))), number)
    });
    let report_file = (!args.no_report).then(|| {
        numbered(args.report.clone().unwrap_or_else(|| PathBuf::from(format!("report-{stem}.html"))), number)
    });
    for file in record.iter().chain(&report_file) {
        output::check_writable(file)?;
    }
    let mut options = options(&args.session)?;
    options.lockstep = args.lockstep;
    options.seconds = args.seconds;
    options.faults = args.faults.as_deref().map(plan).transpose()?;
    options.record = record;
    options.play = args.play;

    if options.lockstep && app.actors().next().is_some() {
        let names = app.actors().collect::<Vec<_>>().join(", ");
        tracing::warn!("in lock-step there is no real time, so these actors are left out: {names}");
    }

    if options.play && host.is_none() {
        tracing::warn!(
            "without a window nobody drives the hands: they rest until a program writes 'person_input'"
        );
    }
    if let Some(host) = &mut host {
        host.prepare(&mut options);
    }

    let mut display = Display::new(&scenario, &options, args.window.headless || args.json);
    let mut tuning_service = TuningService::new(app, &scenario, tuner);
    if !args.lockstep {
        // In virtual time a session is over before a user could tune it.
        tuning_service.open();
    }
    let first = scenario.spawn(app.registry()).map_err(Failure::invalid)?.snapshot();
    if args.pictures.are_asked_for() {
        startup.stage("the renderer of the pictures");
    }
    let mut photographer = Photographer::new(&args.pictures, Some(scenario.folder()), &first)?;
    startup.stage(&startup::first_step(&first));
    let mut startup = Some(startup);
    let mut stage = String::new();
    let outcome = trocar::run::run(app, &scenario, &options, &mut |progress| {
        if let Some(shown) = &startup {
            match unready(progress.scene, host.as_deref()).filter(|_| display.is_silent()) {
                // A live session goes on meanwhile.
                Some(awaited) if awaited != stage => {
                    shown.stage(&awaited);
                    stage = awaited;
                }
                Some(_) => {}
                None => startup = None,
            }
        }
        tuning_service.serve(progress.session);
        display.update(progress);
        if let Some(photographer) = &mut photographer {
            photographer.look(progress.scene, progress.now);
        }
        if let Some(host) = &mut host {
            host.update(progress, &mut tuning_service);
        }
    });
    tuning_service.close();
    display.clear();
    let mut outcome = outcome?;
    if let Some(photographer) = photographer {
        photographer.finish(&outcome.kernel.snapshot, &mut outcome.summary);
    }
    outcome.summary.tuned = tuning_service.tuned(&outcome.kernel.snapshot);
    if let Some(host) = host {
        host.ended(outcome.kernel.snapshot.clone());
    }

    if let Some(file) = report_file {
        outcome.summary.report = Some(file.display().to_string());
        let html = html(&scenario, &outcome, force_limits(&outcome));
        output::write_file(&file, html.as_bytes())?;
    }
    let exit = outcome.exit();
    if outcome.summary.error.is_none() && !outcome.failed_expectations.is_empty() {
        outcome.summary.error =
            Some(format!("expectation failed: {}", outcome.failed_expectations.join("; ")));
    }
    if !args.json {
        output::print_text(&text(&outcome.summary))?;
        for loss in &outcome.summary.losses {
            tracing::warn!("{loss}");
        }
    }
    Ok((outcome.summary, exit))
}

/// What a session that has begun still waits for: computed inverses, and the first picture in a window.
fn unready(scene: &Snapshot, host: Option<&SessionHost>) -> Option<String> {
    let inverses = waiting(scene)
        .map(|(body, share)| format!("the inverse of {} ({:.0} %)", printable(body), 100.0 * share));
    let picture = host.is_some_and(SessionHost::awaits_picture).then(|| "the window".to_owned());
    inverses.chain(picture).next()
}

/// The file name for a repetition, beside that of the first run.
fn numbered(file: PathBuf, number: u32) -> PathBuf {
    if number == 1 {
        return file;
    }
    let stem = file.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    let ending = file.extension().map_or(String::new(), |ending| format!(".{}", ending.to_string_lossy()));
    file.with_file_name(format!("{stem}-{number}{ending}"))
}

/// Options that every command with a session shares; an interrupt ends the session in an orderly way.
pub fn options(args: &SessionArgs) -> Result<RunOptions, Failure> {
    let stop = Arc::new(AtomicBool::new(false));
    for signal in [signal_hook::consts::SIGINT, signal_hook::consts::SIGTERM] {
        // The second interrupt ends the process at once.
        signal_hook::flag::register_conditional_shutdown(
            signal,
            i32::from(Exit::Internal.code()),
            stop.clone(),
        )
        .and_then(|_| signal_hook::flag::register(signal, stop.clone()))
        .map_err(Failure::internal)?;
    }
    Ok(RunOptions {
        seed: args.seed,
        hands: args.hands.clone(),
        skill: args.skill.clone(),
        left_handed: args.left_handed,
        stop,
        ..RunOptions::default()
    })
}

fn plan(name_or_file: &str) -> Result<FaultPlan, Failure> {
    trocar::plans::plan(name_or_file).map_err(|error| {
        let hint = match &error {
            PlanError::Unknown { name, .. } => did_you_mean(name, PLANS.iter().map(|(known, _)| *known)),
            PlanError::Plan(_) => String::new(),
        };
        Failure::invalid(format!("{error}{hint}"))
    })
}

/// The scenario's name with only characters that are valid in a file name.
fn file_stem(scenario: &Scenario) -> String {
    let safe = |c: char| if c.is_alphanumeric() || c == '-' || c == '_' { c } else { '-' };
    scenario.name.chars().take(60).map(safe).collect()
}

fn force_limits(outcome: &RunOutcome) -> BTreeMap<String, f64> {
    let scene = &outcome.kernel.snapshot;
    scene
        .iter::<trocar_scene::DeviceInfo>()
        .filter_map(|(entity, info)| {
            let hand = scene.get::<trocar_scene::Hand>(entity)?;
            Some((hand.side.as_str().to_owned(), info.max_force))
        })
        .collect()
}

fn html(scenario: &Scenario, outcome: &RunOutcome, force_limits: BTreeMap<String, f64>) -> String {
    let lateness: Vec<report::Lateness> = outcome
        .reports
        .iter()
        .map(|row| report::Lateness {
            name: row.name.clone(),
            upper_us: row.lateness_bars.upper_us.clone(),
            counts: row.lateness_bars.counts.clone(),
        })
        .collect();
    let health: Vec<report::Health> = outcome
        .health
        .iter()
        .map(|(name, health)| {
            let restarts = outcome.reports.iter().find(|row| row.name == *name).map_or(0, |row| row.restarts);
            report::Health { name: name.clone(), health: (*health).to_owned(), restarts: u64::from(restarts) }
        })
        .collect();
    let incidents: Vec<report::Incident> = outcome.kernel.incidents.iter().map(incident).collect();
    report::html(&Report {
        title: if scenario.title.is_empty() { &scenario.name } else { &scenario.title },
        summary: &outcome.summary,
        trace: &outcome.trace,
        lateness: &lateness,
        health: &health,
        incidents: &incidents,
        failures: &outcome.failed_expectations,
        force_limits: &force_limits,
    })
}

fn incident(incident: &Incident) -> report::Incident {
    let detected = incident.detected.as_secs_f64();
    let outcome = match (incident.restarted, incident.resumed) {
        (_, Some(resumed)) => {
            format!("at work again after {} ms", short((resumed.as_secs_f64() - detected) * 1e3))
        }
        (Some(_), None) => "restarted, no tick yet".to_owned(),
        (None, None) => "not restarted".to_owned(),
    };
    report::Incident { secs: detected, child: incident.child.clone(), what: cause(&incident.cause), outcome }
}

fn cause(cause: &Cause) -> String {
    match cause {
        Cause::Panic(text) => format!("panicked: {text}"),
        Cause::Error(text) => format!("gave up: {text}"),
        Cause::Stop => "ended".to_owned(),
        Cause::Stall => "stalled".to_owned(),
        Cause::StartTimeout => "did not start in time".to_owned(),
    }
}

/// Contacts that were not kept that the text names one by one; the others are in report and JSON.
const UNKEPT_SHOWN: usize = 4;

/// The summary as text for people.
pub fn text(summary: &RunSummary) -> String {
    let bold = |text: String| console::style(text).bold().to_string();
    let task = &summary.task;
    let verdict = match () {
        () if task.completed => console::style("completed").green().to_string(),
        () if task.cut_off => console::style("cut off").yellow().to_string(),
        () => console::style("not completed").red().to_string(),
    };
    let scenario = bold(summary.scenario.clone());
    let mut lines = if task.is_exercise() {
        let score = task.score.map_or("–".to_owned(), |score| format!("{score:.1}"));
        let errors = task.errors.len();
        vec![
            format!("{scenario} {verdict} in {:.1} s, {errors} errors", task.seconds),
            format!("{} / 100  FLS-style score, not clinically validated", bold(format!("score {score}"))),
        ]
        .into_iter()
        .chain(task.disturbed.then(|| "the score is disturbed: it says little about the trainee".to_owned()))
        .collect()
    } else {
        vec![format!("{scenario}: {:.1} s; there is no exercise in it", summary.sim_secs)]
    };
    lines.extend(summary.too_slow().map(|slow| console::style(slow).yellow().to_string()));
    lines.push(String::new());
    lines.extend(rates(summary));
    lines.push(String::new());
    lines.push(format!(
        "largest force at a driver {} N, deepest penetration {} mm",
        short(summary.force_newtons_max),
        short(summary.penetration_max * 1e3)
    ));
    if summary.contacts_not_kept > 0 {
        lines.push(format!("contacts that were not kept: {}", summary.contacts_not_kept));
        lines.extend(summary.unkept_contacts.iter().take(UNKEPT_SHOWN).map(|contact| format!("  {contact}")));
    }
    if !summary.faults.is_empty() {
        lines.push(format!(
            "no force was held for longer than {} ms after its last fresh command; {} commands of zombies were refused",
            short(summary.force_age_max_us * 1e-3),
            summary.commands_refused
        ));
    }
    for row in summary.controllers.iter().filter(|row| row.lost + row.delayed + row.duplicated > 0) {
        lines.push(format!(
            "{}: of {} batches {} were lost, {} came late, {} came twice",
            row.name, row.sent, row.lost, row.delayed, row.duplicated
        ));
    }
    for fault in &summary.faults {
        let state = match (fault.injected_secs, fault.recovery_secs()) {
            (Some(_), Some(took)) => format!("overcome in {:.1} ms", took * 1e3),
            (Some(_), None) if fault.is_under_way() => "lasted to the end".to_owned(),
            (Some(_), None) => "not overcome".to_owned(),
            (None, _) => "did not strike".to_owned(),
        };
        lines.push(format!("fault '{}' ({} {}): {state}", fault.id, fault.kind, fault.target));
    }
    lines.push(format!(
        "{:.1} s simulated in {:.1} s; state hash {}",
        summary.sim_secs,
        summary.wall_secs,
        summary.state_hash.as_deref().unwrap_or("–")
    ));
    if let Some(file) = &summary.recording {
        let gaps = if summary.recording_complete { "" } else { " (with gaps)" };
        lines.push(format!("recording {file}{gaps}"));
    }
    if let Some(file) = &summary.report {
        lines.push(format!("report {file}"));
    }
    if let Some(error) = &summary.error {
        lines.push(console::style(crate::escape::printable(error)).red().to_string());
    }
    lines.join("\n")
}

/// The table of rates.
fn rates(summary: &RunSummary) -> Vec<String> {
    let live = summary.mode == Mode::Live;
    let head: &[&str] = if live {
        &[
            "controller",
            "target Hz",
            "achieved Hz",
            "on time",
            "late p50 µs",
            "p99",
            "step p50 µs",
            "p99",
            "missed",
            "restarts",
            "hits mean",
            "max",
            "in ticks",
        ]
    } else {
        &[
            "controller",
            "target Hz",
            "ticks",
            "step p50 µs",
            "p99",
            "rejected",
            "restarts",
            "hits mean",
            "max",
            "in ticks",
        ]
    };
    let rows: Vec<Vec<String>> = summary
        .controllers
        .iter()
        .map(|row| {
            let steps = [short(row.step_us.p50), short(row.step_us.p99)];
            let mut cells = vec![row.name.clone(), short(row.target_hz)];
            if live {
                cells.push(format!("{:.1}", row.achieved_hz));
                cells.push(format!("{:.2} %", row.on_time * 100.0));
                cells.extend([short(row.lateness_us.p50), short(row.lateness_us.p99)]);
                cells.extend(steps);
                cells.push(row.missed.to_string());
            } else {
                cells.push(row.scheduled.to_string());
                cells.extend(steps);
                cells.push(row.rejected.to_string());
            }
            cells.push(row.restarts.to_string());
            cells.extend(match &row.hits {
                Some(hits) => [format!("{:.1}", hits.mean), hits.max.to_string(), hits.ticks.to_string()],
                None => ["–", "–", "–"].map(str::to_owned),
            });
            cells
        })
        .collect();
    output::columns(head, &rows)
}
