//! Digest of a scene: a hash for each chunk of 64 neighbouring entities, over their quantised rows.
//!
//! Stations that hold the same state have the same digest, although one of them got it rounded: rounding twice is
//! rounding once. Chunks that differ are named, so that a repair moves those alone.
//!
//! The hash of a chunk is the sum of the hashes (BLAKE3, 64 bits) of its entities and rows, in any order. It finds
//! divergence; it is no defence against a station that wants to hide one.

use std::collections::{BTreeMap, BTreeSet};

use trocar_scene::{ComponentError, ComponentId, Entity, Revision, Snapshot, varint};

use super::ReplicationError;
use super::choice::ReplicatedColumns;
use super::delta::chunk_of;
use super::quantised_row::RowQuantiser;
use super::wire_reader::WireReader;

/// Most chunks of a digest: those of four million entities.
pub const CHUNKS_MAX: usize = 1 << 16;

/// Hashes of a scene's chunks of entities.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct StateDigest {
    /// The revision of the host that it belongs to.
    pub revision: Revision,
    /// The hash of each chunk, see [`chunk_of`].
    pub chunks: BTreeMap<u64, u64>,
}

impl StateDigest {
    /// Digest of those entities and rows of a scene.
    ///
    /// # Errors
    /// When a value cannot be encoded.
    pub fn of(
        scene: &Snapshot,
        revision: Revision,
        columns: &ReplicatedColumns,
        quantiser: &mut RowQuantiser,
        entities: &dyn Fn(Entity) -> bool,
        rows: &dyn Fn(ComponentId, Entity) -> bool,
    ) -> Result<Self, ComponentError> {
        let mut chunks = BTreeMap::new();
        let mut add = |entity: Entity, what: &[u8]| {
            let sum: &mut u64 = chunks.entry(chunk_of(entity)).or_default();
            let mut word = [0; 8];
            word.copy_from_slice(&blake3::hash(what).as_bytes()[..8]);
            *sum = sum.wrapping_add(u64::from_le_bytes(word));
        };
        for entity in scene.entities().filter(|entity| entities(*entity)) {
            add(entity, &entity.to_bits().to_le_bytes());
        }
        let mut form = Vec::new();
        for id in columns.replicated() {
            let mut outcome = Ok(());
            scene.erased_column(id).for_each_entity(&mut |entity| {
                if outcome.is_err() || !rows(id, entity) {
                    return;
                }
                form.clear();
                form.extend_from_slice(&id.0.to_le_bytes());
                form.extend_from_slice(&entity.to_bits().to_le_bytes());
                match quantiser.write(scene, columns, id, entity, &mut form) {
                    Ok(_) => add(entity, &form),
                    Err(error) => outcome = Err(error),
                }
            });
            outcome?;
        }
        Ok(Self { revision, chunks })
    }

    /// The chunks that differ, ascending; those that only one of both has as well.
    pub fn differing(&self, other: &Self) -> Vec<u64> {
        let all: BTreeSet<u64> = self.chunks.keys().chain(other.chunks.keys()).copied().collect();
        all.into_iter().filter(|chunk| self.chunks.get(chunk) != other.chunks.get(chunk)).collect()
    }

    /// Appends it: revision, number of chunks, then each chunk's number (as a difference) and its hash (eight bytes).
    pub fn write(&self, out: &mut Vec<u8>) {
        varint::write(self.revision.0, out);
        varint::write(self.chunks.len() as u64, out);
        let mut before = 0;
        for (chunk, hash) in &self.chunks {
            varint::write(chunk - before, out);
            before = *chunk;
            out.extend_from_slice(&hash.to_le_bytes());
        }
    }

    /// Reads what [`Self::write`] wrote.
    ///
    /// # Errors
    /// When it is malformed or has more than [`CHUNKS_MAX`] chunks.
    pub fn read(bytes: &[u8]) -> Result<Self, ReplicationError> {
        let mut reader = WireReader::new("a digest", bytes);
        let revision = Revision(reader.number()?);
        let count = reader.count()?;
        if count > CHUNKS_MAX {
            return Err(reader.refuse(count as u64, "up to 65,536 chunks"));
        }
        let (mut chunks, mut before) = (BTreeMap::new(), 0_u64);
        for _ in 0..count {
            before = before.wrapping_add(reader.number()?);
            chunks.insert(before, reader.word()?);
        }
        if !reader.is_empty() {
            return Err(reader.refuse(0, "the end of the digest"));
        }
        Ok(Self { revision, chunks })
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn digests_come_back_and_name_the_chunks_that_differ(
            chunks in prop::collection::btree_map(any::<u64>(), any::<u64>(), 0..40),
            change in any::<prop::sample::Index>(),
        ) {
            let digest = StateDigest { revision: Revision(9), chunks };
            let mut bytes = Vec::new();
            digest.write(&mut bytes);
            prop_assert_eq!(StateDigest::read(&bytes), Ok(digest.clone()));
            prop_assert!(digest.differing(&digest).is_empty());
            let mut other = digest.clone();
            if !other.chunks.is_empty() {
                let chunk = *other.chunks.keys().nth(change.index(other.chunks.len())).expect("it is there");
                other.chunks.entry(chunk).and_modify(|hash| *hash ^= 1);
                prop_assert_eq!(digest.differing(&other), vec![chunk]);
                other.chunks.remove(&chunk);
                prop_assert_eq!(digest.differing(&other), vec![chunk]);
                prop_assert_eq!(other.differing(&digest), vec![chunk]);
            }
        }

        #[test]
        fn any_bytes_are_a_digest_or_refused(bytes in prop::collection::vec(any::<u8>(), 0..80)) {
            let _ = StateDigest::read(&bytes);
        }
    }
}
