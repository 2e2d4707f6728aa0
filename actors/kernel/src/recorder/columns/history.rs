//! History: the last two rows of each entity, and the shapes and entities that have occurred in a chunk.

use std::collections::HashMap;

use trocar_scene::{LeafKind, LeafRun};

/// A row that later ones are predicted from.
#[derive(Clone, Debug, Default)]
pub(super) struct PastRow {
    pub(super) shape: u32,
    pub(super) bits: Vec<u64>,
    pub(super) text: Vec<u8>,
}

/// What the rows of a component look like.
#[derive(Clone, Debug)]
pub(super) struct Shape {
    pub(super) runs: Vec<LeafRun>,
    /// How many leaves.
    pub(super) leaves: usize,
    /// Leaves from an element of a list to the next one.
    pub(super) stride: usize,
}

impl Shape {
    pub(super) fn new(runs: Vec<LeafRun>) -> Self {
        let each = runs.iter().filter(|run| run.kind.is_leaf()).map(|run| run.count as usize);
        let leaves = each.fold(0_usize, usize::saturating_add);
        let stride = match runs.first() {
            Some(LeafRun { kind: LeafKind::Sequence, count })
                if *count > 0 && leaves.is_multiple_of(*count as usize) =>
            {
                leaves / *count as usize
            }
            _ => 3,
        };
        Self { runs, leaves, stride: stride.max(1) }
    }

    /// The kind of each leaf.
    pub(super) fn kinds(&self) -> impl Iterator<Item = LeafKind> {
        let runs = self.runs.iter().filter(|run| run.kind.is_leaf());
        runs.flat_map(|run| std::iter::repeat_n(run.kind, run.count as usize))
    }
}

/// What has occurred of one component.
#[derive(Debug, Default)]
pub(super) struct ComponentHistory {
    pub(super) shapes: Vec<Shape>,
    shape_numbers: HashMap<Vec<LeafRun>, u32>,
    pub(super) entities: Vec<u64>,
    entity_numbers: HashMap<u64, u32>,
    /// The last row of each entity, and the one before it.
    pub(super) past: Vec<[Option<PastRow>; 2]>,
}

impl ComponentHistory {
    /// The number of a shape, and whether it is new.
    pub(super) fn shape(&mut self, runs: &[LeafRun]) -> (u32, bool) {
        if let Some(number) = self.shape_numbers.get(runs) {
            return (*number, false);
        }
        (self.add_shape(runs.to_vec()), true)
    }
    pub(super) fn add_shape(&mut self, runs: Vec<LeafRun>) -> u32 {
        let number = self.shapes.len() as u32;
        self.shape_numbers.insert(runs.clone(), number);
        self.shapes.push(Shape::new(runs));
        number
    }
    /// The number of an entity, and whether it is new.
    pub(super) fn entity(&mut self, entity: u64) -> (u32, bool) {
        if let Some(number) = self.entity_numbers.get(&entity) {
            return (*number, false);
        }
        (self.add_entity(entity), true)
    }
    pub(super) fn add_entity(&mut self, entity: u64) -> u32 {
        let number = self.entities.len() as u32;
        self.entity_numbers.insert(entity, number);
        self.entities.push(entity);
        self.past.push([None, None]);
        number
    }
    /// How many leaves of two shapes, from the first on, are of the same kinds.
    pub(super) fn aligned(&self, one: u32, other: u32) -> usize {
        let runs = |shape: u32| {
            let runs = self.shapes[shape as usize].runs.iter().filter(|run| run.kind.is_leaf());
            runs.map(|run| (run.kind, run.count as usize))
        };
        let (mut ours, mut theirs) = (runs(one), runs(other));
        let (mut our, mut their) = (ours.next(), theirs.next());
        let mut aligned = 0;
        while let (Some((kind, left)), Some((their_kind, their_left))) = (&mut our, &mut their) {
            if kind != their_kind {
                break;
            }
            let common = (*left).min(*their_left);
            aligned += common;
            *left -= common;
            *their_left -= common;
            if *left == 0 {
                our = ours.next();
            }
            if matches!(their, Some((_, 0))) {
                their = theirs.next();
            }
        }
        aligned
    }
    /// Makes a row the last one of its entity.
    pub(super) fn remember(&mut self, entity: u32, row: PastRow) {
        if let Some([last, before]) = self.past.get_mut(entity as usize) {
            *before = last.replace(row);
        }
    }
}

/// What a chunk's rows so far predict its next ones from.
#[derive(Debug, Default)]
pub(in super::super) struct History {
    components: HashMap<u64, ComponentHistory>,
}

impl History {
    pub(super) fn component(&mut self, key: u64) -> &mut ComponentHistory {
        self.components.entry(key).or_default()
    }
}
