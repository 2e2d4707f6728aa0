//! What a replica knows of its host's scene: which entities and rows it has, each row at which revision.
//!
//! Memory is proportional to the rows. Vertices are kept beside the scene, because a chunk changes some of them and a
//! row can only be put in whole.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use nalgebra::Point3;
use trocar_scene::{ComponentId, Entity, Revision};

use super::positions::{CHUNK_VERTICES, chunk_count, chunk_range};

/// A row at hand.
#[derive(Clone, Debug, Default)]
pub struct KnownRow {
    /// The revision of its value; of vertices that of the last whole value.
    pub revision: Revision,
    /// The vertices, if it is a row of them.
    pub vertices: Option<KnownVertices>,
}

/// Vertices at hand.
#[derive(Clone, Debug)]
pub struct KnownVertices {
    /// Where they are \[m\].
    pub positions: Arc<Vec<Point3<f64>>>,
    /// The revision of each chunk.
    pub revisions: Vec<Revision>,
    /// Whether chunks came that have not been put into the scene.
    pub is_changed: bool,
}

impl KnownVertices {
    /// Vertices that came in whole.
    pub fn new(positions: Arc<Vec<Point3<f64>>>, revision: Revision) -> Self {
        let revisions = vec![revision; chunk_count(positions.len())];
        Self { positions, revisions, is_changed: false }
    }

    /// Vertices that came in whole replace those at hand, but for chunks that are newer. Returns whether any is.
    pub fn replace(&mut self, positions: &Arc<Vec<Point3<f64>>>, revision: Revision) -> bool {
        let had = std::mem::replace(self, Self::new(positions.clone(), revision));
        if had.positions.len() != positions.len() {
            return false;
        }
        for (chunk, of_chunk) in
            had.revisions.iter().enumerate().filter(|(_, of_chunk)| **of_chunk > revision)
        {
            self.revisions[chunk] = *of_chunk;
            let range = chunk_range(chunk, positions.len());
            Arc::make_mut(&mut self.positions)[range.clone()].copy_from_slice(&had.positions[range]);
            self.is_changed = true;
        }
        self.is_changed
    }

    /// Moves vertices of a chunk.
    pub fn place(&mut self, vertex: usize, position: Point3<f64>) {
        if let Some(place) = Arc::make_mut(&mut self.positions).get_mut(vertex) {
            *place = position;
            self.is_changed = true;
        }
    }

    /// The revision of the chunk of that number, if there is one.
    pub fn revision_of(&mut self, chunk: usize) -> Option<&mut Revision> {
        debug_assert_eq!(self.revisions.len(), self.positions.len().div_ceil(CHUNK_VERTICES));
        self.revisions.get_mut(chunk)
    }
}

/// Entities and rows at hand.
#[derive(Clone, Debug, Default)]
pub struct KnownRows {
    entities: BTreeSet<Entity>,
    /// By the component's number.
    columns: Vec<BTreeMap<Entity, KnownRow>>,
}

impl KnownRows {
    /// Nothing, of so many components.
    pub fn new(components: usize) -> Self {
        Self { entities: BTreeSet::new(), columns: vec![BTreeMap::new(); components] }
    }

    /// Entities that live, in order.
    pub fn entities(&self) -> &BTreeSet<Entity> {
        &self.entities
    }
    /// Whether an entity lives.
    pub fn contains(&self, entity: Entity) -> bool {
        self.entities.contains(&entity)
    }
    /// An entity lives from now on; whether it did not before.
    pub fn spawn(&mut self, entity: Entity) -> bool {
        self.entities.insert(entity)
    }
    /// An entity is gone with all its rows; whether it lived.
    pub fn despawn(&mut self, entity: Entity) -> bool {
        for column in &mut self.columns {
            column.remove(&entity);
        }
        self.entities.remove(&entity)
    }
    /// The row, if it is at hand.
    pub fn row_mut(&mut self, id: ComponentId, entity: Entity) -> Option<&mut KnownRow> {
        self.columns.get_mut(usize::from(id.0))?.get_mut(&entity)
    }
    /// The row, which begins at revision 0 if it was not at hand; `None` for a component that does not exist.
    pub fn row_or_new(&mut self, id: ComponentId, entity: Entity) -> Option<&mut KnownRow> {
        Some(self.columns.get_mut(usize::from(id.0))?.entry(entity).or_default())
    }
    /// Whether the row is at hand.
    pub fn has(&self, id: ComponentId, entity: Entity) -> bool {
        self.columns.get(usize::from(id.0)).is_some_and(|column| column.contains_key(&entity))
    }
    /// The revision of a row's value; of vertices that of the newest chunk.
    pub fn revision(&self, id: ComponentId, entity: Entity) -> Option<Revision> {
        let row = self.columns.get(usize::from(id.0))?.get(&entity)?;
        let chunks = row.vertices.iter().flat_map(|vertices| vertices.revisions.iter());
        Some(chunks.fold(row.revision, |newest, of_chunk| newest.max(*of_chunk)))
    }
    /// The row is gone; whether it was at hand.
    pub fn remove(&mut self, id: ComponentId, entity: Entity) -> bool {
        self.columns.get_mut(usize::from(id.0)).is_some_and(|column| column.remove(&entity).is_some())
    }
    /// All rows of a component are no longer at hand.
    pub fn remove_column(&mut self, id: ComponentId) {
        if let Some(column) = self.columns.get_mut(usize::from(id.0)) {
            column.clear();
        }
    }
    /// All rows of a component, in order of their entities.
    pub fn column(&self, id: ComponentId) -> impl Iterator<Item = Entity> {
        self.columns.get(usize::from(id.0)).into_iter().flat_map(|column| column.keys().copied())
    }
    /// All rows of a component, in order of their entities.
    pub fn column_mut(&mut self, id: ComponentId) -> impl Iterator<Item = (Entity, &mut KnownRow)> {
        let column = self.columns.get_mut(usize::from(id.0)).into_iter();
        column.flat_map(|column| column.iter_mut().map(|(entity, row)| (*entity, row)))
    }
    /// What is at hand of entities that are not `covered` is what the host has in `revision`, as it found by comparing.
    pub fn is_as_in(&mut self, revision: Revision, covered: impl Fn(Entity) -> bool) {
        let rows = self.columns.iter_mut().flat_map(BTreeMap::iter_mut);
        for (_, row) in rows.filter(|(entity, _)| !covered(**entity)) {
            row.revision = revision;
            row.vertices.iter_mut().for_each(|vertices| vertices.revisions.fill(revision));
        }
    }
    /// How many rows are at hand.
    pub fn len(&self) -> usize {
        self.columns.iter().map(BTreeMap::len).sum()
    }
    /// Whether none is.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
}
