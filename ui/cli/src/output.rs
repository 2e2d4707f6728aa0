//! Output: data to stdout, all other text to stderr.

use std::io::{self, Write};
use std::path::{Path, PathBuf};

use serde::Serialize;
use trocar_scene::output_file::{self, Claim, OutputError, Replace, STDOUT};
use trocar_scene::scenario::Scenario;

use crate::failure::Failure;

/// Most runs of one scenario in one folder.
pub const RUNS_MAX: u32 = 10_000;

/// The scenario's name with only characters that are valid in a file name.
pub fn file_stem(scenario: &Scenario) -> String {
    let safe = |c: char| if c.is_alphanumeric() || c == '-' || c == '_' { c } else { '-' };
    scenario.name.chars().take(60).map(safe).collect()
}

/// What `--force` allows.
pub fn replace(force: bool) -> Replace {
    if force { Replace::Always } else { Replace::Never }
}

/// A place that the command line names. A repetition has the next free number and replaces nothing.
///
/// # Errors
/// When it cannot be written to.
pub fn claim(file: &Path, replace: Replace, number: u32) -> Result<Claim, OutputError> {
    if number <= 1 || output_file::is_stream(file) {
        return Claim::take(file, replace);
    }
    let mut claimed = Claim::take(&numbered(file, number), Replace::Never);
    for later in number + 1..number.saturating_add(RUNS_MAX) {
        match claimed {
            Err(error) if error.is_occupied() => {
                claimed = Claim::take(&numbered(file, later), Replace::Never);
            }
            claimed => return claimed,
        }
    }
    claimed
}

/// The file name for a repetition, beside that of the first run.
pub fn numbered(file: &Path, number: u32) -> PathBuf {
    if number <= 1 {
        return file.to_owned();
    }
    let stem = file.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    let ending = file.extension().map_or(String::new(), |ending| format!(".{}", ending.to_string_lossy()));
    file.with_file_name(format!("{stem}-{number}{ending}"))
}

/// Whether one of these files goes to stdout, where then nothing else is printed.
///
/// # Errors
/// When several do, or when the object of `--json` goes there.
pub fn takes_stdout<'a>(
    json: bool,
    files: impl IntoIterator<Item = Option<&'a Path>>,
) -> Result<bool, Failure> {
    let count = files.into_iter().flatten().filter(|file| *file == Path::new(STDOUT)).count();
    match (count, json) {
        (0, _) => Ok(false),
        (_, true) => Err(Failure::usage("'-' is stdout, which holds the object of --json: name a file")),
        (1, false) => Ok(true),
        (_, false) => Err(Failure::usage("'-' is stdout, which takes one result: name files for the others")),
    }
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
        Err(error) if error.kind() != io::ErrorKind::BrokenPipe => {
            Err(Failure::invalid(format!("stdout: cannot be written: {error}")))
        }
        _ => Ok(()),
    }
}

/// Text on stderr. Where stderr cannot be written either, nobody can be told.
pub fn tell(text: &str) {
    let _ = writeln!(io::stderr(), "{}", text.trim_end());
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
    fn stdout_takes_one_result_and_none_beside_an_object() {
        let (out, file) = (Some(Path::new("-")), Some(Path::new("a.html")));
        assert!(!takes_stdout(true, [file, None]).unwrap() && takes_stdout(false, [out, file]).unwrap());
        for (json, files, told) in [(true, [out, None], "--json"), (false, [out, out], "one result")] {
            let refused = takes_stdout(json, files).unwrap_err();
            assert!(refused.message.contains(told), "{}", refused.message);
        }
    }

    #[test]
    fn a_repetition_has_a_number_before_its_ending() {
        assert_eq!(numbered("a/b.mcap".as_ref(), 1), Path::new("a/b.mcap"));
        assert_eq!(numbered("a/b.mcap".as_ref(), 3), Path::new("a/b-3.mcap"));
        assert_eq!(numbered("b".as_ref(), 2), Path::new("b-2"));
    }

    #[test]
    fn columns_line_up() {
        let lines =
            columns(&["name", "Hz"], &[vec!["engine".into(), "500".into()], vec!["x".into(), "5".into()]]);
        assert_eq!(lines, ["name     Hz", "engine  500", "x         5"]);
    }
}
