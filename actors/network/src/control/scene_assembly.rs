//! A scene that arrives in parts.

use super::error::ControlError;
use super::manifest::SceneManifest;

/// Puts the parts of a scene together, and hashes them as they come. It holds no more memory than has arrived, rounded up
/// by the growth of a vector.
#[derive(Debug)]
pub struct SceneAssembly {
    manifest: SceneManifest,
    bytes: Vec<u8>,
    hasher: blake3::Hasher,
}

impl SceneAssembly {
    /// Of the scene that a host announced.
    pub fn new(manifest: SceneManifest) -> Self {
        Self { manifest, bytes: Vec::new(), hasher: blake3::Hasher::new() }
    }

    /// What the host announced.
    pub fn manifest(&self) -> &SceneManifest {
        &self.manifest
    }

    /// Bytes that have arrived.
    pub fn arrived(&self) -> u32 {
        // Parts are taken only within the announced length, which is a u32.
        self.bytes.len() as u32
    }

    /// Whether all parts are there.
    pub fn is_complete(&self) -> bool {
        self.arrived() == self.manifest.bytes
    }

    /// Takes the next part.
    ///
    /// # Errors
    /// [`ControlError::ScenePart`] for one that is empty, is not the next one, or goes beyond the end.
    pub fn take(&mut self, offset: u32, part: &[u8]) -> Result<(), ControlError> {
        let (expected, bytes) = (self.arrived(), self.manifest.bytes);
        let room = (bytes - expected) as usize;
        if offset != expected || part.is_empty() || part.len() > room {
            return Err(ControlError::ScenePart { offset, expected, bytes });
        }
        self.hasher.update(part);
        self.bytes.extend_from_slice(part);
        Ok(())
    }

    /// The scene's bytes, once complete.
    ///
    /// # Errors
    /// [`ControlError::SceneHash`].
    pub fn finish(self) -> Result<(SceneManifest, Vec<u8>), ControlError> {
        if !self.is_complete() || self.hasher.finalize() != blake3::Hash::from_bytes(self.manifest.hash) {
            return Err(ControlError::SceneHash { bytes: self.arrived() });
        }
        Ok((self.manifest, self.bytes))
    }
}

#[cfg(test)]
mod tests {
    use trocar_scene::{Revision, SimTime};

    use super::*;
    use crate::control::manifest::{SceneCounts, SceneKind};

    fn assembly(bytes: &[u8]) -> SceneAssembly {
        SceneAssembly::new(SceneManifest {
            kind: SceneKind::Whole,
            revision: Revision(1),
            time: SimTime::ZERO,
            bytes: bytes.len() as u32,
            hash: *blake3::hash(bytes).as_bytes(),
            counts: SceneCounts::default(),
            digest: [0; 32],
        })
    }

    #[test]
    fn parts_that_are_twice_missing_or_too_long_are_refused() {
        let scene = [1, 2, 3, 4, 5];
        let mut parts = assembly(&scene);
        parts.take(0, &scene[..2]).expect("the first part");
        for (offset, part) in
            [(0, &scene[..2]), (3, &scene[3..]), (2, &[3, 4, 5, 6][..]), (2, &[]), (u32::MAX, &[1])]
        {
            let refused = parts.take(offset, part).expect_err("not the next part");
            assert_eq!(refused, ControlError::ScenePart { offset, expected: 2, bytes: 5 });
        }
        parts.take(2, &scene[2..]).expect("the rest");
        assert_eq!(parts.finish().map(|(_, bytes)| bytes), Ok(scene.to_vec()));
    }

    #[test]
    fn a_scene_with_one_bit_changed_or_cut_off_is_refused() {
        let scene = [1, 2, 3, 4, 5];
        let mut changed = assembly(&scene);
        changed.take(0, &[1, 2, 3, 4, 4]).expect("a part");
        assert_eq!(changed.finish().map(|_| ()), Err(ControlError::SceneHash { bytes: 5 }));
        let mut cut = assembly(&scene);
        cut.take(0, &scene[..4]).expect("a part");
        assert_eq!(cut.finish().map(|_| ()), Err(ControlError::SceneHash { bytes: 4 }));
        assert_eq!(assembly(&[]).finish().map(|(_, bytes)| bytes), Ok(vec![]));
    }
}
