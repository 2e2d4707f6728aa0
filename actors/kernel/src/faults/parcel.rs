//! A batch on its way from its writer to the Model, as links see it.

use std::sync::Arc;

use trocar_scene::{Batch, Commands, EntityAllocator, Registry, SimTime};

use super::link_faults::Message;

/// A sealed batch, with what it takes to read it back from bytes.
pub(crate) struct Parcel {
    /// When it was sealed.
    pub(crate) sealed_at: SimTime,
    pub(crate) batch: Box<Batch>,
    pub(crate) registry: Arc<Registry>,
}

impl Parcel {
    fn encoded(&self) -> Option<Vec<u8>> {
        let mut bytes = Vec::new();
        self.batch.commands.encode(&mut bytes).ok()?;
        Some(bytes)
    }

    fn decoded(&self, bytes: &[u8]) -> Option<Self> {
        let me = self.batch.commands.me();
        let allocator = EntityAllocator::new(me.station(), me.spawner());
        let mut commands = Commands::new(self.registry.clone(), allocator);
        commands.decode(bytes).ok()?;
        commands.seal();
        let batch = Box::new(Batch { provenance: self.batch.provenance, commands });
        Some(Self { sealed_at: self.sealed_at, batch, registry: self.registry.clone() })
    }
}

impl Message for Parcel {
    /// Of one with preconditions there is none: they are no part of the encoding.
    fn duplicate(&self) -> Option<Self> {
        if self.batch.commands.error().is_some() || !self.batch.commands.conditions().is_empty() {
            return None;
        }
        self.decoded(&self.encoded()?)
    }

    fn through(self, noise: &mut dyn FnMut(&mut [u8])) -> Option<Self> {
        let sent = self.encoded()?;
        let mut bytes = sent.clone();
        noise(&mut bytes);
        if bytes == sent {
            // Flips that undid each other. Preconditions, too, are still there.
            return Some(self);
        }
        // Should the checksum ever miss it, the Model's own checks are what is left.
        if crc32fast::hash(&bytes) == crc32fast::hash(&sent) { self.decoded(&bytes) } else { None }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{Count, Level, registry};
    use trocar_scene::{Provenance, Revision, WriterId};

    fn parcel() -> Parcel {
        let registry = registry();
        let mut commands = Commands::new(registry.clone(), EntityAllocator::new(2, 5));
        let entity = commands.spawn();
        commands.put(entity, Count(7));
        commands.put(entity, Level(0.5));
        commands.event("beep", entity, None, 3.0);
        commands.seal();
        let provenance = Provenance {
            writer: WriterId(5),
            epoch: 3,
            tick: 11,
            time: SimTime(9),
            based_on: Revision::ZERO,
        };
        Parcel { sealed_at: SimTime(10), batch: Box::new(Batch { provenance, commands }), registry }
    }

    #[test]
    fn a_duplicate_says_the_same_to_the_byte() {
        let first = parcel();
        let second = first.duplicate().expect("can be copied");
        assert_eq!(first.encoded(), second.encoded());
        assert_eq!(first.batch.provenance, second.batch.provenance);
        assert_eq!(first.batch.commands.me(), second.batch.commands.me());
    }

    #[test]
    fn one_with_preconditions_is_not_doubled() {
        let mut conditional = parcel();
        let me = conditional.batch.commands.me();
        conditional.batch.commands.require_unchanged::<Count>(me, Revision::ZERO);
        assert!(conditional.duplicate().is_none());
    }

    #[test]
    fn any_three_flipped_bits_are_seen() {
        let length = parcel().encoded().expect("encodes").len();
        for bit in 0..8 * length {
            let garbled = parcel().through(&mut |bytes| {
                for flip in [bit, (bit * 7 + 3) % (8 * length), (bit * 13 + 5) % (8 * length)] {
                    bytes[flip / 8] ^= 1 << (flip % 8);
                }
            });
            assert!(garbled.is_none(), "bit {bit}");
        }
        assert!(parcel().through(&mut |_| ()).is_some(), "silence harms nothing");
    }
}
