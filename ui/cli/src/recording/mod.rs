//! `trocar recording`: what a recording holds, for people and for other programs.

mod recover;
mod stats;

use std::path::PathBuf;

use clap::{Args, Subcommand, ValueHint};
use trocar::summary::Exit;

use crate::failure::Failure;

/// What to do with a recording.
#[derive(Debug, Subcommand)]
pub enum RecordingCommand {
    /// What its bytes are spent on: by component, writer, rate and framing, before and after
    Stats(StatsArgs),
    /// Write what is whole of a cut or damaged recording into a new file
    Recover(RecoverArgs),
}

/// What to count.
#[derive(Debug, Args)]
pub struct StatsArgs {
    /// The recording
    #[arg(value_hint = ValueHint::FilePath)]
    pub file: PathBuf,
    /// One JSON object on stdout
    #[arg(long)]
    pub json: bool,
}

/// What to recover.
#[derive(Debug, Args)]
pub struct RecoverArgs {
    /// The recording
    #[arg(value_hint = ValueHint::FilePath)]
    pub file: PathBuf,
    /// The new file [default: FILE-recovered.mcap]
    #[arg(long, value_name = "FILE", value_hint = ValueHint::FilePath)]
    pub out: Option<PathBuf>,
    /// Replace a file of that name
    #[arg(long)]
    pub force: bool,
    /// One JSON object on stdout
    #[arg(long)]
    pub json: bool,
}

/// Runs a command.
pub fn recording(command: &RecordingCommand) -> Result<Exit, Failure> {
    match command {
        RecordingCommand::Stats(args) => stats::stats(args),
        RecordingCommand::Recover(args) => recover::recover(args),
    }
}
