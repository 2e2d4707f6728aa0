//! Files with secrets: only their owner can read them, they are whole or not there, and one process writes at a time.
//!
//! A file is written beside its place, brought to the disk, and takes its place by a rename: whoever is killed in between
//! leaves the old one. What a killed writer left beside it is removed by the next one, who holds the lock.

use std::fs::{self, File, TryLockError};
use std::io::{self, Read, Write};
use std::path::{Path, PathBuf};

use thiserror::Error;

/// Why a private file cannot be read or written.
#[derive(Debug, Error)]
#[error("{}: {reason}", file.display())]
pub struct PrivateFileError {
    /// The file.
    pub file: PathBuf,
    /// What is wrong with it.
    pub reason: PrivateFileReason,
}

/// What is wrong with a private file.
#[derive(Debug, Error)]
pub enum PrivateFileReason {
    /// Others may read or write it.
    #[error(
        "its mode is {0:03o}, so other users may know the secrets in it; let nobody but you read it with 'chmod 600', or, \
         if others can have read it, move it away to start anew"
    )]
    Mode(u32),
    /// It is somebody else's.
    #[error("it belongs to another user (number {0}); run as that user, or name another file")]
    Owner(u32),
    /// It is a directory or a device.
    #[error("it is no regular file; name another file")]
    Kind,
    /// It is too large for what it should be.
    #[error(
        "it has more than {0} bytes, so it is no such file; name another one, or move it away to start anew"
    )]
    TooLarge(u64),
    /// The system refuses.
    #[error(transparent)]
    System(#[from] io::Error),
}

/// A file that exists, opened for reading after its owner and mode were checked; `None` when there is none.
///
/// # Errors
/// [`PrivateFileError`].
pub fn open(file: &Path) -> Result<Option<File>, PrivateFileError> {
    let opened = || {
        match fs::metadata(file) {
            // Opening a FIFO would wait for its writer.
            Ok(found) if !found.is_file() => return Err(PrivateFileReason::Kind),
            Ok(_) => {}
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(None),
            Err(error) => return Err(error.into()),
        }
        let opened = match File::open(file) {
            Ok(opened) => opened,
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(None),
            Err(error) => return Err(error.into()),
        };
        check_owner(&opened)?;
        Ok(Some(opened))
    };
    opened().map_err(|reason| reason.of(file))
}

/// The bytes of a file, at most `bytes_max`; `None` when there is none.
///
/// # Errors
/// [`PrivateFileError`].
pub fn read(file: &Path, bytes_max: u64) -> Result<Option<Vec<u8>>, PrivateFileError> {
    let Some(opened) = open(file)? else { return Ok(None) };
    let mut bytes = Vec::new();
    let read = opened.take(bytes_max + 1).read_to_end(&mut bytes);
    read.map_err(|error| PrivateFileReason::from(error).of(file))?;
    if bytes.len() as u64 > bytes_max {
        return Err(PrivateFileReason::TooLarge(bytes_max).of(file));
    }
    Ok(Some(bytes))
}

/// Writes a whole file of mode 0600, or leaves the old one. On return it is on the disk, rename included.
///
/// Only one process may write a file at a time: see [`FileLock`].
///
/// # Errors
/// [`PrivateFileError`].
pub fn write(file: &Path, bytes: &[u8]) -> Result<(), PrivateFileError> {
    let part = write_beside(file, bytes)?;
    let moved = fs::rename(&part, file).and_then(|()| sync_folder(file));
    moved.map_err(|error| PrivateFileReason::from(error).of(file))
}

/// The new bytes beside the place of their file, and on the disk.
pub(super) fn write_beside(file: &Path, bytes: &[u8]) -> Result<PathBuf, PrivateFileError> {
    let part = named(file, ".part");
    let written = || -> Result<(), PrivateFileReason> {
        match fs::remove_file(&part) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(error.into()),
            _ => {}
        }
        // Follows no link, and fails when something is there again.
        let mut new = private().write(true).create_new(true).open(&part)?;
        let done = new.write_all(bytes).and_then(|()| new.sync_all());
        if done.is_err() {
            let _ = fs::remove_file(&part);
        }
        Ok(done?)
    };
    written().map_err(|reason| reason.of(&part))?;
    Ok(part)
}

/// The place of a file, without links and `..`, in a folder that is made for its owner alone if there is none.
///
/// # Errors
/// [`PrivateFileError`].
pub fn place(file: &Path) -> Result<PathBuf, PrivateFileError> {
    let placed = || {
        if let Ok(place) = fs::canonicalize(file) {
            return Ok(place);
        }
        let (Some(folder), Some(name)) = (file.parent(), file.file_name()) else {
            return Err(PrivateFileReason::Kind);
        };
        let folder = if folder.as_os_str().is_empty() { Path::new(".") } else { folder };
        make_folder(folder)?;
        Ok(fs::canonicalize(folder)?.join(name))
    };
    placed().map_err(|reason| reason.of(file))
}

/// A lock that one process at a time can hold, on a file of its own beside the one that it protects: that one is replaced
/// at each write. The system gives it back when the process ends, however it ends. Its file stays.
#[derive(Debug)]
pub struct FileLock {
    _held: File,
}

impl FileLock {
    /// Takes the lock that is named by the file and an ending; `None` when another process, or somebody else in this
    /// one, has it.
    ///
    /// # Errors
    /// [`PrivateFileError`], also where the file system has no locks.
    pub fn take(file: &Path, ending: &str) -> Result<Option<Self>, PrivateFileError> {
        let path = named(file, ending);
        let taken = || -> Result<Option<Self>, PrivateFileReason> {
            let held = private().read(true).write(true).create(true).truncate(false).open(&path)?;
            match held.try_lock() {
                Ok(()) => Ok(Some(Self { _held: held })),
                Err(TryLockError::WouldBlock) => Ok(None),
                Err(TryLockError::Error(error)) => Err(error.into()),
            }
        };
        taken().map_err(|reason| reason.of(&path))
    }
}

impl PrivateFileReason {
    fn of(self, file: &Path) -> PrivateFileError {
        PrivateFileError { file: file.to_owned(), reason: self }
    }
}

fn named(file: &Path, ending: &str) -> PathBuf {
    let mut name = file.as_os_str().to_owned();
    name.push(ending);
    name.into()
}

#[cfg(unix)]
fn private() -> fs::OpenOptions {
    use rustix::fs::OFlags;
    use std::os::unix::fs::OpenOptionsExt;
    let mut options = File::options();
    options.mode(0o600).custom_flags(OFlags::NOFOLLOW.bits().cast_signed());
    options
}

#[cfg(not(unix))]
fn private() -> fs::OpenOptions {
    File::options()
}

#[cfg(unix)]
fn check_owner(opened: &File) -> Result<(), PrivateFileReason> {
    use std::os::unix::fs::MetadataExt;
    let found = opened.metadata()?;
    // A file that root replaced would be root's, and lost to its owner.
    if found.uid() != rustix::process::geteuid().as_raw() {
        return Err(PrivateFileReason::Owner(found.uid()));
    }
    match found.mode() & 0o777 {
        mode if mode & 0o077 != 0 => Err(PrivateFileReason::Mode(mode)),
        _ => Ok(()),
    }
}

/// Elsewhere the folder of the user keeps others away.
#[cfg(not(unix))]
fn check_owner(_: &File) -> Result<(), PrivateFileReason> {
    Ok(())
}

#[cfg(unix)]
fn make_folder(folder: &Path) -> io::Result<()> {
    use std::os::unix::fs::DirBuilderExt;
    fs::DirBuilder::new().recursive(true).mode(0o700).create(folder)
}

#[cfg(not(unix))]
fn make_folder(folder: &Path) -> io::Result<()> {
    fs::create_dir_all(folder)
}

/// So that the rename survives a loss of power.
#[cfg(unix)]
fn sync_folder(file: &Path) -> io::Result<()> {
    match file.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => File::open(folder)?.sync_all(),
        _ => File::open(".")?.sync_all(),
    }
}

#[cfg(not(unix))]
fn sync_folder(_: &Path) -> io::Result<()> {
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn folder() -> tempfile::TempDir {
        tempfile::tempdir().expect("a folder")
    }

    #[cfg(unix)]
    fn set_mode(file: &Path, mode: u32) {
        use std::os::unix::fs::PermissionsExt;
        fs::set_permissions(file, fs::Permissions::from_mode(mode)).expect("a mode");
    }

    #[cfg(unix)]
    #[test]
    fn a_private_file_and_its_folder_and_lock_are_for_the_owner_alone() {
        use std::os::unix::fs::PermissionsExt;
        let folder = folder();
        let file = place(&folder.path().join("a/b/book")).expect("a place");
        write(&file, b"one").expect("it is written");
        write(&file, b"two").expect("it is replaced");
        let _lock = FileLock::take(&file, ".lock").expect("a lock").expect("it is free");
        let mode = |path: &Path| fs::metadata(path).expect("it is there").permissions().mode() & 0o777;
        assert_eq!(mode(&file), 0o600);
        assert_eq!(mode(&named(&file, ".lock")), 0o600);
        assert_eq!(mode(file.parent().expect("a folder")), 0o700);
        assert_eq!(read(&file, 3).expect("it is read").as_deref(), Some(&b"two"[..]));
        assert!(!named(&file, ".part").exists());
    }

    #[cfg(unix)]
    #[test]
    fn a_file_that_others_can_read_is_refused_and_left_as_it_is() {
        let folder = folder();
        let file = folder.path().join("book");
        write(&file, b"one").expect("it is written");
        for mode in [0o640, 0o604, 0o620, 0o666] {
            set_mode(&file, mode);
            let refused = read(&file, 10).expect_err("it is refused");
            assert!(matches!(refused.reason, PrivateFileReason::Mode(found) if found == mode));
            assert!(refused.to_string().contains("chmod 600"), "{refused}");
        }
        set_mode(&file, 0o400);
        assert_eq!(read(&file, 3).expect("it is read").as_deref(), Some(&b"one"[..]));
    }

    #[test]
    fn a_writer_killed_before_the_rename_leaves_the_old_file() {
        let folder = folder();
        let file = folder.path().join("book");
        write(&file, b"old").expect("it is written");
        // Everything but the rename, as if killed then; and in the middle of writing.
        write_beside(&file, b"new").expect("it is written");
        assert_eq!(read(&file, 3).expect("it is read").as_deref(), Some(&b"old"[..]));
        fs::write(named(&file, ".part"), b"n").expect("half a file");
        write(&file, b"next").expect("the next one is written");
        assert_eq!(read(&file, 4).expect("it is read").as_deref(), Some(&b"next"[..]));
    }

    #[test]
    fn what_is_too_large_or_no_file_is_refused_and_what_is_not_there_is_none() {
        let folder = folder();
        let file = folder.path().join("book");
        assert!(read(&file, 10).expect("no error").is_none());
        write(&file, b"four").expect("it is written");
        let large = read(&file, 3).expect_err("it is too large");
        assert!(matches!(large.reason, PrivateFileReason::TooLarge(3)));
        let kind = read(folder.path(), 3).expect_err("it is a folder");
        assert!(matches!(kind.reason, PrivateFileReason::Kind));
    }

    #[test]
    fn a_lock_is_held_once_and_is_free_again() {
        let folder = folder();
        let file = folder.path().join("book");
        let held = FileLock::take(&file, ".lock").expect("a lock");
        assert!(held.is_some());
        assert!(FileLock::take(&file, ".lock").expect("no error").is_none());
        assert!(FileLock::take(&file, ".host").expect("no error").is_some(), "another lock");
        drop(held);
        assert!(FileLock::take(&file, ".lock").expect("a lock").is_some());
    }
}
