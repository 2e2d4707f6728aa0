//! Columns: the rows of one component, in chunks that snapshots share until one of them changes.
//!
//! Two-level copy-on-write: a block per spawner, pages of 64 chunks, chunks of 64 rows. Entities of one
//! spawner are numbered densely, so a row is found by shifts alone and a publication costs what changed,
//! not what exists. Each row carries the revision in which it changed, each chunk, page and block the
//! largest below it, so that [`Column::iter_changed`] skips what is old.

use std::any::Any;
use std::sync::Arc;

use crate::component::{Component, ComponentError};
use crate::entity::Entity;
use crate::time::Revision;

const BITS: u32 = 6;
const FANOUT: usize = 1 << BITS;
const MASK: u32 = FANOUT as u32 - 1;

#[derive(Clone)]
struct Row<T> {
    value: T,
    revision: Revision,
}

#[derive(Clone)]
struct Chunk<T> {
    latest: Revision,
    rows: Vec<Option<Row<T>>>,
}

#[derive(Clone)]
struct Page<T> {
    latest: Revision,
    chunks: Vec<Option<Arc<Chunk<T>>>>,
}

#[derive(Clone)]
struct Block<T> {
    key: u32,
    latest: Revision,
    pages: Vec<Option<Arc<Page<T>>>>,
}

/// All rows of one component.
#[derive(Clone)]
pub struct Column<T> {
    blocks: Vec<Block<T>>,
    len: usize,
    latest: Revision,
}

impl<T> Default for Column<T> {
    fn default() -> Self {
        Self { blocks: Vec::new(), len: 0, latest: Revision::ZERO }
    }
}

fn indices(counter: u32) -> (usize, usize, usize) {
    ((counter >> (2 * BITS)) as usize, ((counter >> BITS) & MASK) as usize, (counter & MASK) as usize)
}

/// The slot at `index`, after growing the list to reach it.
fn slot<S>(list: &mut Vec<Option<S>>, index: usize) -> &mut Option<S> {
    if list.len() <= index {
        list.resize_with(index + 1, || None);
    }
    &mut list[index]
}

impl<T: Clone> Column<T> {
    fn row(&self, entity: Entity) -> Option<&Row<T>> {
        let key = entity.block();
        let block = self.blocks.iter().find(|block| block.key == key)?;
        let (page, chunk, row) = indices(entity.counter());
        block.pages.get(page)?.as_ref()?.chunks.get(chunk)?.as_ref()?.rows.get(row)?.as_ref()
    }

    /// The entity's value.
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

    /// Rows in entity order.
    pub fn iter(&self) -> impl Iterator<Item = (Entity, &T)> {
        self.rows_since(None).map(|(entity, row)| (entity, &row.value))
    }

    /// Rows that changed after `since`, in entity order.
    pub fn iter_changed(&self, since: Revision) -> impl Iterator<Item = (Entity, &T)> {
        self.rows_since(Some(since)).map(|(entity, row)| (entity, &row.value))
    }

    fn rows_since(&self, since: Option<Revision>) -> impl Iterator<Item = (Entity, &Row<T>)> {
        let newer = move |latest: Revision| since.is_none_or(|since| latest > since);
        self.blocks.iter().filter(move |block| newer(block.latest)).flat_map(move |block| {
            let pages = block.pages.iter().enumerate();
            let pages = pages.filter_map(move |(p, page)| {
                page.as_ref().filter(|page| newer(page.latest)).map(|page| (p, page))
            });
            pages.flat_map(move |(p, page)| {
                let chunks = page.chunks.iter().enumerate();
                let chunks = chunks.filter_map(move |(c, chunk)| {
                    chunk.as_ref().filter(|chunk| newer(chunk.latest)).map(|chunk| (c, chunk))
                });
                chunks.flat_map(move |(c, chunk)| {
                    chunk.rows.iter().enumerate().filter_map(move |(r, row)| {
                        let row = row.as_ref().filter(|row| newer(row.revision))?;
                        let counter = ((p << (2 * BITS)) | (c << BITS) | r) as u32;
                        Some((Entity::from_bits((u64::from(block.key) << 32) | u64::from(counter)), row))
                    })
                })
            })
        })
    }

    /// Sets the entity's value.
    pub fn put(&mut self, entity: Entity, value: T, revision: Revision) {
        let key = entity.block();
        let at = match self.blocks.binary_search_by_key(&key, |block| block.key) {
            Ok(at) => at,
            Err(at) => {
                self.blocks.insert(at, Block { key, latest: revision, pages: Vec::new() });
                at
            }
        };
        let block = &mut self.blocks[at];
        let (page, chunk, row) = indices(entity.counter());
        block.latest = revision;
        let page = Arc::make_mut(
            slot(&mut block.pages, page)
                .get_or_insert_with(|| Arc::new(Page { latest: revision, chunks: Vec::new() })),
        );
        page.latest = revision;
        let chunk = Arc::make_mut(
            slot(&mut page.chunks, chunk)
                .get_or_insert_with(|| Arc::new(Chunk { latest: revision, rows: Vec::new() })),
        );
        chunk.latest = revision;
        let row = slot(&mut chunk.rows, row);
        self.len += usize::from(row.is_none());
        *row = Some(Row { value, revision });
        self.latest = revision;
    }

    /// Takes the entity's value away; says whether there was one.
    pub fn remove(&mut self, entity: Entity, revision: Revision) -> bool {
        if self.row(entity).is_none() {
            return false;
        }
        let key = entity.block();
        let Ok(at) = self.blocks.binary_search_by_key(&key, |block| block.key) else { return false };
        let (page, chunk, row) = indices(entity.counter());
        let block = &mut self.blocks[at];
        let Some(Some(page_slot)) = block.pages.get_mut(page) else { return false };
        let page_rows = Arc::make_mut(page_slot);
        let Some(Some(chunk_slot)) = page_rows.chunks.get_mut(chunk) else { return false };
        let rows = Arc::make_mut(chunk_slot);
        rows.rows[row] = None;
        // Empty chunks and pages go, so that a long session does not keep what it despawned.
        if rows.rows.iter().all(Option::is_none) {
            page_rows.chunks[chunk] = None;
        }
        if page_rows.chunks.iter().all(Option::is_none) {
            block.pages[page] = None;
        }
        block.latest = revision;
        self.len -= 1;
        self.latest = revision;
        true
    }
}

/// A column whose row type is not known here.
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
    /// Takes a row away.
    fn remove(&mut self, entity: Entity, revision: Revision) -> bool;
    /// Visits the entities that have a row, in order.
    fn for_each_entity(&self, visit: &mut dyn FnMut(Entity));
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
    fn remove(&mut self, entity: Entity, revision: Revision) -> bool {
        Column::remove(self, entity, revision)
    }
    fn for_each_entity(&self, visit: &mut dyn FnMut(Entity)) {
        self.iter().for_each(|(entity, _)| visit(entity));
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
    postcard::to_io(value, &mut *out)
        .map(|_| ())
        .map_err(|error| ComponentError::Malformed(error.to_string()))
}
