//! The program: every command of `trocar`, with this crate's device for its hands.
//!
//! ```sh
//! cargo run --release --example emulator &              # or plug in the real one
//! cargo run --release -- run wall --hand right=stylus:127.0.0.1:7700
//! cargo run --release -- list devices
//! ```

use trocar_cli::CommandLine;

fn main() -> std::process::ExitCode {
    template_device::app().run()
}
