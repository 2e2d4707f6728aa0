//! Exercises.
//!
//! All of these tests run beside each other.

mod controller;
mod peg_bench;
mod peg_transfer;
