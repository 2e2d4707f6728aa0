//! The file of a table: there whole or not at all. It comes to its place when it is finished.

use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::Path;

use trocar_scene::output_file::{Claim, OutputError, Part, Replace};

/// A buffered file beside the one that it will be.
pub struct PartFile {
    file: BufWriter<File>,
    part: Part,
}

impl PartFile {
    /// Begins a file.
    pub fn create(whole: &Path, replace: Replace) -> Result<Self, OutputError> {
        let part = Claim::take(whole, replace)?.part()?;
        let file = part
            .file()
            .try_clone()
            .map_err(|error| OutputError { file: whole.to_owned(), reason: error.into() })?;
        Ok(Self { file: BufWriter::new(file), part })
    }

    /// Lets it take its place, and returns its length.
    pub fn finish(mut self) -> io::Result<u64> {
        self.file.flush()?;
        let length = self.file.get_ref().metadata()?.len();
        self.part.finish()?;
        Ok(length)
    }
}

impl Write for PartFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.file.write(bytes)
    }
    fn flush(&mut self) -> io::Result<()> {
        self.file.flush()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_that_is_not_finished_leaves_nothing_and_an_earlier_one_stays() {
        let folder = tempfile::tempdir().unwrap();
        let name = folder.path().join("a.csv");
        let mut file = PartFile::create(&name, Replace::Never).unwrap();
        file.write_all(b"half").unwrap();
        drop(file);
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
        let mut file = PartFile::create(&name, Replace::Never).unwrap();
        file.write_all(b"whole").unwrap();
        assert_eq!(file.finish().unwrap(), 5);
        assert!(PartFile::create(&name, Replace::Never).is_err());
        assert!(PartFile::create(folder.path(), Replace::Always).is_err());
        assert_eq!(std::fs::read(&name).unwrap(), b"whole");
    }
}
