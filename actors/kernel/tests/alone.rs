//! The Model, supervision, recording and lock-step.
//!
//! Tests in real time, of signals, and of processes that must not be disturbed: one after another.

mod begin;
mod bench;
mod conformance;
mod guests;
mod live;
mod live_allocations;
mod operator;
mod pause;
mod support;

#[global_allocator]
static ALLOCATOR: trocar_test_support::allocations::CountingAllocator =
    trocar_test_support::allocations::CountingAllocator;
