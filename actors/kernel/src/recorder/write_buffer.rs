//! Write buffer before the disk: bytes are kept until written, so that a temporarily full disk costs memory, not data.
//! It survives restarts of the recorder.

use std::fs::File;
use std::io::{self, Seek, SeekFrom, Write};
use std::path::Path;

use trocar_scene::output_file;

use super::gate::WritePermit;

/// Where a recording goes.
pub(super) trait Disk: Send {
    /// Writes some of the bytes and returns how many.
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize>;
    /// Makes written bytes durable against a crash or a power failure.
    fn sync(&mut self) -> io::Result<()>;
    /// Truncates the file to its first `length` bytes.
    fn rewind(&mut self, length: u64) -> io::Result<()>;
}

impl Disk for File {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        Write::write(self, bytes)
    }
    fn sync(&mut self) -> io::Result<()> {
        match self.sync_data() {
            // A FIFO or a device has nothing to make durable.
            Err(error) if error.kind() == io::ErrorKind::InvalidInput => Ok(()),
            synced => synced,
        }
    }
    fn rewind(&mut self, length: u64) -> io::Result<()> {
        self.set_len(length)?;
        self.seek(SeekFrom::Start(length)).map(drop)
    }
}

/// Bytes waiting for the disk; appending never fails.
pub(super) struct WriteBuffer {
    waiting: Vec<u8>,
    /// Bytes at the front of `waiting` that are written.
    done: usize,
    /// Total bytes written.
    written: u64,
    /// A write call is in progress; still set if that call panicked.
    asked: bool,
    /// Bytes that a slow disk may still take in the current time step.
    ration: Option<f64>,
    disk: Box<dyn Disk>,
    /// The disk's last error.
    pub(super) refusal: Option<io::Error>,
}

impl WriteBuffer {
    pub(super) fn create(path: &Path) -> io::Result<Self> {
        Ok(Self::new(Box::new(output_file::open(path)?)))
    }

    pub(super) fn new(disk: Box<dyn Disk>) -> Self {
        Self { waiting: Vec::new(), done: 0, written: 0, asked: false, ration: None, disk, refusal: None }
    }

    /// Bytes not yet written.
    pub(super) fn backlog(&self) -> usize {
        self.waiting.len() - self.done
    }

    pub(super) fn append(&mut self, bytes: &[u8]) {
        if self.done > 0 && self.waiting.len() + bytes.len() > self.waiting.capacity() {
            self.waiting.drain(..self.done);
            self.done = 0;
        }
        self.waiting.extend_from_slice(bytes);
    }

    /// Adds the bytes that the disk may take in the elapsed time; `None`: no limit.
    pub(super) fn ration(&mut self, bytes: Option<f64>) {
        // Unused allowance expires, except for the fraction of a byte.
        self.ration = bytes.map(|bytes| bytes + self.ration.map_or(0.0, f64::fract));
    }

    /// Writes as much as the disk takes; `true` when nothing is left. Stops when the permit has ended.
    pub(super) fn drain(&mut self, permit: WritePermit<'_>) -> bool {
        self.refusal = None;
        while self.done < self.waiting.len() {
            if !permit.is_valid() {
                return false;
            }
            let written = if permit.is_disk_full() {
                Err(io::Error::new(io::ErrorKind::StorageFull, "no space left on device (injected fault)"))
            } else if self.ration.is_some_and(|bytes| bytes < 1.0) {
                Err(io::Error::new(io::ErrorKind::WouldBlock, "the disk is too slow (injected fault)"))
            } else {
                let left = self.waiting.len() - self.done;
                let takes = self.ration.map_or(left, |bytes| left.min(bytes as usize));
                self.asked = true;
                let answer = self.disk.write(&self.waiting[self.done..self.done + takes]);
                self.asked = false;
                answer
            };
            match written {
                Ok(0) => {
                    self.refusal = Some(io::ErrorKind::WriteZero.into());
                    return false;
                }
                Ok(count) => {
                    self.done += count;
                    self.written += count as u64;
                    self.ration = self.ration.map(|bytes| bytes - count as f64);
                }
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

    /// Recovers after a failure: if it is unknown how much of a write reached the disk, the file is truncated to its
    /// known length and the write is repeated.
    pub(super) fn resume(&mut self) -> io::Result<()> {
        if self.asked {
            self.disk.rewind(self.written)?;
            self.asked = false;
        }
        Ok(())
    }

    pub(super) fn sync(&mut self) -> io::Result<()> {
        self.disk.sync()
    }
}
