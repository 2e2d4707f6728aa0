//! The program `trocar`: the command line with Trocar's own components and controllers.

use std::process::ExitCode;

use trocar::app::App;
use trocar_cli::{CommandLine, CountingAllocator};

#[global_allocator]
static ALLOCATOR: CountingAllocator = CountingAllocator;

fn main() -> ExitCode {
    App::new().run()
}
