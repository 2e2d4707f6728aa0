//! What is written stays: earlier results, links, devices, FIFOs, and places that cannot be written to.

use std::path::Path;
use std::process::{Command, Output, Stdio};

use trocar_kernel::recorder::Recording;

use crate::support::{BRIEF, assert_valid, here, names, object, stderr, stdout, trocar};

/// A mesh of one face, which can be written as it is read.
const FACE: &str = "v 0 0 0\nv 0.1 0 0\nv 0 0.1 0\nf 1 2 3\n";
/// A picture that is drawn quickly.
const SMALL: [&str; 4] = ["--size", "32x24", "--quality", "plain"];

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

/// Every command that writes a file which the command line names, with that name.
fn writers() -> Vec<(Vec<&'static str>, &'static str)> {
    let brief = |more: &[&'static str]| [&BRIEF[..], more].concat();
    vec![
        (brief(&["--record", "a.mcap", "--no-report"]), "a.mcap"),
        (brief(&["--report", "a.html", "--no-record"]), "a.html"),
        (brief(&[&["--picture", "a.png", "--no-record", "--no-report"], &SMALL[..]].concat()), "a.png"),
        (brief(&[&["--film", "a.gif", "--no-record", "--no-report"], &SMALL[..]].concat()), "a.gif"),
        (vec!["replay", "r.mcap", "--headless", "--report", "b.html"], "b.html"),
        ([&["replay", "r.mcap", "--picture", "c.png"], &SMALL[..]].concat(), "c.png"),
        (vec!["mesh", "face.obj", "--repair", "--out", "a.ply"], "a.ply"),
        (vec!["mesh", "face.obj", "--picture", "b.png", "--size", "32x24"], "b.png"),
        (vec!["gallery", "shown", "--scenario", "wall", "--at", "0.1", "--size", "32x24"], "shown/wall.png"),
    ]
}

#[test]
fn a_named_file_that_is_there_is_refused_by_name_and_with_force_overwritten_whole() {
    let folder = here();
    write(folder.path(), "face.obj", FACE);
    std::fs::create_dir(folder.path().join("shown")).expect("a folder");
    assert_eq!(brief(folder.path(), &["--no-report", "--record", "r.mcap"]).status.code(), Some(0));
    for (arguments, name) in writers() {
        let file = folder.path().join(name);
        write(folder.path(), name, "precious");
        for (protected, told) in
            [(false, "exists already; --force overwrites it"), (true, "is read-only; --force")]
        {
            let mut mode = std::fs::metadata(&file).expect("a file").permissions();
            mode.set_readonly(protected);
            std::fs::set_permissions(&file, mode).expect("its mode");
            let output = trocar(folder.path(), &arguments);
            let message = stderr(&output);
            assert_eq!(output.status.code(), Some(4), "{arguments:?}: {message}");
            assert!(message.contains(name) && message.contains(told), "{arguments:?}: {message}");
            assert_eq!(read(folder.path(), name), b"precious", "{arguments:?}");
        }
        let forced = trocar(folder.path(), &[&arguments[..], &["--force"]].concat());
        assert!(matches!(forced.status.code(), Some(0 | 1)), "{arguments:?}: {}", stderr(&forced));
        assert_ne!(read(folder.path(), name), b"precious", "{arguments:?}");
    }
    assert!(is_whole(&folder.path().join("a.mcap")));
    let left: Vec<String> = names(folder.path()).into_iter().filter(|name| name.ends_with(".part")).collect();
    assert_eq!(left, [] as [&str; 0]);
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
    use std::os::unix::fs::{FileTypeExt, PermissionsExt, symlink};
    use std::os::unix::process::CommandExt;

    use super::*;

    #[test]
    fn a_link_stays_a_link_and_what_it_leads_to_is_an_earlier_result() {
        let folder = here();
        write(folder.path(), "real.html", "precious");
        symlink("real.html", folder.path().join("link.html")).expect("a link");
        symlink("nowhere", folder.path().join("dead.html")).expect("a link");
        let report = |more: &[&str]| brief(folder.path(), &[&["--no-record", "--report"], more].concat());
        let refused = report(&["link.html"]);
        assert_eq!(refused.status.code(), Some(4));
        assert!(stderr(&refused).contains("link.html: exists already"), "{}", stderr(&refused));
        assert_eq!(report(&["link.html", "--force"]).status.code(), Some(0));
        assert!(folder.path().join("link.html").symlink_metadata().expect("a link").is_symlink());
        assert!(read(folder.path(), "real.html").starts_with(b"<!doctype html>"));
        let dead = report(&["dead.html", "--force"]);
        assert_eq!(dead.status.code(), Some(4));
        assert!(stderr(&dead).contains("leads nowhere"), "{}", stderr(&dead));
        // Under a usual name anything is in the way, and stays.
        symlink("precious.mcap", folder.path().join("wall.mcap")).expect("a link");
        assert_eq!(object(&brief(folder.path(), &["--json"]))["recording"], "wall-2.mcap");
        assert!(!folder.path().join("precious.mcap").exists());
    }

    #[test]
    fn devices_are_written_to_as_they_are() {
        let null = Path::new("/dev/null");
        let folder = here();
        symlink(null, folder.path().join("null.ply")).expect("a link");
        symlink("/dev/full", folder.path().join("full.ply")).expect("a link");
        write(folder.path(), "face.obj", FACE);
        let pictures = [&["--no-record", "--no-report", "--picture"], &["/dev/null"][..], &SMALL].concat();
        for arguments in [
            [&BRIEF[..], &["--record", "/dev/null", "--report", "/dev/null"]].concat(),
            [&BRIEF[..], &["--record", "/dev/null", "--no-report", "--force"]].concat(),
            [&BRIEF[..], &pictures].concat(),
            vec!["mesh", "face.obj", "--repair", "--out", "null.ply"],
        ] {
            let output = trocar(folder.path(), &arguments);
            assert!(matches!(output.status.code(), Some(0 | 1)), "{arguments:?}: {}", stderr(&output));
            assert!(null.symlink_metadata().expect("a device").file_type().is_char_device(), "{arguments:?}");
        }
        let whole = object(&brief(folder.path(), &["--record", "/dev/null", "--no-report", "--json"]));
        assert_eq!((&whole["recording_complete"], &whole["error"]), (&true.into(), &serde_json::Value::Null));
        assert_eq!(brief(folder.path(), &["--no-report", "--record", "r.mcap"]).status.code(), Some(0));
        let Ok(full) = Path::new("/dev/full").symlink_metadata() else { return };
        let pictures = [&["--no-record", "--no-report", "--picture"], &["/dev/full"][..], &SMALL].concat();
        for (arguments, is_told) in [
            ([&BRIEF[..], &["--record", "/dev/full", "--no-report"]].concat(), false),
            ([&BRIEF[..], &["--report", "/dev/full", "--no-record"]].concat(), true),
            ([&BRIEF[..], &pictures].concat(), true),
            (vec!["replay", "r.mcap", "--headless", "--report", "/dev/full"], true),
            (vec!["mesh", "face.obj", "--repair", "--out", "full.ply"], false),
        ] {
            let output = trocar(folder.path(), &arguments);
            assert_eq!(output.status.code(), Some(4), "{arguments:?}: {}", stderr(&output));
            assert!(stderr(&output).contains("No space left"), "{arguments:?}: {}", stderr(&output));
            assert_eq!(stdout(&output).contains("state hash"), is_told, "{arguments:?}");
        }
        assert!(full.file_type().is_char_device());
        assert_eq!(names(folder.path()), ["face.obj", "full.ply", "null.ply", "r.mcap"]);
    }

    #[test]
    fn a_fifo_is_written_to_when_somebody_reads_and_refused_otherwise() {
        let folder = here();
        let made = Command::new("mkfifo").arg(folder.path().join("fifo")).status().expect("mkfifo runs");
        assert!(made.success());
        for more in [["--no-record", "--report", "fifo"], ["--no-report", "--record", "fifo"]] {
            let refused = brief(folder.path(), &more);
            assert_eq!(refused.status.code(), Some(4), "{more:?}");
            assert!(
                stderr(&refused).contains("fifo: is a FIFO that nobody reads from"),
                "{}",
                stderr(&refused)
            );
        }
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
    fn what_no_result_can_be_written_to_is_refused_with_what_is_valid() {
        let folder = here();
        let _socket = std::os::unix::net::UnixListener::bind(folder.path().join("socket")).expect("a socket");
        std::fs::create_dir(folder.path().join("folder")).expect("a folder");
        for (name, what) in
            [("socket", "is a socket"), ("folder", "is a directory"), ("no/a.html", "does not exist")]
        {
            for option in ["--report", "--record"] {
                let refused = brief(folder.path(), &[option, name, "--force"]);
                assert_eq!(refused.status.code(), Some(4), "{option} {name}");
                assert!(stderr(&refused).contains(what), "{option} {name}: {}", stderr(&refused));
            }
        }
        assert_eq!(names(folder.path()), ["folder", "socket"]);
    }

    /// The same rules as an ordinary user, who may not write everywhere.
    #[test]
    fn an_ordinary_user_is_refused_where_the_system_refuses_and_loses_nothing() {
        let folder = here();
        let at = |name: &str| folder.path().join(name);
        let mode = |path: &Path, mode| {
            std::fs::set_permissions(path, std::fs::Permissions::from_mode(mode)).expect("allowed");
        };
        // Where the program was built, others may not be allowed to look. Another process copies it: a handle of this one
        // that a sibling test inherits would keep it from being run.
        let copied = Command::new("cp").arg(env!("CARGO_BIN_EXE_trocar")).arg(at("program")).status();
        assert!(copied.expect("cp runs").success());
        for below in ["open", "closed"] {
            std::fs::create_dir(at(below)).expect("a folder");
        }
        write(&at("closed"), "theirs.html", "precious");
        write(&at("open"), "theirs.html", "precious");
        for (name, bits) in [("", 0o755), ("program", 0o755), ("open", 0o777), ("closed", 0o755)] {
            mode(&at(name), bits);
        }
        mode(&at("open/theirs.html"), 0o444);
        mode(&at("closed/theirs.html"), 0o444);
        // In a test of root the files are root's and the user is nobody; otherwise all of them are the user's own.
        let is_root = std::fs::metadata("/proc/self").is_ok_and(|found| {
            use std::os::unix::fs::MetadataExt;
            found.uid() == 0
        });
        if !is_root {
            mode(&at("closed"), 0o555);
        }
        let run = |below: &str, more: &[&str]| {
            let mut command = Command::new(at("program"));
            command.args(BRIEF).args(more).current_dir(at(below)).env("NO_COLOR", "1");
            if is_root {
                command.uid(65_534).gid(65_534);
            }
            command.output().expect("the program starts")
        };
        assert_eq!(run("open", &[]).status.code(), Some(0));
        assert_eq!(names(&at("open")), ["report-wall.html", "theirs.html", "wall.mcap"]);
        for (below, more, told) in [
            ("open", &["--no-record", "--report", "theirs.html"][..], "is read-only; --force"),
            ("closed", &["--no-record", "--report", "theirs.html"], "is read-only; --force"),
            ("closed", &["--no-record"], "report-wall.html: cannot be written: Permission denied"),
            ("closed", &["--no-report"], "wall.mcap: cannot be written: Permission denied"),
        ] {
            let refused = run(below, more);
            assert_eq!(refused.status.code(), Some(4), "{more:?}: {}", stderr(&refused));
            assert!(stderr(&refused).contains(told), "{more:?}: {}", stderr(&refused));
        }
        // A folder that is closed: the score comes out, and the old report stays.
        let lost = run("closed", &["--no-record", "--report", "theirs.html", "--force", "--json"]);
        assert_eq!(lost.status.code(), Some(4), "{}", stderr(&lost));
        let summary = object(&lost);
        assert_valid("run", &summary);
        assert!(summary["state_hash"].is_string() && summary["report"].is_null(), "{summary}");
        assert!(
            summary["losses"].to_string().contains("no report: theirs.html: cannot be written"),
            "{summary}"
        );
        assert_eq!(read(&at("closed"), "theirs.html"), b"precious");
        if !is_root {
            mode(&at("closed"), 0o755);
        }
    }
}
