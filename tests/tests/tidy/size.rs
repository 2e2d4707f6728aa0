//! Limits on the length of files and the width of folders.

use std::collections::BTreeMap;

use super::{refuse, sources};

/// Files with more lines may hold more than one concept.
const LINES_MANY: usize = 600;
/// Most lines of a file.
const LINES_MAX: usize = 1_000;
/// Folders with more files may hold more than one concept.
const FILES_MANY: usize = 20;
/// Most files of a folder.
const FILES_MAX: usize = 25;
/// Wider folders that remain, with their widths. The list only shrinks.
const WIDE: [(&str, usize); 0] = [];

const FOLDERS: [&str; 5] = ["scene", "devices", "actors", "ui", "tests"];

#[test]
fn no_file_is_longer_than_a_newcomer_can_follow() {
    let mut long = Vec::new();
    for (name, text) in FOLDERS.iter().flat_map(|folder| sources(folder)) {
        let lines = text.lines().count();
        if lines > LINES_MAX {
            long.push(format!("{name}: {lines} lines"));
        } else if lines > LINES_MANY {
            println!("warning: {name} has {lines} lines: does it hold one concept?");
        }
    }
    refuse("files that should be split", long);
}

#[test]
fn no_folder_is_wider_than_a_newcomer_can_follow() {
    let mut widths: BTreeMap<String, usize> = BTreeMap::new();
    for (name, _) in FOLDERS.iter().flat_map(|folder| sources(folder)) {
        let (folder, _) = name.rsplit_once('/').unwrap_or_default();
        *widths.entry(folder.to_owned()).or_default() += 1;
    }
    let mut wrong = Vec::new();
    for (folder, files) in &widths {
        let listed = WIDE.iter().find(|(wide, _)| wide == folder).map(|(_, files)| *files);
        if *files > listed.unwrap_or(FILES_MAX) {
            wrong.push(format!("{folder}: {files} files"));
        } else if listed.is_none() && *files > FILES_MANY {
            println!("warning: {folder} has {files} files: does it hold one concept?");
        }
    }
    refuse("folders that should be split", wrong);
    let narrower = WIDE.into_iter().filter_map(|(folder, listed)| {
        let files = widths.get(folder).copied().unwrap_or(0);
        (files < listed).then(|| match files {
            0..=FILES_MAX => {
                format!("{folder}: {files} files, which is within the limit: take it off the list")
            }
            _ => format!("{folder}: write {files}, not {listed}"),
        })
    });
    refuse("the list of wide folders only shrinks", narrower.collect());
}
