//! Recordings and exit after the process itself receives SIGKILL or SIGTERM.

use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use rustix::process::{Pid, Signal, kill_process};
use trocar::summary::{BenchResult, Better};
use trocar_kernel::recorder::Recording;

use super::Plan;
use crate::failure::Failure;

/// Rows of this kind.
pub fn plan<'a>(folder: &'a Path, plan: &mut Plan<'a>) {
    plan.rows("process_killed_recording_lacks", |_| killed(folder));
    plan.rows("process_terminated_with_a_zombie", |_| terminated(folder));
}

/// Runs this program on the exercise, live, and records.
fn start(folder: &Path, file: &str, more: &[&str]) -> Result<Child, Failure> {
    let program = std::env::current_exe().map_err(Failure::internal)?;
    Command::new(program)
        .args(["run", "peg-transfer", "--headless", "--no-report", "--record", file])
        .args(more)
        .current_dir(folder)
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .map_err(Failure::internal)
}

fn recorded_secs(file: &Path) -> Option<f64> {
    Recording::open(file).ok().map(|recording| recording.duration().as_secs_f64())
}

/// Waits until the recording has grown for a while, which shows that the session runs.
fn wait_for(child: &mut Child, file: &Path, secs: f64) -> Result<(), Failure> {
    let begun = Instant::now();
    while recorded_secs(file).is_none_or(|recorded| recorded < secs) {
        let gone = child.try_wait().map_err(Failure::internal)?.is_some();
        if gone || begun.elapsed() > Duration::from_secs(60) {
            // If it has ended by itself there is nothing to kill.
            let _ = child.kill();
            return Err(Failure::internal("the session did not get to run"));
        }
        std::thread::sleep(Duration::from_millis(100));
    }
    Ok(())
}

/// SIGKILL: how much of the session is missing in the file.
fn killed(folder: &Path) -> Result<Vec<BenchResult>, Failure> {
    let file = folder.join("sigkill.mcap");
    let mut lacking = Vec::new();
    for _ in 0..3 {
        // Otherwise the file of the previous run would be read.
        let _ = std::fs::remove_file(&file);
        let mut child = start(folder, "sigkill.mcap", &[])?;
        wait_for(&mut child, &file, 2.0)?;
        let (seen, at) = (recorded_secs(&file).unwrap_or(0.0), Instant::now());
        std::thread::sleep(Duration::from_millis(1_700));
        child.kill().map_err(Failure::internal)?;
        // This much time has passed since the last look; the file holds the difference.
        let passed = at.elapsed().as_secs_f64();
        child.wait().map_err(Failure::internal)?;
        lacking.push((passed - (recorded_secs(&file).unwrap_or(0.0) - seen)).max(0.0));
    }
    let worst = lacking.iter().copied().fold(0.0, f64::max);
    let name = "process_killed_recording_lacks";
    Ok(vec![BenchResult::on_value(name, "s", (worst, 0.0), Some(1.0), Better::Lower)])
}

/// SIGTERM while a thread hangs for good: how long the exit takes, and whether the recording is closed.
fn terminated(folder: &Path) -> Result<Vec<BenchResult>, Failure> {
    let plan = "schema = 1\n[[fault]]\nat_secs = 1.5\ntarget = \"task\"\nkind = \"stall\"\n";
    std::fs::write(folder.join("zombie.toml"), plan).map_err(Failure::internal)?;
    let file = folder.join("sigterm.mcap");
    let mut child = start(folder, "sigterm.mcap", &["--faults", "zombie.toml", "--seconds", "60"])?;
    wait_for(&mut child, &file, 2.5)?;
    let begun = Instant::now();
    let pid = i32::try_from(child.id()).ok().and_then(Pid::from_raw);
    let pid = pid.ok_or_else(|| Failure::internal("the session has no process number"))?;
    kill_process(pid, Signal::TERM).map_err(Failure::internal)?;
    while child.try_wait().map_err(Failure::internal)?.is_none() && begun.elapsed() < Duration::from_secs(10)
    {
        std::thread::sleep(Duration::from_millis(5));
    }
    let took = begun.elapsed().as_secs_f64();
    // Only after ten seconds is there a process left to kill.
    let _ = child.kill();
    let closed = Recording::open(&file).is_ok_and(|recording| recording.end().is_some());
    let mut row =
        BenchResult::on_value("process_terminated_with_a_zombie", "s", (took, 0.0), Some(2.0), Better::Lower);
    row.holds &= closed;
    Ok(vec![row])
}
