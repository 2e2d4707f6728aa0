//! Force rendering.
//!
//! All of these tests run beside each other.

mod allocations;
mod buttons;
mod controller;
mod golden_trace;
mod sampled_wall;
mod support;
mod wall;

#[global_allocator]
static ALLOCATOR: trocar_test_support::allocations::CountingAllocator =
    trocar_test_support::allocations::CountingAllocator;
