//! Impulse world: rigid bodies and instruments, stepped by the rigid-body controller.
//!
//! | Concept | File |
//! |---|---|
//! | The world, its bodies, its contact report | `world.rs`, `world_adapter.rs`, `bodies.rs`, `contact_report.rs` |
//! | Instruments: shaft, jaws, drive, coupling, grasps | `instrument.rs`, `grasp_detection.rs` |
//! | Shapes as boxes and rounded segments; mass properties | `convex_parts.rs`, `mass_properties.rs` of `trocar-dynamics` |
//! | Narrow phase and bounding boxes | `narrow_phase.rs`, `aabb.rs` |
//! | Contact points of two parts | `closest_features.rs`, `box_box.rs` |
//! | Contacts from external detectors | `detected_contact.rs` |
//! | Joints of bodies | `joints.rs` |
//! | Obstacles ahead of an instrument | `obstacle_prediction.rs` |

pub(crate) mod aabb;
mod bodies;
mod box_box;
pub(crate) mod closest_features;
pub(crate) mod contact_report;
pub(crate) mod convex_parts;
pub(crate) mod detected_contact;
pub(crate) mod grasp_detection;
pub(crate) mod instrument;
mod joints;
pub(crate) mod narrow_phase;
pub(crate) mod obstacle_prediction;
mod settings;
mod world;
pub(crate) mod world_adapter;

pub use closest_features::{TouchPoint, touch};
pub use convex_parts::{Core, Part, mass_of, parts_of};
pub use joints::JOINTS_MAX;
pub use settings::RigidSettings;
pub use world::{BODIES_MAX, ImpulseWorld, TOOLS_MAX};
