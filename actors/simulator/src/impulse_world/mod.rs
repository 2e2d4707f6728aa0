//! The world of rigid bodies and instruments of our own, as the controller of rigid bodies steps it.
//!
//! | Concept | File |
//! |---|---|
//! | Our own: momenta and impulses | `world.rs`, `world_adapter.rs`, of which `bodies.rs` holds what is in it, and `contact_report.rs` what it tells |
//! | Instruments in it: shaft, jaws, drive, coupling | `instrument.rs`, `grasp_detection.rs` |
//! | Shapes as boxes and rounded segments; what they weigh | `convex_parts.rs`, `mass_properties.rs` of `trocar-dynamics` |
//! | Who meets whom in a step, and who cannot | `narrow_phase.rs`, `aabb.rs` |
//! | Where two parts touch | `closest_features.rs`, `box_box.rs` |
//! | Contacts that others have found | `detected_contact.rs` |
//! | What an instrument is about to touch | `obstacle_prediction.rs` |

pub(crate) mod aabb;
mod bodies;
mod box_box;
pub(crate) mod closest_features;
pub(crate) mod contact_report;
pub(crate) mod convex_parts;
pub(crate) mod detected_contact;
pub(crate) mod grasp_detection;
pub(crate) mod instrument;
pub(crate) mod narrow_phase;
pub(crate) mod obstacle_prediction;
mod settings;
mod world;
pub(crate) mod world_adapter;

pub use closest_features::{TouchPoint, touch};
pub use convex_parts::{Core, Part, mass_of, parts_of};
pub use settings::RigidSettings;
pub use world::{BODIES_MAX, ImpulseWorld, TOOLS_MAX};
