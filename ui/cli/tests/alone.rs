//! The program from outside.
//!
//! Tests in real time, of signals, and of processes that must not be disturbed: one after another.

mod signals;
mod support;
mod tune;
#[cfg(target_os = "linux")]
mod unprivileged;
mod window;
