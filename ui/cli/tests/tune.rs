//! Tuning from outside: before a run, and while it goes on, by a second process.

use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};

use serde_json::Value;
use trocar_test_support::alone;

const PROGRAM: &str = env!("CARGO_BIN_EXE_trocar");

fn trocar(folder: &Path, arguments: &[&str]) -> Output {
    let mut command = Command::new(PROGRAM);
    command
        .args(arguments)
        .current_dir(folder)
        .env("NO_COLOR", "1")
        .env("TROCAR_RUNTIME_DIR", folder.join("run"));
    command.output().expect("the program starts")
}

fn object(output: &Output) -> Value {
    serde_json::from_slice(&output.stdout)
        .unwrap_or_else(|error| panic!("{error}: {:?}, {}", output, String::from_utf8_lossy(&output.stderr)))
}

fn said(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

#[test]
fn values_are_set_before_a_run() {
    let _alone = alone();
    let folder = tempfile::tempdir().unwrap();
    let run = |more: &[&str]| {
        let base =
            ["run", "peg-transfer", "--lockstep", "--seconds", "0.5", "--no-report", "--no-record", "--json"];
        trocar(folder.path(), &[&base[..], more].concat())
    };
    let hash = |output: &Output| {
        assert_eq!(output.status.code(), Some(0), "{}", said(output));
        object(output)["state_hash"].as_str().unwrap().to_owned()
    };
    let plain = hash(&run(&[]));
    let heavy = hash(&run(&["--set", "ring.*.rigid_body.mass=0.02"]));
    assert_ne!(plain, heavy);
    // The same as what is written there already.
    assert_eq!(plain, hash(&run(&["--set", "ring.*.rigid_body.mass=0.005"])));

    let sets = folder.path().join("sets.toml");
    std::fs::write(&sets, "schema = 1\n[sets.a]\n\"ring.*.rigid_body.mass\" = 0.02\n").unwrap();
    assert_eq!(heavy, hash(&run(&["--tuning", "sets.toml", "--use", "a"])));
    for (wrong, says) in [
        (["--set", "ring.1.rigid_body.mas=1"], "there is no 'mas'"),
        (["--set", "gravity.2=-1000"], "-100 to 100"),
        (["--tuning", "nowhere.toml"], "nowhere.toml"),
    ] {
        let output = run(&wrong);
        assert_eq!(output.status.code(), Some(4), "{wrong:?}");
        assert!(said(&output).contains(says), "{}", said(&output));
    }
    let output = run(&["--tuning", "sets.toml", "--use", "b"]);
    assert!(said(&output).contains("base, a"), "{}", said(&output));
    assert_eq!(run(&["--set", "nothing"]).status.code(), Some(2));
}

/// A session in the background; it ends with the test.
struct Running(Child);

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

struct Session {
    folder: tempfile::TempDir,
    process: Running,
}

impl Session {
    fn start() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let scenario = concat!(env!("CARGO_MANIFEST_DIR"), "/../../scenarios/peg-transfer.toml");
        std::fs::copy(scenario, folder.path().join("mine.toml")).unwrap();
        let sets = "schema = 1\n[sets.a]\n\"ring.*.rigid_body.mass\" = 0.02\n\
                    [sets.b]\n\"grasper.*.instrument.jaw_friction\" = 0.3\n";
        std::fs::write(folder.path().join("sets.toml"), sets).unwrap();
        let mut command = Command::new(PROGRAM);
        command.args([
            "run",
            "mine.toml",
            "--tuning",
            "sets.toml",
            "--headless",
            "--no-report",
            "--record",
            "r.mcap",
        ]);
        command.current_dir(folder.path()).env("TROCAR_RUNTIME_DIR", folder.path().join("run"));
        command.stdout(Stdio::null()).stderr(Stdio::null());
        let session = Self { process: Running(command.spawn().unwrap()), folder };
        let begun = Instant::now();
        while session.tune(&["status"]).status.code() != Some(0) {
            assert!(begun.elapsed() < Duration::from_secs(60), "the session does not answer");
            std::thread::sleep(Duration::from_millis(50));
        }
        session
    }

    fn tune(&self, arguments: &[&str]) -> Output {
        trocar(self.folder.path(), &[&["tune", "--json"], arguments].concat())
    }

    fn value(&self, field: &str) -> Value {
        let reply = object(&self.tune(&["list", field]));
        reply["fields"][0]["value"].clone()
    }

    fn refused(&self, arguments: &[&str]) -> String {
        let output = self.tune(arguments);
        assert_eq!(output.status.code(), Some(4), "{arguments:?}: {}", said(&output));
        assert_eq!(object(&output)["error"].as_str().map(|error| said(&output).contains(error)), Some(true));
        said(&output)
    }

    /// Ends the session as a user would, and returns its folder.
    fn interrupt(mut self) -> (tempfile::TempDir, PathBuf) {
        let pid = self.process.0.id().to_string();
        assert!(Command::new("kill").args(["-INT", &pid]).status().unwrap().success());
        self.process.0.wait().unwrap();
        let file = self.folder.path().join("r.mcap");
        (self.folder, file)
    }
}

#[test]
fn a_running_session_is_tuned_from_another_terminal() {
    let _alone = alone();
    let session = Session::start();
    let mass = |ring: &str| session.value(&format!("ring.{ring}.rigid_body.mass"));
    assert_eq!(object(&session.tune(&["status"]))["in_use"], "base");

    // One field, several fields, all or none.
    let set =
        object(&session.tune(&["set", "ring.6.rigid_body.mass=0.25", "ring.6.rigid_body.friction=0.75"]));
    assert_eq!(set["fields"].as_array().unwrap().len(), 2);
    assert_eq!((mass("6"), mass("5")), (0.25.into(), 0.005.into()));
    let refused = session.refused(&["set", "ring.5.rigid_body.mass=0.5", "ring.6.rigid_body.mass=-1"]);
    assert!(refused.contains("out of range"), "{refused}");
    assert_eq!((mass("6"), mass("5")), (0.25.into(), 0.005.into()));
    assert!(session.refused(&["set", "ring.9.rigid_body.mass=1"]).contains("ring.1"));

    // A and B, and back.
    assert_eq!(object(&session.tune(&["keep", "c"]))["sets"], serde_json::json!(["a", "b", "c"]));
    assert_eq!(object(&session.tune(&["use", "a"]))["in_use"], "a");
    assert_eq!((mass("6"), mass("5")), (0.02.into(), 0.02.into()));
    session.tune(&["use", "b"]);
    assert_eq!(
        (mass("6"), session.value("grasper.left.instrument.jaw_friction")),
        (0.005.into(), 0.3.into())
    );
    assert!(session.refused(&["use", "d"]).contains("base, a, b, c"));

    // The engine takes it: a ring that is put into the air falls.
    session.tune(&["set", "ring.6.pose.translation.2=0.1"]);
    let begun = Instant::now();
    while session.value("ring.6.pose.translation.2").as_f64().is_none_or(|height| height > 0.09) {
        assert!(begun.elapsed() < Duration::from_secs(20), "the ring hangs in the air");
    }

    // What was found good is saved, and nothing else changes in the file.
    session.tune(&["use", "c"]);
    let file = session.folder.path().join("mine.toml");
    let before = std::fs::read_to_string(&file).unwrap();
    assert_eq!(session.tune(&["save"]).status.code(), Some(0));
    let after = std::fs::read_to_string(&file).unwrap();
    let changed: Vec<(&str, &str)> =
        before.lines().zip(after.lines()).filter(|(before, after)| before != after).collect();
    assert!(changed.iter().any(|(_, line)| line.contains("mass = 0.25") && line.contains("friction = 0.75")));
    assert!(changed.len() <= 2 && before.lines().count() == after.lines().count(), "{changed:?}");
    assert!(session.refused(&["save", "sets.toml"]).contains("exists already"));
    session.tune(&["export", "kept.toml"]);
    let kept = || std::fs::read_to_string(session.folder.path().join("kept.toml")).unwrap();
    assert!(kept().contains("[sets.c]"));
    // Sets that were exported before stay, unless it is said.
    session.tune(&["keep", "d"]);
    assert!(session.refused(&["export", "kept.toml"]).contains("kept.toml: exists already; --force"));
    assert!(!kept().contains("[sets.d]"));
    assert_eq!(session.tune(&["export", "kept.toml", "--force"]).status.code(), Some(0));
    assert!(kept().contains("[sets.d]"));
    let printed = trocar(session.folder.path(), &["tune", "export", "-"]);
    assert_eq!(printed.stdout, kept().as_bytes(), "stdout holds the sets and nothing else");
    if Path::new("/dev/full").exists() {
        assert!(session.refused(&["export", "/dev/full"]).contains("No space left"));
    }

    // What an operator does is in the recording like everything else, and comes back in a replay.
    let (folder, recording) = session.interrupt();
    let replay = trocar(folder.path(), &["replay", recording.to_str().unwrap(), "--json"]);
    assert_eq!(replay.status.code(), Some(0), "{}", said(&replay));
    assert_eq!(std::fs::read_dir(folder.path().join("run")).unwrap().count(), 0, "the socket is left behind");
}

#[test]
fn without_a_session_there_is_nothing_to_tune() {
    let _alone = alone();
    let folder = tempfile::tempdir().unwrap();
    let output = trocar(folder.path(), &["tune", "status"]);
    assert_eq!(output.status.code(), Some(4));
    assert!(said(&output).contains("no session of yours is running"), "{}", said(&output));
}

#[test]
fn a_session_of_another_folder_is_not_tuned_in_silence() {
    let _alone = alone();
    let session = Session::start();
    let elsewhere = tempfile::tempdir().unwrap();
    let runtime = session.folder.path().join("run");
    let tune = |arguments: &[&str]| {
        let mut command = Command::new(PROGRAM);
        command.arg("tune").args(arguments).current_dir(elsewhere.path()).env("NO_COLOR", "1");
        command.env("TROCAR_RUNTIME_DIR", &runtime).output().expect("the program starts")
    };
    let before = session.value("ring.6.rigid_body.mass");
    let refused = tune(&["set", "ring.6.rigid_body.mass=0.25"]);
    assert_eq!(refused.status.code(), Some(4), "{}", said(&refused));
    let folder = std::fs::canonicalize(session.folder.path()).unwrap();
    let pid = session.process.0.id().to_string();
    for part in ["peg-transfer", &*folder.display().to_string(), &format!("--session {pid}")] {
        assert!(said(&refused).contains(part), "'{part}' is not in: {}", said(&refused));
    }
    assert_eq!(session.value("ring.6.rigid_body.mass"), before);
    let named = tune(&["set", "ring.6.rigid_body.mass=0.25", "--session", &pid]);
    assert_eq!(named.status.code(), Some(0), "{}", said(&named));
    assert_eq!(session.value("ring.6.rigid_body.mass"), 0.25);
}
