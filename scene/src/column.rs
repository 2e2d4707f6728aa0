//! Columns: the rows of one component, in chunks shared between snapshots by copy-on-write.
//!
//! Two-level copy-on-write: pages of 64 chunks, chunks of 64 rows. A publication copies only changed chunks. Each row
//! stores the revision of its last change, each chunk and page the maximum below it, so that [`Column::iter_changed`]
//! skips unchanged parts.
//!
//! Entities of one spawner are numbered densely, so a row is found by shifts; but numbers may come from a file, so no
//! memory is reserved for absent ones: pages are sorted by number, and below them a node keeps a bitmap of its 64
//! places and only the filled ones (Bagwell, "Ideal Hash Trees", 2001). Memory is proportional to the number of rows,
//! for any numbering of entities.

use std::any::Any;
use std::sync::Arc;

use crate::component::{Component, ComponentError};
use crate::entity::Entity;
use crate::time::Revision;
use crate::values::leaves::Leaves;

const BITS: u32 = 6;
const MASK: u64 = (1 << BITS) - 1;

/// Most pages (4,096 neighbouring numbers of one spawner each) of a column: a bound on the cost of sharing a column.
/// Densely numbered, they hold 67 million entities.
pub(crate) const PAGES_MAX: usize = 1 << 14;

/// [`Sparse::start`] of a node with holes between its filled places.
const HOLES: u32 = u32::MAX;

/// Up to 64 places of which only the filled ones use memory.
#[derive(Clone)]
struct Sparse<S> {
    filled: u64,
    /// The first filled place if no hole follows it, which is the usual case; otherwise [`HOLES`]. Subtracting it is
    /// faster than counting bits.
    start: u32,
    slots: Vec<S>,
}

impl<S> Sparse<S> {
    fn of(index: u32, slot: S) -> Self {
        Self { filled: 1 << index, start: index, slots: vec![slot] }
    }
    /// How many places below `index` are filled.
    fn rank(&self, index: u32) -> usize {
        (self.filled & ((1 << index) - 1)).count_ones() as usize
    }
    fn has(&self, index: u32) -> bool {
        self.filled >> index & 1 == 1
    }
    fn set_filled(&mut self, filled: u64) {
        self.filled = filled;
        let first = filled.trailing_zeros();
        let run = filled.checked_shr(first).unwrap_or(0);
        self.start = if run & run.wrapping_add(1) == 0 { first } else { HOLES };
    }
    #[inline]
    fn get(&self, index: u32) -> Option<&S> {
        if self.start != HOLES {
            self.slots.get(index.wrapping_sub(self.start) as usize)
        } else if self.has(index) {
            self.slots.get(self.rank(index))
        } else {
            None
        }
    }
    fn get_mut(&mut self, index: u32) -> Option<&mut S> {
        if self.has(index) {
            let rank = self.rank(index);
            self.slots.get_mut(rank)
        } else {
            None
        }
    }
    /// Fills an empty place.
    fn insert(&mut self, index: u32, slot: S) {
        let rank = self.rank(index);
        self.slots.insert(rank, slot);
        self.set_filled(self.filled | 1 << index);
    }
    fn remove(&mut self, index: u32) {
        if self.has(index) {
            let rank = self.rank(index);
            self.slots.remove(rank);
            self.set_filled(self.filled & !(1 << index));
        }
    }
    fn is_empty(&self) -> bool {
        self.filled == 0
    }
    /// The filled places in order.
    fn places(&self) -> Places<'_, S> {
        Places { left: self.filled, slots: self.slots.iter() }
    }
}

/// Filled places of a node that are still to be visited.
struct Places<'a, S> {
    left: u64,
    slots: std::slice::Iter<'a, S>,
}

impl<'a, S> Places<'a, S> {
    fn none() -> Self {
        Self { left: 0, slots: [].iter() }
    }

    #[inline]
    fn next(&mut self) -> Option<(u32, &'a S)> {
        let slot = self.slots.next()?;
        let index = self.left.trailing_zeros();
        self.left &= self.left.wrapping_sub(1);
        Some((index, slot))
    }
}

#[derive(Clone)]
struct Row<T> {
    value: T,
    revision: Revision,
}

#[derive(Clone)]
struct Chunk<T> {
    latest: Revision,
    rows: Sparse<Row<T>>,
}

#[derive(Clone)]
struct Page<T> {
    latest: Revision,
    chunks: Sparse<Arc<Chunk<T>>>,
}

/// All rows of one component.
#[derive(Clone)]
pub struct Column<T> {
    /// Pages by [`page_of`], ascending.
    pages: Vec<(u64, Arc<Page<T>>)>,
    len: usize,
    latest: Revision,
}

impl<T> Default for Column<T> {
    fn default() -> Self {
        Self { pages: Vec::new(), len: 0, latest: Revision::ZERO }
    }
}

/// Station, spawner and the counter's upper bits.
fn page_of(entity: Entity) -> u64 {
    entity.to_bits() >> (2 * BITS)
}

/// Place of the chunk in its page, and of the row in its chunk.
fn places(entity: Entity) -> (u32, u32) {
    let bits = entity.to_bits();
    (((bits >> BITS) & MASK) as u32, (bits & MASK) as u32)
}

impl<T: Clone> Column<T> {
    #[inline]
    fn find(&self, page: u64) -> Result<usize, usize> {
        // A scene has a page or two per writer. For so few, comparing with all of them is faster than a binary search
        // with its unpredictable branches.
        const FEW: usize = 8;
        let at = if self.pages.len() <= FEW {
            self.pages.iter().map(|(number, _)| usize::from(*number < page)).sum()
        } else {
            self.pages.partition_point(|(number, _)| *number < page)
        };
        match self.pages.get(at) {
            Some((number, _)) if *number == page => Ok(at),
            _ => Err(at),
        }
    }

    #[inline]
    fn row(&self, entity: Entity) -> Option<&Row<T>> {
        let at = self.find(page_of(entity)).ok()?;
        let (chunk, row) = places(entity);
        self.pages[at].1.chunks.get(chunk)?.rows.get(row)
    }

    /// The entity's value.
    #[inline]
    pub fn get(&self, entity: Entity) -> Option<&T> {
        self.row(entity).map(|row| &row.value)
    }

    /// The revision in which the entity's value last changed.
    pub fn revision(&self, entity: Entity) -> Option<Revision> {
        self.row(entity).map(|row| row.revision)
    }

    /// How many entities have this component.
    pub fn len(&self) -> usize {
        self.len
    }

    /// Whether no entity has it.
    pub fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// The revision of the latest change, removals included.
    pub fn latest(&self) -> Revision {
        self.latest
    }

    /// Whether rows of these entities fit in addition to the existing ones. Consecutive entities of one page count
    /// once; in another order the result may be false although there is room.
    pub(crate) fn has_room(&self, entities: impl Iterator<Item = Entity>) -> bool {
        let (mut pages, mut last) = (self.pages.len(), None);
        for page in entities.map(page_of) {
            if last != Some(page) && self.find(page).is_err() {
                pages += 1;
            }
            last = Some(page);
        }
        pages <= PAGES_MAX
    }

    /// Rows in entity order.
    pub fn iter(&self) -> Rows<'_, T> {
        self.rows_since(None)
    }

    /// Rows that changed after `since`, in entity order.
    pub fn iter_changed(&self, since: Revision) -> Rows<'_, T> {
        self.rows_since(Some(since))
    }

    fn rows_since(&self, since: Option<Revision>) -> Rows<'_, T> {
        Rows { since, pages: self.pages.iter(), ..Rows::none() }
    }

    /// Sets the entity's value.
    pub fn put(&mut self, entity: Entity, value: T, revision: Revision) {
        self.latest = revision;
        let number = page_of(entity);
        let (c, r) = places(entity);
        let row = Row { value, revision };
        let fresh = |row| Arc::new(Chunk { latest: revision, rows: Sparse::of(r, row) });
        let at = match self.find(number) {
            Ok(at) => at,
            Err(at) => {
                let page = Page { latest: revision, chunks: Sparse::of(c, fresh(row)) };
                self.pages.insert(at, (number, Arc::new(page)));
                self.len += 1;
                return;
            }
        };
        let page = Arc::make_mut(&mut self.pages[at].1);
        page.latest = revision;
        let Some(chunk) = page.chunks.get_mut(c) else {
            page.chunks.insert(c, fresh(row));
            self.len += 1;
            return;
        };
        let chunk = Arc::make_mut(chunk);
        chunk.latest = revision;
        match chunk.rows.get_mut(r) {
            Some(place) => *place = row,
            None => {
                chunk.rows.insert(r, row);
                self.len += 1;
            }
        }
    }

    /// Removes the entity's value; returns whether there was one.
    pub fn remove(&mut self, entity: Entity, revision: Revision) -> bool {
        if self.row(entity).is_none() {
            return false;
        }
        let Ok(at) = self.find(page_of(entity)) else { return false };
        let (c, r) = places(entity);
        let page = Arc::make_mut(&mut self.pages[at].1);
        let Some(chunk) = page.chunks.get_mut(c) else { return false };
        let chunk = Arc::make_mut(chunk);
        chunk.rows.remove(r);
        // Empty chunks and pages are freed, so that a long session does not keep memory of despawned entities.
        if chunk.rows.is_empty() {
            page.chunks.remove(c);
        }
        if page.chunks.is_empty() {
            self.pages.remove(at);
        }
        self.len -= 1;
        self.latest = revision;
        true
    }
}

/// Rows of a column, in entity order.
///
/// A loop by hand: nested iterator adapters would be compiled once for each component, at five times the size.
pub struct Rows<'a, T> {
    /// Only rows that changed after it.
    since: Option<Revision>,
    pages: std::slice::Iter<'a, (u64, Arc<Page<T>>)>,
    /// Bits of the entities of the current page.
    page: u64,
    chunks: Places<'a, Arc<Chunk<T>>>,
    /// Bits of the entities of the current chunk.
    chunk: u64,
    rows: Places<'a, Row<T>>,
}

impl<T> Rows<'_, T> {
    /// No rows.
    pub(crate) fn none() -> Self {
        let pages = [].iter();
        Self { since: None, pages, page: 0, chunks: Places::none(), chunk: 0, rows: Places::none() }
    }
}

impl<'a, T> Iterator for Rows<'a, T> {
    type Item = (Entity, &'a T);

    fn next(&mut self) -> Option<Self::Item> {
        let since = self.since;
        let newer = |latest: Revision| since.is_none_or(|since| latest > since);
        loop {
            while let Some((r, row)) = self.rows.next() {
                if newer(row.revision) {
                    return Some((Entity::from_bits(self.chunk | u64::from(r)), &row.value));
                }
            }
            if let Some((c, chunk)) = self.chunks.next() {
                if newer(chunk.latest) {
                    self.chunk = self.page | u64::from(c << BITS);
                    self.rows = chunk.rows.places();
                }
                continue;
            }
            let (number, page) = self.pages.next()?;
            if newer(page.latest) {
                self.page = number << (2 * BITS);
                self.chunks = page.chunks.places();
            }
        }
    }
}

/// A type-erased column.
pub trait ErasedColumn: Send + Sync {
    /// For downcasting to [`Column`].
    fn as_any(&self) -> &dyn Any;
    /// For downcasting to [`Column`].
    fn as_any_mut(&mut self) -> &mut dyn Any;
    /// A copy that shares all chunks.
    fn share(&self) -> Arc<dyn ErasedColumn>;
    /// How many rows there are.
    fn len(&self) -> usize;
    /// Whether there are none.
    fn is_empty(&self) -> bool {
        self.len() == 0
    }
    /// The revision of the latest change.
    fn latest(&self) -> Revision;
    /// The revision of one row.
    fn revision(&self, entity: Entity) -> Option<Revision>;
    /// Whether rows of these entities, in order, fit in addition to the existing ones.
    fn has_room(&self, entities: &mut dyn Iterator<Item = Entity>) -> bool;
    /// Removes a row.
    fn remove(&mut self, entity: Entity, revision: Revision) -> bool;
    /// Visits the entities that have a row, in order.
    fn for_each_entity(&self, visit: &mut dyn FnMut(Entity));
    /// Visits the entities whose rows changed after `since`, in order.
    fn for_each_changed(&self, since: Revision, visit: &mut dyn FnMut(Entity));
    /// The leaves of one row; `Ok(false)` when there is none.
    ///
    /// # Errors
    /// When the value cannot be recorded.
    fn leaves(&self, entity: Entity, leaves: &mut Leaves) -> Result<bool, ComponentError>;
    /// Appends the postcard encoding of one row; `Ok(false)` when there is none.
    ///
    /// # Errors
    /// When the value cannot be encoded.
    fn encode_row(&self, entity: Entity, out: &mut Vec<u8>) -> Result<bool, ComponentError>;
    /// One row as JSON.
    fn row_json(&self, entity: Entity) -> Option<serde_json::Value>;
}

impl<T: Component> ErasedColumn for Column<T> {
    fn as_any(&self) -> &dyn Any {
        self
    }
    fn as_any_mut(&mut self) -> &mut dyn Any {
        self
    }
    fn share(&self) -> Arc<dyn ErasedColumn> {
        Arc::new(self.clone())
    }
    fn len(&self) -> usize {
        self.len
    }
    fn latest(&self) -> Revision {
        self.latest
    }
    fn revision(&self, entity: Entity) -> Option<Revision> {
        Column::revision(self, entity)
    }
    fn has_room(&self, entities: &mut dyn Iterator<Item = Entity>) -> bool {
        Column::has_room(self, entities)
    }
    fn remove(&mut self, entity: Entity, revision: Revision) -> bool {
        Column::remove(self, entity, revision)
    }
    fn for_each_entity(&self, visit: &mut dyn FnMut(Entity)) {
        self.iter().for_each(|(entity, _)| visit(entity));
    }
    fn for_each_changed(&self, since: Revision, visit: &mut dyn FnMut(Entity)) {
        self.iter_changed(since).for_each(|(entity, _)| visit(entity));
    }
    fn leaves(&self, entity: Entity, leaves: &mut Leaves) -> Result<bool, ComponentError> {
        match self.get(entity) {
            Some(value) => leaves.of(value).map(|()| true),
            None => Ok(false),
        }
    }
    fn encode_row(&self, entity: Entity, out: &mut Vec<u8>) -> Result<bool, ComponentError> {
        match self.get(entity) {
            Some(value) => encode(value, out).map(|()| true),
            None => Ok(false),
        }
    }
    fn row_json(&self, entity: Entity) -> Option<serde_json::Value> {
        self.get(entity).and_then(|value| serde_json::to_value(value).ok())
    }
}

/// Appends the postcard encoding of a value.
pub(crate) fn encode<T: serde::Serialize>(value: &T, out: &mut Vec<u8>) -> Result<(), ComponentError> {
    match postcard::to_io(value, &mut *out) {
        Ok(_) => Ok(()),
        Err(error) => Err(malformed(&error)),
    }
}

/// Decodes a postcard value from the front of some bytes and returns the rest.
pub(crate) fn take<'a, T: serde::Deserialize<'a>>(bytes: &'a [u8]) -> Result<(T, &'a [u8]), ComponentError> {
    match postcard::take_from_bytes(bytes) {
        Ok(taken) => Ok(taken),
        Err(error) => Err(malformed(&error)),
    }
}

fn malformed(error: &postcard::Error) -> ComponentError {
    ComponentError::Malformed(error.to_string())
}
