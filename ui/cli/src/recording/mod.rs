//! `trocar recording`: what a recording holds, for people and for other programs.

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

/// Runs a command.
pub fn recording(command: &RecordingCommand) -> Result<Exit, Failure> {
    match command {
        RecordingCommand::Stats(args) => stats::stats(args),
    }
}
