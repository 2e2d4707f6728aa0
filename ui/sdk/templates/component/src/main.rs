//! The program: every command of `trocar`, with this crate's components in it.
//!
//! ```sh
//! cargo run --release -- list components                # says what `bleeding` is
//! cargo run --release -- schema scenario                # for an editor that completes scenario files
//! cargo run --release -- run scenario.toml --lockstep --seconds 30
//! ```

use trocar_cli::CommandLine;

fn main() -> std::process::ExitCode {
    template_component::app().run()
}
