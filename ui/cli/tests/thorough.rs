//! The program from outside.
//!
//! What takes minutes: `tests/run --thorough` runs it before a release.

mod projects;
mod support;
mod two_stations;
