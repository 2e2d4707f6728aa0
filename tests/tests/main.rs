//! Tests across crates that may run in parallel.
//!
//! Tests that need the machine for themselves are in `alone.rs`.

mod bearing;
mod collision_gallery;
mod detectors;
mod determinism;
mod docs;
mod engine_restart;
mod exercise;
mod golden;
mod honesty;
mod inventory;
mod late_partner;
mod own_task;
mod parsers;
mod person;
mod scenarios;
mod sessions;
mod soak;
mod soft_scenes;
mod tele_surgery;
mod touch;
mod wall;

#[global_allocator]
static ALLOCATOR: trocar_test_support::allocations::CountingAllocator =
    trocar_test_support::allocations::CountingAllocator;
