//! The program: every command of `trocar`, with this crate's actor in each live session.
//!
//! ```sh
//! cargo run --release -- run peg-transfer               # the coach speaks on stderr
//! ```

use trocar_cli::CommandLine;

fn main() -> std::process::ExitCode {
    template_actor::app(template_actor::SPEED_MAX).run()
}
