//! The rows that a station has, each in a place of its own, so that queues and datagrams name a row by a number.

use std::collections::BTreeMap;

use trocar_scene::{ComponentId, Entity, Revision, SimTime};

use super::sent_datagrams::Part;
use super::vertex_chunks::VertexChunks;

/// A row at the sender.
pub(super) struct PlacedRow {
    pub(super) id: ComponentId,
    pub(super) entity: Entity,
    /// Counts the rows that had this place, so that nobody takes one for another.
    pub(super) generation: u32,
    pub(super) is_queued: bool,
    /// Revision of the delta that brought it to the station.
    pub(super) introduced: Revision,
    pub(super) sent_at: Option<SimTime>,
    /// The datagram with its last value.
    pub(super) sequence: Option<u64>,
    /// Whether that datagram was lost.
    pub(super) is_lost: bool,
    /// Hash of its last value.
    pub(super) hash: Option<u64>,
    /// Whether datagrams cannot carry it.
    pub(super) is_unfit: bool,
    pub(super) vertices: Option<VertexChunks>,
}

/// Places for rows; those of rows that are gone are used again.
#[derive(Default)]
pub(super) struct RowPlaces {
    places: Vec<PlacedRow>,
    free: Vec<u32>,
    index: BTreeMap<(ComponentId, Entity), u32>,
}

impl RowPlaces {
    /// Places, in use or free.
    pub(super) fn len(&self) -> usize {
        self.places.len()
    }
    /// The rows that are there.
    pub(super) fn iter(&self) -> impl Iterator<Item = &PlacedRow> {
        self.index.values().map(|slot| self.at(*slot))
    }
    /// The place of a row.
    pub(super) fn find(&self, id: ComponentId, entity: Entity) -> Option<u32> {
        self.index.get(&(id, entity)).copied()
    }
    /// The row in a place that was found.
    pub(super) fn at(&self, slot: u32) -> &PlacedRow {
        &self.places[slot as usize]
    }
    /// The row in a place that was found.
    pub(super) fn at_mut(&mut self, slot: u32) -> &mut PlacedRow {
        &mut self.places[slot as usize]
    }
    /// The row that a datagram carried, unless it is gone.
    pub(super) fn of(&mut self, part: &Part) -> Option<&mut PlacedRow> {
        self.places.get_mut(part.slot as usize).filter(|row| row.generation == part.generation)
    }

    /// The place of a row, which gets one if it has none.
    pub(super) fn find_or_place(&mut self, id: ComponentId, entity: Entity) -> u32 {
        if let Some(slot) = self.find(id, entity) {
            return slot;
        }
        let row = PlacedRow {
            id,
            entity,
            generation: 0,
            is_queued: false,
            introduced: Revision::ZERO,
            sent_at: None,
            sequence: None,
            is_lost: false,
            hash: None,
            is_unfit: false,
            vertices: None,
        };
        let slot = match self.free.pop() {
            Some(slot) => {
                let generation = self.at(slot).generation;
                *self.at_mut(slot) = PlacedRow { generation, ..row };
                slot
            }
            None => {
                self.places.push(row);
                (self.places.len() - 1) as u32
            }
        };
        self.index.insert((id, entity), slot);
        slot
    }

    /// Frees the place of a row; whether the row was queued.
    pub(super) fn forget(&mut self, id: ComponentId, entity: Entity) -> bool {
        let Some(slot) = self.index.remove(&(id, entity)) else { return false };
        self.free.push(slot);
        let row = self.at_mut(slot);
        row.generation = row.generation.wrapping_add(1);
        row.vertices = None;
        std::mem::take(&mut row.is_queued)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_place_is_used_again_but_never_taken_for_the_row_before() {
        let mut places = RowPlaces::default();
        let entity = |counter| Entity::new(0, 0, counter);
        let first = places.find_or_place(ComponentId(3), entity(1));
        assert_eq!(places.find_or_place(ComponentId(3), entity(1)), first);
        let generation = places.at(first).generation;
        let part = Part { slot: first, generation, chunk: 0, revision: Revision::ZERO };
        assert!(places.of(&part).is_some());
        places.at_mut(first).is_queued = true;
        assert!(places.forget(ComponentId(3), entity(1)) && !places.forget(ComponentId(3), entity(1)));
        assert!(places.of(&part).is_none());
        let second = places.find_or_place(ComponentId(3), entity(2));
        assert!(second == first && places.of(&part).is_none() && !places.at(second).is_queued);
        assert_eq!((places.len(), places.iter().count()), (1, 1));
    }
}
