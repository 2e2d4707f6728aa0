//! The files of a run: recording and report. Those that are named are refused when they are there; the usual ones get the
//! next free number, so that no earlier result is lost.

use std::path::{Path, PathBuf};

use trocar_scene::output_file::{Claim, OutputError, Part, Replace};

use crate::args::RunArgs;
use crate::failure::Failure;
use crate::output::{RUNS_MAX, claim, numbered, replace};

/// The files of a run. No other session takes them while it exists.
pub struct RunFiles {
    record: Option<Recording>,
    report: Option<Claim>,
    /// The number of the usual names, if it is not the first one.
    number: Option<u32>,
}

/// A recording grows under its name while the session runs.
enum Recording {
    /// At its place.
    Straight(Claim),
    /// It replaces an earlier one, which stays until the session has begun.
    Beside(Part),
}

impl RunFiles {
    /// The files for the run `number` of a window's session, from 1. `stem` is the scenario's name as a file name.
    ///
    /// # Errors
    /// When a file cannot be written, or one that the command line names is there already.
    pub fn choose(args: &RunArgs, stem: &str, number: u32) -> Result<Self, Failure> {
        let replace = replace(args.pictures.force);
        let named =
            |given: &Option<PathBuf>| given.as_deref().map(|file| claim(file, replace, number)).transpose();
        let (mut record, mut report) = (named(&args.record)?, named(&args.report)?);
        let records = !args.no_record && record.is_none();
        let reports = !args.no_report && report.is_none();
        let mut usual = None;
        if records || reports {
            let (own_record, own_report, chosen) = usual_files(stem, records, reports)?;
            record = record.or(own_record);
            report = report.or(own_report);
            usual = Some(chosen).filter(|chosen| *chosen > 1);
        }
        let record = match record {
            Some(claim) if claim.replaces() => Some(Recording::Beside(claim.part()?)),
            claim => claim.map(Recording::Straight),
        };
        Ok(Self { record, report, number: usual })
    }

    /// Where the recorder writes.
    pub fn recorder_file(&self) -> Option<&Path> {
        self.record.as_ref().map(|record| match record {
            Recording::Straight(claim) => claim.file(),
            Recording::Beside(part) => part.path(),
        })
    }

    /// The recording, by its own name.
    pub fn recording(&self) -> Option<&Path> {
        self.record.as_ref().map(|record| match record {
            Recording::Straight(claim) => claim.file(),
            Recording::Beside(part) => part.place(),
        })
    }

    /// The session has begun: its recording takes its place and stays. Further calls change nothing.
    ///
    /// # Errors
    /// When another program has put something else there.
    pub fn begun(&mut self) -> Result<(), OutputError> {
        match &mut self.record {
            Some(Recording::Straight(claim)) => {
                claim.keep();
                Ok(())
            }
            Some(Recording::Beside(part)) => part.finish(),
            None => Ok(()),
        }
    }

    /// The place of the report, once.
    pub fn take_report(&mut self) -> Option<Claim> {
        self.report.take()
    }

    /// A sentence about earlier runs whose files stay, if there are any.
    pub fn note(&self) -> Option<String> {
        let number = self.number?;
        Some(format!("the files of earlier runs stay: those of this one have the number {number}"))
    }
}

/// Takes the usual names with the first number under which neither a recording nor a report is there, and that number.
fn usual_files(
    stem: &str,
    records: bool,
    reports: bool,
) -> Result<(Option<Claim>, Option<Claim>, u32), Failure> {
    let (record, report) = (PathBuf::from(format!("{stem}.mcap")), report_beside(stem));
    for number in 1..=RUNS_MAX {
        let files = [numbered(&record, number), numbered(&report, number)];
        // Both are looked at, also when only one is wanted: files of one number belong to one run.
        if files.iter().any(|file| file.symlink_metadata().is_ok()) {
            continue;
        }
        let take = |wanted: bool, file: &Path| wanted.then(|| Claim::take(file, Replace::Never)).transpose();
        // Another process may be faster; a claim that is dropped leaves nothing behind.
        let claimed = take(records, &files[0]).and_then(|record| Ok((record, take(reports, &files[1])?)));
        match claimed {
            Ok((record, report)) => return Ok((record, report, number)),
            Err(error) if error.is_occupied() => {}
            Err(error) => return Err(error.into()),
        }
    }
    let reason = "runs of this scenario have left their files here; name others with --record and --report";
    Err(Failure::invalid(format!("{RUNS_MAX} {reason}")))
}

/// The usual report; the stem may have a folder before it.
fn report_beside(stem: &str) -> PathBuf {
    let stem = Path::new(stem);
    let name = stem.file_name().unwrap_or_default().to_string_lossy();
    stem.with_file_name(format!("report-{name}.html"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    fn choose(line: &str, folder: &Path, number: u32) -> Result<RunFiles, Failure> {
        let line = line.replace("HERE", &folder.display().to_string());
        let words = ["trocar", "run", "wall"].into_iter().chain(line.split_whitespace());
        let crate::args::Command::Run(args) = crate::args::Cli::parse_from(words).command else {
            panic!("another command")
        };
        RunFiles::choose(&args, &folder.join("wall").display().to_string(), number)
    }

    fn names(files: &RunFiles) -> [Option<String>; 2] {
        let name = |file: &Path| file.file_name().unwrap().to_string_lossy().into_owned();
        [files.recording().map(name), files.report.as_ref().map(|claim| name(claim.file()))]
    }

    fn count(folder: &Path) -> usize {
        std::fs::read_dir(folder).unwrap().count()
    }

    #[test]
    fn sessions_in_one_folder_have_files_of_their_own_with_one_number() {
        let folder = tempfile::tempdir().unwrap();
        let mut first = choose("", folder.path(), 1).unwrap();
        assert_eq!(names(&first), [Some("wall.mcap".into()), Some("report-wall.html".into())]);
        assert_eq!(first.note(), None);
        let second = choose("", folder.path(), 1).unwrap();
        assert_eq!(names(&second), [Some("wall-2.mcap".into()), Some("report-wall-2.html".into())]);
        assert!(second.note().unwrap().contains("the number 2"));
        // A number whose report is there belongs to another run, also when no report is wanted.
        std::fs::write(folder.path().join("report-wall-3.html"), "a report").unwrap();
        let third = choose("--no-report", folder.path(), 1).unwrap();
        assert_eq!(names(&third), [Some("wall-4.mcap".into()), None]);
        let named = choose("--record HERE/wall.mcap --force --no-report", folder.path(), 1).err().unwrap();
        assert!(named.message.contains("another session is writing it"), "{}", named.message);
        drop((second, third));
        assert_eq!(count(folder.path()), 3, "a run that did not begin leaves nothing");
        first.begun().unwrap();
        drop(first);
        assert!(folder.path().join("wall.mcap").exists() && !folder.path().join("report-wall.html").exists());
    }

    #[test]
    fn a_named_file_that_is_there_is_refused_and_with_force_it_stays_until_the_session_has_begun() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("mine.mcap");
        std::fs::write(&file, "a recording").unwrap();
        let refused = choose("--record HERE/mine.mcap", folder.path(), 1).err().unwrap();
        assert_eq!(refused.exit, trocar::summary::Exit::Invalid);
        assert!(refused.message.contains("mine.mcap: exists already; --force"), "{}", refused.message);
        assert_eq!(count(folder.path()), 1, "the report that was not refused leaves nothing either");
        let forced = "--record HERE/mine.mcap --no-report --force";
        drop(choose(forced, folder.path(), 1).unwrap());
        assert_eq!(std::fs::read(&file).unwrap(), b"a recording");
        let mut files = choose(forced, folder.path(), 1).unwrap();
        std::fs::write(files.recorder_file().unwrap(), "a new one").unwrap();
        assert_eq!(std::fs::read(&file).unwrap(), b"a recording");
        files.begun().unwrap();
        files.begun().unwrap();
        assert_eq!(files.recorder_file(), Some(&*file));
        assert_eq!((std::fs::read(&file).unwrap(), count(folder.path())), (b"a new one".to_vec(), 1));
        // A repetition has the next number that is free, whatever is forced.
        std::fs::write(folder.path().join("mine-2.mcap"), "another").unwrap();
        assert_eq!(names(&choose(forced, folder.path(), 2).unwrap())[0].as_deref(), Some("mine-3.mcap"));
    }
}
