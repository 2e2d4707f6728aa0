//! A place that one process alone writes to, and a result in the making beside it.

use std::fs::{self, File, Metadata, Permissions};
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use super::error::{OutputError, PARTS_MAX, Reason, Replace};
use super::place::{Place, may_replace, open_stream, stdout};

/// Longest name from which that of a part is made \[bytes\]: most systems take 255.
const NAME_MAX: usize = 200;

/// Takes a file for this process until it is closed; `false` when another one has it. Where files cannot be locked, and on
/// Windows, where a lock would keep the writer away as well, every file can be taken.
fn lock(file: &File) -> bool {
    !cfg!(unix) || !matches!(file.try_lock(), Err(fs::TryLockError::WouldBlock))
}

#[cfg(unix)]
fn is_same(file: &File, at: &Metadata) -> bool {
    use std::os::unix::fs::MetadataExt;
    file.metadata().is_ok_and(|ours| (ours.dev(), ours.ino()) == (at.dev(), at.ino()))
}

#[cfg(not(unix))]
fn is_same(_: &File, _: &Metadata) -> bool {
    true
}

/// A place that only this process writes to, from the check to the result. The system gives it back when the process ends.
#[derive(Debug)]
pub struct Claim {
    file: PathBuf,
    held: Held,
}

#[derive(Debug)]
enum Held {
    /// There was nothing: an empty file holds the place.
    Empty(File),
    /// The file at the place is the result. Its lock stays as long as this handle.
    Filled {
        _lock: Option<File>,
    },
    /// A regular file is to be replaced; `path` leads to it without a link.
    Old {
        path: PathBuf,
        permissions: Permissions,
        _lock: Option<File>,
    },
    Stream(File),
}

impl Claim {
    /// Takes a place. Check and claim are one step: of two processes only one gets it.
    ///
    /// # Errors
    /// [`OutputError`].
    pub fn take(file: &Path, replace: Replace) -> Result<Self, OutputError> {
        let held = || match Place::of(file)? {
            Place::Stdout => Ok(Held::Stream(stdout()?)),
            Place::Stream => Ok(Held::Stream(open_stream(file)?)),
            Place::Nothing => Self::hold_nothing(file),
            Place::Regular { path, metadata } => Self::hold_old(path, &metadata, replace),
        };
        Ok(Self { file: file.to_owned(), held: held().map_err(|reason| reason.of(file))? })
    }

    fn hold_nothing(file: &Path) -> Result<Held, Reason> {
        // Fails when anything is there, and follows no link.
        let empty =
            File::options().write(true).create_new(true).open(file).map_err(|error| match error.kind() {
                io::ErrorKind::AlreadyExists => Reason::Exists,
                _ => error.into(),
            })?;
        if lock(&empty) {
            return Ok(Held::Empty(empty));
        }
        // A process that overwrites has taken the new file for an old one.
        Err(Reason::Taken)
    }

    fn hold_old(path: PathBuf, metadata: &Metadata, replace: Replace) -> Result<Held, Reason> {
        if replace == Replace::Never && metadata.len() == 0 {
            return Self::hold_abandoned(path, metadata);
        }
        // One that cannot be read cannot be locked either.
        let lock_held = File::open(&path).ok();
        if lock_held.as_ref().is_some_and(|old| !lock(old)) {
            return Err(Reason::Taken);
        }
        may_replace(metadata, replace)?;
        Ok(Held::Old { path, permissions: metadata.permissions(), _lock: lock_held })
    }

    /// An empty file is no result: it is what a process leaves that was killed while it held the place, and the next one
    /// may have it. One that somebody holds, or of which no system tells whether, stays.
    fn hold_abandoned(path: PathBuf, metadata: &Metadata) -> Result<Held, Reason> {
        if metadata.permissions().readonly() {
            return Err(Reason::ExistsProtected);
        }
        let Ok(empty) = File::open(&path) else { return Err(Reason::Exists) };
        let is_ours = cfg!(unix) && empty.try_lock().is_ok();
        // Its holder may have filled it or given it up since.
        let is_empty = fs::symlink_metadata(&path).is_ok_and(|at| at.len() == 0 && is_same(&empty, &at));
        if !(is_ours && is_empty) {
            return Err(Reason::Exists);
        }
        Ok(Held::Old { path, permissions: metadata.permissions(), _lock: Some(empty) })
    }

    /// The place, as it was named.
    pub fn file(&self) -> &Path {
        &self.file
    }

    /// Whether it is a FIFO, a device or stdout, so that nothing can be changed in it afterwards.
    pub fn is_stream(&self) -> bool {
        matches!(self.held, Held::Stream(_))
    }

    /// Whether a file at the place is to be replaced.
    pub fn replaces(&self) -> bool {
        matches!(self.held, Held::Old { .. })
    }

    /// The place is filled: its file is no longer removed with the claim.
    pub fn keep(&mut self) {
        if matches!(self.held, Held::Empty(_))
            && let Held::Empty(file) = std::mem::replace(&mut self.held, Held::Filled { _lock: None })
        {
            self.held = Held::Filled { _lock: Some(file) };
        }
    }

    /// Writes the whole result or nothing.
    ///
    /// # Errors
    /// [`OutputError`]; what was at the place is as it was then.
    pub fn write(self, bytes: &[u8]) -> Result<(), OutputError> {
        let mut part = self.part()?;
        part.file.write_all(bytes).map_err(|error| Reason::from(error).of(part.place()))?;
        part.finish()
    }

    /// Begins the result beside its place.
    ///
    /// # Errors
    /// [`OutputError`].
    pub fn part(self) -> Result<Part, OutputError> {
        let begun = || match &self.held {
            Held::Stream(stream) => Ok((stream.try_clone()?, None)),
            held => {
                let (file, path) = beside(self.target(held))?;
                Ok((file, Some(path)))
            }
        };
        let (file, path) = begun().map_err(|reason: Reason| reason.of(&self.file))?;
        Ok(Part { claim: self, file, path })
    }

    fn target<'a>(&'a self, held: &'a Held) -> &'a Path {
        match held {
            Held::Old { path, .. } => path,
            Held::Empty(_) | Held::Filled { .. } | Held::Stream(_) => &self.file,
        }
    }
}

impl Drop for Claim {
    fn drop(&mut self) {
        // A place that was never filled is free again, unless somebody else has filled it.
        if let Held::Empty(empty) = &self.held
            && fs::symlink_metadata(&self.file).is_ok_and(|at| is_same(empty, &at))
        {
            let _ = fs::remove_file(&self.file);
        }
    }
}

/// A new file beside the place, with a name of its own; it follows no link that lies under that name.
fn beside(target: &Path) -> Result<(File, PathBuf), Reason> {
    let name = target.file_name().unwrap_or_default();
    let name = if name.len() > NAME_MAX { "trocar".as_ref() } else { name };
    let mut tried = PathBuf::new();
    for number in 0..PARTS_MAX {
        let mut part = name.to_owned();
        part.push(format!(".{number}.part"));
        tried = target.with_file_name(part);
        match File::options().read(true).write(true).create_new(true).open(&tried) {
            Ok(file) => {
                lock(&file);
                return Ok((file, tried));
            }
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {}
            Err(error) => return Err(error.into()),
        }
    }
    Err(Reason::Parts(tried))
}

/// A result in the making. Dropped before it is finished, it leaves everything as it was.
#[derive(Debug)]
pub struct Part {
    claim: Claim,
    file: File,
    /// Its own name; `None` for a stream, and once it has taken its place.
    path: Option<PathBuf>,
}

impl Part {
    /// What is written to.
    pub fn file(&self) -> &File {
        &self.file
    }

    /// Where it is now.
    pub fn path(&self) -> &Path {
        self.path.as_deref().unwrap_or(&self.claim.file)
    }

    /// The place that it is for, as it was named.
    pub fn place(&self) -> &Path {
        &self.claim.file
    }

    /// Whether it goes straight into a FIFO, a device or stdout.
    pub fn is_stream(&self) -> bool {
        self.claim.is_stream()
    }

    /// Lets it take its place. It may grow further there.
    ///
    /// # Errors
    /// [`OutputError`]; what was at the place is as it was then.
    pub fn finish(&mut self) -> Result<(), OutputError> {
        let Some(path) = &self.path else { return Ok(()) };
        let target = self.claim.target(&self.claim.held);
        let moved = || {
            // Some disks say only now that they are full.
            self.file.sync_all()?;
            match (&self.claim.held, fs::symlink_metadata(target)) {
                (_, Err(error)) if error.kind() == io::ErrorKind::NotFound => {}
                (_, Err(error)) => return Err(error.into()),
                (_, Ok(at)) if !at.is_file() => return Err(Reason::Kind("no regular file any more")),
                // Somebody else has written there in the meantime.
                (Held::Empty(empty), Ok(at)) if !is_same(empty, &at) || at.len() > 0 => {
                    return Err(Reason::Exists);
                }
                (Held::Old { permissions, .. }, Ok(_)) => {
                    // Where a mode cannot be set, the new file is as new files are.
                    let _ = self.file.set_permissions(permissions.clone());
                }
                _ => {}
            }
            Ok(fs::rename(path, target)?)
        };
        moved().map_err(|reason: Reason| reason.of(&self.claim.file))?;
        self.path = None;
        self.claim.keep();
        Ok(())
    }
}

impl Drop for Part {
    fn drop(&mut self) {
        if let Some(path) = &self.path {
            // An incomplete result is removed.
            let _ = fs::remove_file(path);
        }
    }
}
