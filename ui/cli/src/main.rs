//! The program `trocar`: runs scenarios, lists, replays, draws, measures and looks at the machine.
//!
//! Data goes to stdout, logs and progress to stderr. With `--json` stdout holds exactly one object, also on
//! failure.

mod args;
mod bench;
mod doctor;
mod escape;
mod failure;
mod graph;
mod list;
mod live_table;
mod output;
mod replay;
mod report;
mod run;

use std::process::ExitCode;

use args::{Cli, Command, SchemaOf};
use clap::{CommandFactory, Parser};
use failure::Failure;
use trocar::app::App;
use trocar::summary::{Exit, SCHEMA};

fn main() -> ExitCode {
    let cli = match Cli::try_parse() {
        Ok(cli) => cli,
        Err(error) => return usage(&error),
    };
    start_log(cli.verbose);
    match dispatch(cli.command) {
        Ok(exit) => ExitCode::from(exit.code()),
        Err(failure) => {
            say(&failure.message);
            ExitCode::from(failure.exit.code())
        }
    }
}

fn dispatch(command: Command) -> Result<Exit, Failure> {
    match command {
        Command::Run(args) => run::run(&args),
        Command::List(args) => list::list(&args),
        Command::Replay(args) => replay::replay(&args),
        Command::Graph(args) => graph::graph(&args),
        Command::Bench(args) => bench::bench(&args),
        Command::Doctor(args) => doctor::doctor(&args),
        Command::Schema(args) => {
            let schema = match args.of {
                SchemaOf::Scenario => trocar_scene::scenario::json_schema(App::standard()?.registry()),
                SchemaOf::Run => trocar::summary::run_schema(),
                SchemaOf::Bench => trocar::summary::bench_schema(),
            };
            output::print_json(&schema)?;
            Ok(Exit::Ok)
        }
        Command::Completions { shell } => {
            let mut script = Vec::new();
            clap_complete::generate(shell, &mut Cli::command(), "trocar", &mut script);
            output::print_text(&String::from_utf8_lossy(&script))?;
            Ok(Exit::Ok)
        }
    }
}

/// A command line that does not parse; help and version are no failures.
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
    // Printing fails only when nobody listens.
    let _ = error.print();
    ExitCode::from(if failed { Exit::Usage.code() } else { Exit::Ok.code() })
}

/// An error message for people.
fn say(message: &str) {
    let message: Vec<String> = message.lines().map(escape::printable).collect();
    eprintln!("{} {}", console::style("error:").for_stderr().red().bold(), message.join("\n"));
}

fn start_log(verbose: u8) {
    use tracing_subscriber::EnvFilter;
    let level = match verbose {
        0 => "warn",
        1 => "info",
        2 => "debug",
        _ => "trace",
    };
    let filter = EnvFilter::try_from_env("TROCAR_LOG").unwrap_or_else(|_| EnvFilter::new(level));
    tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_writer(std::io::stderr)
        .with_ansi(console::colors_enabled_stderr())
        .with_target(false)
        .init();
}
