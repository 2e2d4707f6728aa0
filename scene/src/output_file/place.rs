//! What is at a place: nothing, a regular file, a stream, or what no result can be written to.

use std::fs::{self, File, Metadata};
use std::io;
use std::path::{Path, PathBuf};

use super::error::{Reason, Replace};

/// Stands for stdout in the place of a file name.
pub const STDOUT: &str = "-";

/// What is at a place.
pub(super) enum Place {
    Nothing,
    /// `path` leads to the file without a link.
    Regular {
        path: PathBuf,
        metadata: Metadata,
    },
    /// A FIFO or a character device.
    Stream,
    Stdout,
}

impl Place {
    pub(super) fn of(file: &Path) -> Result<Self, Reason> {
        if file == Path::new(STDOUT) {
            return Ok(Self::Stdout);
        }
        match fs::symlink_metadata(file) {
            Ok(_) => {}
            Err(error) if error.kind() == io::ErrorKind::NotFound => {
                let folder = file.parent().filter(|folder| !folder.as_os_str().is_empty());
                return match folder {
                    Some(folder) if !folder.is_dir() => Err(Reason::NoFolder(folder.to_owned())),
                    _ => Ok(Self::Nothing),
                };
            }
            Err(error) => return Err(error.into()),
        }
        let metadata = fs::metadata(file).map_err(|error| match error.kind() {
            io::ErrorKind::NotFound => Reason::DeadLink,
            _ => error.into(),
        })?;
        match kind(&metadata) {
            Kind::Regular => Ok(Self::Regular { path: fs::canonicalize(file)?, metadata }),
            Kind::Stream => Ok(Self::Stream),
            Kind::Other(what) => Err(Reason::Kind(what)),
        }
    }
}

enum Kind {
    Regular,
    Stream,
    Other(&'static str),
}

#[cfg(unix)]
fn kind(metadata: &Metadata) -> Kind {
    use std::os::unix::fs::FileTypeExt;
    let kind = metadata.file_type();
    match () {
        () if kind.is_file() => Kind::Regular,
        () if kind.is_fifo() || kind.is_char_device() => Kind::Stream,
        () if kind.is_dir() => Kind::Other("a directory"),
        () if kind.is_block_device() => Kind::Other("a block device"),
        () if kind.is_socket() => Kind::Other("a socket"),
        () => Kind::Other("no file"),
    }
}

#[cfg(not(unix))]
fn kind(metadata: &Metadata) -> Kind {
    match metadata.is_dir() {
        true => Kind::Other("a directory"),
        false => Kind::Regular,
    }
}

/// Whether the regular file at a place may be replaced.
pub(super) fn may_replace(metadata: &Metadata, replace: Replace) -> Result<(), Reason> {
    // The mode is asked rather than the system, which lets root write to anything.
    match (replace, metadata.permissions().readonly()) {
        (Replace::Never, true) => Err(Reason::ExistsProtected),
        (Replace::Never, false) => Err(Reason::Exists),
        (Replace::Writable, true) => Err(Reason::ReadOnly),
        (Replace::Writable, false) | (Replace::Always, _) => Ok(()),
    }
}

/// A FIFO or device, opened without waiting for a reader, and then written to as any other file.
#[cfg(unix)]
pub(super) fn open_stream(file: &Path) -> Result<File, Reason> {
    use rustix::fs::{OFlags, fcntl_getfl, fcntl_setfl};
    use std::os::unix::fs::{FileTypeExt, OpenOptionsExt};
    let flags = (OFlags::NONBLOCK | OFlags::NOCTTY).bits().cast_signed();
    let opened = File::options().write(true).custom_flags(flags).open(file).map_err(|error| {
        let is_fifo = fs::metadata(file).is_ok_and(|found| found.file_type().is_fifo());
        let lacks_reader = error.raw_os_error() == Some(rustix::io::Errno::NXIO.raw_os_error());
        if is_fifo && lacks_reader { Reason::NoReader } else { error.into() }
    })?;
    let flags = fcntl_getfl(&opened).map_err(io::Error::from)?;
    fcntl_setfl(&opened, flags - OFlags::NONBLOCK).map_err(io::Error::from)?;
    Ok(opened)
}

#[cfg(not(unix))]
pub(super) fn open_stream(file: &Path) -> Result<File, Reason> {
    Ok(File::options().write(true).open(file)?)
}

#[cfg(unix)]
pub(super) fn stdout() -> io::Result<File> {
    use std::os::fd::AsFd;
    io::stdout().as_fd().try_clone_to_owned().map(File::from)
}

#[cfg(windows)]
pub(super) fn stdout() -> io::Result<File> {
    use std::os::windows::io::AsHandle;
    io::stdout().as_handle().try_clone_to_owned().map(File::from)
}

#[cfg(not(any(unix, windows)))]
pub(super) fn stdout() -> io::Result<File> {
    Err(io::ErrorKind::Unsupported.into())
}
