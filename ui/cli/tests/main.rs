//! The program from outside.
//!
//! All of these tests run beside each other.

mod cli;
mod docs_commands;
mod pictures;
mod support;
mod templates;
