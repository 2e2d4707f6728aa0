//! The join manifest: what the scene that is sent must turn out to be, in counts and hashes.
//!
//! A scene that lacks a body looks right until somebody reaches for it, so that a station counts what it has built before
//! it begins.

use std::collections::BTreeMap;
use std::fmt;

use serde::{Deserialize, Serialize};
use trocar_scene::{ComponentId, Registry, Revision, SimTime, Snapshot};

use super::component_list::COMPONENTS_MAX;
use super::message_error::MessageError;
use super::plain_text::PlainText;

/// Most bytes of an encoded scene. A scene of 10,000 entities with meshes has some ten million.
pub const SCENE_BYTES_MAX: u32 = 512 << 20;
/// Most differences that a message names.
const NAMED_MAX: usize = 8;

/// What is in a scene.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct SceneCounts {
    /// Entities.
    pub entities: u32,
    /// Rows of each component that has any, by the component's name.
    pub rows: BTreeMap<PlainText, u32>,
}

impl SceneCounts {
    /// Those of a snapshot.
    pub fn of(snapshot: &Snapshot) -> Self {
        let rows = snapshot.registry().iter().filter_map(|(id, entry)| {
            let rows = snapshot.erased_column(id).len();
            (rows > 0).then(|| (PlainText::new(entry.name), saturated(rows)))
        });
        Self { entities: saturated(snapshot.entities().count()), rows: rows.collect() }
    }

    /// Of so many entities and rows of components.
    pub fn of_rows(
        registry: &Registry,
        entities: usize,
        rows: impl IntoIterator<Item = (ComponentId, usize)>,
    ) -> Self {
        let rows = rows.into_iter().filter(|(_, count)| *count > 0);
        let rows = rows.map(|(id, count)| (PlainText::new(registry.entry(id).name), saturated(count)));
        Self { entities: saturated(entities), rows: rows.collect() }
    }

    /// In what a scene that was built differs from this one.
    ///
    /// # Errors
    /// [`CountsDiffer`].
    pub fn compare(&self, built: &Self) -> Result<(), CountsDiffer> {
        let mut differences = Vec::new();
        if self.entities != built.entities {
            differences.push((PlainText::new("entities"), self.entities, built.entities));
        }
        let names = self.rows.keys().chain(built.rows.keys().filter(|name| !self.rows.contains_key(*name)));
        let of = |counts: &Self, name| counts.rows.get(name).copied().unwrap_or(0);
        for name in names {
            let (announced, found) = (of(self, name), of(built, name));
            if announced != found {
                differences.push((name.clone(), announced, found));
            }
        }
        if differences.is_empty() { Ok(()) } else { Err(CountsDiffer(differences)) }
    }
}

fn saturated(count: usize) -> u32 {
    u32::try_from(count).unwrap_or(u32::MAX)
}

/// What is missing in a scene, or too much: name, announced count, count found.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CountsDiffer(pub Vec<(PlainText, u32, u32)>);

impl fmt::Display for CountsDiffer {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (at, (name, announced, found)) in self.0.iter().take(NAMED_MAX).enumerate() {
            let separator = if at == 0 { "" } else { ", " };
            write!(f, "{separator}{name}: {found} instead of {announced}")?;
        }
        match self.0.len() {
            0..=NAMED_MAX => Ok(()),
            more => write!(f, " and {} more", more - NAMED_MAX),
        }
    }
}

impl std::error::Error for CountsDiffer {}

/// What the bytes of a scene are.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum SceneKind {
    /// The whole scene.
    Whole,
    /// What changed after the revision that the station held.
    Missed {
        /// That revision.
        since: Revision,
    },
}

/// The scene that a station already has.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct HeldScene {
    /// Revision of the host's scene up to which it has everything.
    pub revision: Revision,
    /// Digest of it.
    pub digest: [u8; 32],
}

/// What a host announces of the scene that it sends. The control channel does not look into the scene's bytes.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct SceneManifest {
    /// What the bytes are.
    pub kind: SceneKind,
    /// Revision of the host's scene.
    pub revision: Revision,
    /// Time of the scene.
    pub time: SimTime,
    /// How many bytes follow, at most [`SCENE_BYTES_MAX`].
    pub bytes: u32,
    /// BLAKE3 of the bytes.
    pub hash: [u8; 32],
    /// What is in the scene once the bytes are applied.
    pub counts: SceneCounts,
    /// Digest of that scene, as both ends compute it.
    pub digest: [u8; 32],
}

impl SceneManifest {
    /// Whether all sizes are within their limits.
    ///
    /// # Errors
    /// [`MessageError::Limit`].
    pub fn check(&self) -> Result<(), MessageError> {
        MessageError::limit("bytes of the scene", self.bytes as usize, SCENE_BYTES_MAX as usize)?;
        MessageError::limit("components of the scene", self.counts.rows.len(), COMPONENTS_MAX)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn counts(entities: u32, rows: &[(&str, u32)]) -> SceneCounts {
        let rows = rows.iter().map(|(name, count)| (PlainText::new(name), *count));
        SceneCounts { entities, rows: rows.collect() }
    }

    #[test]
    fn a_scene_that_lacks_bodies_is_told_by_name_and_number() {
        let announced = counts(7, &[("pose", 7), ("tissue", 2)]);
        assert_eq!(announced.compare(&announced), Ok(()));
        let built = counts(6, &[("pose", 6), ("laser", 1)]);
        let differ = announced.compare(&built).expect_err("it differs").to_string();
        assert_eq!(
            differ,
            "entities: 6 instead of 7, pose: 6 instead of 7, tissue: 0 instead of 2, laser: 1 instead of 0"
        );
    }
}
