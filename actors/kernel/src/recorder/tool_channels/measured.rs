//! `/measured`: what controllers measure of their simulations: areas, volumes, energies, slips.

use std::collections::BTreeMap;

use serde_json::json;
use trocar_scene::{Measured, Revision, SimTime, Snapshot};

use super::super::format::channel;
use super::Message;
use super::cadence::Cadence;
use super::numbers::significant;
use super::writers::WriterNames;

/// Least time from one message of a controller to the next.
const PERIOD: SimTime = SimTime::from_millis(200);

/// What has been told of the measurements.
pub(super) struct Measurements {
    cadence: Cadence,
    since: Revision,
}

impl Default for Measurements {
    fn default() -> Self {
        Self { cadence: Cadence::new(PERIOD), since: Revision::ZERO }
    }
}

impl Measurements {
    pub(super) fn begin_anew(&mut self) {
        self.since = Revision::ZERO;
    }

    /// Tells what has changed.
    pub(super) fn tell(
        &mut self,
        scene: &Snapshot,
        writers: &WriterNames,
        now: SimTime,
        message: &mut Message<'_>,
    ) {
        if self.cadence.is_due(now) {
            self.tell_changed(scene, writers, message);
        }
    }

    /// Tells everything.
    pub(super) fn tell_all(&mut self, scene: &Snapshot, writers: &WriterNames, message: &mut Message<'_>) {
        self.begin_anew();
        self.tell_changed(scene, writers, message);
    }

    fn tell_changed(&mut self, scene: &Snapshot, writers: &WriterNames, message: &mut Message<'_>) {
        for (entity, measured) in scene.iter_changed::<Measured>(self.since) {
            let values = measured.values.iter().map(|(name, value)| (name, significant(*value)));
            let values: BTreeMap<_, _> = values.collect();
            message(channel::MEASURED, &json!({"controller": writers.name(scene, entity), "values": values}));
        }
        self.since = scene.revision();
    }
}
