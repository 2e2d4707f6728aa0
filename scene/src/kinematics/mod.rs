//! Kinematics from a hand to its instrument: registration device → world, the port's fulcrum, and the wrenches mapped
//! back by virtual work. Pure functions, shared by haptics and virtual trainees.

pub mod coupling;
pub mod fulcrum;
pub mod hand_rig;
pub mod registration;
pub mod spatial;
