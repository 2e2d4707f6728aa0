//! Rapier as the physics-engine controller.
//!
//! [`RigidWorld`] is the plain simulation: bodies and instruments, advanced by [`step`](RigidWorld::step). It has no
//! scene and no clock. [`EngineController`] schedules it, as [`RigidBodiesController`] does for every
//! [`World`](trocar_dynamics::rigid_world::World) of rigid bodies. Hand following and the grasp rule are in
//! [`trocar_dynamics::instrument`]. No other crate of Trocar uses Rapier.
//!
//! | file | what it holds |
//! |---|---|
//! | `world.rs`, `world/` | the world: bodies, steps, statistics, contacts from external detectors |
//! | `grasper.rs`, `jaws.rs` | an instrument as palm, jaws, hinge and drive |
//! | `contacts.rs`, `anticipate.rs` | contacts for the collision list and for haptics |
//! | `penalty.rs` | penalty contacts from external detectors |
//! | `soft.rs`, `held_back.rs` | Rapier's soft volumes as a soft-body method; instruments that they hold back |
//! | `shapes.rs`, `settings.rs`, `conversion.rs` | geometry, tuning, glam to nalgebra |
//!
//! # How to grasp
//!
//! For the default [`Instrument`](trocar_scene::components::Instrument) (jaws of 18 mm, blades 1.5 mm thick and
//! 3 mm wide) and a ring of 3 mm tube:
//!
//! - **Where.** Put the tip 0.5–3 mm beyond the centre line of the tube, so that the tube lies that far behind the ends
//!   of the blades; the tests use 1 mm. A ring that lies on a board has 1.5 mm of clearance below its centre line: an
//!   instrument from above may go down to z = 0.5 mm. The instrument's x must point across the tube (radially), its y
//!   along it.
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
//! - **Two hands** on one ring need 60° between them, or the blades collide. The receiving hand may be off by 1 mm: the
//!   virtual couplings (1,000 N/m) yield, and both hands feel the force.
//! - **Letting go.** Open by at least 0.05 rad more than the grip; 0.3 rad frees the ring for certain.
//!
//! # Limits
//!
//! The engine has its own floor below the boards (`floor_height`). Instruments are weightless, because the hand carries
//! them. A ring is sixteen capsules: its tube deviates from the ideal circle by 77 µm either way. The poses of bodies
//! spawned after the engine's start are written to the scene only under
//! [`claims_all_poses`](EngineSettings::claims_all_poses).

pub mod anticipate;
pub mod contacts;
pub mod conversion;
pub mod grasper;
mod held_back;
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

/// The controller of rigid bodies, with Rapier as its world.
pub type EngineController = RigidBodiesController<RigidWorld>;

/// Registers the engine's components, [`MechanismState`] among them.
///
/// # Errors
/// When a name is already taken by another type.
pub fn register(builder: &mut trocar_scene::RegistryBuilder) -> Result<(), trocar_scene::RegistryError> {
    builder.register::<MechanismState>()?;
    register_soft(builder)
}

/// Registers the components of soft bodies only.
///
/// # Errors
/// When a name is already taken by another type.
pub fn register_soft(builder: &mut trocar_scene::RegistryBuilder) -> Result<(), trocar_scene::RegistryError> {
    builder.register::<EngineSoftBody>()?;
    Ok(())
}
