//! Rapier as the physics-engine controller.
//!
//! [`RigidWorld`] is the plain algorithm: bodies, instruments, one [`step`](RigidWorld::step) at a time, no scene
//! and no clock. [`EngineController`], which schedules it, is the controller of every
//! [`World`](trocar_dynamics::rigid_world::World) of rigid bodies; how instruments follow hands, and when they hold something,
//! is in [`trocar_dynamics::instrument`]. Nothing else in Trocar knows Rapier.
//!
//! | file | what it holds |
//! |---|---|
//! | `world.rs`, `world/` | the world: bodies, steps, statistics, contacts that others find |
//! | `grasper.rs`, `jaws.rs` | an instrument as palm, jaws, hinge and drive |
//! | `contacts.rs`, `anticipate.rs`, `penalty.rs` | contacts for the collision list and for haptics, and those of others |
//! | `soft.rs` | Rapier's soft volumes as a method beside ours |
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
pub mod conversion;
pub mod grasper;
pub mod jaws;
pub mod penalty;
pub mod settings;
pub mod shapes;
pub mod soft;
pub mod world;

pub use grasper::Grasper;
pub use settings::EngineSettings;
pub use soft::{EngineSoftBody, EngineSoftController, EngineSoftSolver};
pub use trocar_dynamics::instrument::mechanism::MechanismState;
pub use trocar_dynamics::instrument::state::InstrumentState as GrasperState;
pub use trocar_dynamics::rigid_bodies::RigidBodiesController;
pub use trocar_dynamics::rigid_world::WorldError as EngineError;
pub use world::{RigidWorld, WorldStatistics};

/// Rapier as a controller of the scene: the one of all worlds of rigid bodies, with Rapier's in it.
pub type EngineController = RigidBodiesController<RigidWorld>;

/// Registers the components that the engine adds to those of the field.
///
/// # Errors
/// When a name is already taken by another type.
pub fn register(builder: &mut trocar_scene::RegistryBuilder) -> Result<(), trocar_scene::RegistryError> {
    builder.register::<MechanismState>()?;
    register_soft(builder)
}

/// Registers those of soft bodies alone.
///
/// # Errors
/// When a name is already taken by another type.
pub fn register_soft(builder: &mut trocar_scene::RegistryBuilder) -> Result<(), trocar_scene::RegistryError> {
    builder.register::<EngineSoftBody>()?;
    Ok(())
}
