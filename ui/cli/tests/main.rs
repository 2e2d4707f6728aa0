//! The program from outside.
//!
//! All of these tests run beside each other.

mod cli;
mod docs_commands;
#[cfg(target_os = "linux")]
mod full_disks;
mod mesh_files;
mod network;
mod output_files;
mod own_programs;
mod paths;
mod pictures;
mod recording_export;
mod recordings;
mod reflect;
mod refusals;
mod runs;
mod support;
mod templates;
#[cfg(target_os = "linux")]
mod writers;
mod zenoh;
