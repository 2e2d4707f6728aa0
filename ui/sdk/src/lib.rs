//! # Trocar
//!
//! A framework for surgical simulation in which devices, physics and people are actors around one shared scene: **one
//! Model, many actors, no blocking.** Programs depend on this crate.
//!
//! ```text
//!  hand ─▶ driver thread ─▶ haptics ──┐ batches                           ┌─▶ every controller, at its own rate
//!             ▲  force          engine ─┼────────▶ [ Model ] ── snapshots ──┼─▶ recorder
//!             └─────────────────┘ yours ─┤                                  └─▶ viewers, consoles, your actors
//!                            autopilot ──┘
//! ```
//!
//! A new behaviour is one struct and one trait. This is a complete one:
//!
//! ```
//! use trocar::prelude::*;
//!
//! /// How often an instrument was faster than is gentle.
//! #[derive(Clone, Serialize, Deserialize, Component)]
//! #[component(name = "haste")]
//! struct Haste(u32);
//!
//! /// Counts the hasty ticks of every instrument.
//! struct Watcher;
//! impl Controller for Watcher {
//!     fn access(&self) -> Access {
//!         Access::new().reads::<InstrumentTarget>().writes::<Haste>(EntitySet::All)
//!     }
//!     fn tick(&mut self, _: &Tick, scene: &Snapshot, out: &mut Commands) -> Result<(), ControllerError> {
//!         for (tool, target) in scene.iter::<InstrumentTarget>() {
//!             if target.velocity_in_world.linear.norm() > 0.02 {
//!                 out.put(tool, Haste(scene.get::<Haste>(tool).map_or(1, |haste| haste.0 + 1)));
//!             }
//!         }
//!         Ok(())
//!     }
//! }
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let app = App::new().component::<Haste>().controller_with("watcher", |(): &(), _| Ok(Watcher));
//! let app = app.joins("watcher", 100.0);
//!
//! // Two virtual trainees for five seconds, in virtual time: the same bits on every machine.
//! let scenario = app.scenario("peg-transfer")?;
//! let options = RunOptions { lockstep: true, seconds: Some(5.0), ..RunOptions::default() };
//! let outcome = run(&app, &scenario, &options, &mut |_| {})?;
//!
//! let hasty: u32 = outcome.kernel.snapshot.iter::<Haste>().map(|(_, haste)| haste.0).sum();
//! assert!(hasty > 0);
//! # Ok(())
//! # }
//! ```
//!
//! With the crate `trocar-cli` the same `app` becomes a program with every command of `trocar`:
//! `trocar_cli::CommandLine::run(app)`.
//!
//! # Where to go from here
//!
//! * **The [guide]**, chapter by chapter: [concepts](guide::concepts), a [first behaviour](guide::first_behaviour),
//!   [components](guide::components), [scenarios](guide::scenarios), [devices](guide::devices),
//!   [actors](guide::actors), [foreign engines](guide::engines), [supervision and faults](guide::supervision),
//!   [sessions in a program](guide::sessions), [recording and replay](guide::recording),
//!   [testing in lock-step](guide::testing), [performance](guide::performance).
//! * **A project to copy**: `trocar new my-sim --template controller` ([`templates`] names the others).
//! * **The types**: [`prelude`] has what most programs need; [`scene`] the scene's data and the contract of
//!   controllers; [`kernel`] the Model, supervision, faults, recording; [`devices`] the contract of drivers.
//!
//! # Conventions
//!
//! SI units everywhere; angles in radians; time is [`SimTime`](scene::SimTime), in seconds in files. Names state their
//! frames: `tip_in_world`, `world_from_device`. No score is clinically validated.

/// The manual's programs that are not in any example, compiled and run as tests.
#[cfg(doctest)]
#[doc = include_str!("../../../docs/adding.md")]
mod manual {}

pub mod app;
pub mod assembly;
pub mod branching;
pub mod decimate;
pub mod device_kinds;
mod error;
pub mod graph;
pub mod guide;
pub mod hands;
mod kind;
mod kinds;
pub mod network;
pub mod open;
mod options;
pub mod outline;
pub mod plans;
pub mod play;
pub mod prelude;
pub mod recorded_hand;
pub mod run;
pub mod session;
pub mod soak;
pub mod summary;
pub mod templates;
pub mod trace;
pub mod tuning;
pub mod watch;

/// The scene's data and the contract of controllers: all of `trocar-scene`.
pub mod scene {
    /// The derive that finds the scene here, for programs that depend on this crate alone.
    #[doc(no_inline)]
    pub use trocar_scene::ComponentOfTrocar as Component;
    #[doc(no_inline)]
    pub use trocar_scene::*;
}

/// What exercises share: motion metrics, scores, and the judgement of a scene by its measurements.
pub mod tasks {
    #[doc(no_inline)]
    pub use trocar_tasks::motion_metrics::{IDLE_SPEED_DEFAULT, MotionMetrics};
    #[doc(no_inline)]
    pub use trocar_tasks::*;
}

pub use nalgebra;
#[doc(no_inline)]
pub use trocar_devices as devices;
#[doc(no_inline)]
pub use trocar_kernel as kernel;
