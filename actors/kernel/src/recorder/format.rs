//! Format of a recording: an MCAP file (<https://mcap.dev/spec>) with these parts.
//!
//! | record | content |
//! |---|---|
//! | metadata `trocar` | schema and version of this format, scenario, seed, station, components |
//! | metadata `trocar.devices` | capabilities of each device, as JSON |
//! | attachment `scenario.toml` | the scenario's text |
//! | topic `/trocar/commits` | [`Group`]s: everything that changed the scene, with the state hash after it |
//! | topic `/trocar/keyframes` | the whole scene, at the start, every few seconds, and after each gap |
//! | topic `/trocar/gaps` | gaps: spans whose commits were not written, as JSON |
//! | topic `/tf` | poses at 30 Hz as `foxglove.FrameTransforms`, for standard tools |
//! | topic `/events` | events as JSON, for standard tools |
//! | metadata `trocar.end` | written on a clean close: revision, hash and time at the end, completeness |
//!
//! Components are named by the 32-bit key of their NAME, so that neither their number nor the order of
//! registration matters to a reader. Derived components are in keyframes only.

use serde::{Deserialize, Serialize};
use trocar_scene::{Provenance, Revision, SimTime};

use crate::commit::{Commit, CommitBuffer};
use crate::state_hash::{CommitKind, StateHash};

/// Version of the format; readers refuse others.
pub const SCHEMA: &str = "1";
/// The MCAP profile.
pub const PROFILE: &str = "trocar";
pub(super) const META: &str = "trocar";
pub(super) const META_DEVICES: &str = "trocar.devices";
pub(super) const META_END: &str = "trocar.end";
pub(super) const SCENARIO: &str = "scenario.toml";
pub(super) const COMMITS: &str = "/trocar/commits";
pub(super) const KEYFRAMES: &str = "/trocar/keyframes";
pub(super) const GAPS: &str = "/trocar/gaps";
pub(super) const TF: &str = "/tf";
pub(super) const EVENTS: &str = "/events";
/// Prefix of the metadata keys that list components.
pub(super) const COMPONENT: &str = "component.";

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

#[derive(Serialize, Deserialize)]
struct GroupHeader {
    count: u32,
    hash: StateHash,
}

#[derive(Serialize, Deserialize)]
struct CommitHeader<'a> {
    kind: CommitKind,
    revision: Revision,
    #[serde(borrow)]
    writer: &'a str,
    provenance: Provenance,
    payload: u32,
}

/// Appends the commits of one publication.
pub(super) fn encode_group(commits: &CommitBuffer, hash: StateHash, out: &mut Vec<u8>) {
    let mut put = |header: &dyn Fn(&mut Vec<u8>) -> postcard::Result<()>| {
        // Postcard cannot fail on plain structures and a growing vector.
        let _ = header(out);
    };
    put(&|out| extend(&GroupHeader { count: commits.len() as u32, hash }, out));
    for commit in commits.iter() {
        let header = CommitHeader {
            kind: commit.kind,
            revision: commit.revision,
            writer: commit.writer,
            provenance: commit.provenance,
            payload: commit.payload.len() as u32,
        };
        put(&|out| extend(&header, out));
        put(&|out| {
            out.extend_from_slice(commit.payload);
            Ok(())
        });
    }
}

/// Appends the postcard encoding of a value.
fn extend<T: Serialize>(value: &T, out: &mut Vec<u8>) -> postcard::Result<()> {
    let bytes = postcard::to_extend(value, std::mem::take(out))?;
    *out = bytes;
    Ok(())
}

/// The commits of one publication, and the state hash after the last of them.
#[derive(Clone, Debug)]
pub struct Group {
    bytes: Vec<u8>,
    hash: StateHash,
    body: usize,
    count: u32,
}

impl Group {
    /// Checks the structure, so that reading it later cannot fail.
    pub(super) fn decode(bytes: &[u8]) -> Result<Self, String> {
        let (header, rest) = take::<GroupHeader>(bytes)?;
        let body = bytes.len() - rest.len();
        let group = Self { bytes: bytes.to_vec(), hash: header.hash, body, count: header.count };
        let mut rest = &group.bytes[body..];
        for _ in 0..header.count {
            rest = split_commit(rest, header.hash)?.1;
        }
        if !rest.is_empty() {
            return Err(format!("{} bytes too many in a group of commits", rest.len()));
        }
        Ok(group)
    }
    /// The state hash after the last commit.
    pub fn hash(&self) -> StateHash {
        self.hash
    }
    /// How many commits there are.
    pub fn len(&self) -> usize {
        self.count as usize
    }
    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.count == 0
    }
    /// The commits, oldest first; the hash of each is the group's.
    pub fn commits(&self) -> impl Iterator<Item = Commit<'_>> {
        let mut rest = &self.bytes[self.body..];
        std::iter::from_fn(move || {
            let (commit, after) = split_commit(rest, self.hash).ok()?;
            rest = after;
            Some(commit)
        })
        .take(self.len())
    }
}

fn split_commit(bytes: &[u8], hash: StateHash) -> Result<(Commit<'_>, &[u8]), String> {
    let (header, rest) = take::<CommitHeader>(bytes)?;
    let length = header.payload as usize;
    if rest.len() < length {
        return Err(format!("a commit of {length} bytes, {} are left", rest.len()));
    }
    let (payload, rest) = rest.split_at(length);
    let commit = Commit {
        kind: header.kind,
        revision: header.revision,
        writer: header.writer,
        provenance: header.provenance,
        hash,
        payload,
    };
    Ok((commit, rest))
}

pub(super) fn take<'a, T: Deserialize<'a>>(bytes: &'a [u8]) -> Result<(T, &'a [u8]), String> {
    postcard::take_from_bytes(bytes).map_err(|error| error.to_string())
}

/// The body of a keyframe: its hash, then the encoded scene.
pub(super) fn encode_keyframe_header(hash: StateHash, out: &mut Vec<u8>) {
    out.extend_from_slice(&hash.0);
}

/// Splits a keyframe into its hash and the encoded scene.
pub(super) fn decode_keyframe_header(bytes: &[u8]) -> Result<(StateHash, &[u8]), String> {
    let (hash, scene) =
        bytes.split_first_chunk::<32>().ok_or_else(|| "a keyframe without its hash".to_owned())?;
    Ok((StateHash(*hash), scene))
}
