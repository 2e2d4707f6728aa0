//! Signals to a live run.

use std::process::Command;

use crate::support::{assert_valid, here, object, stderr, trocar};
use trocar_test_support::alone;

#[test]
#[cfg(unix)]
fn a_signal_ends_a_live_run_within_two_seconds_and_in_good_order() {
    let _alone = alone();
    let folder = here();
    for signal in ["-INT", "-TERM"] {
        let child = Command::new(env!("CARGO_BIN_EXE_trocar"))
            .args(["run", "peg-transfer", "--json", "--record", "cut.mcap", "--no-report"])
            .current_dir(folder.path())
            .stdout(std::process::Stdio::piped())
            .stderr(std::process::Stdio::piped())
            .spawn()
            .expect("the program starts");
        std::thread::sleep(std::time::Duration::from_millis(1_500));
        let sent = std::time::Instant::now();
        let killed =
            Command::new("kill").args([signal, &child.id().to_string()]).status().expect("kill runs");
        assert!(killed.success(), "the run was over before the signal");
        let output = child.wait_with_output().expect("an end");
        assert!(sent.elapsed().as_secs_f64() < 2.0, "{signal}: {:?}", sent.elapsed());
        assert_eq!(output.status.code(), Some(0), "{signal}: {}", stderr(&output));
        let summary = object(&output);
        assert_valid("run", &summary);
        assert_eq!(summary["task"]["cut_off"], true);
        assert_eq!(summary["recording_complete"], true);
        let replayed = trocar(folder.path(), &["replay", "cut.mcap", "--json"]);
        assert_eq!(object(&replayed)["state_hash"], summary["state_hash"], "{}", stderr(&replayed));
    }
}
