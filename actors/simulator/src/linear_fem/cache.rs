//! Cache of precomputed inverses in a folder, so that each is computed once: one file for each mesh, material and
//! boundary, named by its fingerprint, checksummed, and written to a temporary file that is renamed.
//!
//! An unreadable or mismatched file is recomputed; one that cannot be written is skipped: the cache never causes a
//! failure.

use std::fs::{self, File};
use std::io::{self, BufReader, BufWriter, Write};
use std::path::{Path, PathBuf};
use trocar_dynamics::elasticity::Elastic;
use trocar_dynamics::tet_mesh::TetMesh;

use super::compliance::{Compliance, Limits};
use super::error::LinearFemError;
use super::serialization::fingerprint;
use super::solver::LinearFem;

/// A folder of inverses.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Cache {
    folder: PathBuf,
}

/// Origin of a body's inverse.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Origin {
    /// Read from the cache.
    Read,
    /// Computed and written to the cache.
    Kept,
    /// Computed, but not written: the reason.
    NotKept(String),
}

impl Cache {
    /// In a folder, which is created with the first file.
    #[must_use]
    pub fn new(folder: &Path) -> Self {
        Self { folder: folder.to_owned() }
    }

    /// The file of a body.
    #[must_use]
    pub fn file(&self, mesh: &TetMesh, material: &Elastic, fixed: &[u32]) -> PathBuf {
        self.folder.join(format!("{:016x}.compliance", fingerprint(mesh, material, fixed)))
    }

    /// A body at rest, as [`LinearFem::new`], from the file if there is a valid one.
    ///
    /// # Errors
    /// As [`LinearFem::new`].
    pub fn body(
        &self,
        mesh: TetMesh,
        material: &Elastic,
        fixed: &[u32],
        limits: &Limits,
        progress: &mut dyn FnMut(f64) -> bool,
    ) -> Result<(LinearFem, Origin), LinearFemError> {
        let file = self.file(&mesh, material, fixed);
        if let Ok(open) = File::open(&file)
            && let Ok(known) = Compliance::read(&mut BufReader::new(open), &mesh, material, fixed, limits)
        {
            let body = LinearFem::with_compliance(mesh, material, fixed, limits, known)?;
            progress(1.0);
            return Ok((body, Origin::Read));
        }
        let body = LinearFem::new(mesh, material, fixed, limits, progress)?;
        let origin = match self.keep(body.compliance(), &file) {
            Ok(()) => Origin::Kept,
            Err(error) => Origin::NotKept(format!("{}: {error}", file.display())),
        };
        Ok((body, origin))
    }

    fn keep(&self, compliance: &Compliance, file: &Path) -> io::Result<()> {
        fs::create_dir_all(&self.folder)?;
        let (beside, new) = part_of(file)?;
        let write = |new: File| {
            let mut out = BufWriter::new(new);
            compliance.write(&mut out)?;
            out.flush()?;
            out.get_ref().sync_all()
        };
        let done = write(new).and_then(|()| fs::rename(&beside, file));
        if done.is_err() {
            let _ = fs::remove_file(&beside);
        }
        done
    }
}

/// Maximum number of concurrent writers of one file, including crashed ones.
const WRITERS_MAX: u32 = 16;

/// A new temporary file next to the final one, with a name unique among concurrent writers.
fn part_of(file: &Path) -> io::Result<(PathBuf, File)> {
    let mut taken = None;
    for number in 0..WRITERS_MAX {
        let part = file.with_extension(format!("{number}.part"));
        match File::options().write(true).create_new(true).open(&part) {
            Ok(new) => return Ok((part, new)),
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists => taken = Some(error),
            Err(error) => return Err(error),
        }
    }
    Err(taken.unwrap_or_else(|| io::ErrorKind::AlreadyExists.into()))
}
