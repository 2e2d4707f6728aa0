//! Encoder of the rows of one component in a block.

use trocar_scene::{LeafRun, Leaves, varint};

use super::grid::GridFinder;
use super::history::History;
use super::planes::write_planes;
use super::prediction::{BlockRows, whole};

/// Rows of one component, collected for a block.
#[derive(Debug, Default)]
pub(in super::super) struct RowEncoder {
    key: u64,
    rows: Vec<PendingRow>,
    shapes: Vec<LeafRun>,
    bits: Vec<u64>,
    text: Vec<u8>,
}

/// A row with the ends of its parts in the encoder's buffers.
#[derive(Clone, Copy, Debug)]
struct PendingRow {
    commit: u32,
    entity: u64,
    shape: usize,
    text: usize,
}

impl RowEncoder {
    pub(in super::super) fn new(key: u64) -> Self {
        Self { key, ..Self::default() }
    }

    pub(in super::super) fn is_empty(&self) -> bool {
        self.rows.is_empty()
    }

    /// Adds a row of a commit; commits come in order.
    pub(in super::super) fn push(&mut self, commit: u32, entity: u64, leaves: &Leaves) {
        self.shapes.extend_from_slice(&leaves.shape);
        self.bits.extend_from_slice(&leaves.bits);
        self.text.extend_from_slice(&leaves.text);
        let (shape, text) = (self.shapes.len(), self.text.len());
        self.rows.push(PendingRow { commit, entity, shape, text });
    }

    /// Appends the rows to a block, and leaves the encoder empty.
    pub(in super::super) fn finish(&mut self, history: &mut History, out: &mut Vec<u8>) {
        let component = history.component(self.key);
        let (mut shapes, mut entities) = (Vec::new(), Vec::new());
        let (mut new_shapes, mut new_entities) = (Vec::new(), Vec::new());
        let mut begin = 0;
        for row in &self.rows {
            let runs = &self.shapes[begin..row.shape];
            begin = row.shape;
            let (shape, is_new) = component.shape(runs);
            if is_new {
                new_shapes.push(shape);
            }
            let (entity, is_new) = component.entity(row.entity);
            if is_new {
                new_entities.push(row.entity);
            }
            shapes.push(shape);
            entities.push(entity);
        }
        varint::write(self.key, out);
        varint::write(self.rows.len() as u64, out);
        varint::write(new_shapes.len() as u64, out);
        for number in new_shapes {
            let runs = &component.shapes[number as usize].runs;
            varint::write(runs.len() as u64, out);
            for run in runs {
                out.push(run.kind as u8);
                varint::write(u64::from(run.count), out);
            }
        }
        varint::write(new_entities.len() as u64, out);
        new_entities.iter().for_each(|entity| out.extend_from_slice(&entity.to_le_bytes()));

        let mut rows = BlockRows::new(component);
        entities.iter().zip(&shapes).for_each(|(entity, shape)| rows.push(*entity, *shape));
        rows.bits = std::mem::take(&mut self.bits);
        let texts = self.texts();
        write_deltas(self.rows.iter().map(|row| i64::from(row.commit)), out);
        write_deltas(entities.iter().map(|entity| i64::from(*entity)), out);
        // The lowest bit of a shape says that the text of the row is that of the row before.
        let repeats = (0..texts.len()).map(|row| rows.past_text(row, &texts) == Some(texts[row].as_slice()));
        let repeats: Vec<bool> = repeats.collect();
        write_deltas(
            shapes.iter().zip(&repeats).map(|(shape, repeats)| i64::from(*shape) * 2 + i64::from(*repeats)),
            out,
        );
        write_leaves(&rows, out);
        let text: Vec<&[u8]> =
            texts.iter().zip(&repeats).filter(|(_, repeats)| !**repeats).map(|(text, _)| &text[..]).collect();
        out.extend(text.concat());
        let past = rows.into_past(texts);
        past.into_iter().for_each(|(entity, row)| component.remember(entity, row));
        *self = Self::new(self.key);
    }

    fn texts(&self) -> Vec<Vec<u8>> {
        let mut begin = 0;
        let text =
            self.rows.iter().map(|row| self.text[std::mem::replace(&mut begin, row.text)..row.text].to_vec());
        text.collect()
    }
}

/// Appends the difference of each number to the one before it.
fn write_deltas(numbers: impl Iterator<Item = i64>, out: &mut Vec<u8>) {
    let mut last = 0;
    let deltas: Vec<u64> =
        numbers.map(|number| varint::zigzag(number - std::mem::replace(&mut last, number))).collect();
    write_planes(&deltas, out);
}

/// Appends the grids, and what is left of the leaves after their prediction.
fn write_leaves(rows: &BlockRows<'_>, out: &mut Vec<u8>) {
    let mut rest = Vec::with_capacity(rows.leaves());
    if let Some(columns) = rows.columns() {
        let kinds = rows.kinds(0);
        for leaf in 0..columns {
            let mut finder = GridFinder::new();
            if kinds[leaf].is_float() {
                (0..rows.places.len()).for_each(|row| show(rows, row, leaf, &mut finder));
            }
            let grid = finder.grid();
            if kinds[leaf].is_float() {
                out.push(grid.to_byte());
            }
            for (row, place) in rows.places.iter().enumerate() {
                let found = whole(kinds[leaf], grid, rows.bits[place.start + leaf]);
                rest.push(varint::zigzag(found.wrapping_sub(rows.predict(row, leaf, &kinds, grid))));
            }
        }
    } else {
        let mut finder = GridFinder::new();
        for (row, place) in rows.places.iter().enumerate() {
            for (leaf, kind) in rows.kinds(row).iter().enumerate().take(place.leaves) {
                if kind.is_float() {
                    show(rows, row, leaf, &mut finder);
                }
            }
        }
        let grid = finder.grid();
        out.push(grid.to_byte());
        for (row, place) in rows.places.iter().enumerate() {
            let kinds = rows.kinds(row);
            for leaf in 0..place.leaves {
                let found = whole(kinds[leaf], grid, rows.bits[place.start + leaf]);
                rest.push(varint::zigzag(found.wrapping_sub(rows.predict(row, leaf, &kinds, grid))));
            }
        }
    }
    write_planes(&rest, out);
}

/// Shows a leaf to the finder of a grid, and the leaves that predict it.
fn show(rows: &BlockRows<'_>, row: usize, leaf: usize, finder: &mut GridFinder) {
    finder.show(rows.bits[rows.places[row].start + leaf]);
    for past in rows.past_leaf(row, leaf).into_iter().flatten() {
        finder.show(past);
    }
}
