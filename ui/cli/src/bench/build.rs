//! The suite `build`: time of a cold build of the program from these sources, the program's size, and the disk space of
//! the build.

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Instant;

use trocar::summary::{BenchResult, Better};

use crate::failure::Failure;

/// Longest cold build on two idle cores \[min\].
const WALL_MAX_MIN: f64 = 8.0;
/// Most processor time of a cold build \[min\].
const CPU_MAX_MIN: f64 = 13.0;
/// Largest program \[MB\].
const PROGRAM_MAX_MB: f64 = 60.0;
/// Most disk of the target folder \[GB\].
const TARGET_MAX_GB: f64 = 2.0;

/// Builds the program into an empty folder as the README says, after downloading the dependencies.
pub fn cold() -> Result<Vec<BenchResult>, Failure> {
    let sources = sources()?;
    let target = tempfile::tempdir().map_err(Failure::internal)?;
    cargo(&sources, target.path(), &["fetch", "--locked", "--quiet"])?;
    let (begun, cpu_before) = (Instant::now(), children_cpu_secs());
    cargo(&sources, target.path(), &["build", "--release", "--locked", "--quiet"])?;
    let wall_min = begun.elapsed().as_secs_f64() / 60.0;
    let cpu_min = cpu_before.zip(children_cpu_secs()).map(|(before, after)| (after - before) / 60.0);
    let program = target.path().join("release/trocar").with_extension(std::env::consts::EXE_EXTENSION);
    let program_mb = std::fs::metadata(&program).map_err(Failure::internal)?.len() as f64 * 1e-6;
    let target_gb = disk_bytes(target.path())? as f64 * 1e-9;
    let row = |name: &str, unit: &str, value: f64, bar: f64| {
        BenchResult::on_value(name, unit, (value, 0.0), Some(bar), Better::Lower)
    };
    let mut rows = vec![row("cold_build_wall", "min", wall_min, WALL_MAX_MIN)];
    rows.extend(cpu_min.map(|minutes| row("cold_build_cpu", "min", minutes, CPU_MAX_MIN)));
    rows.push(row("program_size", "MB", program_mb, PROGRAM_MAX_MB));
    rows.push(row("target_folder", "GB", target_gb, TARGET_MAX_GB));
    Ok(rows)
}

/// The sources that this program was built from, if they still exist.
fn sources() -> Result<PathBuf, Failure> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    if root.join("Cargo.lock").is_file() {
        return Ok(root);
    }
    Err(Failure::usage("the suite 'build' needs the sources that this program was built from; they are gone"))
}

fn cargo(sources: &Path, target: &Path, words: &[&str]) -> Result<(), Failure> {
    let cargo = std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into());
    let mut command = Command::new(cargo);
    command.args(words).current_dir(sources).env("CARGO_TARGET_DIR", target);
    command.stdin(Stdio::null()).stdout(Stdio::null());
    let status = command
        .status()
        .map_err(|error| Failure::usage(format!("the suite 'build' needs cargo on the path: {error}")))?;
    if status.success() {
        return Ok(());
    }
    Err(Failure::internal(format!("cargo {} failed: {status}", words.join(" "))))
}

/// Processor time of all ended child processes and their descendants \[s\]; unknown where the system has no `/proc`.
fn children_cpu_secs() -> Option<f64> {
    let text = std::fs::read_to_string("/proc/self/stat").ok()?;
    // The program's name is in parentheses and may contain spaces; the children's times are fields 16 and 17.
    let fields: Vec<&str> = text.rsplit_once(')')?.1.split_whitespace().collect();
    let ticks = |field: usize| fields.get(field - 3)?.parse::<f64>().ok();
    Some((ticks(16)? + ticks(17)?) / rustix::param::clock_ticks_per_second() as f64)
}

/// Bytes of all files below a folder; a hard-linked file counts once for each name.
fn disk_bytes(folder: &Path) -> Result<u64, Failure> {
    let mut bytes = 0;
    for entry in std::fs::read_dir(folder).map_err(Failure::internal)? {
        let entry = entry.map_err(Failure::internal)?;
        let kind = entry.metadata().map_err(Failure::internal)?;
        bytes += if kind.is_dir() { disk_bytes(&entry.path())? } else { kind.len() };
    }
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_time_of_children_is_counted() {
        let Some(before) = children_cpu_secs() else { return };
        let busy =
            Command::new("sh").args(["-c", "i=0; while [ $i -lt 300000 ]; do i=$((i+1)); done"]).status();
        assert!(busy.expect("a shell").success());
        assert!(children_cpu_secs().expect("as before") > before);
    }

    #[test]
    fn the_bytes_of_a_folder_are_those_of_all_its_files() {
        let folder = tempfile::tempdir().expect("a folder");
        std::fs::create_dir(folder.path().join("below")).expect("a folder below");
        std::fs::write(folder.path().join("a"), [0; 1_000]).expect("a file");
        std::fs::write(folder.path().join("below/b"), [0; 234]).expect("a file below");
        assert_eq!(disk_bytes(folder.path()).expect("readable"), 1_234);
    }
}
