//! The recorder as the Model sees it: takes commits without waiting, and leaves the disk to a thread.

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, TrySendError, sync_channel};
use std::time::Duration;

use trocar_scene::Snapshot;

use super::spool::Spool;
use super::writer::{RecordWriter, RecorderError, RecorderOptions, RecordingHead};
use crate::chain::{Chain, StateHash};
use crate::commit::CommitBuffer;
use crate::spec::{CommitSink, FaultKind, FaultOrder};

/// How long the recorder's thread sleeps at most before it flushes what it has.
const IDLE_FLUSH: Duration = Duration::from_millis(500);
/// How long closing may take.
const CLOSE_MAX: Duration = Duration::from_millis(900);
/// Emptied buffers that wait to be used again.
const BUFFERS: usize = 64;

enum Message {
    Commits {
        snapshot: Arc<Snapshot>,
        commits: CommitBuffer,
        hash: StateHash,
        /// Something before this was lost, because of this.
        lost: Option<&'static str>,
    },
    DiskFull(bool),
    Close(SyncSender<bool>),
}

enum Target {
    /// On the caller's thread: lock-step.
    Inline(Option<Box<RecordWriter>>),
    /// On a thread of its own: live.
    Thread { queue: SyncSender<Message>, emptied: Receiver<CommitBuffer>, sound: Arc<AtomicBool> },
}

/// Records a session into a file.
///
/// The file grows in whole chunks, at least twice a second: whatever kills the process, what was flushed can
/// be read.
pub struct Recorder {
    target: Target,
    hash: StateHash,
    lost: Option<&'static str>,
}

impl Recorder {
    /// Records on the thread that commits: for lock-step, where nobody is kept waiting.
    ///
    /// # Errors
    /// [`RecorderError`] when the file or its head cannot be written.
    pub fn inline(
        path: &Path,
        head: &RecordingHead,
        scene: &Snapshot,
        options: RecorderOptions,
    ) -> Result<Self, RecorderError> {
        let (writer, hash) = begin(path, head, scene, options)?;
        Ok(Self { target: Target::Inline(Some(Box::new(writer))), hash, lost: None })
    }

    /// Records on a thread of its own, behind a bounded queue: for live sessions.
    ///
    /// # Errors
    /// [`RecorderError`] when the file or its head cannot be written, or there is no thread.
    pub fn threaded(
        path: &Path,
        head: &RecordingHead,
        scene: &Snapshot,
        options: RecorderOptions,
    ) -> Result<Self, RecorderError> {
        let (writer, hash) = begin(path, head, scene, options)?;
        let (queue, inbox) = sync_channel(options.queue_max.max(1));
        let (give_back, emptied) = sync_channel(BUFFERS);
        let sound = Arc::new(AtomicBool::new(true));
        let flag = sound.clone();
        std::thread::Builder::new()
            .name("trocar-recorder".into())
            .spawn(move || write_all(writer, &inbox, &give_back, &flag))
            .map_err(|source| RecorderError::Create { file: path.to_owned(), source })?;
        Ok(Self { target: Target::Thread { queue, emptied, sound }, hash, lost: None })
    }
}

fn begin(
    path: &Path,
    head: &RecordingHead,
    scene: &Snapshot,
    options: RecorderOptions,
) -> Result<(RecordWriter, StateHash), RecorderError> {
    let head_error = |message: String| RecorderError::Head { file: path.to_owned(), message };
    let hash = Chain::begin(scene).map_err(|error| head_error(error.to_string()))?.head();
    let spool =
        Spool::create(path).map_err(|source| RecorderError::Create { file: path.to_owned(), source })?;
    let writer = RecordWriter::begin(spool, head, scene, hash, options).map_err(head_error)?;
    Ok((writer, hash))
}

impl CommitSink for Recorder {
    fn committed(&mut self, snapshot: &Arc<Snapshot>, mut commits: CommitBuffer) -> CommitBuffer {
        if let Some(last) = commits.last_hash() {
            self.hash = last;
        }
        match &mut self.target {
            Target::Inline(writer) => {
                if let Some(writer) = writer {
                    writer.committed(snapshot, &commits, self.hash);
                }
                commits.clear();
                commits
            }
            Target::Thread { queue, emptied, .. } => {
                if commits.is_empty() && self.lost.is_none() {
                    return commits;
                }
                let message = Message::Commits {
                    snapshot: snapshot.clone(),
                    commits,
                    hash: self.hash,
                    lost: self.lost.take(),
                };
                match queue.try_send(message) {
                    Ok(()) => emptied.try_recv().unwrap_or_default(),
                    Err(TrySendError::Full(refused) | TrySendError::Disconnected(refused)) => {
                        self.lost = Some("the recorder's queue was full");
                        match refused {
                            Message::Commits { mut commits, .. } => {
                                commits.clear();
                                commits
                            }
                            _ => CommitBuffer::new(),
                        }
                    }
                }
            }
        }
    }

    fn close(&mut self) -> bool {
        let lost = self.lost.take();
        match &mut self.target {
            Target::Inline(writer) => writer.take().is_some_and(|writer| writer.close()),
            Target::Thread { queue, .. } => {
                let (done, answer) = sync_channel(1);
                // The thread may be behind: wait for room, but not for long.
                let begun = std::time::Instant::now();
                let mut message = Message::Close(done);
                loop {
                    match queue.try_send(message) {
                        Ok(()) => break,
                        Err(TrySendError::Disconnected(_)) => return false,
                        Err(TrySendError::Full(back)) if begun.elapsed() < CLOSE_MAX => {
                            message = back;
                            std::thread::sleep(Duration::from_millis(5));
                        }
                        Err(TrySendError::Full(_)) => return false,
                    }
                }
                let left = CLOSE_MAX.saturating_sub(begun.elapsed());
                answer.recv_timeout(left).unwrap_or(false) && lost.is_none()
            }
        }
    }

    fn fault(&mut self, order: &FaultOrder) {
        if order.kind != FaultKind::DiskFull {
            return;
        }
        match &mut self.target {
            Target::Inline(Some(writer)) => writer.set_disk_full(order.begins),
            Target::Inline(None) => {}
            Target::Thread { queue, .. } => {
                // A queue that is full already shows what the fault would.
                let _ = queue.try_send(Message::DiskFull(order.begins));
            }
        }
    }

    fn is_sound(&self) -> Option<bool> {
        Some(match &self.target {
            Target::Inline(writer) => writer.as_ref().is_some_and(|writer| writer.is_sound()),
            Target::Thread { sound, .. } => self.lost.is_none() && sound.load(Ordering::Relaxed),
        })
    }
}

fn write_all(
    mut writer: RecordWriter,
    inbox: &Receiver<Message>,
    give_back: &SyncSender<CommitBuffer>,
    sound: &AtomicBool,
) {
    let close = loop {
        match inbox.recv_timeout(IDLE_FLUSH) {
            Ok(Message::Commits { snapshot, mut commits, hash, lost }) => {
                if let Some(reason) = lost {
                    writer.begin_gap(reason.to_owned());
                }
                writer.committed(&snapshot, &commits, hash);
                commits.clear();
                // Full: somebody uses fewer buffers than before.
                let _ = give_back.try_send(commits);
            }
            Ok(Message::DiskFull(full)) => writer.set_disk_full(full),
            Ok(Message::Close(done)) => break Some(done),
            Err(RecvTimeoutError::Timeout) => writer.flush(),
            Err(RecvTimeoutError::Disconnected) => break None,
        }
        sound.store(writer.is_sound(), Ordering::Relaxed);
    };
    let complete = writer.close();
    if let Some(done) = close {
        let _ = done.try_send(complete);
    }
}
