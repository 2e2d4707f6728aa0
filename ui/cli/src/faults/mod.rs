//! `trocar faults verify`: injects every kind of fault and measures recovery.

mod disks;
mod flood;
mod forces;
mod hostile;
mod links;
mod live;
mod live_faults;
mod lockstep;
mod process;
mod stations;
mod zombie;

use indicatif::{ProgressBar, ProgressStyle};
use trocar::summary::{BenchResult, BenchSummary, Exit};

use crate::args::{FaultsCommand, VerifyArgs};
use crate::bench;
use crate::doctor::machine;
use crate::failure::Failure;
use crate::output;

/// Runs the command.
pub fn faults(command: &FaultsCommand) -> Result<Exit, Failure> {
    match command {
        FaultsCommand::Verify(args) => verify(args),
    }
}

fn verify(args: &VerifyArgs) -> Result<Exit, Failure> {
    let mut summary = BenchSummary::new(machine());
    let result = measure(args).map(|rows| summary.results = rows);
    if let Err(failure) = &result {
        summary.error = Some(failure.message.clone());
    }
    if args.json {
        output::print_json(&summary)?;
    } else if result.is_ok() {
        output::print_text(&bench::text(&summary))?;
    }
    result?;
    Ok(if summary.missed().next().is_none() { Exit::Ok } else { Exit::Failed })
}

/// The results of a measurement.
type Rows = Result<Vec<BenchResult>, Failure>;

/// The list of measurements.
pub struct Plan<'a>(Vec<Step<'a>>);

/// A name for people, and a measurement of one or more rows.
struct Step<'a> {
    name: String,
    measure: Box<dyn FnOnce(&str) -> Rows + 'a>,
}

impl<'a> Plan<'a> {
    /// Adds a measurement of one row.
    pub fn row(
        &mut self,
        name: impl Into<String>,
        measure: impl FnOnce(&str) -> Result<BenchResult, Failure> + 'a,
    ) {
        self.rows(name, |name| Ok(vec![measure(name)?]));
    }
    /// Adds a measurement of several rows.
    pub fn rows(&mut self, name: impl Into<String>, measure: impl FnOnce(&str) -> Rows + 'a) {
        self.0.push(Step { name: name.into(), measure: Box::new(measure) });
    }
}

fn measure(args: &VerifyArgs) -> Rows {
    let folder = tempfile::tempdir().map_err(Failure::internal)?;
    let mut plan = Plan(Vec::new());
    let both = args.live == args.lockstep;
    if both || args.lockstep {
        lockstep::plan(folder.path(), &mut plan);
        forces::lockstep(&mut plan);
        links::lockstep(&mut plan);
        stations::lockstep(&mut plan);
        disks::lockstep(folder.path(), &mut plan);
    }
    if both || args.live {
        live::plan(&mut plan);
        forces::live(&mut plan);
        live_faults::live(&mut plan);
        links::live(&mut plan);
        flood::live(&mut plan);
        disks::live(folder.path(), &mut plan);
        process::plan(folder.path(), &mut plan);
    }
    if let Some(text) = &args.only {
        let names: Vec<String> = plan.0.iter().map(|step| step.name.clone()).collect();
        plan.0.retain(|step| step.name.contains(text));
        if plan.0.is_empty() {
            let message = format!("no measurement has '{text}' in its name; there are: {}", names.join(", "));
            return Err(Failure::usage(message));
        }
    }
    let bar = ProgressBar::new(plan.0.len() as u64);
    let style = ProgressStyle::with_template("{bar:30} {pos} of {len}  {msg}  {elapsed}");
    bar.set_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()));
    bar.enable_steady_tick(std::time::Duration::from_millis(200));
    let mut rows = Vec::new();
    for Step { name, measure } in plan.0 {
        bar.set_message(name.clone());
        rows.extend(measure(&name)?);
        bar.inc(1);
    }
    bar.finish_and_clear();
    Ok(rows)
}
