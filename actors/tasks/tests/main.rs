//! Exercises.
//!
//! All of these tests run beside each other.

mod controller;
mod peg_transfer;
