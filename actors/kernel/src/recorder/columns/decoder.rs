//! Decoder of the rows of a component in a block. Bytes from outside: everything is checked, and memory stays
//! proportional to the bytes read.

use trocar_scene::{LeafKind, LeafRun, Leaves, varint};

use super::grid::Grid;
use super::history::{History, Shape};
use super::planes::Cursor;
use super::prediction::{BlockRows, bits};

/// Most parts of the shapes of all rows of a component in a block. What has no leaves takes no bytes of its own, so
/// that only this bounds it.
const PARTS_MAX: usize = 1 << 22;

/// A decoded row.
pub(in super::super) struct DecodedRow {
    pub(in super::super) commit: u32,
    pub(in super::super) entity: u64,
    /// The postcard encoding of its value.
    pub(in super::super) value: Vec<u8>,
}

/// The decoder of a block; see [`Self::next`].
pub(in super::super) struct RowDecoder<'a, 'h> {
    history: &'h mut History,
    cursor: Cursor<'a>,
}

impl<'a, 'h> RowDecoder<'a, 'h> {
    pub(in super::super) fn new(history: &'h mut History, bytes: &'a [u8]) -> Self {
        Self { history, cursor: Cursor(bytes) }
    }

    /// How many bytes are left.
    pub(in super::super) fn left(&self) -> usize {
        self.cursor.0.len()
    }

    /// The key of the next component and its rows, in the order of their commits; `None` at the end.
    ///
    /// # Errors
    /// What is wrong with the bytes.
    pub(in super::super) fn next(&mut self) -> Result<Option<(u64, Vec<DecodedRow>)>, String> {
        if self.cursor.0.is_empty() {
            return Ok(None);
        }
        let cursor = &mut self.cursor;
        let key = cursor.varint()?;
        let component = self.history.component(key);
        let count = cursor.count("rows")?;
        for _ in 0..cursor.count("shapes")? {
            let mut runs = Vec::new();
            for _ in 0..cursor.count("parts of a shape")? {
                let number = cursor.byte()?;
                let kind = LeafKind::from_number(number)
                    .ok_or_else(|| format!("a leaf of unknown kind {number}"))?;
                let count = u32::try_from(cursor.varint()?).map_err(|_| "a run is too long")?;
                runs.push(LeafRun { kind, count });
            }
            component.add_shape(runs);
        }
        for _ in 0..cursor.count("entities")? {
            let bytes: [u8; 8] = cursor.take(8)?.try_into().unwrap_or_default();
            component.add_entity(u64::from_le_bytes(bytes));
        }
        let commits = deltas(cursor, count)?;
        let entities = deltas(cursor, count)?;
        let shapes = deltas(cursor, count)?;
        let mut rows = BlockRows::new(component);
        let (mut leaves, mut parts) = (0_usize, 0_usize);
        for (entity, shape) in entities.iter().zip(&shapes) {
            let known = |number: i64, known: usize, what: &str| match u32::try_from(number) {
                Ok(number) if (number as usize) < known => Ok(number),
                _ => Err(format!("{what} {number} of {known}")),
            };
            let entity = known(*entity, component.entities.len(), "entity")?;
            let shape = known(shape >> 1, component.shapes.len(), "shape")?;
            // Each leaf takes at least one of the bytes that are left.
            leaves = leaves.saturating_add(component.shapes[shape as usize].leaves);
            parts = parts.saturating_add(component.shapes[shape as usize].runs.len());
            if leaves > cursor.0.len() || parts > PARTS_MAX {
                return Err(format!("{leaves} numbers in {} bytes, {parts} parts", cursor.0.len()));
            }
            rows.push(entity, shape);
        }
        read_leaves(cursor, &mut rows)?;
        let mut texts: Vec<Vec<u8>> = Vec::with_capacity(count);
        for (row, shape) in shapes.iter().enumerate() {
            let text = if shape & 1 == 1 {
                let past = rows.past_text(row, &texts).ok_or("a text like that before, and there is none")?;
                past.to_vec()
            } else {
                let length = text_length(&rows, row)?;
                cursor.take(length)?.to_vec()
            };
            if text.len() != text_length(&rows, row)? {
                return Err("a text of another length than it says".to_owned());
            }
            texts.push(text);
        }
        let mut decoded = Vec::with_capacity(count);
        let mut value = Leaves::default();
        let mut last = 0;
        for (row, place) in rows.places.iter().enumerate() {
            let commit = u32::try_from(commits[row]).map_err(|_| "the number of a commit is out of range")?;
            if commit < last {
                return Err("rows that are not in the order of their commits".to_owned());
            }
            last = commit;
            value.clear();
            value.shape.extend_from_slice(&component.shapes[place.shape as usize].runs);
            value.bits.extend_from_slice(&rows.bits[place.start..place.start + place.leaves]);
            value.text.extend_from_slice(&texts[row]);
            let mut bytes = Vec::with_capacity(8 * place.leaves);
            value.encode(&mut bytes);
            decoded.push(DecodedRow {
                commit,
                entity: component.entities[place.entity as usize],
                value: bytes,
            });
        }
        let past = rows.into_past(texts);
        past.into_iter().for_each(|(entity, row)| component.remember(entity, row));
        Ok(Some((key, decoded)))
    }
}

/// What the encoder's differences stand for.
fn deltas(cursor: &mut Cursor<'_>, count: usize) -> Result<Vec<i64>, String> {
    let mut last = 0_i64;
    let deltas = cursor.planes(count)?.into_iter();
    Ok(deltas
        .map(|delta| {
            last = last.wrapping_add(varint::unzigzag(delta));
            last
        })
        .collect())
}

fn read_leaves(cursor: &mut Cursor<'_>, rows: &mut BlockRows<'_>) -> Result<(), String> {
    let total = rows.leaves();
    if let Some(columns) = rows.columns() {
        let kinds = rows.kinds(0);
        let mut grids = vec![Grid::Bits; columns];
        for (grid, _) in grids.iter_mut().zip(&kinds).filter(|(_, kind)| kind.is_float()) {
            *grid = Grid::from_byte(cursor.byte()?);
        }
        let mut rest = cursor.planes(total)?.into_iter();
        rows.bits = vec![0; total];
        for (leaf, grid) in grids.into_iter().enumerate() {
            for row in 0..rows.places.len() {
                fill(rows, row, leaf, &kinds, grid, rest.next().unwrap_or_default());
            }
        }
    } else {
        let grid = Grid::from_byte(cursor.byte()?);
        let mut rest = cursor.planes(total)?.into_iter();
        rows.bits = vec![0; total];
        for row in 0..rows.places.len() {
            let kinds = rows.kinds(row);
            for leaf in 0..kinds.len() {
                fill(rows, row, leaf, &kinds, grid, rest.next().unwrap_or_default());
            }
        }
    }
    Ok(())
}

fn fill(rows: &mut BlockRows<'_>, row: usize, leaf: usize, kinds: &[LeafKind], grid: Grid, rest: u64) {
    let found = rows.predict(row, leaf, kinds, grid).wrapping_add(varint::unzigzag(rest));
    let at = rows.places[row].start + leaf;
    rows.bits[at] = bits(kinds[leaf], grid, found);
}

/// The bytes of all texts of a row, by its leaves.
fn text_length(rows: &BlockRows<'_>, row: usize) -> Result<usize, String> {
    let place = &rows.places[row];
    let shape: &Shape = &rows.history.shapes[place.shape as usize];
    let mut at = place.start;
    let mut length = 0_u64;
    for run in shape.runs.iter().filter(|run| run.kind.is_leaf()) {
        if run.kind == LeafKind::Text {
            let leaves = &rows.bits[at..at + run.count as usize];
            length = leaves.iter().fold(length, |sum, leaf| sum.saturating_add(*leaf));
        }
        at += run.count as usize;
    }
    usize::try_from(length).map_err(|_| "a text is too long".to_owned())
}
