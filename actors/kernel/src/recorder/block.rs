//! Block: the commits of a tenth of a second as one message, in columns; a keyframe is a block with one commit.
//!
//! ```text
//! columns = rows of the commits' heads ‖ rows of each component, ordered by NAME
//! ```
//! They are deflated, and lie in a [`BlockMessage`] with the hashes.
//! A commit's payload is cut into three parts: what lies before its puts, the puts, and what lies behind them. Without
//! its values the scene of a keyframe is laid out in the same three parts.

use miniz_oxide::deflate::compress_to_vec;
use miniz_oxide::inflate::decompress_to_vec_with_limit;
use trocar_scene::{
    Commands, ComponentError, ComponentId, LeafKind, LeafRun, Leaves, Provenance, Registry, Revision,
    SimTime, WriterId, varint,
};

use super::block_message::BlockMessage;
use super::columns::{Cursor, History, RowDecoder, RowEncoder};
use crate::state_hash::{CommitKind, StateHash};

/// The key of the commits' heads; those of components have 32 bits.
pub(super) const HEADS: u64 = 1 << 32;
/// Effort of the compression, of 10.
pub(super) const LEVEL: u8 = 6;
/// Longest body of a block.
const BODY_MAX: u64 = 256 << 20;
/// Deflate makes at most this many bytes of one.
const DEFLATE_MAX: u64 = 1_032;
/// What lies before the puts of a commit that only puts: no spawns, despawns or removes.
const NOTHING_BEFORE: [u8; 3] = [0; 3];
/// What lies behind them: no transfers or events.
const NOTHING_BEHIND: [u8; 2] = [0; 2];

/// The head of a commit.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct CommitHead<'a> {
    pub(super) kind: CommitKind,
    pub(super) revision: Revision,
    pub(super) writer: &'a str,
    pub(super) provenance: Provenance,
}

/// Commits on their way into a block.
pub(super) struct BlockEncoder {
    heads: RowEncoder,
    /// By component id, and so ordered by NAME.
    rows: Vec<RowEncoder>,
    leaves: Leaves,
    count: u32,
    revision: Revision,
    commands: Commands,
}

impl BlockEncoder {
    pub(super) fn new(registry: &std::sync::Arc<Registry>) -> Self {
        let rows = registry.iter().map(|(_, entry)| RowEncoder::new(u64::from(entry.key))).collect();
        let allocator = trocar_scene::EntityAllocator::new(0, 0);
        Self {
            heads: RowEncoder::new(HEADS),
            rows,
            leaves: Leaves::default(),
            count: 0,
            revision: Revision::ZERO,
            commands: Commands::new(registry.clone(), allocator),
        }
    }

    /// Begins a block after that revision.
    pub(super) fn begin(&mut self, base: Revision) {
        self.revision = base;
    }

    /// Adds a commit without its puts: `before` and `behind` are the parts of its payload around them.
    pub(super) fn head(&mut self, head: &CommitHead<'_>, before: &[u8], behind: &[u8]) {
        let before = if before == NOTHING_BEFORE { &[][..] } else { before };
        let behind = if behind == NOTHING_BEHIND { &[][..] } else { behind };
        let Provenance { writer, epoch, tick, time, based_on } = head.provenance;
        let step = head.revision.0.wrapping_sub(self.revision.0);
        let lag = head.revision.0.wrapping_sub(based_on.0);
        self.revision = head.revision;
        let leaves = &mut self.leaves;
        leaves.clear();
        leaves.shape.extend_from_slice(&HEAD_SHAPE);
        let numbers = [head.kind as u64, tick, time.as_nanos(), step, lag, u64::from(epoch)];
        let texts = [head.writer.as_bytes(), before, behind];
        leaves.bits.extend(numbers.into_iter().chain(texts.map(|text| text.len() as u64)));
        texts.into_iter().for_each(|text| leaves.text.extend_from_slice(text));
        self.heads.push(self.count, u64::from(writer.0), leaves);
        self.count += 1;
    }

    /// Adds a row of the last commit.
    pub(super) fn row(&mut self, component: ComponentId, entity: u64, leaves: &Leaves) {
        self.rows[usize::from(component.0)].push(self.count.saturating_sub(1), entity, leaves);
    }

    /// Adds a commit whose puts lie in `payload` from `puts.0` to `puts.1`.
    ///
    /// # Errors
    /// When a value cannot be recorded.
    pub(super) fn commit(
        &mut self,
        head: &CommitHead<'_>,
        payload: &[u8],
        puts: (usize, usize),
    ) -> Result<(), ComponentError> {
        self.head(head, &payload[..puts.0], &payload[puts.1..]);
        self.commands.clear();
        self.commands.decode(payload)?;
        let mut leaves = std::mem::take(&mut self.leaves);
        let mut done = Ok(());
        for (component, puts) in self.commands.puts() {
            for index in 0..puts.len() {
                done = done.and_then(|()| puts.leaves(index, &mut leaves));
                let entity = puts.entity(index).to_bits();
                self.rows[usize::from(component.0)].push(self.count - 1, entity, &leaves);
            }
        }
        self.leaves = leaves;
        done
    }

    /// Appends the block and is empty again.
    pub(super) fn finish(
        &mut self,
        (stored, state): (StateHash, StateHash),
        base: Revision,
        history: &mut History,
        out: &mut Vec<u8>,
    ) {
        let mut body = Vec::new();
        self.heads.finish(history, &mut body);
        for rows in self.rows.iter_mut().filter(|rows| !rows.is_empty()) {
            rows.finish(history, &mut body);
        }
        let packed = compress_to_vec(&body, LEVEL);
        let (revision, unpacked) = (base.0, body.len() as u64);
        BlockMessage { stored, state, revision, unpacked, packed: &packed }.write(out);
        self.count = 0;
    }
}

const HEAD_SHAPE: [LeafRun; 2] =
    [LeafRun { kind: LeafKind::Unsigned, count: 6 }, LeafRun { kind: LeafKind::Text, count: 3 }];

/// A decoded commit.
#[derive(Clone, Debug)]
pub(super) struct DecodedCommit {
    pub(super) kind: CommitKind,
    pub(super) revision: Revision,
    pub(super) writer: String,
    pub(super) provenance: Provenance,
    pub(super) payload: Vec<u8>,
}

/// A decoded block.
#[derive(Clone, Debug)]
pub(super) struct DecodedBlock {
    pub(super) stored: StateHash,
    pub(super) state: StateHash,
    pub(super) commits: Vec<DecodedCommit>,
}

/// Decodes a block; `history` is that of the blocks before it in its chunk.
///
/// # Errors
/// What is wrong with the bytes.
pub(super) fn decode(bytes: &[u8], history: &mut History) -> Result<DecodedBlock, String> {
    let BlockMessage { stored, state, revision: base, .. } = BlockMessage::parse(bytes)?;
    let (packed, length) = packed_body(bytes)?;
    let body = decompress_to_vec_with_limit(packed, length)
        .map_err(|error| format!("a block that does not unpack: {error}"))?;
    let mut decoder = RowDecoder::new(history, &body);
    let mut commits = Vec::new();
    // The sections of each commit's puts, with their number, and what lies behind them.
    let mut puts: Vec<(u64, Vec<u8>)> = Vec::new();
    let mut behind = Vec::new();
    let mut revision = base;
    while let Some((key, rows)) = decoder.next()? {
        if key == HEADS {
            for row in rows {
                let head = Head::parse(row.entity, &row.value)?;
                revision = revision.wrapping_add(head.step);
                commits.push(head.commit(revision)?);
                puts.push((0, Vec::new()));
                behind.push(if head.behind.is_empty() { NOTHING_BEHIND.to_vec() } else { head.behind });
            }
            continue;
        }
        // Rows of one commit lie beside each other.
        for rows in rows.chunk_by(|one, other| one.commit == other.commit) {
            let commit = rows[0].commit;
            let (count, section) = puts
                .get_mut(commit as usize)
                .ok_or_else(|| format!("a row of commit {commit} of {}", commits.len()))?;
            *count += 1;
            varint::write(key, section);
            varint::write(rows.len() as u64, section);
            for row in rows {
                varint::write(row.entity, section);
                section.extend_from_slice(&row.value);
            }
        }
    }
    for (commit, ((count, section), behind)) in commits.iter_mut().zip(puts.into_iter().zip(behind)) {
        varint::write(count, &mut commit.payload);
        commit.payload.extend(section);
        commit.payload.extend(behind);
    }
    Ok(DecodedBlock { stored, state, commits })
}

/// The packed body of a block, and how many bytes it unpacks to.
pub(super) fn packed_body(bytes: &[u8]) -> Result<(&[u8], usize), String> {
    let BlockMessage { unpacked: length, packed, .. } = BlockMessage::parse(bytes)?;
    if length > BODY_MAX || length > DEFLATE_MAX * (packed.len() as u64 + 1) {
        return Err(format!("a block of {length} bytes in {} packed ones", packed.len()));
    }
    Ok((packed, length as usize))
}

/// How many rows some unpacked bodies hold, each with those before it as its history; for tests of the decoder.
///
/// # Errors
/// What is wrong with the bytes.
#[doc(hidden)]
pub fn rows_of_body(bodies: &[&[u8]]) -> Result<usize, String> {
    let (mut history, mut count) = (History::default(), 0);
    for body in bodies {
        let mut decoder = RowDecoder::new(&mut history, body);
        while let Some((_, rows)) = decoder.next()? {
            count += rows.len();
        }
    }
    Ok(count)
}

struct Head {
    kind: CommitKind,
    provenance: Provenance,
    step: u64,
    lag: u64,
    writer: String,
    before: Vec<u8>,
    behind: Vec<u8>,
}

impl Head {
    /// From the number of the writer and the row's value, in which each leaf is a varint.
    fn parse(writer: u64, value: &[u8]) -> Result<Self, String> {
        let mut cursor = Cursor(value);
        let mut number = || cursor.varint();
        let kind = match number()? {
            0 => CommitKind::Batch,
            1 => CommitKind::Fence,
            2 => CommitKind::Sample,
            other => return Err(format!("a commit of unknown kind {other}")),
        };
        let (tick, time, step, lag) = (number()?, SimTime(number()?), number()?, number()?);
        let epoch = u32::try_from(number()?).map_err(|_| "an epoch is too large")?;
        let mut text = || {
            let length = cursor.count("bytes")?;
            Ok::<_, String>(cursor.take(length)?.to_vec())
        };
        let name = String::from_utf8_lossy(&text()?).into_owned();
        let (before, behind) = (text()?, text()?);
        let writer = WriterId(u16::try_from(writer).map_err(|_| format!("a writer with number {writer}"))?);
        let provenance = Provenance { writer, epoch, tick, time, based_on: Revision::ZERO };
        Ok(Self { kind, provenance, step, lag, writer: name, before, behind })
    }

    fn commit(&self, revision: u64) -> Result<DecodedCommit, String> {
        const REVISION_MAX: u64 = 1 << 62;
        if revision > REVISION_MAX {
            return Err(format!("revision {revision} is beyond {REVISION_MAX}"));
        }
        let mut provenance = self.provenance;
        provenance.based_on = Revision(revision.wrapping_sub(self.lag).min(REVISION_MAX));
        let before = if self.before.is_empty() { &NOTHING_BEFORE[..] } else { &self.before };
        Ok(DecodedCommit {
            kind: self.kind,
            revision: Revision(revision),
            writer: self.writer.clone(),
            provenance,
            payload: before.to_vec(),
        })
    }
}
