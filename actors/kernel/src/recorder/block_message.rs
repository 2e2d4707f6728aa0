//! A block as a message of Protocol Buffers, so that any program which reads MCAP sees its hashes and its revision, and
//! the columns as bytes.
//!
//! ```text
//! message Block {
//!   bytes stored_hash = 1;      // 32 bytes
//!   bytes state_hash = 2;       // 32 bytes
//!   uint64 revision = 3;        // before its first commit
//!   uint64 columns_bytes = 4;   // unpacked
//!   bytes columns = 5;          // deflate
//! }
//! ```
//! Writers set every field, in this order, and readers ask for that.

use trocar_scene::varint;

use super::columns::Cursor;
use crate::state_hash::StateHash;

/// Name of the message's type.
pub(super) const NAME: &str = "trocar.Block";
const FIELDS: [(&str, Kind); 5] = [
    ("stored_hash", Kind::Bytes),
    ("state_hash", Kind::Bytes),
    ("revision", Kind::Unsigned),
    ("columns_bytes", Kind::Unsigned),
    ("columns", Kind::Bytes),
];

/// Type of a field, by its number in a descriptor.
#[derive(Clone, Copy)]
#[repr(u8)]
enum Kind {
    Unsigned = 4,
    Bytes = 12,
}

/// The parts of a block.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct BlockMessage<'a> {
    /// Hash of what is stored, after the block.
    pub(super) stored: StateHash,
    /// The Model's hash after the block.
    pub(super) state: StateHash,
    /// The revision before its first commit.
    pub(super) revision: u64,
    /// Bytes of the columns, unpacked.
    pub(super) unpacked: u64,
    /// The columns, packed.
    pub(super) packed: &'a [u8],
}

impl<'a> BlockMessage<'a> {
    /// Appends the message.
    pub(super) fn write(&self, out: &mut Vec<u8>) {
        bytes(1, &self.stored.0, out);
        bytes(2, &self.state.0, out);
        unsigned(3, self.revision, out);
        unsigned(4, self.unpacked, out);
        bytes(5, self.packed, out);
    }

    /// Reads the message.
    ///
    /// # Errors
    /// What is wrong with the bytes.
    pub(super) fn parse(message: &'a [u8]) -> Result<Self, String> {
        let mut cursor = Cursor(message);
        let block = Self {
            stored: hash(&mut cursor, 1)?,
            state: hash(&mut cursor, 2)?,
            revision: field(&mut cursor, 3)?,
            unpacked: field(&mut cursor, 4)?,
            packed: bytes_of(&mut cursor, 5)?,
        };
        if cursor.0.is_empty() { Ok(block) } else { Err(format!("{} bytes behind a block", cursor.0.len())) }
    }
}

/// The tag of a field: its number and how it is encoded.
const fn tag(number: u8, kind: Kind) -> u8 {
    number << 3 | if matches!(kind, Kind::Bytes) { 2 } else { 0 }
}

fn unsigned(number: u8, value: u64, out: &mut Vec<u8>) {
    out.push(tag(number, Kind::Unsigned));
    varint::write(value, out);
}

fn bytes(number: u8, value: &[u8], out: &mut Vec<u8>) {
    out.push(tag(number, Kind::Bytes));
    varint::write(value.len() as u64, out);
    out.extend_from_slice(value);
}

/// The number behind the tag of a field: its value, or the length of its bytes.
fn number(cursor: &mut Cursor<'_>, number: u8, kind: Kind) -> Result<u64, String> {
    let found = cursor.byte()?;
    if found != tag(number, kind) {
        let (name, _) = FIELDS[usize::from(number) - 1];
        return Err(format!("a block whose '{name}' has the tag {found}"));
    }
    cursor.varint()
}

fn field(cursor: &mut Cursor<'_>, at: u8) -> Result<u64, String> {
    number(cursor, at, Kind::Unsigned)
}

fn bytes_of<'a>(cursor: &mut Cursor<'a>, at: u8) -> Result<&'a [u8], String> {
    let length = number(cursor, at, Kind::Bytes)?;
    cursor.take(usize::try_from(length).unwrap_or(usize::MAX))
}

fn hash(cursor: &mut Cursor<'_>, at: u8) -> Result<StateHash, String> {
    let hash = bytes_of(cursor, at)?;
    hash.try_into().map(StateHash).map_err(|_| format!("a hash of {} bytes", hash.len()))
}

/// The schema: a `FileDescriptorSet` (`google/protobuf/descriptor.proto`) with the file that declares the message.
pub(super) fn schema() -> Vec<u8> {
    const LABEL_OPTIONAL: u64 = 1;
    let (package, name) = NAME.split_once('.').unwrap_or(("", NAME));
    let mut message = Vec::new();
    bytes(1, name.as_bytes(), &mut message);
    for ((name, kind), number) in FIELDS.into_iter().zip(1..) {
        let mut field = Vec::new();
        bytes(1, name.as_bytes(), &mut field);
        unsigned(3, number, &mut field);
        unsigned(4, LABEL_OPTIONAL, &mut field);
        unsigned(5, kind as u64, &mut field);
        bytes(2, &field, &mut message);
    }
    let mut file = Vec::new();
    bytes(1, b"trocar.proto", &mut file);
    bytes(2, package.as_bytes(), &mut file);
    bytes(4, &message, &mut file);
    bytes(12, b"proto3", &mut file);
    let mut set = Vec::new();
    bytes(1, &file, &mut set);
    set
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_block_comes_back_and_anything_else_is_refused_with_its_place() {
        let block = BlockMessage {
            stored: StateHash([1; 32]),
            state: StateHash([2; 32]),
            revision: 300,
            unpacked: 0,
            packed: b"columns",
        };
        let mut message = Vec::new();
        block.write(&mut message);
        assert_eq!(message[..2], [0x0a, 32], "field 1 has bytes, 32 of them");
        assert_eq!(BlockMessage::parse(&message), Ok(block));
        for length in 0..message.len() {
            BlockMessage::parse(&message[..length]).expect_err("it is cut");
        }
        let refused = |at: usize, byte: u8| {
            let mut wrong = message.clone();
            wrong[at] = byte;
            BlockMessage::parse(&wrong).expect_err("it is no block")
        };
        assert_eq!(refused(0, 0x12), "a block whose 'stored_hash' has the tag 18");
        assert_eq!(refused(1, 31), "a hash of 31 bytes");
        message.push(0);
        assert_eq!(BlockMessage::parse(&message), Err("1 bytes behind a block".to_owned()));
    }

    #[test]
    fn the_schema_has_the_bytes_that_the_library_of_protocol_buffers_writes() {
        // descriptor_pb2.FileDescriptorSet.SerializeToString() of Python's protobuf 7.36 for the message above.
        let wanted = "0a8a010a0c74726f6361722e70726f746f120674726f636172226a0a05426c6f636b12130a0b73746f7265645f686173\
                      6818012001280c12120a0a73746174655f6861736818022001280c12100a087265766973696f6e1803200128041215\
                      0a0d636f6c756d6e735f6279746573180420012804120f0a07636f6c756d6e7318052001280c620670726f746f33";
        let found: String = schema().iter().map(|byte| format!("{byte:02x}")).collect();
        assert_eq!(found, wanted);
    }
}
