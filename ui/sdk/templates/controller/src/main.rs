//! The program: every command of `trocar`, with this crate's components and controllers in it.
//!
//! ```sh
//! cargo run --release -- run scenario.toml              # live, until Ctrl-C
//! cargo run --release -- run scenario.toml --lockstep --seconds 30
//! cargo run --release -- graph scenario.toml            # who acts, and what flows between them
//! ```

use trocar_cli::CommandLine;

fn main() -> std::process::ExitCode {
    template_controller::app().run()
}
