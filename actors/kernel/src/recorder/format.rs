//! Format of a recording: an MCAP file (<https://mcap.dev/spec>) with these parts.
//!
//! | record | content |
//! |---|---|
//! | metadata `trocar` | schema and version of this format, scenario, seed, station, components and how each is kept |
//! | metadata `trocar.devices` | capabilities of each device, as JSON |
//! | attachment `scenario.toml` | the scenario's text |
//! | topic `/trocar/commits` | [blocks](super::block), as [messages](super::block_message) of Protocol Buffers: what is kept of the commits of a tenth of a second |
//! | topic `/trocar/keyframes` | the whole scene, at the start, every few seconds, and after each gap |
//! | topic `/trocar/gaps` | gaps: spans whose commits were not written, as JSON |
//! | other topics | JSON for [standard tools](super::tool_channels): poses, forces, exercises, events, what is to be seen |
//! | metadata `trocar.bytes` | on a clean close: bytes of all commits by component and writer, before anything was left out |
//! | metadata `trocar.end` | on a clean close: revision, hashes and time at the end, completeness |
//!
//! Blocks, keyframes and gaps lie in chunks of their own, each of which can be read without the others; a keyframe
//! begins a chunk. Messages for tools lie in other chunks, compressed with LZ4.
//!
//! **Two hashes.** The *state hash* is the Model's, over everything that it applied. The *stored hash* is a chain of the
//! same construction over what is stored: exact components in every commit, samples of the others. A replay computes the
//! stored hash; a repetition of the session in lock-step computes the state hash. Where every commit is kept to the last
//! bit, both are the same.

use serde::{Deserialize, Serialize};
use trocar_scene::{Revision, SimTime};

use super::block::{DecodedBlock, DecodedCommit};
use crate::commit::Commit;
use crate::state_hash::StateHash;

/// Version of the format; readers refuse others.
pub const SCHEMA: &str = "2";
/// The MCAP profile.
pub const PROFILE: &str = "trocar";
pub(super) const META: &str = "trocar";
pub(super) const META_DEVICES: &str = "trocar.devices";
pub(super) const META_BYTES: &str = "trocar.bytes";
pub(super) const META_END: &str = "trocar.end";
pub(super) const SCENARIO: &str = "scenario.toml";
pub(super) const COMMITS: &str = "/trocar/commits";
pub(super) const KEYFRAMES: &str = "/trocar/keyframes";
pub(super) const GAPS: &str = "/trocar/gaps";
pub(super) const TF: &str = "/tf";
pub(super) const TF_STATIC: &str = "/tf_static";
pub(super) const EVENTS: &str = "/events";
pub(super) const HAND_LEFT: &str = "/hands/left";
pub(super) const HAND_RIGHT: &str = "/hands/right";
pub(super) const TASK: &str = "/task";
pub(super) const PHASES: &str = "/task/phases";
pub(super) const MEASURED: &str = "/measured";
pub(super) const SCENE: &str = "/scene";
pub(super) const SCENE_DEFORMING: &str = "/scene/deforming";
/// Prefix of the metadata keys that list components.
pub(super) const COMPONENT: &str = "component.";

/// Numbers of the channels.
pub(super) mod channel {
    pub(crate) const COMMITS: u16 = 1;
    pub(crate) const KEYFRAMES: u16 = 2;
    pub(crate) const GAPS: u16 = 3;
    pub(crate) const TF: u16 = 4;
    pub(crate) const EVENTS: u16 = 5;
    pub(crate) const HAND_LEFT: u16 = 6;
    pub(crate) const HAND_RIGHT: u16 = 7;
    pub(crate) const TASK: u16 = 8;
    pub(crate) const PHASES: u16 = 9;
    pub(crate) const MEASURED: u16 = 10;
    pub(crate) const SCENE: u16 = 11;
    pub(crate) const SCENE_DEFORMING: u16 = 12;
    pub(crate) const TF_STATIC: u16 = 13;
}

/// A part of the session that is not in the recording.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Gap {
    /// The last revision before it.
    pub after: Revision,
    /// The last revision in it; a keyframe of this revision follows.
    pub until: Revision,
    /// Its end.
    pub time: SimTime,
    /// Why.
    pub reason: String,
}

/// What is kept of the commits of one block, with the hashes after the last of them.
#[derive(Clone, Debug)]
pub struct Group {
    block: DecodedBlock,
}

impl Group {
    pub(super) fn new(block: DecodedBlock) -> Self {
        Self { block }
    }
    /// The hash of what is stored, after the last commit.
    pub fn hash(&self) -> StateHash {
        self.block.stored
    }
    /// The Model's hash after the block.
    pub fn state_hash(&self) -> StateHash {
        self.block.state
    }
    /// How many commits there are.
    pub fn len(&self) -> usize {
        self.block.commits.len()
    }
    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.block.commits.is_empty()
    }
    /// The commits, oldest first; the hash of each is the group's.
    pub fn commits(&self) -> impl Iterator<Item = Commit<'_>> {
        self.block.commits.iter().map(|commit| self.commit(commit))
    }
    /// The commit of that number.
    pub(super) fn get(&self, index: usize) -> Option<Commit<'_>> {
        self.block.commits.get(index).map(|commit| self.commit(commit))
    }
    fn commit<'a>(&self, commit: &'a DecodedCommit) -> Commit<'a> {
        Commit {
            kind: commit.kind,
            revision: commit.revision,
            writer: &commit.writer,
            provenance: commit.provenance,
            hash: self.block.stored,
            payload: &commit.payload,
        }
    }
}
