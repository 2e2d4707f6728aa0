//! Prediction of the leaves of rows: the same for the encoder, which subtracts it, and the decoder, which adds it.

use trocar_scene::LeafKind;

use super::COLUMNS_MAX;
use super::grid::Grid;
use super::history::{ComponentHistory, PastRow};

/// A row by which others are predicted.
#[derive(Clone, Copy, Debug)]
enum Past {
    /// A row of the same block.
    Row(usize),
    /// The last row (0) of the entity in the history, or the one before it (1).
    History(usize),
}

/// A row of a block.
#[derive(Clone, Copy, Debug)]
pub(super) struct RowPlace {
    /// The number of its entity in the history.
    pub(super) entity: u32,
    /// The number of its shape in the history.
    pub(super) shape: u32,
    /// Its first leaf, among those of all rows.
    pub(super) start: usize,
    /// How many leaves.
    pub(super) leaves: usize,
    /// The row of its entity before it, and the one before that.
    past: [Past; 2],
    /// How many of its first leaves are of the same kinds as theirs.
    aligned: [usize; 2],
}

/// The rows of one component in a block, with the leaves that are known so far.
pub(super) struct BlockRows<'h> {
    pub(super) history: &'h ComponentHistory,
    pub(super) places: Vec<RowPlace>,
    pub(super) bits: Vec<u64>,
    /// The newest two rows of each entity.
    newest: Vec<[Past; 2]>,
}

impl<'h> BlockRows<'h> {
    pub(super) fn new(history: &'h ComponentHistory) -> Self {
        let newest = vec![[Past::History(0), Past::History(1)]; history.entities.len()];
        Self { history, places: Vec::new(), bits: Vec::new(), newest }
    }

    /// Adds a row; its entity and its shape are in the history.
    pub(super) fn push(&mut self, entity: u32, shape: u32) {
        let leaves = self.history.shapes[shape as usize].leaves;
        let past = self.newest[entity as usize];
        self.newest[entity as usize] = [Past::Row(self.places.len()), past[0]];
        let start = self.leaves();
        let aligned = past.map(|past| match self.past_shape(entity, past) {
            Some(other) if other == shape => leaves,
            Some(other) => self.history.aligned(shape, other),
            None => 0,
        });
        self.places.push(RowPlace { entity, shape, start, leaves, past, aligned });
    }

    fn past_shape(&self, entity: u32, past: Past) -> Option<u32> {
        match past {
            Past::Row(row) => Some(self.places[row].shape),
            Past::History(which) => Some(self.history.past[entity as usize][which].as_ref()?.shape),
        }
    }

    /// How many leaves all rows have.
    pub(super) fn leaves(&self) -> usize {
        self.places.last().map_or(0, |place| place.start + place.leaves)
    }

    /// The number of leaves of each row, when all rows have one shape with few enough leaves for columns.
    pub(super) fn columns(&self) -> Option<usize> {
        let first = self.places.first()?;
        let alike = self.places.iter().all(|place| place.shape == first.shape);
        (alike && first.leaves <= COLUMNS_MAX).then_some(first.leaves)
    }

    /// The kind of each leaf of a row.
    pub(super) fn kinds(&self, row: usize) -> Vec<LeafKind> {
        self.history.shapes[self.places[row].shape as usize].kinds().collect()
    }

    /// The leaf of the rows of the same entity before this one, newest first, where it is of the same kind.
    pub(super) fn past_leaf(&self, row: usize, leaf: usize) -> [Option<u64>; 2] {
        let place = &self.places[row];
        let of = |which: usize| {
            if leaf >= place.aligned[which] {
                return None;
            }
            match place.past[which] {
                Past::Row(other) => self.bits.get(self.places[other].start + leaf).copied(),
                Past::History(which) => {
                    let past = self.history.past[place.entity as usize][which].as_ref()?;
                    past.bits.get(leaf).copied()
                }
            }
        };
        let last = of(0);
        [last, last.and_then(|_| of(1))]
    }

    /// The text of the row of the same entity before this one, where it has the same shape; `texts` are those of the
    /// rows before it in this block.
    pub(super) fn past_text<'a>(&'a self, row: usize, texts: &'a [Vec<u8>]) -> Option<&'a [u8]> {
        let place = &self.places[row];
        match place.past[0] {
            Past::Row(other) => (self.places[other].shape == place.shape).then(|| texts[other].as_slice()),
            Past::History(which) => {
                let past = self.history.past[place.entity as usize][which].as_ref()?;
                (past.shape == place.shape).then_some(past.text.as_slice())
            }
        }
    }

    /// The whole number that a leaf is expected to be.
    pub(super) fn predict(&self, row: usize, leaf: usize, kinds: &[LeafKind], grid: Grid) -> i64 {
        let kind = kinds[leaf];
        let whole = |bits| whole(kind, grid, bits);
        match self.past_leaf(row, leaf) {
            [Some(last), Some(before)] => match (kind, grid) {
                (LeafKind::Bool | LeafKind::Text, _) => whole(last),
                (LeafKind::F32 | LeafKind::F64, Grid::Bits) => {
                    let line = 2.0 * f64::from_bits(last) - f64::from_bits(before);
                    whole(if line.is_finite() { line.to_bits() } else { last })
                }
                _ => whole(last).wrapping_mul(2).wrapping_sub(whole(before)),
            },
            [Some(last), None] => whole(last),
            _ => {
                let place = &self.places[row];
                let stride = self.history.shapes[place.shape as usize].stride;
                match leaf.checked_sub(stride) {
                    Some(other) if kinds[other] == kind => whole(self.bits[place.start + other]),
                    _ => 0,
                }
            }
        }
    }

    /// The rows as the history of the next block.
    pub(super) fn into_past(self, mut texts: Vec<Vec<u8>>) -> Vec<(u32, PastRow)> {
        let mut rows = Vec::new();
        for (index, place) in self.places.iter().enumerate() {
            let newest = self.newest[place.entity as usize];
            let is_needed = newest.iter().any(|past| matches!(past, Past::Row(row) if *row == index));
            if is_needed {
                let bits = self.bits[place.start..place.start + place.leaves].to_vec();
                let text = texts.get_mut(index).map(std::mem::take).unwrap_or_default();
                rows.push((place.entity, PastRow { shape: place.shape, bits, text }));
            }
        }
        rows
    }
}

/// The whole number of a leaf.
pub(super) fn whole(kind: LeafKind, grid: Grid, bits: u64) -> i64 {
    if kind.is_float() { grid.whole(bits) } else { bits as i64 }
}

/// The leaf of a whole number.
pub(super) fn bits(kind: LeafKind, grid: Grid, whole: i64) -> u64 {
    if kind.is_float() { grid.bits(whole) } else { whole as u64 }
}
