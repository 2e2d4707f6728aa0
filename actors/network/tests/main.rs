//! Hands over a network.
//!
//! All of these tests run beside each other.

mod allocations;
mod hand_over_a_bad_path;
mod station_gone;

#[global_allocator]
static ALLOCATOR: trocar_test_support::allocations::CountingAllocator =
    trocar_test_support::allocations::CountingAllocator;
