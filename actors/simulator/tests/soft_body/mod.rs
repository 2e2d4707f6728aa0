//! Common behaviour of all soft-body methods: contacts, grasps, frozen bodies.

mod bearing;
mod contact;
mod frozen;
mod frozen_fluids;
mod grasp;
mod held_back;
mod jaw_friction;
mod mesh_fit;
mod picking;
mod regions;
mod rigid_contact;
