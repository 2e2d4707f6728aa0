//! The Model, supervision, recording and lock-step.
//!
//! All of these tests run beside each other.

mod escalation;
mod memory;
mod model_sequences;
mod otp;
mod recorder_allocations;
mod supervisor;
mod support;

#[global_allocator]
static ALLOCATOR: trocar_test_support::allocations::CountingAllocator =
    trocar_test_support::allocations::CountingAllocator;
