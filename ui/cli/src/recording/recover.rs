//! `trocar recording recover`: what is whole of a cut or damaged recording, as a closed file.

use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

use serde_json::json;
use trocar::summary::{Exit, SCHEMA};
use trocar_kernel::recorder::{Recording, RecordingError, Recovered};
use trocar_scene::output_file::Claim;

use super::RecoverArgs;
use crate::escape::printable;
use crate::failure::Failure;
use crate::output;

/// Writes what is whole of a recording into a new file.
pub fn recover(args: &RecoverArgs) -> Result<Exit, Failure> {
    let target = args.out.clone().unwrap_or_else(|| beside(&args.file));
    let takes_stdout = output::takes_stdout(args.json, [Some(target.as_path())])?;
    let recording = Recording::open(&args.file).map_err(Failure::invalid)?;
    let mut part = Claim::take(&target, output::replace(args.force))?.part()?;
    let mut out = BufWriter::new(part.file());
    let unwritten = |error| Failure::invalid(format!("{}: cannot be written: {error}", target.display()));
    let found = recording.recover(&mut out).map_err(|error| match error {
        RecordingError::Write(error) => unwritten(error),
        error => Failure::invalid(error),
    })?;
    out.flush().map_err(unwritten)?;
    drop(out);
    part.finish()?;
    if args.json {
        output::print_json(&json!({
            "schema": SCHEMA,
            "file": args.file.display().to_string(),
            "recovered": target.display().to_string(),
            "bytes": found.bytes,
            "chunks": found.chunks,
            "damaged_chunks": found.damaged_chunks,
            "seconds": found.until.as_secs_f64(),
            "damage": found.damage,
        }))?;
    } else if takes_stdout {
        output::tell(&text(&target, &found).join("\n"));
    } else {
        output::print_text(&text(&target, &found).join("\n"))?;
    }
    Ok(Exit::Ok)
}

/// `a/b.mcap` → `a/b-recovered.mcap`.
fn beside(file: &Path) -> PathBuf {
    let stem = file.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    file.with_file_name(format!("{stem}-recovered.mcap"))
}

fn text(target: &Path, found: &Recovered) -> Vec<String> {
    let mut lines: Vec<String> = found.damage.iter().map(|what| printable(what)).collect();
    lines.push(format!(
        "{} whole chunks, {} damaged; {:.2} s are in {}",
        found.chunks,
        found.damaged_chunks,
        found.until.as_secs_f64(),
        printable(&target.display().to_string())
    ));
    lines
}
