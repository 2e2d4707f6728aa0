//! From a path as it is written to the modules that define what it names.

use std::collections::BTreeSet;

use super::Graph;
use super::read::Import;

/// Words that stand for a place in the crate.
const PLACES: [&str; 3] = ["crate", "self", "super"];
/// Words of a path at most while it is followed: what grows beyond leads in a circle.
const WORDS_MAX: usize = 24;

/// What is defined, by module and name.
type Definitions = BTreeSet<(usize, String)>;

/// Paths that have been followed, and from which module: imports may lead in circles.
type Seen = BTreeSet<(usize, Vec<String>)>;

impl Graph {
    /// The modules that define what a path names, seen from a module. None for what other crates define, and for a
    /// module by itself: what is imported is what its paths name.
    pub(super) fn defined(&self, from: usize, path: &[String]) -> Definitions {
        let mut found = Definitions::new();
        if let Some((module, rest)) = self.start(from, path) {
            self.follow(module, rest, &mut Seen::new(), &mut found);
        }
        // An import of a name by the module itself leads back to it.
        found.retain(|(module, _)| *module != from);
        found
    }

    /// Where a path starts: a module, and what is left of the path.
    fn start<'p>(&self, from: usize, path: &'p [String]) -> Option<(usize, &'p [String])> {
        let mut module = match path.first()?.as_str() {
            "crate" => self.above(from).last().unwrap_or(from),
            "self" => from,
            "super" => self.modules[from].parent?,
            _ => return Some((from, path)),
        };
        let mut rest = &path[1..];
        while rest.first().is_some_and(|word| word == "super") {
            module = self.modules[module].parent?;
            rest = &rest[1..];
        }
        Some((module, rest))
    }

    /// Adds the modules that define `path` as it is seen in a module. Says whether there are any.
    fn follow(&self, module: usize, path: &[String], seen: &mut Seen, found: &mut Definitions) -> bool {
        let here = &self.modules[module];
        let Some((name, rest)) = path.split_first() else { return false };
        if path.len() > WORDS_MAX || !seen.insert((module, path.to_vec())) {
            return false;
        }
        let mut known = false;
        if let Some(child) = here.children.get(name) {
            if rest.is_empty() {
                // A module: what is taken from it counts where it is named.
                known = true;
            } else if self.follow(*child, rest, seen, found) {
                return true;
            } else {
                // What a macro has made up there.
                found.insert((*child, rest[0].clone()));
                return true;
            }
        }
        if here.items.contains(name) {
            found.insert((module, name.clone()));
            return true;
        }
        // A name imported by itself, or from where a glob looks, is a child or another crate's.
        let foreign = |path: &[String]| {
            let first = path.first().map_or("", String::as_str);
            let known = |import: &Import| import.name == first && import.name != *name;
            !PLACES.contains(&first) && !here.children.contains_key(first) && !here.imports.iter().any(known)
        };
        for import in here.imports.iter().filter(|import| import.name == *name && !foreign(&import.path)) {
            let whole: Vec<String> = import.path.iter().chain(rest).cloned().collect();
            if let Some((start, path)) = self.start(module, &whole)
                && self.follow(start, path, seen, found)
            {
                return true;
            }
        }
        if known {
            return true;
        }
        here.globs.iter().filter(|glob| !foreign(&glob.path)).any(|glob| {
            let whole: Vec<String> = glob.path.iter().chain(path).cloned().collect();
            self.start(module, &whole).is_some_and(|(start, path)| self.follow(start, path, seen, found))
        })
    }
}
