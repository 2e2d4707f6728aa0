//! `trocar faults verify`: what a session survives, shown by doing it.

mod hostile;
mod live;
mod lockstep;
mod process;

use std::path::Path;

use indicatif::{ProgressBar, ProgressStyle};
use trocar::summary::{BenchResult, BenchSummary, Exit};

use crate::args::{FaultsCommand, VerifyArgs};
use crate::bench;
use crate::doctor::machine;
use crate::failure::Failure;
use crate::output;

/// Does what is asked about faults.
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

fn measure(args: &VerifyArgs) -> Result<Vec<BenchResult>, Failure> {
    let folder = tempfile::tempdir().map_err(Failure::internal)?;
    let bar = ProgressBar::new_spinner();
    let style = ProgressStyle::with_template("{spinner} {pos} rows  {msg}  {elapsed}");
    bar.set_style(style.unwrap_or_else(|_| ProgressStyle::default_spinner()));
    bar.enable_steady_tick(std::time::Duration::from_millis(200));
    let rows = parts(args, folder.path(), &mut |name| {
        bar.set_message(name.to_owned());
        bar.inc(1);
    });
    bar.finish_and_clear();
    rows
}

fn parts(args: &VerifyArgs, folder: &Path, tell: &mut dyn FnMut(&str)) -> Result<Vec<BenchResult>, Failure> {
    let both = args.live == args.lockstep;
    let mut rows = Vec::new();
    if both || args.lockstep {
        rows.extend(lockstep::rows(folder, tell)?);
    }
    if both || args.live {
        rows.extend(live::rows(tell)?);
        rows.extend(process::rows(folder, tell)?);
    }
    Ok(rows)
}
