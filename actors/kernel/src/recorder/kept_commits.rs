//! Kept commits: what a recording keeps of each of the Model's commits. Sampled components are left out; their values
//! come from the [`Sampler`](super::sampler::Sampler).

use trocar_scene::{Commands, ComponentError, EntityAllocator, Registry, varint};

use super::rounding::{Policies, Rounder};
use crate::commit::{Commit, Sections};

/// Cuts sampled components out of commits.
pub(super) struct Keeper {
    policies: Policies,
    rounder: Rounder,
    commands: Commands,
}

/// What is kept of a commit, in [`Keeper::keep`]'s buffer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Kept {
    /// Where the puts begin and end.
    pub(super) puts: (usize, usize),
    /// Whether rows or entities are removed.
    pub(super) removes: bool,
}

impl Keeper {
    pub(super) fn new(registry: &std::sync::Arc<Registry>, policies: &Policies) -> Self {
        Self {
            policies: policies.clone(),
            rounder: Rounder::new(registry, policies.clone()),
            commands: Commands::new(registry.clone(), EntityAllocator::new(0, 0)),
        }
    }

    /// Writes the payload that is kept into `out`; `None` when nothing is left of the commit.
    ///
    /// # Errors
    /// When a value cannot be recorded.
    pub(super) fn keep(
        &mut self,
        commit: &Commit<'_>,
        sections: &Sections<'_>,
        out: &mut Vec<u8>,
    ) -> Result<Option<Kept>, ComponentError> {
        out.clear();
        let (before, behind) = (&commit.payload[..sections.puts_at], &commit.payload[sections.puts_end..]);
        // The first two counts, of spawns and despawns, are zero, and so is that of removes.
        let removes = before != [0; 3];
        let kept = || sections.puts.iter().filter(|put| !self.policies.is_sampled(put.component));
        let count = kept().count();
        if count == sections.puts.len() {
            out.extend_from_slice(commit.payload);
            return Ok(Some(Kept { puts: (sections.puts_at, sections.puts_end), removes }));
        }
        out.extend_from_slice(before);
        if sections.spawns {
            // What is created has all its components at once.
            self.commands.clear();
            self.commands.decode(commit.payload)?;
            varint::write(sections.puts.len() as u64, out);
            for (component, puts) in self.commands.puts() {
                varint::write(u64::from(self.commands.registry().entry(component).key), out);
                varint::write(puts.len() as u64, out);
                for index in 0..puts.len() {
                    self.rounder.put_row(component, puts, index)?;
                    varint::write(puts.entity(index).to_bits(), out);
                    out.extend_from_slice(&self.rounder.bytes);
                }
            }
        } else {
            if count == 0 && !removes && behind == [0; 2] {
                return Ok(None);
            }
            varint::write(count as u64, out);
            for put in kept() {
                out.extend_from_slice(&commit.payload[put.start as usize..put.end as usize]);
            }
        }
        let puts = (sections.puts_at, out.len());
        out.extend_from_slice(behind);
        Ok(Some(Kept { puts, removes }))
    }
}
