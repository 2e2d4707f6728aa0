//! Instruments on virtual couplings, independent of the world that simulates their contacts.
//!
//! | Concept | File |
//! |---|---|
//! | Pose of an instrument, opening of its jaws | `state.rs` |
//! | Target of the hand: samples, gaps, virtual coupling | `target_track.rs`, `set_point.rs`, `coupling.rs` |
//! | Jaws and their drive | `jaw.rs` |
//! | Grasp rule | `grasp.rs` |
//! | Contacts, and the local contact model for haptics | `contact.rs`, `local_model.rs` |
//! | Instruments whose contacts another controller models | `../rigid_bodies/external_contact_model.rs` |
//! | Mechanism state for a restart | `mechanism.rs` |
//! | Displacement from the hand where no rigid world moves it, and its coupling | `deflection.rs`, `hand_coupling.rs` |

pub mod contact;
pub mod coupling;
pub mod deflection;
pub mod grasp;
pub mod hand_coupling;
pub mod jaw;
pub mod local_model;
pub mod mechanism;
pub mod set_point;
pub mod state;
pub mod target_track;
