//! Architecture tests: the invariants of the design that can be checked on the sources.

#[path = "tidy/mod.rs"]
mod tidy;
