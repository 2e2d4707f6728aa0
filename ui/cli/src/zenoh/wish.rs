//! What a session that is to be reached by Zenoh is told at its start.

use trocar::network::Network;
use trocar_scene::Snapshot;
use trocar_scene::scenario::Scenario;

/// What the command line wishes, and what is run.
#[cfg_attr(not(feature = "zenoh"), allow(dead_code, reason = "nobody reads it there"))]
pub struct Wish<'a> {
    /// The text of `--zenoh`, if it was given.
    pub text: Option<&'a str>,
    /// What is run.
    pub scenario: &'a Scenario,
    /// Its first scene.
    pub first: &'a Snapshot,
    /// Whether others may join it.
    pub network: &'a Network,
    /// Whether nothing is told on the terminal.
    pub is_silent: bool,
}
