//! Size limits of mesh files, and bounded reading.

use std::fs::File;
use std::io::Read;
use std::path::Path;

use super::error::{FilePosition, MeshError};

/// Size limits of a mesh file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Limits {
    /// Size of a file \[bytes\], and of everything it refers to.
    pub bytes: u64,
    /// Vertices of a mesh.
    pub vertices: u64,
    /// Triangles or tetrahedra of a mesh, and elements of any kind in its file.
    pub elements: u64,
}

impl Default for Limits {
    fn default() -> Self {
        Self { bytes: 256 << 20, vertices: 4_000_000, elements: 16_000_000 }
    }
}

/// Reads the whole file, unless it exceeds the limit (even if it grows while it is read).
pub(super) fn read_bytes(file: &Path, limits: &Limits) -> Result<Vec<u8>, MeshError> {
    let io = |source| MeshError::Io { file: file.into(), source };
    let too_large = |count| MeshError::TooLarge {
        file: file.into(),
        place: FilePosition::Whole,
        what: "bytes",
        count,
        limit: limits.bytes,
    };
    let handle = File::open(file).map_err(io)?;
    let metadata = handle.metadata().map_err(io)?;
    if !metadata.is_file() {
        return Err(io(std::io::Error::new(std::io::ErrorKind::InvalidInput, "not a regular file")));
    }
    if metadata.len() > limits.bytes {
        return Err(too_large(metadata.len()));
    }
    let mut bytes = Vec::with_capacity(metadata.len() as usize);
    handle.take(limits.bytes.saturating_add(1)).read_to_end(&mut bytes).map_err(io)?;
    if bytes.len() as u64 > limits.bytes {
        return Err(too_large(bytes.len() as u64));
    }
    Ok(bytes)
}
