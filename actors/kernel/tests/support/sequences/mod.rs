//! Random sessions of a Model against a reference that is obviously right.

pub mod reference;
pub mod steps;
pub mod values;
