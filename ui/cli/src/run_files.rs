//! The files of a run: recording and report. Where another session writes the usual ones, this one takes names of its own.

use std::fs::File;
use std::path::{Path, PathBuf};

use crate::args::RunArgs;
use crate::failure::Failure;
use crate::output;

/// Most sessions of one scenario in one folder at a time.
const BESIDE_MAX: u32 = 64;

/// The files of a run. While it exists, no other session takes its recording.
pub struct RunFiles {
    /// The recording.
    pub record: Option<PathBuf>,
    /// The report.
    pub report: Option<PathBuf>,
    /// Files of an earlier run that are replaced.
    replaced: Vec<PathBuf>,
    claim: Option<Claim>,
}

impl RunFiles {
    /// The files for the run `number` of a window's session, from 1. `stem` is the scenario's name as a file name.
    ///
    /// # Errors
    /// When a file cannot be written, or another session writes one that the command line names.
    pub fn choose(args: &RunArgs, stem: &str, number: u32) -> Result<Self, Failure> {
        let usual = |given: &Option<PathBuf>, name: String, number| {
            numbered(given.clone().unwrap_or_else(|| PathBuf::from(name)), number)
        };
        let mut passed = None;
        for number in number..number.saturating_add(BESIDE_MAX) {
            let record = (!args.no_record).then(|| usual(&args.record, format!("{stem}.mcap"), number));
            let report =
                (!args.no_report).then(|| usual(&args.report, format!("report-{stem}.html"), number));
            for file in record.iter().chain(&report) {
                output::check_writable(file)?;
            }
            let replaced = record.iter().chain(&report).filter(|file| is_filled(file)).cloned().collect();
            let claim = match record.as_deref().map(Claim::take).transpose() {
                Ok(claim) => claim.flatten(),
                Err(Taken) if args.record.is_none() => {
                    passed = passed.or(record);
                    continue;
                }
                Err(Taken) => {
                    let file = record.unwrap_or_default();
                    let reason = "another session is writing it; name another file with --record";
                    return Err(Failure::invalid(format!("{}: {reason}", file.display())));
                }
            };
            if let (Some(passed), Some(record)) = (&passed, &record) {
                let (passed, record) = (passed.display(), record.display());
                tracing::warn!("{passed} is being written by another session: this one writes {record}");
            }
            return Ok(Self { record, report, replaced, claim });
        }
        let reason = "sessions of this scenario run in this folder already; name a file with --record";
        Err(Failure::invalid(format!("{BESIDE_MAX} {reason}")))
    }

    /// A sentence about files of an earlier run that were replaced, if there were any.
    pub fn note(&self) -> Option<String> {
        let names: Vec<String> = self.replaced.iter().map(|file| file.display().to_string()).collect();
        let replace = if names.len() == 1 { "replaces the one" } else { "replace those" };
        (!names.is_empty()).then(|| {
            format!("{} {replace} of an earlier run; --record and --report name others", names.join(" and "))
        })
    }
}

impl Drop for RunFiles {
    fn drop(&mut self) {
        // A run that did not start leaves no empty file behind.
        if let (Some(Claim { is_new: true, .. }), Some(record)) = (&self.claim, &self.record)
            && !is_filled(record)
        {
            let _ = std::fs::remove_file(record);
        }
    }
}

/// The file name for a repetition, beside that of the first run.
fn numbered(file: PathBuf, number: u32) -> PathBuf {
    if number == 1 {
        return file;
    }
    let stem = file.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    let ending = file.extension().map_or(String::new(), |ending| format!(".{}", ending.to_string_lossy()));
    file.with_file_name(format!("{stem}-{number}{ending}"))
}

fn is_filled(file: &Path) -> bool {
    file.metadata().is_ok_and(|found| found.is_file() && found.len() > 0)
}

/// A lock on a recording, which the system gives back when the process ends, whatever happens.
struct Claim {
    /// The file did not exist before.
    is_new: bool,
    _locked: File,
}

/// Another session has the file.
struct Taken;

impl Claim {
    /// Takes a file; `None` where files cannot be locked. On Windows a lock would keep the recorder away as well.
    fn take(file: &Path) -> Result<Option<Self>, Taken> {
        if !cfg!(unix) || (file.exists() && !file.is_file()) {
            return Ok(None);
        }
        let is_new = !file.exists();
        let opened = File::options().write(true).create(true).truncate(false).open(file);
        let Ok(opened) = opened else { return Ok(None) };
        match opened.try_lock() {
            Ok(()) => Ok(Some(Self { is_new, _locked: opened })),
            Err(std::fs::TryLockError::WouldBlock) => Err(Taken),
            Err(std::fs::TryLockError::Error(_)) => Ok(None),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    fn choose(line: &str, folder: &Path) -> Result<RunFiles, Failure> {
        let line = line.replace("HERE", &folder.display().to_string());
        let words = ["trocar", "run", "wall"].into_iter().chain(line.split(' '));
        let crate::args::Command::Run(args) = crate::args::Cli::parse_from(words).command else {
            panic!("another command")
        };
        let stem = folder.join("wall").display().to_string();
        RunFiles::choose(&args, &stem, 1)
    }

    #[test]
    fn a_second_session_in_one_folder_records_into_a_file_of_its_own() {
        let folder = tempfile::tempdir().unwrap();
        let name = |files: &RunFiles| files.record.as_deref().unwrap().file_name().unwrap().to_owned();
        let first = choose("--no-report", folder.path()).unwrap();
        let second = choose("--no-report", folder.path()).unwrap();
        let third = choose("--no-report", folder.path()).unwrap();
        assert_eq!([name(&first), name(&second), name(&third)], ["wall.mcap", "wall-2.mcap", "wall-3.mcap"]);
        let named = choose("--no-report --record HERE/wall.mcap", folder.path()).err().unwrap();
        assert!(named.message.contains("another session is writing it"), "{}", named.message);
        drop((second, third));
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1, "nothing was recorded");
        drop(first);
        assert_eq!(name(&choose("--no-report", folder.path()).unwrap()), "wall.mcap");
    }

    #[test]
    fn files_of_an_earlier_run_are_replaced_and_it_is_said() {
        let folder = tempfile::tempdir().unwrap();
        assert_eq!(choose("--no-report", folder.path()).unwrap().note(), None);
        std::fs::write(folder.path().join("wall.mcap"), "a recording").unwrap();
        let files = choose("--no-report", folder.path()).unwrap();
        let note = files.note().unwrap();
        assert!(note.contains("wall.mcap replaces the one of an earlier run; --record"), "{note}");
        drop(files);
        assert_eq!(std::fs::read(folder.path().join("wall.mcap")).unwrap(), b"a recording");
    }

    #[test]
    fn a_repetition_has_a_number_before_its_ending() {
        assert_eq!(numbered("a/b.mcap".into(), 1), Path::new("a/b.mcap"));
        assert_eq!(numbered("a/b.mcap".into(), 3), Path::new("a/b-3.mcap"));
        assert_eq!(numbered("b".into(), 2), Path::new("b-2"));
    }
}
