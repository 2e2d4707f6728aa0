//! Solvers and their controllers.
//!
//! All of these tests run in parallel.

mod allocations;
mod controllers;
mod coupling;
mod cutting;
mod dynamic_fem;
mod electrosurgery;
mod fluid;
mod linear_fem;
mod mass_spring;
mod outside_data;
mod rigid;
mod soft_body;
mod support;
mod suture;
mod suture_thread;
mod tet_mesh;
mod xpbd;

#[global_allocator]
static ALLOCATOR: trocar_test_support::allocations::CountingAllocator =
    trocar_test_support::allocations::CountingAllocator;
