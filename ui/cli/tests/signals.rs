//! Signals to a session: it ends in good order, with the exit code of the signal.

use std::io::Write;
use std::path::Path;
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};

use crate::support::{assert_valid, here, names, object, stderr, stdout, trocar};
use trocar_test_support::alone;

/// The signals, with the options of `kill` and the exit codes.
const SIGNALS: [(&str, &str, i32); 3] =
    [("SIGHUP", "-HUP", 129), ("SIGINT", "-INT", 130), ("SIGTERM", "-TERM", 143)];
/// Nothing takes as long as this on the slowest machine.
const PATIENCE: Duration = Duration::from_secs(60);

/// Starts the program as from a terminal, whatever the tests themselves were started by.
fn start(folder: &Path, arguments: &[&str], environment: &[(&str, &Path)]) -> Child {
    Command::new("env")
        .args(["--default-signal=HUP,INT,TERM", env!("CARGO_BIN_EXE_trocar")])
        .args(arguments)
        .current_dir(folder)
        .env("NO_COLOR", "1")
        .env("TROCAR_RUNTIME_DIR", folder.join("run"))
        .envs(environment.iter().copied())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("the program starts")
}

fn send(child: &Child, signal: &str) {
    let sent = Command::new("kill").args([signal, &child.id().to_string()]).status().expect("kill runs");
    assert!(sent.success(), "the run was over before the signal");
}

fn wait_for(what: &str, is_there: impl Fn() -> bool) {
    let begun = Instant::now();
    while !is_there() {
        assert!(begun.elapsed() < PATIENCE, "in vain: {what}");
        std::thread::sleep(Duration::from_millis(20));
    }
}

/// Waits until the session has begun: its socket is there.
fn wait_for_session(folder: &Path) {
    let sockets = || std::fs::read_dir(folder.join("run"));
    wait_for("a session", || sockets().is_ok_and(|mut sockets| sockets.next().is_some()));
}

fn end(child: Child) -> Output {
    child.wait_with_output().expect("an end")
}

#[test]
#[cfg(target_os = "linux")]
fn a_signal_ends_a_live_run_within_two_seconds_in_good_order_and_with_its_own_exit_code() {
    let _alone = alone();
    for (name, option, code) in SIGNALS {
        let folder = here();
        let child = start(folder.path(), &["run", "peg-transfer", "--json", "--headless"], &[]);
        wait_for_session(folder.path());
        std::thread::sleep(Duration::from_millis(500));
        let sent = Instant::now();
        send(&child, option);
        let output = end(child);
        assert!(sent.elapsed().as_secs_f64() < 2.0, "{name}: {:?}", sent.elapsed());
        assert_eq!(output.status.code(), Some(code), "{name}: {}", stderr(&output));
        let summary = object(&output);
        assert_valid("run", &summary);
        assert_eq!((&summary["task"]["cut_off"], &summary["cut_off_by"]), (&true.into(), &name.into()));
        assert!(summary["error"].as_str().is_some_and(|error| error.contains(name)), "{summary}");
        assert_eq!(summary["recording_complete"], true);
        let replayed = trocar(folder.path(), &["replay", "peg-transfer.mcap", "--json"]);
        assert_eq!(object(&replayed)["state_hash"], summary["state_hash"], "{}", stderr(&replayed));
        let report =
            std::fs::read_to_string(folder.path().join("report-peg-transfer.html")).expect("a report");
        assert!(report.contains(&format!("{name} ended the run")) && report.ends_with("</html>\n"));
        assert_eq!(names(folder.path()), ["peg-transfer.mcap", "report-peg-transfer.html", "run"]);
    }
}

#[test]
#[cfg(target_os = "linux")]
fn a_person_reads_who_ended_a_run_and_a_second_signal_ends_it_with_the_same_code() {
    let _alone = alone();
    let folder = here();
    let child = start(folder.path(), &["run", "wall", "--headless", "--no-report"], &[]);
    wait_for_session(folder.path());
    send(&child, "-INT");
    let output = end(child);
    assert_eq!(output.status.code(), Some(130), "{}", stderr(&output));
    assert!(stdout(&output).contains("SIGINT ended the run before its time"), "{}", stdout(&output));
    // Both may arrive before the program has looked: the first one ends it in good order then.
    let child = start(folder.path(), &["run", "wall", "--headless", "--no-report"], &[]);
    wait_for_session(folder.path());
    send(&child, "-TERM");
    let _ = Command::new("kill").args(["-TERM", &child.id().to_string()]).stderr(Stdio::null()).status();
    assert_eq!(end(child).status.code(), Some(143));
}

#[test]
#[cfg(target_os = "linux")]
fn a_run_that_is_killed_leaves_a_recording_to_read_and_no_name_that_is_lost() {
    let _alone = alone();
    let folder = here();
    let named = ["run", "wall", "--headless", "--record", "a.mcap", "--report", "a.html"];
    let child = start(folder.path(), &named, &[]);
    wait_for_session(folder.path());
    let sessions = folder.path().join("run");
    std::thread::sleep(Duration::from_secs(2));
    send(&child, "-KILL");
    assert_eq!(end(child).status.code(), None);
    std::fs::remove_dir_all(sessions).expect("its socket goes");
    // The file that held the report's name is empty, and the next run has the name.
    assert_eq!(std::fs::metadata(folder.path().join("a.html")).expect("it held the name").len(), 0);
    let again = ["run", "wall", "--lockstep", "--seconds", "0.1", "--no-record", "--report", "a.html"];
    let next = trocar(folder.path(), &again);
    assert_eq!(next.status.code(), Some(0), "{}", stderr(&next));
    assert!(std::fs::read(folder.path().join("a.html")).expect("a report").ends_with(b"</html>\n"));
    let recovered = trocar(folder.path(), &["recording", "recover", "a.mcap", "--json"]);
    let seconds = object(&recovered)["seconds"].as_f64();
    assert!(seconds.is_some_and(|seconds| seconds >= 1.0), "of two seconds: {seconds:?}");
    assert_eq!(names(folder.path()), ["a-recovered.mcap", "a.html", "a.mcap"]);
}

#[test]
#[cfg(target_os = "linux")]
fn a_run_whose_reader_takes_nothing_ends_with_the_second_signal() {
    let _alone = alone();
    let folder = here();
    let fifo = folder.path().join("fifo");
    assert!(Command::new("mkfifo").arg(&fifo).status().expect("mkfifo runs").success());
    // Nobody takes out what is in there, and little more fits in.
    let mut held = std::fs::File::options().read(true).write(true).open(&fifo).expect("a FIFO");
    held.write_all(&[0; 60_000]).expect("room");
    let run = ["run", "wall", "--lockstep", "--seconds", "0.1", "--no-record", "--report", "fifo"];
    let mut child = start(folder.path(), &run, &[]);
    std::thread::sleep(Duration::from_secs(1));
    assert!(child.try_wait().expect("a child").is_none(), "the report waits for its reader");
    send(&child, "-TERM");
    std::thread::sleep(Duration::from_millis(100));
    send(&child, "-TERM");
    assert_eq!(end(child).status.code(), Some(143));
}

#[test]
#[cfg(target_os = "linux")]
fn a_run_that_shall_outlive_its_terminal_does() {
    let _alone = alone();
    let folder = here();
    let child = Command::new("nohup")
        .arg(env!("CARGO_BIN_EXE_trocar"))
        .args(["run", "wall", "--seconds", "1.5", "--json", "--headless", "--no-report"])
        .current_dir(folder.path())
        .env("TROCAR_RUNTIME_DIR", folder.path().join("run"))
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("nohup runs");
    wait_for_session(folder.path());
    send(&child, "-HUP");
    let output = end(child);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    assert!(object(&output)["cut_off_by"].is_null());
}

#[test]
#[cfg(target_os = "linux")]
fn a_soak_that_a_signal_ends_tells_what_came_of_its_plans_until_then() {
    let _alone = alone();
    let folder = here();
    let scratch = folder.path().join("scratch");
    std::fs::create_dir(&scratch).expect("a folder");
    let soak = ["soak", "--plans", "100000", "--seconds", "0.1", "--json"];
    let child = start(folder.path(), &soak, &[("TMPDIR", &scratch)]);
    // Its folder for recordings is made when it has begun.
    wait_for("a soak", || !names(&scratch).is_empty());
    send(&child, "-INT");
    let output = end(child);
    assert_eq!(output.status.code(), Some(130), "{}", stderr(&output));
    let object = object(&output);
    assert!(object["plans"].as_u64().is_some_and(|plans| plans < 100_000), "{object}");
    assert!(
        object["error"].as_str().is_some_and(|error| error.contains("SIGINT ended the soak")),
        "{object}"
    );
    assert_eq!(names(&scratch), [] as [&str; 0], "what it recorded is gone");
}
