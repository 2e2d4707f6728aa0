//! Solvers of our own, and their controllers.
//!
//! All of these tests run beside each other.

mod allocations;
mod bleeding;
mod controllers;
mod coupled;
mod coupling;
mod cutting;
mod dynamic_fem;
mod dynamic_fem_apart;
mod dynamic_fem_controller;
mod electrosurgery;
mod fluid;
mod fluid_reference;
mod following;
mod found_contacts;
mod found_rigid;
mod freezing;
mod freezing_fluids;
mod heat_cut;
mod holding;
mod linear_fem;
mod linear_fem_apart;
mod linear_fem_controller;
mod linear_fem_cut;
mod linear_fem_hertz;
mod linear_fem_order;
mod linear_fem_pins;
mod linear_fem_reference;
mod linear_fem_removal;
mod mass_spring;
mod mass_spring_reference;
mod outside_data;
mod parting;
mod picking;
mod puncture;
mod rigid;
mod rigid_controller;
mod scissors;
mod support;
mod suture_controller;
mod suture_island;
mod suture_knot;
mod suture_needle;
mod suture_stitch;
mod suture_strands;
mod suture_surface;
mod suture_tightened;
mod tet_mesh;
mod tet_volume;
mod thread_adapt;
mod thread_budget;
mod thread_contact;
mod thread_controller;
mod thread_cut;
mod thread_elastic;
mod thread_hold;
mod thread_knot;
mod thread_lying;
mod thread_rod;
mod thread_several;
mod thread_slip_force;
mod thread_tied;
mod thread_together;
mod thread_turns;
mod xpbd;
mod xpbd_controller;
mod xpbd_reference;

#[global_allocator]
static ALLOCATOR: trocar_test_support::allocations::CountingAllocator =
    trocar_test_support::allocations::CountingAllocator;
