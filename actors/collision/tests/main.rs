//! Detection methods.
//!
//! All of these tests run beside each other.

mod aabb_tree;
mod continuous_finder;
mod continuous_membrane;
mod continuous_pairs;
mod dynamic_point;
mod finger_proxy;
mod finger_proxy_strokes;
mod no_allocation;
mod obb_tree_allocations;
mod obb_tree_brute_force;
mod obb_tree_front;
mod obb_tree_reference;
mod spherical_hash;
mod support;
mod z_buffer;

#[global_allocator]
static ALLOCATOR: trocar_test_support::allocations::CountingAllocator =
    trocar_test_support::allocations::CountingAllocator;
