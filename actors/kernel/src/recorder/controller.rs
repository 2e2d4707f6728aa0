//! The recorder as a supervised controller that writes nothing into the scene.

use std::path::Path;
use std::sync::Arc;

use rtrb::RingBuffer;
use trocar_scene::{Access, Commands, Controller, ControllerError, SimTime, Snapshot, Tick};

use super::commit_sink::Tap;
use super::gate::Gate;
use super::handover::Handover;
use super::journal::{Journal, Pen};
use super::options::{RecorderError, RecorderOptions, RecordingHead};
use super::write_buffer::WriteBuffer;
use crate::spec::{ControllerSpec, RECORDER, SessionSpec};
use crate::state_hash::Chain;
use crate::supervision::{Node, RuntimeClass};

/// Ticks per second: high enough for a short queue, and a multiple of the two flushes per second.
pub const RATE_HZ: f64 = 50.0;
/// Longest tick. A disk may be slow, but the publications of that time must fit into the queue.
const HEARTBEAT_LIMIT: SimTime = SimTime::from_millis(1_000);
/// Its writer number: the last one, so that other writers' numbers do not depend on whether there is a recording.
const WRITER: u16 = u16::MAX;
/// Emptied buffers kept for reuse: enough for the publications between two ticks.
const BUFFERS: usize = 256;
/// The epoch in which a recording is begun, before its first life.
const FIRST_EPOCH: u32 = 0;

/// A started recording, to be installed into a session.
///
/// The file grows in whole chunks, at least twice a second: after a crash of the process, all flushed chunks are
/// readable. After a crash of the recorder alone, its next life continues the same file without a gap, unless the queue
/// overflows meanwhile.
pub struct Recorder {
    tap: Tap,
    desk: Arc<Handover>,
}

impl Recorder {
    /// Creates the file and writes its header and the initial scene.
    ///
    /// # Errors
    /// [`RecorderError`] when the file or its head cannot be written.
    pub fn create(
        path: &Path,
        head: &RecordingHead,
        scene: &Snapshot,
        options: RecorderOptions,
    ) -> Result<Self, RecorderError> {
        let spool = WriteBuffer::create(path)
            .map_err(|source| RecorderError::Create { file: path.to_owned(), source })?;
        Self::begin(spool, head, scene, options)
            .map_err(|message| RecorderError::Head { file: path.to_owned(), message })
    }

    pub(super) fn begin(
        spool: WriteBuffer,
        head: &RecordingHead,
        scene: &Snapshot,
        options: RecorderOptions,
    ) -> Result<Self, String> {
        let hash = Chain::begin(scene).map_err(|error| error.to_string())?.head();
        let gate = Gate::new();
        let journal = Journal::begin(spool, head, scene, hash, options, gate.pass(FIRST_EPOCH))?;
        let (queue, published) = RingBuffer::new(options.queue_max.max(1));
        let (give_back, emptied) = RingBuffer::new(BUFFERS);
        let desk = Arc::new(Handover::new(gate, journal, published, give_back));
        Ok(Self { tap: Tap::new(queue, emptied, desk.clone(), hash), desk })
    }

    /// Installs it into a session: takes the Model's commits, and adds the controller [`RECORDER`], which is supervised
    /// like any other, as well as the fault target of that name.
    pub fn install(self, session: &mut SessionSpec) {
        let desk = self.desk.clone();
        let mut spec =
            ControllerSpec::new(RECORDER, WRITER, RuntimeClass::Recorder, RATE_HZ, move |context| {
                desk.take_over(context.epoch)?;
                let life = Life { desk: desk.clone(), epoch: context.epoch, pen: Pen::default() };
                Ok(Box::new(life) as Box<dyn Controller>)
            });
        spec.child = spec.child.with_heartbeat_limit(HEARTBEAT_LIMIT);
        spec.fences.push(self.desk.clone());
        // The recorder sends no batches.
        spec.ring_capacity = 1;
        if let Some(tree) = &mut session.tree {
            tree.children.push(Node::Child(spec.child.clone()));
        }
        session.controllers.push(spec);
        session.fault_sinks.push((RECORDER.to_owned(), self.desk));
        session.commit_sink = Some(Box::new(self.tap));
    }

    /// The Model's end alone, for tests that drive it by hand.
    #[cfg(test)]
    pub(super) fn into_tap(self) -> Tap {
        self.tap
    }
}

/// One life of the recorder.
struct Life {
    desk: Arc<Handover>,
    epoch: u32,
    pen: Pen,
}

impl Controller for Life {
    fn access(&self) -> Access {
        Access::new()
    }
    fn tick(&mut self, tick: &Tick<'_>, _: &Snapshot, _: &mut Commands) -> Result<(), ControllerError> {
        self.desk.work(self.epoch, tick.time, &mut self.pen)
    }
}
