//! `trocar recording`: what a recording holds, for people and for other programs.

mod export;
mod recover;
mod stats;

use std::path::PathBuf;

use clap::{Args, Subcommand, ValueEnum, ValueHint};
use trocar::app::App;
use trocar::summary::Exit;

use crate::failure::Failure;

/// What to do with a recording.
#[derive(Debug, Subcommand)]
pub enum RecordingCommand {
    /// What its bytes are spent on: by component, writer, rate and framing, before and after
    Stats(StatsArgs),
    /// Write what is whole of a cut or damaged recording into a new file
    Recover(RecoverArgs),
    /// Its values as tables, for spreadsheets and programs: one for each component, one with the events
    Export(ExportArgs),
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

/// What to write.
#[derive(Debug, Args)]
pub struct ExportArgs {
    /// The recording
    #[arg(value_hint = ValueHint::FilePath)]
    pub file: PathBuf,
    /// Folder of the tables; by default beside the recording, with its name and the ending .tables
    #[arg(long, value_name = "DIR", value_hint = ValueHint::DirPath)]
    pub out: Option<PathBuf>,
    /// Format of the tables
    #[arg(long, value_enum, default_value_t = TableFormat::Csv)]
    pub format: TableFormat,
    /// A component, or `events`, or `gaps`; may be given several times. By default those that tell what the hands, the
    /// instruments and the exercise did
    #[arg(long = "component", value_name = "NAME")]
    pub components: Vec<String>,
    /// Only values of this entity; may be given several times
    #[arg(long = "entity", value_name = "NAME")]
    pub entities: Vec<String>,
    /// Replace tables of an earlier export
    #[arg(long)]
    pub force: bool,
    /// One JSON object on stdout
    #[arg(long)]
    pub json: bool,
}

/// A format of tables.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum TableFormat {
    /// Comma-separated values, as text
    Csv,
    /// Apache Parquet, compressed with Snappy
    Parquet,
}

/// Runs a command.
pub fn recording(app: &App, command: &RecordingCommand) -> Result<Exit, Failure> {
    match command {
        RecordingCommand::Stats(args) => stats::stats(args),
        RecordingCommand::Recover(args) => recover::recover(args),
        RecordingCommand::Export(args) => export::export(app, args),
    }
}
