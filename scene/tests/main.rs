//! What exists, and the contract of those who act on it.
//!
//! All of these tests run beside each other.

mod component_derive;
mod components_round_trip;
mod core;
mod decode_properties;
mod mesh_dialects;
mod mesh_fit;
mod mesh_inspect;
mod mesh_orientation;
mod mesh_properties;
mod mesh_readers;
mod mesh_regions;
mod mesh_repair;
mod scenario;
mod shapes;
mod store_properties;
mod support;
mod surface_repair;

#[global_allocator]
static ALLOCATOR: trocar_test_support::allocations::CountingAllocator =
    trocar_test_support::allocations::CountingAllocator;
