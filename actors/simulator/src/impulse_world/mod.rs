//! Worlds of rigid bodies and instruments, as a controller steps them: what they must be able to do, and the one of our own.
//!
//! | Concept | File |
//! |---|---|
//! | What a world does | `world.rs` |
//! | Our own: momenta and impulses | `impulse_world.rs`, `scheduled.rs`, of which `bodies.rs` holds what is in it, and `told.rs` what it tells |
//! | Instruments in it: shaft, jaws, drive, coupling | `tool.rs`, `holds.rs` |
//! | Shapes as boxes and rounded segments; what they weigh | `parts.rs`, `mesh_mass.rs` |
//! | Who meets whom in a step, and who cannot | `meetings.rs`, `bounds.rs` |
//! | Where two parts touch | `touch.rs`, `box_box.rs` |
//! | Contacts that others have found | `found.rs` |
//! | What an instrument is about to touch | `ahead.rs` |

mod ahead;
mod bodies;
mod bounds;
mod box_box;
mod found;
mod holds;
mod meetings;
mod parts;
mod scheduled;
mod settings;
mod told;
mod tool;
mod touch;
mod world;

pub use parts::{Core, Part, mass_of, parts_of};
pub use settings::RigidSettings;
pub use touch::{TouchPoint, touch};
pub use world::{BODIES_MAX, ImpulseWorld, TOOLS_MAX};
