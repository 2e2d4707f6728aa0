//! Links and pictures of the README and of `docs/`: no dead links, no unused pictures, and a short README.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use super::{refuse, root};

/// Most lines of the README.
const README_LINES_MAX: usize = 200;
const PICTURES: [&str; 5] = ["png", "svg", "gif", "jpg", "jpeg"];

#[test]
fn the_readme_is_short() {
    let text = std::fs::read_to_string(root().join("README.md")).expect("a readable README");
    let lines = text.lines().count();
    assert!(lines <= README_LINES_MAX, "README.md has {lines} lines: manual pages belong into docs/");
}

#[test]
fn no_link_is_dead() {
    let mut dead = Vec::new();
    let mut links = 0;
    for page in pages() {
        let text = std::fs::read_to_string(root().join(&page)).expect("a readable page");
        for link in targets(&text) {
            links += 1;
            if let Some(why) = fault(&page, &link) {
                dead.push(format!("{}: {link}: {why}", page.display()));
            }
        }
    }
    refuse("dead links", dead);
    assert!(links >= 10, "{links} links were found");
}

#[test]
fn every_picture_is_shown_by_a_page() {
    let shown: BTreeSet<PathBuf> = pages()
        .iter()
        .flat_map(|page| {
            let text = std::fs::read_to_string(root().join(page)).expect("a readable page");
            targets(&text).into_iter().map(|link| from(page, &link)).collect::<Vec<_>>()
        })
        .collect();
    let is_picture =
        |path: &PathBuf| path.extension().is_some_and(|end| PICTURES.iter().any(|known| end == *known));
    let pictures: Vec<PathBuf> = files("docs").into_iter().filter(is_picture).collect();
    let unused = pictures.iter().filter(|path| !shown.contains(*path)).map(|path| path.display().to_string());
    refuse("pictures that no page shows", unused.collect());
    assert!(pictures.len() > 5, "{} pictures were found", pictures.len());
}

/// The fault of a link, if any.
fn fault(page: &Path, link: &str) -> Option<String> {
    let (path, anchor) = link.split_once('#').unwrap_or((link, ""));
    let target = if path.is_empty() { page.to_owned() } else { from(page, path) };
    if !root().join(&target).exists() {
        return Some(format!("{} does not exist", target.display()));
    }
    if anchor.is_empty() || target.extension().is_none_or(|end| end != "md") {
        return None;
    }
    let text = std::fs::read_to_string(root().join(&target)).expect("a readable page");
    (!anchors(&text).contains(anchor)).then(|| format!("{} has no such heading", target.display()))
}

/// The target of a page's link, from the root.
fn from(page: &Path, link: &str) -> PathBuf {
    let mut place = page.parent().unwrap_or(Path::new("")).to_owned();
    for part in link.split('#').next().unwrap_or_default().split('/') {
        match part {
            "." | "" => {}
            ".." => {
                place.pop();
            }
            name => place.push(name),
        }
    }
    place
}

/// The README and every page of `docs/`, from the root.
fn pages() -> Vec<PathBuf> {
    let is_page = |path: &PathBuf| path.extension().is_some_and(|end| end == "md");
    let mut pages: Vec<PathBuf> = files("docs").into_iter().filter(is_page).collect();
    pages.insert(0, PathBuf::from("README.md"));
    pages
}

/// Every file below a folder, from the root.
fn files(folder: &str) -> Vec<PathBuf> {
    let mut found = Vec::new();
    let mut open = vec![PathBuf::from(folder)];
    while let Some(folder) = open.pop() {
        for entry in std::fs::read_dir(root().join(&folder)).expect("a readable folder") {
            let entry = entry.expect("a readable entry");
            let path = folder.join(entry.file_name());
            if entry.path().is_dir() { open.push(path) } else { found.push(path) }
        }
    }
    found.sort();
    found
}

/// Text without blocks of code.
fn prose(text: &str) -> impl Iterator<Item = &str> {
    let mut code = false;
    text.lines().filter(move |line| {
        let fence = line.trim_start().starts_with("```");
        code ^= fence;
        !code && !fence
    })
}

/// Targets of links and pictures within this repository.
fn targets(text: &str) -> Vec<String> {
    let text = prose(text).collect::<Vec<_>>().join("\n");
    // Text between backticks is code, not a link.
    let text: String = text.split('`').step_by(2).collect::<Vec<_>>().join("code");
    let written = text.split("](").skip(1).map(|rest| rest.split(')').next().unwrap_or_default());
    let tags = ["src=\"", "href=\""];
    let tagged = tags
        .iter()
        .flat_map(|tag| text.split(tag).skip(1).map(|rest| rest.split('"').next().unwrap_or_default()));
    let named = text.lines().filter_map(|line| line.strip_prefix('[')?.split_once("]: ").map(|(_, to)| to));
    written
        .chain(tagged)
        .chain(named)
        .map(|link| link.split_whitespace().next().unwrap_or_default().to_owned())
        .filter(|link| !link.contains("://") && !link.starts_with("mailto:"))
        .collect()
}

/// The anchors of a page's headings, as GitHub generates them.
fn anchors(text: &str) -> BTreeSet<String> {
    let mut found = BTreeSet::new();
    for line in prose(text).filter(|line| line.starts_with('#')) {
        let heading = line.trim_start_matches('#').trim().to_lowercase();
        let kept = heading.chars().filter(|c| c.is_alphanumeric() || [' ', '-', '_'].contains(c));
        let anchor: String = kept.map(|c| if c == ' ' { '-' } else { c }).collect();
        // A repeated heading gets a number.
        let numbered = (1..).map(|number| format!("{anchor}-{number}"));
        let free = std::iter::once(anchor.clone()).chain(numbered).find(|name| !found.contains(name));
        found.extend(free);
    }
    found
}

#[test]
fn links_are_found_however_they_are_written_and_headings_have_their_anchors() {
    let text = "# What it is\n[a](docs/a.md#part) ![b](b.png \"a title\") <img src=\"c.svg\">\n[d]: ../d.md\n\
                `[no](code.md)` [far](https://example.org)\n```\n[no](block.md)\n# no heading\n```\n## Units, & more\n## Units, & more\n";
    assert_eq!(targets(text), ["docs/a.md#part", "b.png", "c.svg", "../d.md"]);
    let expected = ["units--more", "units--more-1", "what-it-is"].map(str::to_owned);
    assert_eq!(anchors(text), BTreeSet::from(expected));
    assert_eq!(from(Path::new("docs/a.md"), "../README.md#x"), PathBuf::from("README.md"));
    assert!(fault(Path::new("README.md"), "docs/no-such-page.md").is_some());
    assert!(fault(Path::new("README.md"), "docs/architecture.md#no-such-heading").is_some());
}
