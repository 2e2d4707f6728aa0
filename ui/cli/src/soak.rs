//! `trocar soak`: random fault plans on the exercise, on all cores, until one breaks something.

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError};
use std::thread;

use indicatif::{ProgressBar, ProgressStyle};
use serde_json::json;
use trocar::app::App;
use trocar::soak::{Soaked, soak};
use trocar::summary::{Exit, SCHEMA};

use crate::args::SoakArgs;
use crate::failure::Failure;
use crate::output;

/// Runs the plans that are asked for.
pub fn run(app: &App, args: &SoakArgs) -> Result<Exit, Failure> {
    let scenario = app.scenario(&args.scenario)?;
    let folder = tempfile::tempdir().map_err(Failure::internal)?;
    let bar = ProgressBar::new(args.plans);
    let style = ProgressStyle::with_template("{bar:30} {pos} of {len} plans  {msg}  {elapsed}, {eta} left");
    bar.set_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()));
    let next = AtomicU64::new(0);
    let done: Mutex<Vec<Result<Soaked, Failure>>> = Mutex::new(Vec::new());
    let workers = thread::available_parallelism().map_or(1, usize::from);
    thread::scope(|scope| {
        for worker in 0..workers {
            let (next, done, bar, scenario) = (&next, &done, &bar, &scenario);
            let file = folder.path().join(format!("{worker}.mcap"));
            scope.spawn(move || {
                loop {
                    let number = next.fetch_add(1, Ordering::Relaxed);
                    if number >= args.plans {
                        break;
                    }
                    let seed = args.from.wrapping_add(number);
                    let soaked = soak(app, scenario, seed, args.seconds, &file).map_err(Failure::from);
                    let mut done = done.lock().unwrap_or_else(PoisonError::into_inner);
                    done.push(soaked);
                    let broken = |row: &&Result<Soaked, Failure>| {
                        row.as_ref().map_or(true, |soaked| !soaked.violations.is_empty())
                    };
                    bar.set_message(format!("{} broke something", done.iter().filter(broken).count()));
                    bar.inc(1);
                }
            });
        }
    });
    bar.finish_and_clear();
    let done = done.into_inner().unwrap_or_else(PoisonError::into_inner);
    let mut rows = done.into_iter().collect::<Result<Vec<Soaked>, Failure>>()?;
    rows.sort_by_key(|row| row.seed);
    report(args, &rows)
}

fn report(args: &SoakArgs, rows: &[Soaked]) -> Result<Exit, Failure> {
    let broken: Vec<&Soaked> = rows.iter().filter(|row| !row.violations.is_empty()).collect();
    let completed = rows.iter().filter(|row| row.completed).count();
    let seconds = args.seconds.map_or(String::new(), |seconds| format!(" --seconds {seconds}"));
    let again = |seed: u64| format!("trocar soak {} --plans 1 --from {seed}{seconds}", args.scenario);
    if args.json {
        let violations: Vec<_> = broken
            .iter()
            .map(|row| {
                json!({ "seed": row.seed, "faults": row.faults, "violations": row.violations,
                        "reproduce": again(row.seed) })
            })
            .collect();
        output::print_json(&json!({
            "schema": SCHEMA, "scenario": args.scenario, "plans": rows.len(), "completed": completed,
            "broken": violations, "error": null,
        }))?;
    } else {
        let mut lines = vec![format!(
            "{} random plans: {} broke something, {completed} exercises were completed",
            rows.len(),
            broken.len()
        )];
        for row in &broken {
            lines.push(format!("seed {}: {}", row.seed, row.violations.join("; ")));
            lines.push(format!("    {}", row.faults.join(", ")));
            lines.push(format!("    {}", again(row.seed)));
        }
        output::print_text(&lines.join("\n"))?;
    }
    Ok(if broken.is_empty() { Exit::Ok } else { Exit::Failed })
}
