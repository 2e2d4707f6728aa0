//! The command line of `trocar`, and of every program that has controllers of its own.
//!
//! ```no_run
//! use trocar::prelude::*;
//! use trocar_cli::CommandLine;
//!
//! fn main() -> std::process::ExitCode {
//!     App::new().run() // with `.component::<T>()` and `.controller::<C>("name")` in between
//! }
//! ```
//!
//! Data goes to stdout, logs and progress to stderr. With `--json` stdout holds exactly one object, also on
//! failure.

mod args;
mod bench;
mod doctor;
mod escape;
mod failure;
mod faults;
mod gallery;
mod graph;
mod host;
mod join;
mod list;
mod live_table;
mod mesh;
mod new;
mod output;
mod pictures;
mod recording;
mod reflect;
mod relay;
mod replay;
mod report;
mod run;
mod run_files;
mod run_text;
mod show;
mod signals;
mod soak;
mod startup;
mod tune;
mod window;
mod zenoh;

pub use bench::counting::CountingAllocator;

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use args::{Cli, Command, SchemaOf};
use clap::FromArgMatches;
use failure::Failure;
use trocar::app::App;
use trocar::summary::{Exit, SCHEMA};
use trocar_scene::confined_path::Assets;

/// The whole command line, every command with its options, for tests of the documentation.
pub fn command_line() -> clap::Command {
    args::command()
}

/// Gives an application the whole command line: every command of `trocar`, with its own components and
/// controllers among them.
pub trait CommandLine {
    /// Runs the command in the arguments of the process.
    fn run(self) -> ExitCode;
}

impl CommandLine for App {
    fn run(self) -> ExitCode {
        // Help and completions use the name by which the program was called.
        let name = std::env::args_os().next().map(PathBuf::from);
        let name =
            name.as_deref().and_then(Path::file_stem).and_then(|stem| stem.to_str()).unwrap_or("trocar");
        let mut command = args::command().name(name.to_owned()).bin_name(name.to_owned());
        let parsed = command.try_get_matches_from_mut(std::env::args_os());
        let cli = match parsed.and_then(|matches| Cli::from_arg_matches(&matches)) {
            Ok(cli) => cli,
            Err(error) => return usage(&error),
        };
        start_log(cli.verbose);
        let done = Assets::new(cli.command.assets())
            .map_err(|error| Failure::usage(format!("--assets: {error}")))
            .and_then(|assets| dispatch(&zenoh::with_devices(self.assets(assets)), cli.command, command));
        match done {
            Ok(exit) => ExitCode::from(exit.code()),
            Err(failure) => {
                say(&failure.message);
                ExitCode::from(failure.exit.code())
            }
        }
    }
}

fn dispatch(app: &App, command: Command, mut line: clap::Command) -> Result<Exit, Failure> {
    match command {
        Command::Run(args) => run::run(app, &args),
        Command::Host(args) => host::host(app, &args),
        Command::Join(args) => join::join(app, &args),
        Command::Watch(args) => join::watch(app, &args),
        Command::List(args) => list::list(app, &args),
        Command::Replay(args) => replay::replay(app, &args),
        Command::Recording { command } => recording::recording(app, &command),
        Command::Graph(args) => graph::graph(app, &args),
        Command::Bench(args) => bench::bench(&args),
        Command::Tune(args) => tune::tune(&args),
        Command::Faults { command } => faults::faults(&command),
        Command::Mesh(args) => mesh::mesh(app, &args),
        Command::Gallery(args) => gallery::gallery(app, &args),
        Command::Soak(args) => soak::run(app, &args),
        Command::Reflect(args) => reflect::reflect(&args),
        Command::Relay(args) => relay::relay(&args),
        Command::Zenoh(args) => zenoh::command(&args),
        Command::New(args) => new::new(&args),
        Command::Doctor(args) => doctor::doctor(&args),
        Command::Schema(args) => {
            let schema = match args.of {
                SchemaOf::Scenario => trocar_scene::scenario::json_schema(app.registry()),
                SchemaOf::Run => trocar::summary::run_schema(),
                SchemaOf::Bench => trocar::summary::bench_schema(),
            };
            output::print_json(&schema)?;
            Ok(Exit::Ok)
        }
        Command::Completions { shell } => {
            let mut script = Vec::new();
            let name = line.get_name().to_owned();
            clap_complete::generate(shell, &mut line, name, &mut script);
            output::print_text(&String::from_utf8_lossy(&script))?;
            Ok(Exit::Ok)
        }
    }
}

/// The exit for a command line that does not parse; help and version are no failures.
fn usage(error: &clap::Error) -> ExitCode {
    let failed = error.use_stderr();
    if failed && std::env::args().any(|argument| argument == "--json") {
        let message = error.to_string();
        let line = message.lines().next().unwrap_or_default().trim_start_matches("error: ");
        let object = serde_json::json!({ "schema": SCHEMA, "error": line });
        if let Err(failure) = output::print_json(&object) {
            say(&failure.message);
        }
    }
    // Printing fails only when the terminal or pipe is closed.
    let _ = error.print();
    ExitCode::from(if failed { Exit::Usage.code() } else { Exit::Ok.code() })
}

/// An error message for people.
fn say(message: &str) {
    let message: Vec<String> = message.lines().map(escape::printable).collect();
    output::tell(&format!("{} {}", console::style("error:").for_stderr().red().bold(), message.join("\n")));
}

fn start_log(verbose: u8) {
    use tracing_subscriber::EnvFilter;
    let level = match verbose {
        0 => "warn",
        1 => "info",
        2 => "debug",
        _ => "trace",
    };
    // Warnings of the window library (a display without a size in millimetres) are useless to users.
    let usual = || EnvFilter::new(format!("{level},winit=error"));
    let filter = EnvFilter::try_from_env("TROCAR_LOG").unwrap_or_else(|_| usual());
    tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_writer(std::io::stderr)
        .with_ansi(console::colors_enabled_stderr())
        .with_target(false)
        // It would tell on stderr, and panic, that stderr cannot be written.
        .log_internal_errors(false)
        .init();
}
