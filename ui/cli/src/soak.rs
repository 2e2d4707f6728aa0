//! `trocar soak`: random fault plans on the exercise, on all cores, until one causes a violation.

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError};
use std::thread;

use indicatif::{ProgressBar, ProgressStyle};
use serde_json::json;
use trocar::app::App;
use trocar::soak::{SoakResult, soak};
use trocar::summary::{Exit, SCHEMA};

use crate::args::SoakArgs;
use crate::failure::Failure;
use crate::output;
use crate::signals;

/// Runs the requested plans.
pub fn run(app: &App, args: &SoakArgs) -> Result<Exit, Failure> {
    let signals = signals::catch()?;
    let scenario = app.scenario(&args.scenario)?;
    let folder = tempfile::tempdir().map_err(Failure::internal)?;
    let bar = ProgressBar::new(args.plans);
    let style = ProgressStyle::with_template("{bar:30} {pos} of {len} plans  {msg}  {elapsed}, {eta} left");
    bar.set_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()));
    let next = AtomicU64::new(0);
    let done: Mutex<Vec<SoakResult>> = Mutex::new(Vec::new());
    let workers = thread::available_parallelism().map_or(1, usize::from);
    thread::scope(|scope| {
        for worker in 0..workers {
            let (next, done, bar, scenario) = (&next, &done, &bar, &scenario);
            let file = folder.path().join(format!("{worker}.mcap"));
            scope.spawn(move || {
                loop {
                    let number = next.fetch_add(1, Ordering::Relaxed);
                    if number >= args.plans || signals.arrived().is_some() {
                        break;
                    }
                    let seed = args.from.wrapping_add(number);
                    let soaked = soak(app, scenario, seed, args.seconds, &file).unwrap_or_else(|error| {
                        // The results of the other plans are kept.
                        SoakResult {
                            seed,
                            faults: Vec::new(),
                            completed: false,
                            violations: vec![error.to_string()],
                        }
                    });
                    if is_broken(&soaked) {
                        let told = told(args, &soaked);
                        // Printed at once, so that the user can investigate during a long soak.
                        bar.suspend(|| output::tell(&told));
                    }
                    let mut done = done.lock().unwrap_or_else(PoisonError::into_inner);
                    done.push(soaked);
                    let broken = done.iter().filter(|row| is_broken(row)).count();
                    bar.set_message(format!("{broken} broke something"));
                    bar.inc(1);
                }
            });
        }
    });
    bar.finish_and_clear();
    let mut rows = done.into_inner().unwrap_or_else(PoisonError::into_inner);
    rows.sort_by_key(|row| row.seed);
    report(args, &rows, signals.arrived())
}

fn is_broken(row: &SoakResult) -> bool {
    !row.violations.is_empty()
}

/// The command that runs this plan alone.
fn again(args: &SoakArgs, seed: u64) -> String {
    let seconds = args.seconds.map_or(String::new(), |seconds| format!(" --seconds {seconds}"));
    format!("trocar soak {} --plans 1 --from {seed}{seconds}", args.scenario)
}

/// A plan's violations, in words.
fn told(args: &SoakArgs, row: &SoakResult) -> String {
    let SoakResult { seed, faults, violations, .. } = row;
    let again = again(args, *seed);
    format!("seed {seed}: {}\n    {}\n    {again}", violations.join("; "), faults.join(", "))
}

/// What came of the plans that were run: of all of them, or of those before a signal.
fn report(
    args: &SoakArgs,
    rows: &[SoakResult],
    signal: Option<(&'static str, Exit)>,
) -> Result<Exit, Failure> {
    let ended =
        signal.map(|(name, _)| format!("{name} ended the soak after {} of {} plans", rows.len(), args.plans));
    let broken: Vec<&SoakResult> = rows.iter().filter(|row| is_broken(row)).collect();
    let completed = rows.iter().filter(|row| row.completed).count();
    if args.json {
        let violations: Vec<_> = broken
            .iter()
            .map(|row| {
                json!({ "seed": row.seed, "faults": row.faults, "violations": row.violations,
                        "reproduce": again(args, row.seed) })
            })
            .collect();
        output::print_json(&json!({
            "schema": SCHEMA, "scenario": args.scenario, "plans": rows.len(), "completed": completed,
            "broken": violations, "error": ended,
        }))?;
    } else {
        let all = rows.len();
        let broke = broken.len();
        let mut lines = vec![format!(
            "{all} random plans: {broke} broke something, {completed} exercises were completed"
        )];
        lines.extend(ended);
        lines.extend(broken.iter().map(|row| told(args, row)));
        output::print_text(&lines.join("\n"))?;
    }
    Ok(match signal {
        Some((_, exit)) => exit,
        None if broken.is_empty() => Exit::Ok,
        None => Exit::Failed,
    })
}
