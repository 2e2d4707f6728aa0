//! `trocar recording recover`: what is whole of a cut or damaged recording, as a closed file.

use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

use serde_json::json;
use trocar::summary::{Exit, SCHEMA};
use trocar_kernel::recorder::{Recording, Recovered};

use super::RecoverArgs;
use crate::escape::printable;
use crate::failure::Failure;
use crate::output;

/// Writes what is whole of a recording into a new file.
pub fn recover(args: &RecoverArgs) -> Result<Exit, Failure> {
    let target = args.out.clone().unwrap_or_else(|| beside(&args.file));
    output::check_writable(&target)?;
    if target.exists() && !args.force {
        return Err(Failure::invalid(format!(
            "{}: there is a file of this name; --out names another, --force replaces it",
            target.display()
        )));
    }
    let recording = Recording::open(&args.file).map_err(Failure::invalid)?;
    let found = written(&recording, &target)?;
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
    } else {
        output::print_text(&text(&target, &found).join("\n"))?;
    }
    Ok(Exit::Ok)
}

/// Writes the new file whole or not at all.
fn written(recording: &Recording, target: &Path) -> Result<Recovered, Failure> {
    let mut name = target.file_name().unwrap_or_default().to_owned();
    name.push(format!(".{}.part", std::process::id()));
    let part = target.with_file_name(name);
    let attempt = || {
        let file = File::create_new(&part).map_err(|error| Failure::write(target, error))?;
        let mut out = BufWriter::new(file);
        let found = recording.recover(&mut out).map_err(Failure::invalid)?;
        let done = out.flush().and_then(|()| std::fs::rename(&part, target));
        done.map(|()| found).map_err(|error| Failure::write(target, error))
    };
    attempt().inspect_err(|_| {
        // A part of a file is of no use; the first error is the one to tell.
        let _ = std::fs::remove_file(&part);
    })
}

/// `a/b.mcap` → `a/b-recovered.mcap`.
fn beside(file: &Path) -> PathBuf {
    let stem = file.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    file.with_file_name(format!("{stem}-recovered.mcap"))
}

fn text(target: &Path, found: &Recovered) -> Vec<String> {
    let mut lines: Vec<String> = found.damage.iter().map(|what| printable(what)).collect();
    lines.push(format!(
        "{} whole chunks, {} damaged; the first {:.2} s reach into {}",
        found.chunks,
        found.damaged_chunks,
        found.until.as_secs_f64(),
        printable(&target.display().to_string())
    ));
    lines
}
