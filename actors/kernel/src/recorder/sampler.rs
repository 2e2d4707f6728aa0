//! Sampler: takes the values of sampled components at regular times, from one snapshot each time.

use std::collections::HashMap;
use std::sync::Arc;

use trocar_scene::{
    ComponentError, ComponentId, Entity, RecordPolicy, Registry, Revision, SimTime, Snapshot, varint,
};

use super::rounding::{Policies, Rounder};

/// One sampled component.
struct Sampled {
    component: ComponentId,
    key: u32,
    period: SimTime,
    next: SimTime,
    since: Revision,
    /// A digest of the last stored value of each row: what is the same after rounding is not stored again.
    stored: HashMap<Entity, [u8; 16]>,
}

impl Sampled {
    /// Publications come at times of their own: one that is a little early is better than the one after it.
    fn is_due(&self, now: SimTime) -> bool {
        self.next <= now + SimTime(self.period.0 / 8)
    }
}

/// Takes samples; see the module.
pub(super) struct Sampler {
    sampled: Vec<Sampled>,
    rounder: Rounder,
}

impl Sampler {
    /// A sampler for what has changed since a revision.
    pub(super) fn new(registry: &Arc<Registry>, policies: &Policies, since: Revision) -> Self {
        let sampled = registry.iter().filter_map(|(component, entry)| match entry.record {
            RecordPolicy::Sampled(sampling) if policies.is_sampled(component) => Some(Sampled {
                component,
                key: entry.key,
                period: SimTime::from_secs_f64(1.0 / sampling.hz.max(1e-3)),
                next: SimTime::ZERO,
                since,
                stored: HashMap::new(),
            }),
            _ => None,
        });
        Self { sampled: sampled.collect(), rounder: Rounder::new(registry, policies.clone()) }
    }

    /// Rows may have been removed: the next sample takes every changed row, also one that comes again as it was.
    pub(super) fn forget(&mut self) {
        self.sampled.iter_mut().for_each(|sampled| sampled.stored.clear());
    }

    /// Writes the puts of what is due at `now`, or of everything, into `out`, in the encoding of commands; `false` when
    /// nothing has changed.
    ///
    /// # Errors
    /// When a value cannot be recorded.
    pub(super) fn sample(
        &mut self,
        scene: &Snapshot,
        now: SimTime,
        everything: bool,
        out: &mut Vec<u8>,
    ) -> Result<bool, ComponentError> {
        out.clear();
        let (mut sections, mut section, mut count) = (Vec::new(), Vec::new(), 0_u64);
        let rounder = &mut self.rounder;
        for sampled in self.sampled.iter_mut().filter(|sampled| everything || sampled.is_due(now)) {
            let column = scene.erased_column(sampled.component);
            // Counted from the due time, so that irregular publications do not lower the rate.
            let next = sampled.next + sampled.period;
            sampled.next = if next <= now { now + sampled.period } else { next };
            let since = std::mem::replace(&mut sampled.since, scene.revision());
            if column.latest() <= since {
                continue;
            }
            section.clear();
            let (mut rows, mut done) = (0_u64, Ok(()));
            column.for_each_changed(since, &mut |entity| {
                if done.is_err() {
                    return;
                }
                done = rounder.column_row(sampled.component, column, entity).map(|found| {
                    let digest = digest(&rounder.bytes);
                    if found && sampled.stored.insert(entity, digest) != Some(digest) {
                        rows += 1;
                        varint::write(entity.to_bits(), &mut section);
                        section.extend_from_slice(&rounder.bytes);
                    }
                });
            });
            done?;
            if sampled.stored.len() > 2 * column.len() + 16 {
                sampled.stored.retain(|entity, _| column.revision(*entity).is_some());
            }
            if rows > 0 {
                count += 1;
                varint::write(u64::from(sampled.key), &mut sections);
                varint::write(rows, &mut sections);
                sections.extend_from_slice(&section);
            }
        }
        if count == 0 {
            return Ok(false);
        }
        out.extend([0; 3]);
        varint::write(count, out);
        out.extend(sections);
        out.extend([0; 2]);
        Ok(true)
    }
}

fn digest(bytes: &[u8]) -> [u8; 16] {
    let mut digest = [0; 16];
    digest.copy_from_slice(&blake3::hash(bytes).as_bytes()[..16]);
    digest
}
