//! Drivers and devices: what people hold.
//!
//! Tests in real time, of signals, and of processes that must not be disturbed: one after another.

mod live;
mod support;
