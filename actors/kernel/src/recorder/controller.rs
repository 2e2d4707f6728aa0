//! The recorder as a supervised controller that writes nothing into the scene.

use std::path::Path;
use std::sync::Arc;

use rtrb::RingBuffer;
use trocar_scene::{Access, Commands, Controller, ControllerError, SimTime, Snapshot, Tick};

use super::commit_sink::RecorderSink;
use super::gate::Gate;
use super::handover::Handover;
use super::journal::Journal;
use super::life_buffers::LifeBuffers;
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
    sink: RecorderSink,
    handover: Arc<Handover>,
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
        let write_buffer = WriteBuffer::create(path)
            .map_err(|source| RecorderError::Create { file: path.to_owned(), source })?;
        Self::begin(write_buffer, head, scene, options)
            .map_err(|message| RecorderError::Head { file: path.to_owned(), message })
    }

    pub(super) fn begin(
        write_buffer: WriteBuffer,
        head: &RecordingHead,
        scene: &Snapshot,
        options: RecorderOptions,
    ) -> Result<Self, String> {
        let hash = Chain::begin(scene).map_err(|error| error.to_string())?.head();
        let gate = Gate::new();
        let journal = Journal::begin(write_buffer, head, scene, hash, options, gate.permit(FIRST_EPOCH))?;
        let (queue, published) = RingBuffer::new(options.queue_max.max(1));
        let (give_back, emptied) = RingBuffer::new(BUFFERS);
        let handover = Arc::new(Handover::new(gate, journal, published, give_back));
        Ok(Self { sink: RecorderSink::new(queue, emptied, handover.clone(), hash), handover })
    }

    /// Installs it into a session: takes the Model's commits, and adds the controller [`RECORDER`], which is supervised
    /// like any other, as well as the fault target of that name.
    pub fn install(self, session: &mut SessionSpec) {
        let handover = self.handover.clone();
        let mut spec =
            ControllerSpec::new(RECORDER, WRITER, RuntimeClass::Recorder, RATE_HZ, move |context| {
                let buffers = handover.take_over(context.epoch)?;
                let life = RecorderController { handover: handover.clone(), epoch: context.epoch, buffers };
                Ok(Box::new(life) as Box<dyn Controller>)
            });
        spec.child = spec.child.with_heartbeat_limit(HEARTBEAT_LIMIT);
        spec.fences.push(self.handover.clone());
        // The recorder sends no batches.
        spec.ring_capacity = 1;
        if let Some(tree) = &mut session.tree {
            tree.children.push(Node::Child(spec.child.clone()));
        }
        session.controllers.push(spec);
        session.fault_sinks.push((RECORDER.to_owned(), self.handover));
        session.commit_sink = Some(Box::new(self.sink));
    }

    /// The Model's end alone, for tests that drive it by hand.
    #[cfg(test)]
    pub(super) fn into_sink(self) -> RecorderSink {
        self.sink
    }
}

/// One life of the recorder.
struct RecorderController {
    handover: Arc<Handover>,
    epoch: u32,
    buffers: LifeBuffers,
}

impl Controller for RecorderController {
    fn access(&self) -> Access {
        Access::new()
    }
    fn tick(&mut self, tick: &Tick<'_>, _: &Snapshot, _: &mut Commands) -> Result<(), ControllerError> {
        self.handover.work(self.epoch, tick.time, &mut self.buffers)
    }
}
