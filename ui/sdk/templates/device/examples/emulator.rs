//! An emulated stylus to try the program with: `cargo run --release --example emulator`, ended with Ctrl-C.

use template_device::emulator::Emulator;

fn main() -> std::io::Result<()> {
    let emulator = Emulator::start("127.0.0.1:7700")?;
    println!("a stylus is at {}", emulator.address());
    loop {
        std::thread::sleep(std::time::Duration::from_secs(1));
        println!("largest force so far: {:.2} N", emulator.force_max());
    }
}
