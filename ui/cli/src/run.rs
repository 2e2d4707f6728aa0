//! `trocar run`: a scenario from start to end, with a table while it runs and a report after it.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use trocar::app::App;
use trocar::plans::{PLANS, PlanError};
use trocar::play::Bindings;
use trocar::run::{RunOptions, RunOutcome};
use trocar::session::{doubts, forecast};
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
use crate::run_files::RunFiles;
use crate::run_text::{text, verdict};
use crate::startup::{self, READING, Startup};
use crate::tune::{self, TuningService};
use crate::window::{self, Next, SessionHost, Show, Verdict};

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
            let next = host.wait(match &outcome {
                Ok((summary, exit)) => verdict(summary, *exit != Exit::Ok),
                Err(failure) => {
                    let lines = failure.message.lines().map(printable).collect();
                    Verdict { title: "failed".to_owned(), lines, bad: true }
                }
            });
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
    let files = RunFiles::choose(args, &file_stem(&scenario), number)?;
    let mut options = options(&args.session)?;
    options.lockstep = args.lockstep;
    options.seconds = args.seconds;
    options.faults = args.faults.as_deref().map(plan).transpose()?;
    options.record = files.record.clone();
    options.recorder.exact = args.record_exact;
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
    // What was mended, and what is doubtful, in the meshes and values of the scenario, and what its methods cannot bear, is
    // said before anything runs.
    let mut known = doubts(&first);
    known.extend(forecast(&first, &scenario));
    if !args.json {
        known.iter().for_each(|doubt| tracing::warn!("{}", printable(doubt)));
    }
    if let Some(host) = &mut host {
        host.doubt(&known);
    }
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

    if let Some(file) = &files.report {
        outcome.summary.report = Some(file.display().to_string());
        let html = html(&scenario, &outcome, force_limits(&outcome));
        output::write_file(file, html.as_bytes())?;
    }
    let exit = outcome.exit();
    if outcome.summary.error.is_none() && !outcome.failed_expectations.is_empty() {
        outcome.summary.error =
            Some(format!("expectation failed: {}", outcome.failed_expectations.join("; ")));
    }
    if !args.json {
        let note = files.note().map_or_else(String::new, |note| format!("\n{note}"));
        output::print_text(&format!("{}{note}", text(&outcome.summary)))?;
        for loss in outcome.summary.losses.iter().filter(|loss| !known.contains(loss)) {
            tracing::warn!("{}", printable(loss));
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
