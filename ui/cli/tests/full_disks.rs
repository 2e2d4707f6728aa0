//! Full and read-only disks: the score comes out all the same, and nothing half-written is left.
//!
//! Each disk is a file system of its own, of three megabytes in memory, that only the commands of one test see. Where
//! mounting is not permitted, as to an ordinary user, there is nothing to test.

use std::path::Path;
use std::process::{Command, Output};

use serde_json::Value;

use crate::support::{assert_valid, here, names, object, stderr, stdout, trocar};
use crate::writers::{WRITERS, Workplace};

/// Mounts `disk` in the folder with these options, runs a shell script in it, in which `$TROCAR` is a program of `words`, and
/// leaves the names on the disk in `left`. `None` where mounting is not permitted.
fn on_disk(folder: &Path, words: &str, options: &str, script: &str) -> Option<Output> {
    let disk = folder.join("disk");
    std::fs::create_dir_all(&disk).expect("a folder");
    let shell = |script: &str| {
        Command::new("unshare")
            .args(["-m", "sh", "-c", script])
            .current_dir(folder)
            .env("NO_COLOR", "1")
            .env("OPTIONS", options)
            .output()
    };
    let mount = "mount -t tmpfs -o \"size=3M,$OPTIONS\" none disk";
    if !shell(mount).is_ok_and(|output| output.status.success()) {
        println!("no file system can be mounted here");
        return None;
    }
    // On a full disk a filler leaves no room but for a name.
    let script = script.replace("$TROCAR", words);
    let whole = format!("{mount} && cd disk && {{ {script}\n}}; code=$?; ls -A >../left; exit $code");
    Some(shell(&whole).expect("a shell starts"))
}

/// The words of the program for the user of the tests.
const OURS: &str = concat!("\"", env!("CARGO_BIN_EXE_trocar"), "\"");

fn left(folder: &Path) -> Vec<String> {
    std::fs::read_to_string(folder.join("left")).expect("a list").lines().map(str::to_owned).collect()
}

/// The commands of [`WRITERS`], and those that write folders or under their usual names: with whether they tell a score.
fn commands() -> Vec<(&'static str, bool)> {
    let more = [
        // A recording that cannot begin is refused before the run; everything else is told after it.
        ("run wall --lockstep --seconds 0.1 --no-report", false),
        ("run wall --lockstep --seconds 0.1 --no-record", true),
        (
            "run wall --lockstep --seconds 0.1 --no-record --no-report --size 32x24 --quality plain --film frames",
            true,
        ),
        ("new sim", false),
    ];
    WRITERS.iter().map(|writer| (writer.words, writer.plays)).chain(more).collect()
}

#[test]
fn on_a_full_disk_every_writing_command_says_so_and_leaves_nothing_behind() {
    for workplace in Workplace::all() {
        for (command, plays) in commands() {
            let script = format!("head -c 4000000 /dev/zero >filler 2>/dev/null; $TROCAR {command}");
            let words = workplace.shell_words();
            let Some(output) = on_disk(workplace.folder(), &words, "mode=777", &script) else { return };
            let told = stderr(&output);
            assert_eq!(output.status.code(), Some(4), "{command}: {told}");
            assert!(told.contains("No space left") && !told.contains("panicked"), "{command}: {told}");
            assert_eq!(stdout(&output).contains("state hash"), plays, "{command}");
            assert_eq!(left(workplace.folder()), ["filler"], "{command}");
        }
    }
}

#[test]
fn on_a_read_only_disk_everything_is_refused_before_it_runs() {
    for workplace in Workplace::all() {
        for (command, _) in commands() {
            let (words, script) = (workplace.shell_words(), format!("$TROCAR {command}"));
            let Some(output) = on_disk(workplace.folder(), &words, "mode=777,ro", &script) else { return };
            let told = stderr(&output);
            assert_eq!(output.status.code(), Some(4), "{command}: {told}");
            assert!(told.contains("Read-only file system"), "{command}: {told}");
            assert_eq!(stdout(&output), "", "{command}");
            assert_eq!(left(workplace.folder()), [] as [&str; 0]);
        }
    }
}

#[test]
fn a_disk_that_fills_up_during_a_run_leaves_score_and_summary_and_a_recording_that_says_what_it_holds() {
    let folder = here();
    let run = "run peg-transfer --lockstep --seconds 3 --json";
    // Room for a part of the recording, and none for the report.
    let script = format!(
        "head -c 3080000 /dev/zero >filler; $TROCAR {run}; code=$?; cp peg-transfer.mcap ../kept.mcap; (exit $code)"
    );
    let Some(output) = on_disk(folder.path(), OURS, "mode=700", &script) else { return };
    assert_eq!(output.status.code(), Some(4), "{}", stderr(&output));
    let summary = object(&output);
    assert_valid("run", &summary);
    assert_eq!((&summary["recording_complete"], &summary["report"]), (&false.into(), &Value::Null));
    for part in [
        "peg-transfer.mcap: the recording is cut short",
        "no report: report-peg-transfer.html: cannot be written",
    ] {
        let told = |at: &str| summary[at].to_string().contains(part);
        assert!(
            told("losses") && told("error"),
            "'{part}' is not in: {} {}",
            summary["losses"],
            summary["error"]
        );
    }
    assert_eq!(left(folder.path()), ["filler", "peg-transfer.mcap"]);
    // The session is the same as with room.
    let words: Vec<&str> = run.split(' ').chain(["--no-record", "--no-report"]).collect();
    assert_eq!(object(&trocar(folder.path(), &words))["state_hash"], summary["state_hash"]);
    let replayed = trocar(folder.path(), &["replay", "kept.mcap", "--headless"]);
    assert_eq!(replayed.status.code(), Some(1), "{}", stderr(&replayed));
    assert!(stderr(&replayed).contains("the recording is cut short"), "{}", stderr(&replayed));
    assert_eq!(names(folder.path()), ["disk", "kept.mcap", "left"]);
}
