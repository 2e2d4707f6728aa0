//! Rapier as the physics-engine controller.
//!
//! [`RigidWorld`] is the plain algorithm: bodies, instruments, one [`step`](RigidWorld::step) at a time, no scene
//! and no clock. [`EngineController`] schedules it: it brings the world up to the time of each tick, from
//! what the scene says, and writes poses, forces, contacts and grasps back. Nothing else in Trocar knows
//! Rapier.
//!
//! | file | what it holds |
//! |---|---|
//! | `world.rs` | the world: bodies, steps, statistics |
//! | `grasper.rs`, `jaws.rs` | an instrument as palm, jaws, hinge and drive |
//! | `coupling.rs`, `target_track.rs` | the spring between hand and instrument, and what it follows |
//! | `grasp.rs` | when an instrument holds something |
//! | `contacts.rs`, `local_model.rs`, `anticipate.rs` | contacts for the collision list and for haptics |
//! | `felt.rs` | instruments whose contacts somebody else models |
//! | `controller.rs`, `mechanism.rs` | the controller, and its resume state |
//! | `shapes.rs`, `settings.rs`, `conversion.rs` | geometry, tuning, glam to nalgebra |
//!
//! # How to grasp
//!
//! For the default [`Instrument`](trocar_scene::components::Instrument) (jaws of 18 mm, blades 1.5 mm thick and
//! 3 mm wide) and a ring of 3 mm tube:
//!
//! - **Where.** Put the tip 0.5–3 mm beyond the centre line of the tube, so that the tube lies that far behind
//!   the ends of the blades; 1 mm is what the tests use. A ring that lies on a board leaves 1.5 mm below its
//!   centre line: an instrument from above may go down to z = 0.5 mm. The instrument's x must point across the
//!   tube (radially), its y along it.
//! - **How wide.** The ends of the blades are `jaw_length · angle` apart: 5.4 mm at 0.3 rad, which clears the
//!   tube by 1.2 mm either way; 9 mm at 0.5 rad. The inner blade's back is then 3.8 mm (0.3 rad) or 2.0 mm
//!   (0.5 rad) from the centre of a ring that is gripped at its side, which clears a peg of 1 mm in the centre.
//!   More than 0.6 rad touches it.
//! - **How hard.** The drive presses with `jaw_force_max` at the tips once the target lies
//!   [0.1 rad](jaws::SATURATION_ANGLE) inside of the actual opening, and in proportion before. A 3 mm tube
//!   keeps the jaws open by 0.185 rad, so a target of 0.08 rad or less is full force. The pads are parallel
//!   there. 1 N holds a 5 g ring at a friction of 0.3 while it is shaken with half of gravity.
//! - **How long.** The drive moves at up to 6 rad/s; 0.1 s after the target dropped to 0 the grip has settled, and
//!   the [`Grasp`](trocar_scene::components::Grasp) component appears as soon as both pads press with 0.02 N.
//!   It goes away 20 ms after they stopped.
//! - **Two hands** on one ring need 60° between them, or the blades meet. The receiving hand may be off by 1 mm:
//!   the hands' couplings (1,000 N/m) give way, and both feel it.
//! - **Letting go.** Open by at least 0.05 rad more than the grip; 0.3 rad frees the ring for certain.
//!
//! # Limits
//!
//! The floor below the boards is the engine's own (`floor_height`). Instruments are weightless, as the hand carries
//! them. A ring is sixteen capsules: its tube leaves the ideal circle by 77 µm either way. Bodies that are
//! spawned after the engine's start are moved in the scene only under
//! [`claims_all_poses`](EngineSettings::claims_all_poses).

pub mod anticipate;
pub mod contacts;
pub mod controller;
pub mod conversion;
pub mod coupling;
pub mod error;
pub mod felt;
pub mod grasp;
pub mod grasper;
pub mod jaws;
pub mod local_model;
pub mod mechanism;
pub mod mesh_mass;
pub mod penalty;
mod set_point;
pub mod settings;
pub mod shapes;
pub mod target_track;
pub mod world;

pub use controller::EngineController;
pub use error::EngineError;
pub use grasper::{Grasper, GrasperState};
pub use mechanism::MechanismState;
pub use settings::EngineSettings;
pub use world::{RigidWorld, WorldStatistics};

/// Registers the components that the engine adds to those of the field.
///
/// # Errors
/// When a name is already taken by another type.
pub fn register(builder: &mut trocar_scene::RegistryBuilder) -> Result<(), trocar_scene::RegistryError> {
    builder.register::<MechanismState>()?;
    Ok(())
}
