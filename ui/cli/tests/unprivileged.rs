//! Without root, real-time priority or locked memory everything works, and what is lost is said.

use std::os::unix::fs::PermissionsExt;
use std::os::unix::process::CommandExt;
use std::path::Path;
use std::process::{Command, Output};

use trocar::summary::RunSummary;
use trocar_kernel::runtime::ticker;
use trocar_scene::SimTime;
use trocar_test_support::alone;

const SECONDS: u64 = 4;
const MILLISECOND: SimTime = SimTime::from_millis(1);
/// The least share of a bare loop's ticks that a hand makes under the same conditions.
const SHARE_MIN: f64 = 0.5;

/// Runs the program without rights: no real-time priority, 64 KiB of locked memory, and as nobody when it can.
fn unprivileged(program: &Path, folder: &Path, arguments: &[&str]) -> Output {
    let mut command = Command::new("sh");
    command.args(["-c", "ulimit -r 0; ulimit -l 64; exec \"$0\" \"$@\""]).arg(program).args(arguments);
    command.current_dir(folder);
    // Root may do everything whatever its limits are.
    if is_root() {
        command.uid(65_534).gid(65_534);
    }
    command.output().expect("a shell starts")
}

fn is_root() -> bool {
    let status = std::fs::read_to_string("/proc/self/status").expect("the system tells");
    let ids = status.lines().find_map(|line| line.strip_prefix("Uid:")).expect("a process has a user");
    ids.split_whitespace().nth(1) == Some("0")
}

#[test]
fn the_live_exercise_runs_without_any_rights_and_says_what_it_lost() {
    let _alone = alone();
    // Where the program was built, others may not be allowed to look.
    let folder = tempfile::tempdir().expect("a folder");
    let program = folder.path().join("trocar");
    std::fs::copy(env!("CARGO_BIN_EXE_trocar"), &program).expect("copied");
    for (path, mode) in [(folder.path(), 0o777), (program.as_path(), 0o755)] {
        std::fs::set_permissions(path, std::fs::Permissions::from_mode(mode)).expect("allowed");
    }

    // Beside it a bare loop that ticks as often, under the ordinary scheduler as well.
    let mut floor = 0_u64;
    let output = std::thread::scope(|scope| {
        scope.spawn(|| {
            let span = SimTime::from_millis(1_000 * SECONDS);
            ticker::bare_loop(MILLISECOND, span, |_| floor += 1).expect("a timer");
        });
        let seconds = SECONDS.to_string();
        let arguments = ["run", "peg-transfer", "--seconds", &seconds, "--json", "--no-report"];
        unprivileged(&program, folder.path(), &arguments)
    });
    let errors = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(0), "{errors}");
    let summary: RunSummary = serde_json::from_slice(&output.stdout).expect("one object");
    assert!(summary.task.cut_off && summary.error.is_none(), "{:?}", summary.error);
    assert!(summary.recording_complete, "the recording lies in a folder that anybody may write to");

    // Said once for the controllers, with a way to mend it, and once for each device.
    let losses = &summary.losses;
    assert!(losses.iter().any(|loss| loss.contains("SCHED_FIFO") && loss.contains("rtprio")), "{losses:?}");
    for device in ["device.left", "device.right"] {
        assert!(losses.iter().any(|loss| loss.starts_with(device)), "{losses:?}");
    }
    for hand in ["haptics.left", "haptics.right"] {
        let row = summary.controllers.iter().find(|row| row.name == hand).expect("it has a row");
        let ran = row.scheduled - row.missed;
        assert!(
            ran as f64 >= SHARE_MIN * floor as f64,
            "{hand} ticked {ran} times, a bare loop {floor} times"
        );
        assert_eq!(row.demotions, 0, "what was never granted is not taken away");
    }
}
