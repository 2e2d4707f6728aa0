//! Output: data to stdout, files by rename, all other text to stderr.

use std::io::{self, Write};
use std::path::{Path, PathBuf};

use serde::Serialize;

use crate::failure::Failure;

/// Writes a file completely or not at all: to a temporary file beside it, then by rename.
pub fn write_file(path: &Path, bytes: &[u8]) -> Result<(), Failure> {
    let mut name = path.file_name().unwrap_or_default().to_owned();
    name.push(format!(".{}.part", std::process::id()));
    let part = path.with_file_name(name);
    let written = std::fs::write(&part, bytes).and_then(|()| std::fs::rename(&part, path));
    written.map_err(|error| {
        // The partial file is useless; a failure to remove it adds nothing to the first error.
        let _ = std::fs::remove_file(&part);
        Failure::write(path, error)
    })
}

/// Checks before a long run that a file can be written.
pub fn check_writable(path: &Path) -> Result<(), Failure> {
    let folder = match path.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder.to_path_buf(),
        _ => PathBuf::from("."),
    };
    if path.is_dir() {
        return Err(Failure::write(path, io::Error::from(io::ErrorKind::IsADirectory)));
    }
    if !folder.is_dir() {
        let reason = format!("the folder {} does not exist", folder.display());
        return Err(Failure::write(path, io::Error::new(io::ErrorKind::NotFound, reason)));
    }
    Ok(())
}

/// One JSON object on stdout.
pub fn print_json(value: &impl Serialize) -> Result<(), Failure> {
    let text = serde_json::to_string_pretty(value).map_err(Failure::internal)?;
    print_text(&text)
}

/// Text on stdout; a reader that closed the pipe (`| head`) is no failure.
pub fn print_text(text: &str) -> Result<(), Failure> {
    let mut stdout = io::stdout().lock();
    match writeln!(stdout, "{}", text.trim_end()).and_then(|()| stdout.flush()) {
        Err(error) if error.kind() != io::ErrorKind::BrokenPipe => Err(Failure::internal(error)),
        _ => Ok(()),
    }
}

/// An error's kind for people: `drop in view`. A sentence stays as it is: it names quantities by their own names.
pub fn in_words(kind: &str) -> String {
    if kind.contains(' ') { kind.to_owned() } else { kind.replace('_', " ") }
}

/// Columns aligned by the widest cell: text to the left, cells that begin with a digit to the right.
pub fn columns(head: &[&str], rows: &[Vec<String>]) -> Vec<String> {
    let width_of = |column: usize| {
        let cells =
            rows.iter().filter_map(|row| row.get(column)).map(|cell| console::measure_text_width(cell));
        cells.chain([console::measure_text_width(head[column])]).max().unwrap_or(0)
    };
    let widths: Vec<usize> = (0..head.len()).map(width_of).collect();
    let align = |cell: &str, column: usize| {
        let side = if column == 0 { console::Alignment::Left } else { console::Alignment::Right };
        console::pad_str(cell, widths[column], side, None).into_owned()
    };
    let line =
        |cells: &mut dyn Iterator<Item = String>| cells.collect::<Vec<_>>().join("  ").trim_end().to_owned();
    let mut lines = vec![line(&mut head.iter().enumerate().map(|(column, cell)| align(cell, column)))];
    for row in rows {
        lines.push(line(
            &mut row.iter().take(head.len()).enumerate().map(|(column, cell)| align(cell, column)),
        ));
    }
    lines
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_is_written_whole_or_not_at_all() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("a.html");
        write_file(&file, b"one").unwrap();
        write_file(&file, b"two").unwrap();
        assert_eq!(std::fs::read(&file).unwrap(), b"two");
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
        let missing = folder.path().join("no/such/b.html");
        assert!(check_writable(&missing).unwrap_err().message.contains("does not exist"));
        assert!(write_file(&missing, b"x").is_err());
        assert!(check_writable(folder.path()).is_err());
    }

    #[test]
    fn columns_line_up() {
        let lines =
            columns(&["name", "Hz"], &[vec!["engine".into(), "500".into()], vec!["x".into(), "5".into()]]);
        assert_eq!(lines, ["name     Hz", "engine  500", "x         5"]);
    }
}
