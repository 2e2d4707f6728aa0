//! No import cycles: a file's dependencies can be read without the file.

use std::collections::BTreeSet;

use super::graph::{Edges, Graph, circles};
use super::{ROOMS, refuse, root};

/// Files that may form a cycle: a concept and its parts, which are read together.
const FILES_MAX: usize = 4;
/// Larger cycles of files that remain: the number of files of each, the largest first. The list only shrinks.
const LARGE: [(&str, &[usize]); 0] = [];
/// Cycles of folders that remain: the number of folders of each, the largest first. The list only shrinks.
const BETWEEN_FOLDERS: [(&str, &[usize]); 0] = [];
/// Modules that their crates declare for tests only, without `tests` in their names.
const TEST_ONLY: [&str; 1] = ["actors/collision/src/primitive/arbitrary.rs"];
/// Most names of an import in a failure message.
const SHOWN_MAX: usize = 6;

#[test]
fn files_form_no_large_circles_and_folders_none() {
    let mut wrong = Vec::new();
    for (_, room) in ROOMS {
        let graph = graph(room);
        wrong.extend(differences(room, "files", &graph.imports(), FILES_MAX, &LARGE));
        wrong.extend(differences(room, "folders", &graph.imports_of_folders(), 1, &BETWEEN_FOLDERS));
    }
    refuse("circles of imports", wrong);
    for (room, _) in LARGE.iter().chain(&BETWEEN_FOLDERS) {
        assert!(ROOMS.iter().any(|(_, folder)| folder == room), "{room} is no room");
    }
}

#[test]
fn the_graph_reads_every_file_of_a_crate() {
    for (_, room) in ROOMS {
        let sources: BTreeSet<String> =
            super::production_sources(room).into_iter().map(|(name, _)| name).collect();
        let graph = graph(room);
        let read: BTreeSet<String> = graph.files().into_iter().map(|file| format!("{room}/{file}")).collect();
        let starts = |name: &&String| !name.ends_with("/main.rs") && !TEST_ONLY.contains(&name.as_str());
        let missed: Vec<String> = sources.difference(&read).filter(starts).cloned().collect();
        refuse("production sources that the graph does not know", missed);
        assert!(sources.len() < 10 || graph.imports().len() > sources.len() / 4, "{room} imports too little");
    }
}

fn graph(room: &str) -> Graph {
    let folder = root().join(room);
    Graph::read("src/lib.rs", &|name| std::fs::read_to_string(folder.join(name)).ok())
}

/// Differences between the listed cycles and those with more than `most` nodes.
fn differences(
    room: &str,
    what: &str,
    edges: &Edges,
    most: usize,
    listed: &[(&str, &[usize])],
) -> Vec<String> {
    let found: Vec<BTreeSet<String>> =
        circles(edges).into_iter().filter(|circle| circle.len() > most).collect();
    let sizes: Vec<usize> = found.iter().map(BTreeSet::len).collect();
    let listed = listed.iter().find(|(listed, _)| *listed == room).map_or(&[][..], |(_, sizes)| sizes);
    if sizes == listed {
        return Vec::new();
    }
    // Sorted by size, so a cycle smaller than the listed one in its place is allowed.
    let grown = |place: usize| listed.get(place).is_none_or(|listed| sizes[place] > *listed);
    let grown: Vec<usize> = (0..sizes.len()).filter(|place| grown(*place)).collect();
    if grown.is_empty() {
        return vec![format!("{room}: circles of {what} got smaller: list {sizes:?}, not {listed:?}")];
    }
    grown.into_iter().map(|place| format!("{room}: {}", told(what, &found[place], edges))).collect()
}

/// A cycle with the imports that form it.
fn told(what: &str, circle: &BTreeSet<String>, edges: &Edges) -> String {
    let within = edges.iter().filter(|((from, to), _)| circle.contains(from) && circle.contains(to));
    let lines = within.map(|((from, to), names)| {
        let shown: Vec<&str> = names.iter().map(String::as_str).take(SHOWN_MAX).collect();
        let more = if names.len() > SHOWN_MAX { ", …" } else { "" };
        format!("\n    {from} → {to}: {}{more}", shown.join(", "))
    });
    format!("a circle of {} {what}:{}", circle.len(), lines.collect::<String>())
}

#[test]
fn a_circle_that_is_larger_than_listed_fails_and_one_that_is_smaller_is_taken_off_the_list() {
    let edge = |from: &str, to: &str| ((from.to_owned(), to.to_owned()), BTreeSet::from(["Name".to_owned()]));
    let three: Edges = [edge("a", "b"), edge("b", "c"), edge("c", "a"), edge("c", "d")].into();
    let told = |listed: &'static [usize]| differences("room", "files", &three, 2, &[("room", listed)]);
    assert_eq!(told(&[3]), Vec::<String>::new());
    assert_eq!(
        told(&[]),
        ["room: a circle of 3 files:\n    a → b: Name\n    b → c: Name\n    c → a: Name".to_owned()]
    );
    assert_eq!(told(&[4]), ["room: circles of files got smaller: list [3], not [4]"]);
    assert_eq!(told(&[3, 3]), ["room: circles of files got smaller: list [3], not [3, 3]"]);
    assert_eq!(differences("room", "files", &three, 3, &[]), Vec::<String>::new());
}
