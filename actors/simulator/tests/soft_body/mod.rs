//! What all methods of soft bodies share: contacts, grasps, bodies that freeze.

mod contact;
mod frozen;
mod frozen_fluids;
mod grasp;
mod picking;
mod rigid_contact;
