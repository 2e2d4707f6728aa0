//! The state hash: a hash chain over all changes of the scene.
//!
//! ```text
//! hash₀     = BLAKE3("trocar-chain-1" ‖ initial scene)
//! hashₙ₊₁   = BLAKE3(hashₙ ‖ kind ‖ len(name) ‖ name ‖ tick ‖ time ‖ payload)
//! ```
//! *kind* is one byte (0 a batch, 1 a fence, 2 a sample of a recording), the lengths and numbers are little-endian 64-bit words, *name*
//! is the writer's, *time* is in nanoseconds. The payload of a batch is [`Commands::encode`]: spawns,
//! despawns, removals, then every put that is not derived in order of component NAME and entity, transfers,
//! events. The payload of a fence is the removal of the writer's contributions in the same encoding.
//!
//! Neither the order in which components were registered, nor writer numbers, epochs, or the revision that a writer had
//! read enter the hash: a session and its replay agree if the same names write the same commands at the same times in
//! the same order.
//!
//! [`Commands::encode`]: trocar_scene::Commands::encode

use std::fmt;

use serde::{Deserialize, Serialize};
use trocar_scene::{ComponentError, SimTime, Snapshot};

/// 32 bytes of BLAKE3.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct StateHash(pub [u8; 32]);

impl fmt::Display for StateHash {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.iter().try_for_each(|byte| write!(f, "{byte:02x}"))
    }
}

impl fmt::Debug for StateHash {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "StateHash({self})")
    }
}

/// Kind of a change of the scene.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum CommitKind {
    /// A batch was applied.
    Batch,
    /// A writer was fenced and its contributions removed.
    Fence,
    /// Only in recordings: the values of sampled components at one time.
    Sample,
}

/// The running hash chain.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Chain {
    head: StateHash,
}

impl Chain {
    /// Starts a chain from a scene.
    ///
    /// # Errors
    /// When the scene cannot be encoded.
    pub fn begin(scene: &Snapshot) -> Result<Self, ComponentError> {
        let mut bytes = b"trocar-chain-1".to_vec();
        scene.encode(&mut bytes)?;
        Ok(Self { head: StateHash(*blake3::hash(&bytes).as_bytes()) })
    }

    /// Continues a chain from the hash returned by [`Self::head`].
    pub fn resume(head: StateHash) -> Self {
        Self { head }
    }

    /// The hash of everything so far.
    pub fn head(&self) -> StateHash {
        self.head
    }

    /// Appends one change. Allocates nothing.
    pub fn append(&mut self, kind: CommitKind, writer: &str, tick: u64, time: SimTime, payload: &[u8]) {
        let mut hasher = blake3::Hasher::new();
        hasher.update(&self.head.0);
        hasher.update(&[kind as u8]);
        hasher.update(&(writer.len() as u64).to_le_bytes());
        hasher.update(writer.as_bytes());
        hasher.update(&tick.to_le_bytes());
        hasher.update(&time.as_nanos().to_le_bytes());
        hasher.update(payload);
        self.head = StateHash(*hasher.finalize().as_bytes());
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_part_counts_and_no_two_parts_can_be_shifted_into_each_other() {
        let start = Chain::resume(StateHash([7; 32]));
        let hash = |kind, writer: &str, tick, time, payload: &[u8]| {
            let mut chain = start;
            chain.append(kind, writer, tick, SimTime(time), payload);
            chain.head()
        };
        let all = [
            hash(CommitKind::Batch, "engine", 1, 2, b"abc"),
            hash(CommitKind::Fence, "engine", 1, 2, b"abc"),
            hash(CommitKind::Batch, "enginf", 1, 2, b"abc"),
            hash(CommitKind::Batch, "engine", 3, 2, b"abc"),
            hash(CommitKind::Batch, "engine", 1, 3, b"abc"),
            hash(CommitKind::Batch, "engine", 1, 2, b"abd"),
            hash(CommitKind::Batch, "", 1, 2, b"abc"),
            start.head(),
        ];
        for (index, one) in all.iter().enumerate() {
            assert!(all.iter().skip(index + 1).all(|other| one != other), "{index}");
        }
        assert_eq!(all[0], hash(CommitKind::Batch, "engine", 1, 2, b"abc"));
        assert_eq!(all[0].to_string().len(), 64);
    }
}
