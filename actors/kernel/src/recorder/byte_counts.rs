//! Byte counts of what the Model committed, by component and by writer: what a recording would take if it kept every
//! commit as it is.

use std::collections::BTreeMap;
use std::sync::Arc;

use trocar_scene::Registry;

use crate::commit::{Commit, Sections};

/// Rows or commits, and their bytes.
type Count = (u64, u64);

/// See the module.
pub(super) struct ByteCounts {
    registry: Arc<Registry>,
    /// By component id.
    components: Vec<Count>,
    writers: BTreeMap<String, Count>,
    /// Heads, and what is no put.
    rest: Count,
}

impl ByteCounts {
    pub(super) fn new(registry: &Arc<Registry>) -> Self {
        let components = vec![(0, 0); registry.len()];
        Self { registry: registry.clone(), components, writers: BTreeMap::new(), rest: (0, 0) }
    }

    pub(super) fn registry(&self) -> &Arc<Registry> {
        &self.registry
    }

    pub(super) fn add(&mut self, commit: &Commit<'_>, sections: &Sections<'_>) {
        let mut puts = 0;
        for section in sections.puts {
            let (rows, bytes) = &mut self.components[usize::from(section.component.0)];
            *rows += 1;
            *bytes += u64::from(section.end - section.start);
            puts += u64::from(section.end - section.start);
        }
        let all = commit.payload.len() as u64;
        self.rest.0 += 1;
        self.rest.1 += all - puts;
        match self.writers.get_mut(commit.writer) {
            Some((commits, bytes)) => {
                *commits += 1;
                *bytes += all;
            }
            None => drop(self.writers.insert(commit.writer.to_owned(), (1, all))),
        }
    }

    /// As metadata: `component.NAME`, `writer.NAME` and `rest`, each with a count and bytes.
    pub(super) fn metadata(&self) -> BTreeMap<String, String> {
        let text = |(count, bytes): &Count| format!("{count} {bytes}");
        let components = self.registry.iter().zip(&self.components).filter(|(_, (count, _))| *count > 0);
        let components =
            components.map(|((_, entry), count)| (format!("component.{}", entry.name), text(count)));
        let writers = self.writers.iter().map(|(name, count)| (format!("writer.{name}"), text(count)));
        components.chain(writers).chain([("rest".to_owned(), text(&self.rest))]).collect()
    }
}
