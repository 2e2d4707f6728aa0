//! A file that is there whole or not at all: it gets its name when it is finished.

use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

/// A file beside the one that it will be.
pub struct PartFile {
    file: BufWriter<File>,
    part: PathBuf,
    whole: PathBuf,
    is_whole: bool,
}

impl PartFile {
    /// Begins a file.
    pub fn create(whole: &Path) -> io::Result<Self> {
        if whole.is_dir() {
            return Err(io::ErrorKind::IsADirectory.into());
        }
        let mut name = whole.file_name().unwrap_or_default().to_owned();
        name.push(format!(".{}.part", std::process::id()));
        let part = whole.with_file_name(name);
        let file = BufWriter::new(File::create(&part)?);
        Ok(Self { file, part, whole: whole.to_owned(), is_whole: false })
    }

    /// Gives it its name, and returns its length.
    pub fn finish(mut self) -> io::Result<u64> {
        self.file.flush()?;
        let length = self.file.get_ref().metadata()?.len();
        std::fs::rename(&self.part, &self.whole)?;
        self.is_whole = true;
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

impl Drop for PartFile {
    fn drop(&mut self) {
        if !self.is_whole {
            // A part is of no use; nothing can be done about one that cannot be removed.
            let _ = std::fs::remove_file(&self.part);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_that_is_not_finished_leaves_nothing() {
        let folder = tempfile::tempdir().unwrap();
        let name = folder.path().join("a.csv");
        let mut file = PartFile::create(&name).unwrap();
        file.write_all(b"half").unwrap();
        drop(file);
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
        let mut file = PartFile::create(&name).unwrap();
        file.write_all(b"whole").unwrap();
        assert_eq!(file.finish().unwrap(), 5);
        assert_eq!(std::fs::read(&name).unwrap(), b"whole");
        assert!(PartFile::create(folder.path()).is_err());
    }
}
