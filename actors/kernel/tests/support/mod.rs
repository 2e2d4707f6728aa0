//! What several of the tests share.
#![allow(dead_code, reason = "each of the two programs uses a part of it")]

pub mod rig;
pub mod sequences;
pub mod toys;
