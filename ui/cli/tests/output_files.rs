//! What is written stays: earlier results, links, devices, FIFOs, and places that cannot be written to.

use std::path::Path;
use std::process::{Command, Output, Stdio};

use trocar_kernel::recorder::Recording;

use crate::support::{BRIEF, here, names, object, stderr, stdout, trocar};

fn brief(folder: &Path, more: &[&str]) -> Output {
    trocar(folder, &[&BRIEF[..], more].concat())
}

fn read(folder: &Path, name: &str) -> Vec<u8> {
    std::fs::read(folder.join(name)).unwrap_or_else(|error| panic!("{name}: {error}"))
}

fn write(folder: &Path, name: &str, text: &str) {
    std::fs::write(folder.join(name), text).expect("a file");
}

/// Whether it is a recording that lacks nothing.
fn is_whole(file: &Path) -> bool {
    let recording = Recording::open(file).unwrap_or_else(|error| panic!("{}: {error}", file.display()));
    recording.truncation().is_none() && recording.end().is_some_and(|end| end.complete)
}

#[test]
fn a_second_run_takes_the_next_number_and_says_its_names() {
    let folder = here();
    assert_eq!(brief(folder.path(), &[]).status.code(), Some(0));
    let first = ["wall.mcap", "report-wall.html"].map(|name| read(folder.path(), name));
    let second = stdout(&brief(folder.path(), &[]));
    for told in ["recording wall-2.mcap", "report report-wall-2.html", "those of this one have the number 2"]
    {
        assert!(second.contains(told), "'{told}' is not in: {second}");
    }
    let third = object(&brief(folder.path(), &["--json", "--no-record"]));
    assert_eq!(
        (&third["recording"], &third["report"]),
        (&serde_json::Value::Null, &"report-wall-3.html".into())
    );
    let fourth = object(&brief(folder.path(), &["--json", "--no-report"]));
    assert_eq!(fourth["recording"], "wall-4.mcap", "files of one number are of one run");
    assert_eq!(["wall.mcap", "report-wall.html"].map(|name| read(folder.path(), name)), first);
    let all = [
        "report-wall-2.html",
        "report-wall-3.html",
        "report-wall.html",
        "wall-2.mcap",
        "wall-4.mcap",
        "wall.mcap",
    ];
    assert_eq!(names(folder.path()), all);
}

#[test]
fn a_run_that_does_not_start_loses_nothing_and_leaves_nothing() {
    let folder = here();
    write(folder.path(), "a.mcap", "precious");
    let bare = "schema = 1\nname = \"bare\"\n[[entity]]\nname = \"liver\"\ndynamic_fem = {}\n\
                [[controller]]\nname = \"soft\"\nkind = \"dynamic-fem\"\nrate_hz = 60\n";
    write(folder.path(), "bare.toml", bare);
    for more in [&["--record", "a.mcap", "--force"][..], &[]] {
        let output = trocar(folder.path(), &[&["run", "bare.toml", "--lockstep"], more].concat());
        assert_eq!(output.status.code(), Some(4), "{}", stderr(&output));
    }
    assert_eq!(read(folder.path(), "a.mcap"), b"precious");
    assert_eq!(names(folder.path()), ["a.mcap", "bare.toml"]);
}

#[test]
fn processes_that_start_at_once_in_one_folder_share_no_file_and_lose_none() {
    let program = env!("CARGO_BIN_EXE_trocar");
    let start = |folder: &Path, more: &[&str]| {
        let mut command = Command::new(program);
        command.args(BRIEF).args(more).arg("--json").current_dir(folder).env("NO_COLOR", "1");
        command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().expect("the program starts")
    };
    for round in 0..100 {
        let folder = here();
        // Now and then a larger crowd.
        let crowd = if round % 10 == 0 { 4 } else { 2 };
        let racing: Vec<_> = (0..crowd).map(|_| start(folder.path(), &[])).collect();
        let count = racing.len();
        let mut files = Vec::new();
        for child in racing {
            let output = child.wait_with_output().expect("it ends");
            assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
            let summary = object(&output);
            for file in [&summary["recording"], &summary["report"]] {
                files.push(file.as_str().unwrap_or_else(|| panic!("{summary}")).to_owned());
            }
        }
        for name in &files {
            let file = folder.path().join(name);
            let html = || String::from_utf8(read(folder.path(), name)).expect("text");
            assert!(
                if name.ends_with(".mcap") { is_whole(&file) } else { html().ends_with("</html>\n") },
                "{name}"
            );
        }
        files.sort();
        assert_eq!((files.len(), names(folder.path())), (2 * count, files), "round {round}");

        if crowd == 2 {
            continue;
        }
        // For one name there is one winner at a time; the others are refused with a word.
        let named = ["--record", "one.mcap", "--no-report", "--force"];
        write(folder.path(), "one.mcap", "old");
        let racing = [start(folder.path(), &named), start(folder.path(), &named)];
        let ended = racing.map(|child| child.wait_with_output().expect("it ends"));
        let won = ended.iter().filter(|output| output.status.code() == Some(0)).count();
        assert!(won >= 1, "{}", stderr(&ended[0]));
        for output in ended.iter().filter(|output| output.status.code() != Some(0)) {
            assert!(stderr(output).contains("another session is writing it"), "{}", stderr(output));
        }
        assert!(is_whole(&folder.path().join("one.mcap")));
        assert_eq!(names(folder.path()).len(), 2 * count + 1, "round {round}");
    }
}

#[test]
fn stdout_takes_one_result_and_then_the_summary_goes_to_stderr() {
    let folder = here();
    let report = brief(folder.path(), &["--no-record", "--report", "-"]);
    assert_eq!(report.status.code(), Some(0), "{}", stderr(&report));
    assert!(stdout(&report).starts_with("<!doctype html>") && stdout(&report).ends_with("</html>\n"));
    assert!(stderr(&report).contains("state hash"), "{}", stderr(&report));
    let recording = brief(folder.path(), &["--no-report", "--record", "-"]);
    assert_eq!(recording.status.code(), Some(0), "{}", stderr(&recording));
    std::fs::write(folder.path().join("piped.mcap"), &recording.stdout).expect("a file");
    assert!(is_whole(&folder.path().join("piped.mcap")));
    let refused = brief(folder.path(), &["--no-record", "--report", "-", "--json"]);
    assert_eq!(refused.status.code(), Some(2));
    assert!(object(&refused)["error"].as_str().is_some_and(|error| error.contains("--json")));
    assert_eq!(names(folder.path()), ["piped.mcap"]);
}

#[test]
fn a_stdout_that_takes_nothing_is_said_and_the_result_stands_on_stderr() {
    let folder = here();
    let full = || std::fs::File::options().write(true).open("/dev/full");
    let Ok(_) = full() else { return };
    for (more, told) in [(&[][..], "state hash"), (&["--json"], "stdout: cannot be written")] {
        let output = Command::new(env!("CARGO_BIN_EXE_trocar"))
            .args([&BRIEF[..], &["--no-record", "--no-report"], more].concat())
            .current_dir(folder.path())
            .env("NO_COLOR", "1")
            .stdout(full().expect("a device"))
            .output()
            .expect("the program starts");
        assert_eq!(output.status.code(), Some(4), "{}", stderr(&output));
        assert!(
            stderr(&output).contains(told) && !stderr(&output).contains("panicked"),
            "{}",
            stderr(&output)
        );
    }
    let deaf = Command::new(env!("CARGO_BIN_EXE_trocar"))
        .args(["run", "nobody"])
        .stderr(full().expect("a device"))
        .output()
        .expect("the program starts");
    assert_eq!(deaf.status.code(), Some(4), "an error that nobody can be told is no panic");
}

#[cfg(unix)]
mod special {
    use std::os::unix::fs::{FileTypeExt, symlink};

    use super::*;

    #[test]
    fn under_a_usual_name_a_link_is_in_the_way_and_stays() {
        let folder = here();
        symlink("precious.mcap", folder.path().join("wall.mcap")).expect("a link");
        assert_eq!(object(&brief(folder.path(), &["--json"]))["recording"], "wall-2.mcap");
        assert!(folder.path().join("wall.mcap").symlink_metadata().expect("a link").is_symlink());
        assert!(!folder.path().join("precious.mcap").exists());
    }

    #[test]
    fn a_device_takes_a_whole_recording_and_a_report_at_once() {
        let (null, folder) = (Path::new("/dev/null"), here());
        let whole =
            object(&brief(folder.path(), &["--record", "/dev/null", "--report", "/dev/null", "--json"]));
        assert_eq!((&whole["recording_complete"], &whole["error"]), (&true.into(), &serde_json::Value::Null));
        assert!(null.symlink_metadata().expect("a device").file_type().is_char_device());
        assert_eq!(names(folder.path()), [] as [&str; 0]);
    }

    #[test]
    fn a_fifo_takes_a_whole_recording_or_report() {
        let folder = here();
        let made = Command::new("mkfifo").arg(folder.path().join("fifo")).status().expect("mkfifo runs");
        assert!(made.success());
        for (more, name) in
            [(["--no-record", "--report", "fifo"], "a.html"), (["--no-report", "--record", "fifo"], "a.mcap")]
        {
            let copy = std::fs::File::create(folder.path().join(name)).expect("a file");
            let mut reader = Command::new("cat")
                .arg("fifo")
                .current_dir(folder.path())
                .stdout(copy)
                .spawn()
                .expect("cat runs");
            // Until the reader has opened it, the FIFO is refused.
            let output = loop {
                let output = brief(folder.path(), &[&more[..], &["--json"]].concat());
                if output.status.code() != Some(4) {
                    break output;
                }
            };
            assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
            assert!(reader.wait().expect("it ends").success());
            assert_eq!(name.ends_with("mcap"), object(&output)["recording_complete"] == true);
        }
        assert!(read(folder.path(), "a.html").ends_with(b"</html>\n"));
        assert!(is_whole(&folder.path().join("a.mcap")));
        assert!(folder.path().join("fifo").symlink_metadata().expect("it is there").file_type().is_fifo());
    }

    #[test]
    fn a_folder_that_is_missing_is_named() {
        let folder = here();
        for option in ["--report", "--record"] {
            let refused = brief(folder.path(), &[option, "no/a", "--force"]);
            assert_eq!(refused.status.code(), Some(4), "{option}");
            assert!(stderr(&refused).contains("the folder no does not exist"), "{}", stderr(&refused));
        }
        assert_eq!(names(folder.path()), [] as [&str; 0]);
    }
}
