//! `trocar replay`: plays back what a recording stores, and checks it by its hashes.

use std::collections::BTreeMap;
use std::time::Instant;

use indicatif::{ProgressBar, ProgressStyle};
use trocar::app::App;
use trocar::run::task_summary;
use trocar::summary::{Exit, Mode, RunSummary, TaskErrorSummary};
use trocar::trace::RunTrace;
use trocar_kernel::recorder::{Recording, RecordingError, Replay};
use trocar_scene::output_file::Claim;
use trocar_scene::{CollisionList, DeviceState, SimTime};
use trocar_viewer::window::subject::{Mark, Note};

use crate::args::ReplayArgs;
use crate::failure::Failure;
use crate::output::{self, in_words};
use crate::pictures::Photographer;
use crate::report::{self, Report};
use crate::run_text;
use crate::signals;
use crate::startup::Startup;
use crate::window::{self, Findings};

/// Interval between two samples of the trace.
const SAMPLE_EVERY: SimTime = SimTime::from_millis(10);

/// Plays a recording back.
pub fn replay(app: &App, args: &ReplayArgs) -> Result<Exit, Failure> {
    let by_default = !(args.json || args.pictures.are_asked_for() || args.report.is_some());
    let Some(windows) = window::connect(&args.window, by_default)? else {
        if args.beside.is_some() {
            return Err(Failure::usage("--beside needs a window, and there is none here"));
        }
        return check(app, args, &|_| {});
    };
    let files = std::iter::once(&args.file).chain(&args.beside);
    let recordings: Result<Vec<_>, _> = files.map(|file| Recording::open(file)).collect();
    let recordings = recordings.map_err(Failure::invalid)?;
    window::with_recordings(app, windows, &args.pictures, args.folder.as_deref(), &recordings, |found| {
        // While the window plays the recording, it is also replayed at full speed and checked.
        check(app, args, &|findings| drop(found.send(findings)))
    })
}

/// Plays a recording from start to end, or until a signal arrives, checks it, and returns the result.
fn check(app: &App, args: &ReplayArgs, tell: &dyn Fn(Findings)) -> Result<Exit, Failure> {
    let mut summary = RunSummary::new("", Mode::Replay, 0);
    summary.recording = Some(args.file.display().to_string());
    let named = [&args.report, &args.pictures.picture].map(|file| file.as_deref());
    let stdout_is_taken = output::takes_stdout(args.json, named);
    let result = match &stdout_is_taken {
        Ok(_) => attempt(app, args, &mut summary),
        Err(failure) => Err(Failure { exit: failure.exit, message: failure.message.clone() }),
    };
    tell(findings(&summary, &result));
    // Of a recording that is cut short, or does not replay, or whose report cannot be written, what is whole is told all
    // the same.
    let is_played = summary.stored_hash.is_some();
    let printed = if args.json {
        summary.error = result.as_ref().err().map(|failure| failure.message.clone());
        output::print_json(&summary)
    } else if is_played {
        for loss in &summary.losses {
            tracing::warn!("{loss}");
        }
        let text = run_text::text(&summary);
        match stdout_is_taken {
            Ok(false) => output::print_text(&text),
            _ => {
                output::tell(&text);
                Ok(())
            }
        }
    } else {
        Ok(())
    };
    // The replay's own failure comes first.
    result.and_then(|exit| printed.map(|()| exit))
}

/// Marks for the timeline of a recording, and a note for people.
fn findings(summary: &RunSummary, result: &Result<Exit, Failure>) -> Findings {
    let error = |error: &TaskErrorSummary| Mark {
        time: SimTime::from_secs_f64(error.at_secs),
        what: in_words(&error.kind),
        bad: true,
    };
    let note = match result {
        Ok(_) => Note { text: "the recording replays to its own hashes".to_owned(), bad: false },
        Err(failure) => Note { text: failure.message.clone(), bad: true },
    };
    Findings { marks: summary.task.errors.iter().map(error).collect(), note }
}

/// How much of the recording has been replayed, where stderr is a terminal.
fn progress_bar(recording: &Recording, silent: bool) -> ProgressBar {
    if silent {
        return ProgressBar::hidden();
    }
    let bar = ProgressBar::new(recording.duration().as_nanos());
    let style = ProgressStyle::with_template("{spinner} {bar:32} {percent} % of the recording  {elapsed}");
    bar.set_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()));
    bar
}

fn attempt(app: &App, args: &ReplayArgs, summary: &mut RunSummary) -> Result<Exit, Failure> {
    let signals = signals::catch()?;
    let replace = output::replace(args.pictures.force);
    let report = args.report.as_deref().map(|file| Claim::take(file, replace)).transpose()?;
    let begun = Instant::now();
    let startup = Startup::new(&args.file.display().to_string(), "reading the recording", args.json);
    let recording = Recording::open(&args.file).map_err(Failure::invalid)?;
    summary.scenario = recording.metadata().scenario.clone();
    summary.seed = recording.metadata().seed;
    let mut trace = RunTrace::new();
    let mut replay = Replay::new(&recording, app.registry()).map_err(Failure::invalid)?;
    let mut photographer = Photographer::new(&args.pictures, args.folder.as_deref(), replay.view())?;
    drop(startup);
    let bar = progress_bar(&recording, args.json);
    let mut next = SimTime::ZERO;
    let mut force_newtons_max = 0.0_f64;
    let diverged = loop {
        if let Some((name, exit)) = signals.arrived() {
            bar.finish_and_clear();
            let at = replay.time().as_secs_f64();
            return Err(Failure { exit, message: format!("{name} ended the replay at {at:.2} s") });
        }
        match replay.step() {
            Ok(Some(time)) => {
                if time >= next {
                    trace.sample(replay.view());
                    bar.set_position(time.as_nanos());
                    next = time + SAMPLE_EVERY;
                }
                if let Some(photographer) = &mut photographer {
                    photographer.look(replay.view(), time);
                }
                let forces = replay.view().iter::<DeviceState>().map(|(_, state)| state.applied_force.norm());
                force_newtons_max = forces.fold(force_newtons_max, f64::max);
            }
            Ok(None) => break None,
            Err(error @ RecordingError::Diverged { .. }) => break Some(error),
            Err(error) => return Err(Failure::invalid(error)),
        }
    };
    bar.finish_and_clear();
    trace.sample(replay.view());
    let mut lost =
        photographer.map_or_else(Vec::new, |photographer| photographer.finish(replay.view(), summary));
    summary.sim_secs = replay.time().as_secs_f64();
    summary.stored_hash = Some(replay.hash().to_string());
    summary.state_hash = Some(replay.state_hash().to_string());
    summary.task = task_summary(replay.view());
    summary.force_newtons_max = force_newtons_max;
    summary.penetration_max =
        replay.view().iter::<CollisionList>().map(|(_, list)| list.penetration_max).fold(0.0, f64::max);
    summary.recording_complete = recording.is_complete();
    summary.wall_secs = begun.elapsed().as_secs_f64();

    let mut failures: Vec<String> = replay
        .gaps()
        .iter()
        .map(|gap| format!("the recording has a gap at {:.3} s", gap.time.as_secs_f64()))
        .collect();
    failures.extend(replay.damage().iter().map(|what| format!("the recording is damaged {what}")));
    failures.extend(recording.truncation().map(|what| {
        format!("the recording is cut short: {what}; its first {:.2} s are whole", summary.sim_secs)
    }));
    failures.extend(diverged.map(|error| error.to_string()));
    if let Some(end) = recording.end()
        && end.complete
        && Some(&end.hash) != summary.stored_hash.as_ref()
    {
        failures.push(format!("the replay ends in another hash; recorded was {}", end.hash));
    }
    if let Some(claim) = report {
        summary.report = Some(claim.file().display().to_string());
        let html = report::html(&Report {
            title: &format!("Replay of {}", summary.scenario),
            summary,
            trace: &trace,
            lateness: &[],
            health: &[],
            incidents: &[],
            failures: &failures,
            force_limits: &BTreeMap::new(),
        });
        if let Err(error) = claim.write(html.as_bytes()) {
            summary.report = None;
            summary.losses.push(format!("no report: {error}"));
            lost.push(format!("no report: {error}"));
        }
    }
    let exit = match (failures.is_empty(), lost.is_empty()) {
        (true, true) => return Ok(Exit::Ok),
        (true, false) => Exit::Invalid,
        (false, _) => Exit::Failed,
    };
    failures.extend(lost);
    Err(Failure { exit, message: failures.join("; ") })
}
