//! Reader of a message's numbers; no size in it is trusted.

use trocar_scene::{ComponentId, Entity, varint};

use super::ReplicationError;
use super::choice::ReplicatedColumns;

/// The rest of a message.
#[derive(Clone)]
pub(crate) struct WireReader<'a> {
    what: &'static str,
    bytes: &'a [u8],
    at: usize,
}

impl<'a> WireReader<'a> {
    /// Reads from the front; `what` names the message in errors.
    pub(crate) fn new(what: &'static str, bytes: &'a [u8]) -> Self {
        Self { what, bytes, at: 0 }
    }
    pub(crate) fn is_empty(&self) -> bool {
        self.at >= self.bytes.len()
    }
    /// The bytes not yet read.
    pub(crate) fn rest(&self) -> &'a [u8] {
        self.bytes.get(self.at..).unwrap_or(&[])
    }
    /// Goes on where `rest` begins, which another decoder has left of [`Self::rest`].
    pub(crate) fn continue_at(&mut self, rest: &[u8]) {
        self.at = self.bytes.len().saturating_sub(rest.len());
    }
    fn short(&self) -> ReplicationError {
        ReplicationError::Short { what: self.what, at: self.bytes.len() }
    }
    /// An error about a number that has just been read.
    pub(crate) fn refuse(&self, found: u64, valid: &'static str) -> ReplicationError {
        ReplicationError::Number { what: self.what, at: self.at, found, valid }
    }
    pub(crate) fn take(&mut self, count: usize) -> Result<&'a [u8], ReplicationError> {
        let taken = self.rest().get(..count).ok_or_else(|| self.short())?;
        self.at += count;
        Ok(taken)
    }
    pub(crate) fn array<const N: usize>(&mut self) -> Result<[u8; N], ReplicationError> {
        let mut array = [0; N];
        array.copy_from_slice(self.take(N)?);
        Ok(array)
    }
    pub(crate) fn byte(&mut self) -> Result<u8, ReplicationError> {
        Ok(self.take(1)?[0])
    }
    pub(crate) fn word(&mut self) -> Result<u64, ReplicationError> {
        let mut word = [0; 8];
        word.copy_from_slice(self.take(8)?);
        Ok(u64::from_le_bytes(word))
    }
    /// A number of up to ten bytes, seven bits each.
    pub(crate) fn number(&mut self) -> Result<u64, ReplicationError> {
        let mut value = 0;
        for shift in (0..64).step_by(7) {
            let byte = self.byte()?;
            if shift == 63 && byte > 1 {
                return Err(self.refuse(u64::from(byte), "the last byte of a 64-bit number"));
            }
            value |= u64::from(byte & 0x7f) << shift;
            if byte < 0x80 {
                return Ok(value);
            }
        }
        Err(self.short())
    }
    pub(crate) fn signed(&mut self) -> Result<i64, ReplicationError> {
        self.number().map(varint::unzigzag)
    }
    /// How many things follow; each of them takes at least one byte.
    pub(crate) fn count(&mut self) -> Result<usize, ReplicationError> {
        let count = self.number()?;
        let room = self.rest().len();
        match usize::try_from(count) {
            Ok(count) if count <= room => Ok(count),
            _ => Err(self.refuse(count, "a number of things that fit into the rest of the message")),
        }
    }
    /// An entity, as what it is above the one before.
    pub(crate) fn entity(&mut self, before: &mut u64) -> Result<Entity, ReplicationError> {
        *before = before.wrapping_add(self.signed()? as u64);
        Ok(Entity::from_bits(*before))
    }
    /// A component that is replicated.
    pub(crate) fn component(&mut self, columns: &ReplicatedColumns) -> Result<ComponentId, ReplicationError> {
        let number = self.number()?;
        let id = u16::try_from(number).ok().map(ComponentId);
        match id.filter(|id| columns.is_replicated(*id)) {
            Some(id) => Ok(id),
            None => Err(self.refuse(number, "the number of a replicated component")),
        }
    }
}

/// Appends an entity, as what it is above the one before.
pub(crate) fn write_entity(entity: Entity, before: &mut u64, out: &mut Vec<u8>) {
    varint::write(varint::zigzag(entity.to_bits().wrapping_sub(*before) as i64), out);
    *before = entity.to_bits();
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_and_entities_come_back_and_overlong_ones_are_refused() {
        let entities = [0, 1, u64::MAX, 1 << 48, 7].map(Entity::from_bits);
        let (mut out, mut before) = (Vec::new(), 0);
        entities.iter().for_each(|entity| write_entity(*entity, &mut before, &mut out));
        varint::write(u64::MAX, &mut out);
        let mut reader = WireReader::new("test", &out);
        let mut before = 0;
        for entity in entities {
            assert_eq!(reader.entity(&mut before), Ok(entity));
        }
        assert_eq!(reader.number(), Ok(u64::MAX));
        assert!(reader.is_empty() && reader.byte().is_err());
        assert!(WireReader::new("test", &[0xff; 10]).number().is_err());
        assert!(WireReader::new("test", &[0x80; 9]).number().is_err());
        // A count above the number of bytes left never reaches an allocation.
        assert!(WireReader::new("test", &[4, 0, 0, 0]).count().is_err());
        assert_eq!(WireReader::new("test", &[3, 0, 0, 0]).count(), Ok(3));
    }
}
