//! The module graph of a crate: which source file imports names that another one defines.
//!
//! Nodes are files. An edge stands for a `use`, or for a path written out in place, resolved through `pub use`, globs,
//! `self` and `super` to the file that really defines the name. What a file and the modules that it declares say of
//! each other is no import, nor is the re-export of what lies below. Parts under `#[cfg(test)]` do not count.
//!
//! Rust is read by `syn`: a parser made here would misread raw strings, macros and nested imports sooner or later.
//! What it cannot see: calls of methods (their types are named somewhere, too), and names that a macro makes up.

mod circles;
mod read;
mod resolve;
#[cfg(test)]
mod tests;

use std::collections::{BTreeMap, BTreeSet};

pub use circles::circles;
use read::Module;

/// Who imports what from whom: (importing, defining) → names, as they are defined.
pub type Edges = BTreeMap<(String, String), BTreeSet<String>>;

/// The module graph of one crate.
#[derive(Debug, Default)]
pub struct Graph {
    modules: Vec<Module>,
}

impl Graph {
    /// Reads the crate that starts at `root`, such as `src/lib.rs`. `source` gives a file's text, if it exists.
    pub fn read(root: &str, source: &dyn Fn(&str) -> Option<String>) -> Self {
        let mut graph = Self::default();
        read::file(&mut graph.modules, root, None, source);
        graph
    }

    /// The files of the crate.
    pub fn files(&self) -> BTreeSet<&str> {
        self.modules.iter().map(|module| module.file.as_str()).collect()
    }

    /// Imports between files.
    pub fn imports(&self) -> Edges {
        let mut edges = Edges::new();
        for (from, module) in self.modules.iter().enumerate() {
            let imported = module.imports.iter().map(|import| (&import.path, import.public));
            let globs = module.globs.iter().map(|glob| (&glob.path, glob.public));
            let named = module.paths.iter().map(|path| (path, false));
            for (path, public) in imported.chain(globs).chain(named) {
                for (target, name) in self.defined(from, path) {
                    if self.counts(from, target, public) {
                        let ends = (module.file.clone(), self.modules[target].file.clone());
                        edges.entry(ends).or_default().insert(name);
                    }
                }
            }
        }
        edges
    }

    /// Imports between folders, by the folder's name. A folder's own file belongs to it; what a folder and the one
    /// that it lies in say of each other does not count.
    pub fn imports_of_folders(&self) -> Edges {
        let files = self.files();
        let mut edges = Edges::new();
        for ((from, to), names) in self.imports() {
            let ends = (folder(&from, &files), folder(&to, &files));
            if ends.0 != ends.1 && parent(&ends.0) != ends.1 && parent(&ends.1) != ends.0 {
                let named = names.iter().map(|name| format!("{from} → {to}: {name}"));
                edges.entry(ends).or_default().extend(named);
            }
        }
        edges
    }

    /// Whether a module that names another one imports it.
    fn counts(&self, from: usize, to: usize, public: bool) -> bool {
        let (here, there) = (&self.modules[from], &self.modules[to]);
        let family = self.parent_file(from) == Some(there.file.as_str())
            || self.parent_file(to) == Some(here.file.as_str());
        let below = || self.above(to).any(|module| self.modules[module].file == here.file);
        here.file != there.file && !family && !(public && below())
    }

    /// The file that declares the file in which a module stands.
    fn parent_file(&self, module: usize) -> Option<&str> {
        let here = &self.modules[module].file;
        self.above(module).map(|above| self.modules[above].file.as_str()).find(|file| file != here)
    }

    /// The modules in which a module lies, from the inside out.
    fn above(&self, module: usize) -> impl Iterator<Item = usize> {
        std::iter::successors(self.modules[module].parent, |above| self.modules[*above].parent)
    }
}

/// The folder to which a file belongs: `a/b.rs` and `a/b/mod.rs` belong to `a/b` where such a folder has files.
fn folder(file: &str, files: &BTreeSet<&str>) -> String {
    let own = file.strip_suffix(".rs").unwrap_or(file);
    let has_folder = files.iter().any(|other| other.starts_with(&format!("{own}/")));
    if has_folder { own.to_owned() } else { parent(own).to_owned() }
}

/// The folder in which something lies.
fn parent(path: &str) -> &str {
    path.rsplit_once('/').map_or("", |(folder, _)| folder)
}
