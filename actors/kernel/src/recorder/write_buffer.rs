//! Bytes on their way to the disk: kept until it takes them, so that a disk that is full for a while costs
//! memory and not data. Outlives whoever fills it.

use std::fs::File;
use std::io::{self, Seek, SeekFrom, Write};
use std::path::Path;

use super::gate::Pass;

/// Where a recording goes.
pub(super) trait Disk: Send {
    /// Writes some of the bytes and says how many.
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize>;
    /// Makes sure that they survive the end of the process and of the power supply.
    fn sync(&mut self) -> io::Result<()>;
    /// Forgets everything behind the first `length` bytes.
    fn rewind(&mut self, length: u64) -> io::Result<()>;
}

impl Disk for File {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        Write::write(self, bytes)
    }
    fn sync(&mut self) -> io::Result<()> {
        self.sync_data()
    }
    fn rewind(&mut self, length: u64) -> io::Result<()> {
        self.set_len(length)?;
        self.seek(SeekFrom::Start(length)).map(drop)
    }
}

/// What waits for the disk; appending to it never fails.
pub(super) struct WriteBuffer {
    waiting: Vec<u8>,
    /// Bytes at the front of `waiting` that the disk has.
    done: usize,
    /// Bytes that the disk has altogether.
    written: u64,
    /// The disk was asked to write and has not answered; still set when that call panicked.
    asked: bool,
    /// Bytes that a slow disk still takes before time passes.
    ration: Option<f64>,
    disk: Box<dyn Disk>,
    /// What the disk said last, if it refused.
    pub(super) refusal: Option<io::Error>,
}

impl WriteBuffer {
    pub(super) fn create(path: &Path) -> io::Result<Self> {
        Ok(Self::new(Box::new(File::create(path)?)))
    }

    pub(super) fn new(disk: Box<dyn Disk>) -> Self {
        Self { waiting: Vec::new(), done: 0, written: 0, asked: false, ration: None, disk, refusal: None }
    }

    /// Bytes that the disk has not taken yet.
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

    /// Time has passed, in which the disk takes so many bytes; `None`: as many as it can.
    pub(super) fn ration(&mut self, bytes: Option<f64>) {
        // Time in which nothing was written is gone, but for the rest of a byte.
        self.ration = bytes.map(|bytes| bytes + self.ration.map_or(0.0, f64::fract));
    }

    /// Gives the disk what it takes; `true` when nothing is left. Who was fenced meanwhile stops.
    pub(super) fn drain(&mut self, pass: Pass<'_>) -> bool {
        self.refusal = None;
        while self.done < self.waiting.len() {
            if !pass.is_valid() {
                return false;
            }
            let written = if pass.is_disk_full() {
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

    /// After a failure: when nobody knows how much of a write reached the disk, the file goes back to what is
    /// known, and that write is done again.
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
