//! Instruments that follow hands, whoever computes what they touch.
//!
//! | Concept | File |
//! |---|---|
//! | Where an instrument is, and how far its jaws are open | `state.rs` |
//! | What the hand wants: samples, gaps, the spring between hand and instrument | `target_track.rs`, `set_point.rs`, `coupling.rs` |
//! | Its jaws, and their drive | `jaw.rs` |
//! | When it holds something | `grasp.rs` |
//! | Contacts, and the model of them that haptics evaluates | `contact.rs`, `local_model.rs` |
//! | Instruments whose contacts somebody else models | `felt.rs` |
//! | What another life needs of the mechanism | `mechanism.rs` |

pub mod contact;
pub mod coupling;
pub mod grasp;
pub mod jaw;
pub mod local_model;
pub mod mechanism;
pub mod set_point;
pub mod state;
pub mod target_track;
