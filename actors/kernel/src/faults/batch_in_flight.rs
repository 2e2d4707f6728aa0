//! A batch in flight from its writer to the Model, as the message type of faulty links.

use trocar_scene::{Batch, Commands, SimTime};

use super::link_faults::Message;

/// A sealed batch.
pub(crate) struct BatchInFlight {
    /// When it was sealed.
    pub(crate) sealed_at: SimTime,
    pub(crate) batch: Box<Batch>,
}

/// Duplicates a batch through its encoding, into `empty` buffers. A batch with preconditions cannot be duplicated: the
/// encoding does not contain them.
pub(crate) fn second_of(batch: &Batch, empty: Commands) -> Option<Box<Batch>> {
    if batch.commands.error().is_some() || !batch.commands.conditions().is_empty() {
        return None;
    }
    read_back(batch, &encoded(batch)?, empty)
}

fn encoded(batch: &Batch) -> Option<Vec<u8>> {
    let mut bytes = Vec::new();
    batch.commands.encode(&mut bytes).ok()?;
    Some(bytes)
}

fn read_back(batch: &Batch, bytes: &[u8], mut empty: Commands) -> Option<Box<Batch>> {
    empty.decode(bytes).ok()?;
    empty.seal();
    Some(Box::new(Batch { provenance: batch.provenance, commands: empty }))
}

impl Message for BatchInFlight {
    fn bytes(&self) -> usize {
        encoded(&self.batch).map_or(0, |bytes| bytes.len())
    }

    fn duplicate(&self) -> Option<Self> {
        // Its buffers return to the writer, which allocates entities from them.
        let batch = second_of(&self.batch, self.batch.commands.another())?;
        Some(Self { batch, ..*self })
    }

    fn through(self, noise: &mut dyn FnMut(&mut [u8])) -> Option<Self> {
        let sent = encoded(&self.batch)?;
        let mut bytes = sent.clone();
        noise(&mut bytes);
        if bytes == sent {
            // The flips cancelled each other: the batch and its preconditions are intact.
            return Some(self);
        }
        // If the checksum misses the corruption, the Model's own checks remain.
        if crc32fast::hash(&bytes) != crc32fast::hash(&sent) {
            return None;
        }
        let batch = read_back(&self.batch, &bytes, self.batch.commands.another())?;
        Some(Self { batch, ..self })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{Count, Level, registry};
    use trocar_scene::{EntityAllocator, Provenance, Revision, WriterId};

    fn batch_in_flight() -> BatchInFlight {
        let mut commands = Commands::new(registry(), EntityAllocator::new(2, 5));
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
        BatchInFlight { sealed_at: SimTime(10), batch: Box::new(Batch { provenance, commands }) }
    }

    #[test]
    fn a_duplicate_says_the_same_to_the_byte() {
        let first = batch_in_flight();
        let second = first.duplicate().expect("can be copied");
        assert_eq!(encoded(&first.batch), encoded(&second.batch));
        assert_eq!(first.batch.provenance, second.batch.provenance);
        assert_eq!(first.batch.commands.me(), second.batch.commands.me());
        let (mut first, mut second) = (first, second);
        let spawned = [&mut first, &mut second].map(|batch_in_flight| batch_in_flight.batch.commands.spawn());
        assert_ne!(spawned[0], spawned[1], "one writer, one counter");
    }

    #[test]
    fn one_with_preconditions_is_not_doubled() {
        let mut conditional = batch_in_flight();
        let me = conditional.batch.commands.me();
        conditional.batch.commands.require_unchanged::<Count>(me, Revision::ZERO);
        assert!(conditional.duplicate().is_none());
    }

    #[test]
    fn any_three_flipped_bits_are_seen() {
        let length = encoded(&batch_in_flight().batch).expect("encodes").len();
        for bit in 0..8 * length {
            let garbled = batch_in_flight().through(&mut |bytes| {
                for flip in [bit, (bit * 7 + 3) % (8 * length), (bit * 13 + 5) % (8 * length)] {
                    bytes[flip / 8] ^= 1 << (flip % 8);
                }
            });
            assert!(garbled.is_none(), "bit {bit}");
        }
        assert!(batch_in_flight().through(&mut |_| ()).is_some(), "silence harms nothing");
    }
}
