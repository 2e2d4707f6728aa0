//! A host's book of tickets on disk, so that certificate, spent tokens and withdrawals survive restarts.
//!
//! One host at a time holds the book for as long as it runs. Beside it, commands give out and withdraw tickets in the same
//! file: each change takes a lock, reads what the others changed, and writes the whole book. A token is on the disk as
//! spent before its station hears that it may come in.
//!
//! | offset | bytes | field |
//! |---|---|---|
//! | 0 | 8 | `trcrbook` |
//! | 8 | 4 | version of the format, 1 |
//! | 12 | 4 | count n of the bytes of the content |
//! | 16 | 8 | number of this state: one more with each change |
//! | 24 | n | content (postcard) |
//! | 24 + n | 32 | BLAKE3 of everything before |
//!
//! Numbers are little-endian. A file that is damaged, of another version, or open to others is refused and stays as it is.
//! A copy of an older state that is put back lets tickets in that were spent since; a host that runs notices it, one that
//! starts later cannot.

use std::io::Read;
use std::path::{Path, PathBuf};

use ring::rand::SecureRandom;
use thiserror::Error;

use super::byte_reader::ByteReader;
use super::host_time::HostTime;
use super::identity::{Identity, IdentityError};
use super::join_ticket::Ticket;
use super::plain_name::PlainName;
use super::private_file::{self, FileLock, PrivateFileError};
use super::refused::Refused;
use super::secret::{ResumeSecret, Token};
use super::ticket_book::{Admission, IssueError, Offer, RevokeError, Revoked, TicketBook, TicketId, Whom};

/// Most bytes of the file. With all its entries and the longest names it has half as many.
pub const STORE_BYTES_MAX: u64 = 4 * 1024 * 1024;
const MAGIC: [u8; 8] = *b"trcrbook";
const VERSION: u32 = 1;
const HEADER_BYTES: usize = 24;
const CHECKSUM_BYTES: usize = blake3::OUT_LEN;
/// Ending of the lock that a host holds while it runs.
const HOST_LOCK: &str = ".host";
/// Ending of the lock of a change.
const EDIT_LOCK: &str = ".lock";

/// Called while another process changes the book, with the number of the try from 0: waits some milliseconds and says
/// whether to try again. A change takes milliseconds, so that a second is plenty.
pub type Wait = fn(u32) -> bool;

/// Why the book cannot be read or written.
#[derive(Debug, Error)]
pub enum StoreError {
    /// File, mode, owner or lock.
    #[error(transparent)]
    File(#[from] PrivateFileError),
    /// A second host.
    #[error("{}: another host runs with this file; end it, or name another file for this one", .0.display())]
    HostRuns(PathBuf),
    /// Somebody else was changing it all the time.
    #[error("{}: another program is changing it; try again", .0.display())]
    Busy(PathBuf),
    /// No book.
    #[error("{}: this is no book of tickets; name another file", .0.display())]
    NoBook(PathBuf),
    /// Of a newer program.
    #[error("{}: its format is version {found}, and this program reads version {VERSION}; update this program", file.display())]
    NewerVersion {
        /// The file.
        file: PathBuf,
        /// Its version.
        found: u32,
    },
    /// Damaged.
    #[error(
        "{}: it is damaged ({why}), and left as it is; put a copy of it back, or move it away to start anew with a new \
         certificate, for which all tickets have to be given out again", file.display()
    )]
    Damaged {
        /// The file.
        file: PathBuf,
        /// What is wrong.
        why: String,
    },
    /// It was removed, or replaced by another one.
    #[error(
        "{}: it was {what} while it was in use; nobody is let in before it is put back or this program starts again",
        file.display()
    )]
    Replaced {
        /// The file.
        file: PathBuf,
        /// What became of it.
        what: &'static str,
    },
    /// No certificate can be made.
    #[error(transparent)]
    Identity(#[from] IdentityError),
}

/// A book and its file.
#[derive(Debug)]
pub struct TicketStore {
    file: PathBuf,
    book: TicketBook,
    state: u64,
    wait: Wait,
    _host: Option<FileLock>,
}

impl TicketStore {
    /// Opens the book for a host, alone, until it is dropped. A new one is made if there is none, with a certificate of
    /// its own.
    ///
    /// # Errors
    /// [`StoreError`].
    pub fn open_host(file: &Path, host: &PlainName, wait: Wait) -> Result<Self, StoreError> {
        let file = private_file::place(file)?;
        let lock = FileLock::take(&file, HOST_LOCK)?.ok_or_else(|| StoreError::HostRuns(file.clone()))?;
        Self::opened(file, host, wait, Some(lock))
    }

    /// Opens the book for a command, also while a host runs with it. A new one is made if there is none.
    ///
    /// # Errors
    /// [`StoreError`].
    pub fn open(file: &Path, host: &PlainName, wait: Wait) -> Result<Self, StoreError> {
        Self::opened(private_file::place(file)?, host, wait, None)
    }

    fn opened(
        file: PathBuf,
        host: &PlainName,
        wait: Wait,
        lock: Option<FileLock>,
    ) -> Result<Self, StoreError> {
        let _edit = edit_lock(&file, wait)?;
        let (state, book) = match read(&file)? {
            Some(kept) => kept,
            None => {
                let book = TicketBook::new(Identity::create(host)?);
                write(&file, 1, &book)?;
                (1, book)
            }
        };
        Ok(Self { file, book, state, wait, _host: lock })
    }

    /// The book as it was read last.
    pub fn book(&self) -> &TicketBook {
        &self.book
    }

    /// Where it is kept, without links.
    pub fn file(&self) -> &Path {
        &self.file
    }

    /// Reads what others have changed; whether they have. It costs two system calls and 24 bytes if they have not.
    ///
    /// # Errors
    /// [`StoreError`]; the book is then as it was.
    pub fn refresh(&mut self) -> Result<bool, StoreError> {
        let replaced = |what| StoreError::Replaced { file: self.file.clone(), what };
        if state_of(&self.file)? == Some(self.state) {
            return Ok(false);
        }
        let (state, book) = read(&self.file)?.ok_or_else(|| replaced("removed"))?;
        if book.identity() != self.book.identity() {
            return Err(replaced("replaced by that of another host"));
        }
        if state < self.state {
            return Err(replaced("replaced by an older copy of it"));
        }
        (self.state, self.book) = (state, book);
        Ok(true)
    }

    /// Gives out a ticket: see [`TicketBook::issue`].
    ///
    /// # Errors
    /// [`StoreError`] of the file, and [`IssueError`] within.
    pub fn issue(
        &mut self,
        offer: Offer,
        now: u64,
        random: &dyn SecureRandom,
    ) -> Result<Result<(TicketId, Ticket), IssueError>, StoreError> {
        self.edit(|book| book.issue(offer, now, random))
    }

    /// Lets a station in by its token, once: see [`TicketBook::redeem`]. When it returns, the disk knows that the token
    /// is spent. Of several calls with one token, in whatever processes, one succeeds.
    ///
    /// # Errors
    /// [`StoreError`] of the file, after which the station must not be let in, and [`Refused`] within.
    pub fn redeem(
        &mut self,
        token: &Token,
        station: u16,
        resume: &ResumeSecret,
        now: impl Into<HostTime>,
    ) -> Result<Result<Admission, Refused>, StoreError> {
        self.edit(|book| book.redeem(token, station, resume, now))
    }

    /// Lets a station come back: see [`TicketBook::resume`]. What was withdrawn in another process is withdrawn here.
    ///
    /// # Errors
    /// [`StoreError`] of the file, and [`Refused`] within.
    pub fn resume(
        &mut self,
        secret: &ResumeSecret,
        now: impl Into<HostTime>,
    ) -> Result<Result<Admission, Refused>, StoreError> {
        self.refresh()?;
        Ok(self.book.resume(secret, now))
    }

    /// Withdraws tickets: see [`TicketBook::revoke`].
    ///
    /// # Errors
    /// [`StoreError`] of the file, and [`RevokeError`] within.
    pub fn revoke(&mut self, whom: &Whom, now: u64) -> Result<Result<Revoked, RevokeError>, StoreError> {
        self.edit(|book| book.revoke(whom, now))
    }

    /// Changes the newest state of the book and brings it to the disk; a change that fails changes nothing.
    fn edit<T, E>(
        &mut self,
        change: impl FnOnce(&mut TicketBook) -> Result<T, E>,
    ) -> Result<Result<T, E>, StoreError> {
        let _edit = edit_lock(&self.file, self.wait)?;
        self.refresh()?;
        let mut changed = self.book.clone();
        let result = match change(&mut changed) {
            Ok(result) => result,
            Err(error) => return Ok(Err(error)),
        };
        // The number counts in one process after the other, and cannot reach its end.
        let state = self.state.saturating_add(1);
        write(&self.file, state, &changed)?;
        (self.state, self.book) = (state, changed);
        Ok(Ok(result))
    }
}

fn edit_lock(file: &Path, wait: Wait) -> Result<FileLock, StoreError> {
    let mut tries = 0;
    loop {
        if let Some(lock) = FileLock::take(file, EDIT_LOCK)? {
            return Ok(lock);
        }
        if !wait(tries) {
            return Err(StoreError::Busy(file.to_owned()));
        }
        tries = tries.saturating_add(1);
    }
}

pub(super) fn write(file: &Path, state: u64, book: &TicketBook) -> Result<(), StoreError> {
    let content = book.encode().map_err(|error| damaged(file, error))?;
    let mut bytes = Vec::with_capacity(HEADER_BYTES + content.len() + CHECKSUM_BYTES);
    bytes.extend(MAGIC);
    bytes.extend(VERSION.to_le_bytes());
    // The number of entries and their sizes are limited to far fewer bytes.
    bytes.extend((content.len() as u32).to_le_bytes());
    bytes.extend(state.to_le_bytes());
    bytes.extend(content);
    let checksum = blake3::hash(&bytes);
    bytes.extend(checksum.as_bytes());
    Ok(private_file::write(file, &bytes)?)
}

/// State and book; `None` when there is no file.
fn read(file: &Path) -> Result<Option<(u64, TicketBook)>, StoreError> {
    private_file::read(file, STORE_BYTES_MAX)?.map(|bytes| decode(file, &bytes)).transpose()
}

pub(super) fn decode(file: &Path, bytes: &[u8]) -> Result<(u64, TicketBook), StoreError> {
    let mut from = ByteReader(bytes);
    if from.array() != Some(MAGIC) {
        return Err(StoreError::NoBook(file.to_owned()));
    }
    let version = from.array().map(u32::from_le_bytes);
    if let Some(found) = version.filter(|found| *found > VERSION) {
        return Err(StoreError::NewerVersion { file: file.to_owned(), found });
    }
    let cut_off = || damaged(file, "its end is missing");
    let count = from.array().map(u32::from_le_bytes).ok_or_else(cut_off)?;
    let state = from.array().map(u64::from_le_bytes).ok_or_else(cut_off)?;
    let content = from.bytes(count as usize).ok_or_else(cut_off)?;
    let checksum: [u8; CHECKSUM_BYTES] = from.array().ok_or_else(cut_off)?;
    let checked = &bytes[..HEADER_BYTES + content.len()];
    if blake3::hash(checked) != checksum || version != Some(VERSION) || !from.0.is_empty() {
        return Err(damaged(file, "its checksum is wrong"));
    }
    Ok((state, TicketBook::decode(content).map_err(|error| damaged(file, error))?))
}

/// The number of the state on disk; `None` when there is none, or it cannot be told.
fn state_of(file: &Path) -> Result<Option<u64>, StoreError> {
    let mut header = [0; HEADER_BYTES];
    let Some(mut opened) = private_file::open(file)? else { return Ok(None) };
    if opened.read_exact(&mut header).is_err() {
        return Ok(None);
    }
    let (before, state) = header.split_at(HEADER_BYTES - 8);
    Ok(state.try_into().ok().map(u64::from_le_bytes).filter(|_| before.starts_with(&MAGIC)))
}

fn damaged(file: &Path, why: impl ToString) -> StoreError {
    StoreError::Damaged { file: file.to_owned(), why: why.to_string() }
}
