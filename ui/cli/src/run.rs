//! `trocar run`: a scenario from start to end, with a table while it runs and a report after it.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

use trocar::app::App;
use trocar::network::Network;
use trocar::plans::{PLANS, PlanError};
use trocar::play::Bindings;
use trocar::run::{Resumed, RunOptions, RunOutcome};
use trocar::session::{doubts, forecast};
use trocar::summary::{BY_THE_PROGRAM, Exit, Mode, RunSummary};
use trocar::tuning::{Tuner, TuningSets};
use trocar_kernel::faults::FaultPlan;
use trocar_kernel::recorder::Recording;
use trocar_kernel::supervision::{Cause, Incident};
use trocar_scene::Snapshot;
use trocar_scene::output_file::{self, OutputError};
use trocar_scene::scenario::Scenario;

use crate::args::{RunArgs, SessionArgs};
use crate::escape::printable;
use crate::failure::{Failure, did_you_mean};
use crate::live_table::{Display, waiting};
use crate::output::{self, file_stem};
use crate::pictures::Photographer;
use crate::reflect;
use crate::report::{self, Report, short};
use crate::run_files::RunFiles;
use crate::run_text::{text, verdict};
use crate::signals;
use crate::startup::{self, READING, Startup};
use crate::tune::{self, TuningService};
use crate::window::{self, Next, SessionHost, Show, Verdict};
use crate::zenoh;

/// What is told of a run that a person ended in its window.
const BY_THE_WINDOW: &str = "a person at the window";

/// Runs the scenario of the command line, in a window where there is a display.
pub fn run(app: &App, args: &RunArgs) -> Result<Exit, Failure> {
    run_in(app, args, &Network::None)
}

/// The same as part of a session over a network.
pub fn run_in(app: &App, args: &RunArgs, network: &Network) -> Result<Exit, Failure> {
    let by_default = !(args.json || args.lockstep || args.pictures.are_asked_for());
    let Some(windows) = window::connect(&args.window, by_default)? else {
        return told(args, attempt(app, args, network, 1, None));
    };
    let bindings = match &args.bindings {
        Some(file) => bindings(file)?,
        None => Bindings::default(),
    };
    // Errors in the scenario are reported before a window opens.
    let startup = Startup::new(&args.session.scenario, READING, args.json);
    let (scenario, _) = scenario(app, args, network)?;
    let resumed = resumed(app, args, 1)?;
    let show = Show {
        title: if scenario.title.is_empty() { scenario.name.clone() } else { scenario.title.clone() },
        folder: Some(scenario.folder().to_owned()),
        first: Arc::new(first_scene(app, &scenario, network, resumed.as_ref())?),
        play: args.play.then_some(bindings),
    };
    drop(startup);
    window::with_session(windows, &args.pictures, show, |mut host| {
        let mut number = 0_u32;
        loop {
            number = number.saturating_add(1);
            let outcome = attempt(app, args, network, number, Some(&mut host));
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
        Ok((summary, exit)) if args.json => match output::print_json(&summary) {
            // What the run itself came to is told first.
            Err(failure) if exit != Exit::Ok => {
                crate::say(&failure.message);
                Ok(exit)
            }
            printed => printed.map(|()| exit),
        },
        Ok((_, exit)) => Ok(exit),
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

/// The scenario of the command line, or that of the host that was joined.
fn scenario(app: &App, args: &RunArgs, network: &Network) -> Result<(Scenario, Tuner), Failure> {
    match network.station() {
        Some(station) => Ok((station.scenario.clone(), Tuner::new(TuningSets::default()))),
        None => tune::scenario(app, &args.session),
    }
}

/// The scene at the start.
fn first_scene(
    app: &App,
    scenario: &Scenario,
    network: &Network,
    resumed: Option<&Resumed>,
) -> Result<Snapshot, Failure> {
    match (network.station(), resumed) {
        (Some(station), _) => Ok(station.scene.clone()),
        (None, Some(resumed)) => Ok(Snapshot::clone(resumed.scene())),
        (None, None) => Ok(scenario.spawn(app.registry()).map_err(Failure::invalid)?.snapshot()),
    }
}

/// Where an earlier session has stopped, for the first session of this run; repetitions begin at the beginning.
fn resumed(app: &App, args: &RunArgs, number: u32) -> Result<Option<Resumed>, Failure> {
    let file = args.resume.as_ref().filter(|_| number == 1);
    file.map(|file| Resumed::read(app.registry(), file)).transpose().map_err(Failure::invalid)
}

/// One session from start to end: the first one, or a repetition.
fn attempt(
    app: &App,
    args: &RunArgs,
    network: &Network,
    number: u32,
    mut host: Option<&mut SessionHost>,
) -> Result<(RunSummary, Exit), Failure> {
    let startup = Startup::new(&args.session.scenario, READING, args.json);
    let (scenario, tuner) = scenario(app, args, network)?;
    let named = [&args.record, &args.report, &args.pictures.picture].map(|file| file.as_deref());
    let stdout_is_taken = output::takes_stdout(args.json, named)?;
    // From here on a signal ends the command in good order, so that no place stays claimed.
    let mut options = options(&args.session)?;
    let mut files = RunFiles::choose(args, &file_stem(&scenario), number)?;
    options.lockstep = args.lockstep;
    options.seconds = args.seconds;
    options.faults = args.faults.as_deref().map(plan).transpose()?;
    options.record = files.recorder_file().map(Path::to_owned);
    options.recorder.exact = args.record_exact;
    options.play = args.play;
    options.network = network.clone();
    let address = |text: &String| reflect::address("--reflector", text);
    options.reflector = args.reflector.as_ref().map(address).transpose()?;
    options.consoles = args.consoles.clone();
    options.begin = network.station().map_or(options.begin, |station| station.now());
    options.resume = resumed(app, args, number)?;
    if options.resume.as_ref().is_some_and(Resumed::is_too_coarse) {
        tracing::warn!(
            "threads and needles may not go on from this recording; one of --record-exact has all that they need"
        );
    }
    options.seed = options.resume.as_ref().map_or(options.seed, Resumed::seed);

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
    let first = first_scene(app, &scenario, network, options.resume.as_ref())?;
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
    let wish = zenoh::Wish {
        text: args.zenoh.as_deref(),
        scenario: &scenario,
        first: &first,
        network,
        is_silent: args.json,
    };
    let mut beyond = zenoh::Beyond::open(&wish)?;
    let mut photographer = Photographer::repeated(&args.pictures, number, Some(scenario.folder()), &first)?;
    startup.stage(&startup::first_step(&first));
    let mut startup = Some(startup);
    let mut stage = String::new();
    let mut misplaced = None;
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
        if misplaced.is_none() {
            misplaced = files.begun().err();
        }
        tuning_service.serve(progress.session);
        if let Some(beyond) = &mut beyond {
            beyond.serve(progress);
        }
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
    let beyond = beyond.map_or(Ok(()), zenoh::Beyond::close);
    let mut outcome = outcome?;
    beyond?;
    if misplaced.is_none() {
        misplaced = files.begun().err();
    }
    if let Some(by) = outcome.summary.cut_off_by.as_mut().filter(|by| *by == BY_THE_PROGRAM) {
        let signal = signals::catch()?.arrived().map(|(name, _)| name);
        *by = signal.or(host.is_some().then_some(BY_THE_WINDOW)).unwrap_or(BY_THE_PROGRAM).to_owned();
    }
    let mut lost: Vec<String> = recording_loss(&files, misplaced, &mut outcome.summary).into_iter().collect();
    outcome.summary.losses.extend(lost.iter().cloned());
    if let Some(photographer) = photographer {
        lost.extend(photographer.finish(&outcome.kernel.snapshot, &mut outcome.summary));
    }
    outcome.summary.tuned = tuning_service.tuned(&outcome.kernel.snapshot);
    if let Some(host) = host {
        host.ended(outcome.kernel.snapshot.clone());
    }

    if let Some(claim) = files.take_report() {
        let file = claim.file().display().to_string();
        outcome.summary.report = Some(file);
        let html = html(&scenario, &outcome, force_limits(&outcome));
        if let Err(error) = claim.write(html.as_bytes()) {
            outcome.summary.report = None;
            outcome.summary.losses.push(format!("no report: {error}"));
            lost.push(format!("no report: {error}"));
        }
    }
    let exit = judged(&mut outcome, &lost)?;
    if !args.json {
        let note = files.note().map_or_else(String::new, |note| format!("\n{note}"));
        let text = format!("{}{note}", text(&outcome.summary));
        for loss in outcome.summary.losses.iter().filter(|loss| !known.contains(loss)) {
            tracing::warn!("{}", printable(loss));
        }
        if stdout_is_taken {
            output::tell(&text);
        } else if let Err(failure) = output::print_text(&text) {
            // The result still comes out, on the terminal.
            output::tell(&text);
            if exit == Exit::Ok {
                return Err(failure);
            }
        }
    }
    Ok((outcome.summary, exit))
}

/// Why the recording is not whole on its disk, if it is not, with its own name in the summary. One with declared gaps is
/// whole: it says itself what it holds.
fn recording_loss(
    files: &RunFiles,
    misplaced: Option<OutputError>,
    summary: &mut RunSummary,
) -> Option<String> {
    let file = files.recording()?;
    if let Some(error) = misplaced {
        (summary.recording, summary.recording_complete) = (None, false);
        return Some(format!("no recording: {error}"));
    }
    summary.recording = Some(file.display().to_string());
    // The run knew it by the name of a part of it, if an earlier one was overwritten.
    summary.recording_bytes = file.metadata().ok().filter(std::fs::Metadata::is_file).map(|file| file.len());
    if summary.recording_complete {
        return None;
    }
    if output_file::is_stream(file) {
        return Some(format!("{}: did not take all of the recording", file.display()));
    }
    match Recording::open(file) {
        Ok(recording) => recording.truncation().map(|what| {
            let whole = recording.duration().as_secs_f64();
            format!(
                "{}: the recording is cut short: {what}; its first {whole:.2} s are whole",
                file.display()
            )
        }),
        Err(error) => Some(error.to_string()),
    }
}

/// The exit code of a run, with its reason in the summary: the session's own failure comes before a signal, and that before
/// results that were lost.
fn judged(outcome: &mut RunOutcome, lost: &[String]) -> Result<Exit, Failure> {
    let own = outcome.exit();
    let cut_off_by = outcome.summary.cut_off_by.as_deref();
    let signal = signals::catch()?.arrived().filter(|_| cut_off_by.is_some());
    let (exit, reason) = match (own, signal) {
        (Exit::Internal, _) => (own, None),
        (_, Some((name, exit))) => (exit, Some(format!("{name} ended the run before its time"))),
        (Exit::Ok, None) if !lost.is_empty() => (Exit::Invalid, Some(lost.join("; "))),
        (Exit::Ok, None) => (own, None),
        (_, None) if !outcome.failed_expectations.is_empty() => {
            (own, Some(format!("expectation failed: {}", outcome.failed_expectations.join("; "))))
        }
        (_, None) => (own, cut_off_by.map(|by| format!("{by} ended the run before the exercise was over"))),
    };
    if outcome.summary.error.is_none() {
        outcome.summary.error = reason;
    }
    Ok(exit)
}

/// What a session that has begun still waits for: computed inverses, and the first picture in a window.
fn unready(scene: &Snapshot, host: Option<&SessionHost>) -> Option<String> {
    let inverses = waiting(scene)
        .map(|(body, share)| format!("the inverse of {} ({:.0} %)", printable(body), 100.0 * share));
    let picture = host.is_some_and(SessionHost::awaits_picture).then(|| "the window".to_owned());
    inverses.chain(picture).next()
}

/// Options that every command with a session shares; a signal ends the session in good order.
pub fn options(args: &SessionArgs) -> Result<RunOptions, Failure> {
    Ok(RunOptions {
        seed: args.seed,
        hands: args.hands.clone(),
        skill: args.skill.clone(),
        left_handed: args.left_handed,
        stop: signals::catch()?.stop().clone(),
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
