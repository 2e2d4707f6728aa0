//! Bytes on their way to the disk: kept until it takes them, so that a disk that is full for a while costs
//! memory and not data.

use std::fs::File;
use std::io::{self, Seek, SeekFrom, Write};
use std::path::Path;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Where a recording goes.
pub(super) trait Disk: Send {
    /// Writes some of the bytes and says how many.
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize>;
    /// Makes sure that they survive the end of the process and of the power supply.
    fn sync(&mut self) -> io::Result<()>;
}

impl Disk for File {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        Write::write(self, bytes)
    }
    fn sync(&mut self) -> io::Result<()> {
        self.sync_data()
    }
}

/// What waits for the disk; appending to it never fails.
pub(super) struct Spool {
    waiting: Vec<u8>,
    /// Bytes at the front of `waiting` that the disk has.
    done: usize,
    position: u64,
    disk: Box<dyn Disk>,
    /// Fault hook: the disk takes nothing.
    pub(super) full: bool,
    /// What the disk said last, if it refused.
    pub(super) refusal: Option<io::Error>,
}

impl Spool {
    pub(super) fn create(path: &Path) -> io::Result<Self> {
        Ok(Self::new(Box::new(File::create(path)?)))
    }

    pub(super) fn new(disk: Box<dyn Disk>) -> Self {
        Self { waiting: Vec::new(), done: 0, position: 0, disk, full: false, refusal: None }
    }

    /// Bytes that the disk has not taken yet.
    pub(super) fn backlog(&self) -> usize {
        self.waiting.len() - self.done
    }

    /// Gives the disk what it takes; `true` when nothing is left.
    pub(super) fn drain(&mut self) -> bool {
        self.refusal = None;
        while self.done < self.waiting.len() {
            let written = if self.full {
                Err(io::Error::new(io::ErrorKind::StorageFull, "no space left on device (injected fault)"))
            } else {
                self.disk.write(&self.waiting[self.done..])
            };
            match written {
                Ok(0) => {
                    self.refusal = Some(io::ErrorKind::WriteZero.into());
                    return false;
                }
                Ok(count) => self.done += count,
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                Err(error) => {
                    self.refusal = Some(error);
                    return false;
                }
            }
        }
        self.waiting.clear();
        self.done = 0;
        true
    }

    pub(super) fn sync(&mut self) -> io::Result<()> {
        self.disk.sync()
    }

    fn append(&mut self, bytes: &[u8]) {
        if self.done > 0 && self.waiting.len() + bytes.len() > self.waiting.capacity() {
            self.waiting.drain(..self.done);
            self.done = 0;
        }
        self.waiting.extend_from_slice(bytes);
        self.position += bytes.len() as u64;
    }
}

/// A shared spool: one end belongs to the MCAP writer, which does not lend it, the other one to us. Both
/// are used by the same thread, so the lock is never contended.
#[derive(Clone)]
pub(super) struct SpoolEnd(Arc<Mutex<Spool>>);

impl SpoolEnd {
    pub(super) fn new(spool: Spool) -> Self {
        Self(Arc::new(Mutex::new(spool)))
    }
    pub(super) fn lock(&self) -> MutexGuard<'_, Spool> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Write for SpoolEnd {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.lock().append(bytes);
        Ok(bytes.len())
    }
    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl Seek for SpoolEnd {
    fn seek(&mut self, target: SeekFrom) -> io::Result<u64> {
        let position = self.lock().position;
        match target {
            SeekFrom::Current(0) | SeekFrom::End(0) => Ok(position),
            SeekFrom::Start(at) if at == position => Ok(at),
            _ => Err(io::Error::new(io::ErrorKind::Unsupported, "a recording is only appended to")),
        }
    }
}
