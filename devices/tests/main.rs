//! Drivers and devices: what people hold.
//!
//! All of these tests run beside each other.

mod allocation;
mod passivity;
mod properties;
mod recordings;
mod safety;
mod support;
mod virtual_hand;

#[global_allocator]
static ALLOCATOR: trocar_test_support::allocations::CountingAllocator =
    trocar_test_support::allocations::CountingAllocator;
