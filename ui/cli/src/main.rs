//! The program `trocar`: what comes with the framework, on the command line.

use std::process::ExitCode;

use trocar::app::App;
use trocar_cli::{CommandLine, CountingAllocator};

#[global_allocator]
static ALLOCATOR: CountingAllocator = CountingAllocator;

fn main() -> ExitCode {
    App::new().run()
}
