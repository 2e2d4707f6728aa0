//! What a station does about bodies that differ from their owner's, among peers.

use std::collections::VecDeque;

use trocar_scene::{Commands, Entity, Repaired, SimTime, Snapshot};

use crate::control::{ClientControl, RequestKind};
use crate::peers::comparison::{Comparison, ComparisonCounts};
use crate::peers::repair;
use crate::replication::choice::ReplicatedColumns;

/// Answers that wait to be written, one a step.
const ANSWERS_MAX: usize = 16;

/// A peer's comparison with the owner of the bodies, and the answers that have come.
#[derive(Default)]
pub(super) struct PeerRepair {
    comparison: Comparison,
    answers: VecDeque<Vec<u8>>,
}

impl PeerRepair {
    /// For a session of these columns, if it is one among peers.
    pub fn of(columns: &ReplicatedColumns) -> Option<Self> {
        columns.simulated().next().map(|_| Self::default())
    }

    /// How the bodies compare.
    pub fn counts(&self) -> &ComparisonCounts {
        self.comparison.counts()
    }

    /// The station's own scene, as it is now.
    pub fn remember(&mut self, now: SimTime, scene: &Snapshot) {
        self.comparison.remember(now, scene);
    }

    /// Sketches came that were sent at `sent_at`.
    pub fn compare(&mut self, sent_at: SimTime, payload: &[u8]) {
        // What cannot be read came from the owner, whose next one is newer.
        let _ = self.comparison.compare(sent_at, payload);
    }

    /// The owner has answered. What does not fit is asked for again, since it differs still.
    pub fn answered(&mut self, bytes: &[u8]) {
        if self.answers.len() < ANSWERS_MAX {
            self.answers.push_back(bytes.to_vec());
        }
    }

    /// Asks for the bodies that differ.
    pub fn ask(
        &mut self,
        now: SimTime,
        scene: &Snapshot,
        columns: &ReplicatedColumns,
        control: &mut ClientControl,
    ) {
        for entity in self.comparison.take_asked(now) {
            let asked = repair::request(scene, columns, entity);
            // The next sketch finds what could not be asked for now.
            let _ = control.request(RequestKind::Repair(asked), now);
        }
    }

    /// Writes the next answer, as a batch of its own; the body that it is of.
    pub fn write(
        &mut self,
        scene: &Snapshot,
        columns: &ReplicatedColumns,
        out: &mut Commands,
    ) -> Option<Entity> {
        if !out.is_empty() {
            return None;
        }
        let bytes = self.answers.pop_front()?;
        match repair::write(&bytes, columns, scene, out) {
            Ok(entity) => {
                let times = scene.get::<Repaired>(entity).map_or(0, |before| before.times);
                out.put(entity, Repaired { times: times.wrapping_add(1) });
                Some(entity)
            }
            Err(_) => {
                out.clear();
                None
            }
        }
    }
}
