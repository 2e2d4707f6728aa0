//! Buffers of one life of the recorder. The next life does not reuse them.

use std::sync::Arc;

use trocar_scene::{ComponentError, Provenance, Registry, Revision, SimTime, Snapshot, WriterId};

use super::block::{BlockEncoder, CommitHead};
use super::columns::History;
use super::kept_commits::Keeper;
use super::rounding::{Policies, Rounder};
use super::sampler::Sampler;
use super::tool_channels::ToolCache;
use crate::spec::RECORDER;
use crate::state_hash::{CommitKind, StateHash};

/// See the module.
pub(super) struct LifeBuffers {
    registry: Arc<Registry>,
    policies: Policies,
    pub(super) keeper: Keeper,
    pub(super) sampler: Sampler,
    pub(super) encoder: BlockEncoder,
    rounder: Rounder,
    pub(super) tools: ToolCache,
    /// The payload of a commit.
    pub(super) payload: Vec<u8>,
    /// The data of a message.
    pub(super) message: Vec<u8>,
}

impl LifeBuffers {
    /// Buffers for what has changed since the last keyframe.
    pub(super) fn new(registry: &Arc<Registry>, exact: bool, keyframe: Revision) -> Self {
        let policies = Policies::new(registry, exact);
        Self {
            keeper: Keeper::new(registry, &policies),
            sampler: Sampler::new(registry, &policies, keyframe),
            encoder: BlockEncoder::new(registry),
            rounder: Rounder::new(registry, policies.clone()),
            tools: ToolCache::default(),
            payload: Vec::new(),
            message: Vec::new(),
            registry: registry.clone(),
            policies,
        }
    }

    /// Forgets what was collected, after a failure.
    pub(super) fn forget(&mut self) {
        self.encoder = BlockEncoder::new(&self.registry);
        self.sampler = Sampler::new(&self.registry, &self.policies, Revision::ZERO);
    }

    /// Writes the scene, with sampled values rounded, into [`Self::message`].
    ///
    /// # Errors
    /// When a value cannot be recorded.
    pub(super) fn keyframe(
        &mut self,
        scene: &Snapshot,
        hashes: (StateHash, StateHash),
        history: &mut History,
    ) -> Result<(), ComponentError> {
        let (mut before, mut behind) = (Vec::new(), Vec::new());
        scene.encode_entities(&mut before)?;
        scene.encode_events(&mut behind)?;
        let revision = scene.revision();
        let provenance = Provenance {
            writer: WriterId(u16::MAX),
            epoch: 1,
            tick: 0,
            time: SimTime::ZERO,
            based_on: revision,
        };
        let head = CommitHead { kind: CommitKind::Sample, revision, writer: RECORDER, provenance };
        self.encoder.begin(Revision::ZERO);
        self.encoder.head(&head, &before, &behind);
        for (component, _) in self.registry.iter() {
            let column = scene.erased_column(component);
            let mut done = Ok(());
            column.for_each_entity(&mut |entity| {
                if done.is_ok() {
                    done = self.rounder.column_row(component, column, entity).map(|_| {
                        self.encoder.row(component, entity.to_bits(), &self.rounder.leaves);
                    });
                }
            });
            done?;
        }
        self.message.clear();
        self.encoder.finish(hashes, Revision::ZERO, history, &mut self.message);
        Ok(())
    }
}
