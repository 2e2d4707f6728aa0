//! Binary format of a compliance: a header that identifies its body, the numbers, and a checksum over both.
//! Little-endian.
//!
//! | bytes | what |
//! |---|---|
//! | 8 | `TROCARK1`: magic number with the version of the format |
//! | 8 | fingerprint of mesh, material and fixed nodes |
//! | 8 | free surface nodes, n |
//! | 4 n | their numbers, ascending |
//! | 36 n² | the entries as f32, by rows |
//! | 8 | checksum of everything before |

use std::io::{self, Read, Write};

use thiserror::Error;
use trocar_dynamics::elasticity::Elastic;
use trocar_dynamics::tet_mesh::TetMesh;

use super::compliance::{Boundary, Compliance, Limits, PrecomputeError};

const MAGIC: [u8; 8] = *b"TROCARK1";
/// Bytes read or written at once.
const CHUNK: usize = 1 << 16;

/// Why bytes are not the requested compliance.
#[derive(Debug, Error)]
pub enum BytesError {
    /// The file could not be read or written, or ended too early.
    #[error("the compliance could not be read or written: {0}")]
    Io(#[from] io::Error),
    /// Another format or version.
    #[error("these bytes are no compliance of this version: they begin with {0:?}, not with \"TROCARK1\"")]
    Magic([u8; 8]),
    /// A compliance of another mesh, material or boundary.
    #[error(
        "the compliance belongs to another mesh, material or boundary: its fingerprint is {found:016x}, not {expected:016x}"
    )]
    Fingerprint {
        /// Fingerprint in the file.
        found: u64,
        /// Fingerprint requested.
        expected: u64,
    },
    /// A damaged file.
    #[error("the compliance is damaged: {0}")]
    Damaged(&'static str),
    /// The requested body is invalid.
    #[error(transparent)]
    Boundary(#[from] PrecomputeError),
}

/// FNV-1a over words of eight bytes, to detect accidental changes, not deliberate ones.
#[derive(Clone, Copy)]
struct Fnv(u64);

impl Fnv {
    fn new() -> Self {
        Self(0xcbf2_9ce4_8422_2325)
    }

    fn word(&mut self, word: u64) {
        // Multiplication carries upwards only: the rotation brings high bits back down.
        self.0 = (self.0 ^ word).wrapping_mul(0x0000_0100_0000_01b3).rotate_left(29);
    }

    fn bytes(&mut self, bytes: &[u8]) {
        for chunk in bytes.chunks(8) {
            let mut word = [0; 8];
            word[..chunk.len()].copy_from_slice(chunk);
            self.word(u64::from_le_bytes(word));
        }
    }
}

/// Fingerprint of everything that a compliance depends on.
pub(super) fn fingerprint(mesh: &TetMesh, material: &Elastic, fixed: &[u32]) -> u64 {
    let mut hash = Fnv::new();
    hash.word(mesh.rest().len() as u64);
    for point in mesh.rest() {
        point.iter().for_each(|x| hash.word(x.to_bits()));
    }
    hash.word(mesh.tets().len() as u64);
    for [a, b, c, d] in mesh.tets() {
        hash.word(u64::from(*a) << 32 | u64::from(*b));
        hash.word(u64::from(*c) << 32 | u64::from(*d));
    }
    hash.word(material.young_modulus().to_bits());
    hash.word(material.poisson_ratio().to_bits());
    let mut fixed = fixed.to_vec();
    fixed.sort_unstable();
    fixed.dedup();
    fixed.iter().for_each(|&node| hash.word(u64::from(node)));
    hash.0
}

impl Compliance {
    /// Writes the compliance.
    ///
    /// # Errors
    /// Errors of the writer.
    pub fn write(&self, out: &mut dyn Write) -> io::Result<()> {
        let mut hash = Fnv::new();
        let mut put = |bytes: &[u8]| {
            hash.bytes(bytes);
            out.write_all(bytes)
        };
        put(&MAGIC)?;
        put(&self.fingerprint.to_le_bytes())?;
        put(&(self.nodes.len() as u64).to_le_bytes())?;
        let mut buffer = Vec::with_capacity(CHUNK);
        for nodes in self.nodes.chunks(CHUNK / 4) {
            buffer.clear();
            nodes.iter().for_each(|node| buffer.extend_from_slice(&node.to_le_bytes()));
            put(&buffer)?;
        }
        for entries in self.entries.chunks(CHUNK / 4) {
            buffer.clear();
            entries.iter().for_each(|entry| buffer.extend_from_slice(&entry.to_le_bytes()));
            put(&buffer)?;
        }
        out.write_all(&hash.0.to_le_bytes())
    }

    /// Reads what [`Self::write`] wrote for the same mesh, material and fixed nodes. These determine the size, so that
    /// damaged bytes cannot cause a large allocation.
    ///
    /// # Errors
    /// Bytes of another format or mesh, damaged or truncated.
    pub fn read(
        input: &mut dyn Read,
        mesh: &TetMesh,
        material: &Elastic,
        fixed: &[u32],
        limits: &Limits,
    ) -> Result<Self, BytesError> {
        let boundary = Boundary::new(mesh, fixed)?;
        let count = boundary.surface.len();
        let bytes = 36 * (count as u64).pow(2);
        if bytes > limits.bytes_max {
            let bytes_max = limits.bytes_max;
            return Err(PrecomputeError::TooLarge { surface_nodes: count, bytes, bytes_max }.into());
        }
        let mut hash = Fnv::new();
        let mut word = || -> io::Result<([u8; 8], u64)> {
            let mut bytes = [0; 8];
            input.read_exact(&mut bytes)?;
            hash.bytes(&bytes);
            Ok((bytes, u64::from_le_bytes(bytes)))
        };
        let (magic, _) = word()?;
        if magic != MAGIC {
            return Err(BytesError::Magic(magic));
        }
        let expected = fingerprint(mesh, material, fixed);
        let (_, found) = word()?;
        if found != expected {
            return Err(BytesError::Fingerprint { found, expected });
        }
        if word()?.1 != count as u64 {
            return Err(BytesError::Damaged("another number of surface nodes than the mesh has"));
        }
        let mut buffer = vec![0; CHUNK];
        let mut nodes = Vec::with_capacity(count);
        words(input, &mut hash, &mut buffer, count, |bytes| nodes.push(u32::from_le_bytes(bytes)))?;
        if nodes != boundary.surface {
            return Err(BytesError::Damaged("other surface nodes than those of the mesh"));
        }
        let mut entries = Vec::with_capacity(9 * count * count);
        words(input, &mut hash, &mut buffer, 9 * count * count, |bytes| {
            entries.push(f32::from_le_bytes(bytes))
        })?;
        let mut checksum = [0; 8];
        input.read_exact(&mut checksum)?;
        if u64::from_le_bytes(checksum) != hash.0 {
            return Err(BytesError::Damaged("its checksum is another"));
        }
        if !entries.iter().all(|entry| entry.is_finite()) {
            return Err(BytesError::Damaged("an entry is not a finite number"));
        }
        Ok(Self { entries, nodes, fingerprint: found })
    }
}

/// Reads `count` words of four bytes.
fn words(
    input: &mut dyn Read,
    hash: &mut Fnv,
    buffer: &mut [u8],
    count: usize,
    mut push: impl FnMut([u8; 4]),
) -> io::Result<()> {
    let mut left = 4 * count;
    while left > 0 {
        let now = &mut buffer[..left.min(CHUNK)];
        input.read_exact(now)?;
        hash.bytes(now);
        for four in now.chunks_exact(4) {
            push([four[0], four[1], four[2], four[3]]);
        }
        left -= now.len();
    }
    Ok(())
}
