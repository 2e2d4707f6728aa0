//! Two streams that are one: what comes from one goes to the other, both ways, without a thread of its own.

use std::io::{self, ErrorKind, Read, Write};
use std::net::{Shutdown, TcpStream};

use rustix::event::{PollFd, PollFlags};
use trocar_scene::SimTime;

/// Bytes of a direction under way in this process; while so many wait, no more is taken.
const PIECE: usize = 32 << 10;
/// Pieces carried in one turn, so that others have theirs.
const TURNS_MAX: usize = 4;
/// Both ends of a control channel say something each second; a pair that has been silent for so long is broken.
pub(super) const SILENCE_MAX: SimTime = SimTime::from_millis(60_000);

/// One direction.
#[derive(Debug)]
struct Way {
    bytes: Box<[u8]>,
    begin: usize,
    end: usize,
    /// Nothing more comes; and the other end has been told.
    is_over: bool,
    is_told: bool,
}

impl Way {
    /// With bytes that have come before.
    fn new(first: &[u8]) -> Self {
        let mut bytes = vec![0; PIECE.max(first.len())].into_boxed_slice();
        bytes[..first.len()].copy_from_slice(first);
        Self { bytes, begin: 0, end: first.len(), is_over: false, is_told: false }
    }

    fn has_bytes(&self) -> bool {
        self.begin < self.end
    }

    /// Carries what it can; whether something moved.
    fn carry(&mut self, mut from: &TcpStream, mut to: &TcpStream) -> io::Result<bool> {
        let mut has_moved = false;
        for _ in 0..TURNS_MAX {
            if !self.has_bytes() && !self.is_over {
                match from.read(&mut self.bytes) {
                    Ok(0) => self.is_over = true,
                    Ok(count) => (self.begin, self.end, has_moved) = (0, count, true),
                    Err(error) if error.kind() == ErrorKind::WouldBlock => break,
                    Err(error) if error.kind() == ErrorKind::Interrupted => continue,
                    Err(error) => return Err(error),
                }
            }
            if self.has_bytes() {
                match to.write(&self.bytes[self.begin..self.end]) {
                    Ok(0) => return Err(ErrorKind::WriteZero.into()),
                    Ok(count) => (self.begin, has_moved) = (self.begin + count, true),
                    Err(error) if error.kind() == ErrorKind::WouldBlock => break,
                    Err(error) if error.kind() == ErrorKind::Interrupted => {}
                    Err(error) => return Err(error),
                }
            } else if self.is_over {
                if !self.is_told {
                    to.shutdown(Shutdown::Write)?;
                    self.is_told = true;
                }
                break;
            }
        }
        Ok(has_moved)
    }
}

/// Two streams that are one.
#[derive(Debug)]
pub(super) struct Splice {
    ends: [TcpStream; 2],
    /// From the first to the second, and back.
    ways: [Way; 2],
    moved_at: SimTime,
}

impl Splice {
    /// Of these two; `first` has come from the second already.
    ///
    /// # Errors
    /// When a socket cannot be made non-blocking.
    pub fn new(one: TcpStream, other: TcpStream, first: &[u8], now: SimTime) -> io::Result<Self> {
        for end in [&one, &other] {
            end.set_nonblocking(true)?;
            // Small messages go out at once; a system without the option only sends them a little later.
            let _ = end.set_nodelay(true);
        }
        Ok(Self { ends: [one, other], ways: [Way::new(&[]), Way::new(first)], moved_at: now })
    }

    /// Goes on; false when it is over.
    pub fn work(&mut self, now: SimTime) -> bool {
        let [one, other] = &self.ends;
        let [there, back] = &mut self.ways;
        match (there.carry(one, other), back.carry(other, one)) {
            (Ok(there), Ok(back)) => {
                if there || back {
                    self.moved_at = now;
                }
            }
            // One end is gone, and the other one learns it by the end of its own.
            _ => return false,
        }
        now.since(self.moved_at) < SILENCE_MAX && !self.ways.iter().all(|way| way.is_told)
    }

    /// Appends what a driver may wait for before it calls `work` again.
    pub fn wake_on<'a>(&'a self, into: &mut Vec<PollFd<'a>>) {
        for (at, end) in self.ends.iter().enumerate() {
            let (own, others) = (&self.ways[at], &self.ways[1 - at]);
            let mut flags = PollFlags::empty();
            flags.set(PollFlags::IN, !own.has_bytes() && !own.is_over);
            flags.set(PollFlags::OUT, others.has_bytes());
            if !flags.is_empty() {
                into.push(PollFd::new(end, flags));
            }
        }
    }
}
