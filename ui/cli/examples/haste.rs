//! A program of one's own: a new component and a new behaviour, and the whole command line of `trocar` with them.
//!
//! `cargo run --release --example haste -- run peg-transfer`

use trocar::prelude::*;
use trocar_cli::CommandLine;

/// How often an instrument was faster than is gentle.
#[derive(Clone, Serialize, Deserialize, Component)]
#[component(name = "haste")]
struct Haste(u32);

/// Counts the hasty ticks of every instrument.
struct Watcher;
impl Controller for Watcher {
    fn access(&self) -> Access {
        Access::new().reads::<InstrumentTarget>().writes::<Haste>(EntitySet::All)
    }
    fn tick(&mut self, _: &Tick, scene: &Snapshot, out: &mut Commands) -> Result<(), ControllerError> {
        for (tool, target) in scene.iter::<InstrumentTarget>() {
            if target.velocity_in_world.linear.norm() > 0.2 {
                out.put(tool, Haste(scene.get::<Haste>(tool).map_or(1, |haste| haste.0 + 1)));
            }
        }
        Ok(())
    }
}

fn main() -> std::process::ExitCode {
    let app = App::new().component::<Haste>().controller_with("watcher", |(): &(), _| Ok(Watcher));
    app.joins("watcher", 100.0).run()
}
