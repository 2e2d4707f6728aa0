//! The program: every command of `trocar`, with a foreign engine in it.
//!
//! ```sh
//! cargo run --release -- run scenario.toml --lockstep --seconds 10
//! CHAIN_ENGINE=/opt/vendor/libchain.so cargo run --release -- run scenario.toml
//! ```

use std::process::ExitCode;

use template_engine::{app, library_file};
use trocar_cli::CommandLine;

fn main() -> ExitCode {
    match app(&library_file()) {
        Ok(app) => app.run(),
        Err(error) => {
            eprintln!("error: {error}");
            // The exit code for an invalid file, as for a scenario.
            ExitCode::from(4)
        }
    }
}
