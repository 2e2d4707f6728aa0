//! Puts: the rows of one component that a tick writes.
//!
//! All that is compiled once for each component stands here, and is kept small: how rows are ordered is computed from
//! their entities alone, in code that knows no component.

use std::any::Any;

use crate::column::{Column, ErasedColumn, encode};
use crate::component::{Component, ComponentError};
use crate::entity::Entity;
use crate::time::Revision;
use crate::values::leaves::Leaves;

/// The puts of one component.
pub struct Puts<T> {
    rows: Vec<(Entity, T)>,
}

impl<T> Default for Puts<T> {
    fn default() -> Self {
        Self { rows: Vec::new() }
    }
}

impl<T> Puts<T> {
    pub(crate) fn push(&mut self, entity: Entity, value: T) {
        self.rows.push((entity, value));
    }
    /// The rows, in entity order once sealed.
    pub fn rows(&self) -> &[(Entity, T)] {
        &self.rows
    }
}

/// Type-erased puts.
pub trait ErasedPuts: Send {
    /// For downcasting to [`Puts`].
    fn as_any(&self) -> &dyn Any;
    /// For downcasting to [`Puts`].
    fn as_any_mut(&mut self) -> &mut dyn Any;
    /// How many rows.
    fn len(&self) -> usize;
    /// Whether there are none.
    fn is_empty(&self) -> bool {
        self.len() == 0
    }
    /// Clears the rows.
    fn clear(&mut self);
    /// Sorts by entity and keeps the last put of each row. Nothing is allocated when the rows are in order already.
    fn seal(&mut self, order: &mut RowOrder);
    /// The entity of row `index`.
    fn entity(&self, index: usize) -> Entity;
    /// Checks every value again.
    ///
    /// # Errors
    /// The first entity whose value is refused, and why.
    fn check(&self) -> Result<(), (Entity, ComponentError)>;
    /// Appends (entity, value) of every row.
    ///
    /// # Errors
    /// When a value cannot be encoded.
    fn encode(&self, out: &mut Vec<u8>) -> Result<(), ComponentError>;
    /// The leaves of row `index`.
    ///
    /// # Errors
    /// When the value cannot be recorded.
    fn leaves(&self, index: usize, leaves: &mut Leaves) -> Result<(), ComponentError>;
    /// Moves the rows into a column of the same type.
    fn apply(&mut self, column: &mut dyn ErasedColumn, revision: Revision);
}

impl<T: Component> ErasedPuts for Puts<T> {
    fn as_any(&self) -> &dyn Any {
        self
    }
    fn as_any_mut(&mut self) -> &mut dyn Any {
        self
    }
    fn len(&self) -> usize {
        self.rows.len()
    }
    fn clear(&mut self) {
        self.rows.clear();
    }
    fn seal(&mut self, order: &mut RowOrder) {
        if self.rows.windows(2).all(|pair| pair[0].0 < pair[1].0) {
            return;
        }
        order.entities.clear();
        for (entity, _) in &self.rows {
            order.entities.push(*entity);
        }
        order.find();
        for (one, other) in &order.swaps {
            self.rows.swap(*one, *other);
        }
        self.rows.truncate(order.kept);
    }
    fn entity(&self, index: usize) -> Entity {
        self.rows[index].0
    }
    fn check(&self) -> Result<(), (Entity, ComponentError)> {
        for (entity, value) in &self.rows {
            if let Err(error) = value.check() {
                return Err((*entity, error));
            }
        }
        Ok(())
    }
    fn encode(&self, out: &mut Vec<u8>) -> Result<(), ComponentError> {
        for row in &self.rows {
            encode(row, out)?;
        }
        Ok(())
    }
    fn leaves(&self, index: usize, leaves: &mut Leaves) -> Result<(), ComponentError> {
        leaves.of(&self.rows[index].1)
    }
    fn apply(&mut self, column: &mut dyn ErasedColumn, revision: Revision) {
        if let Some(column) = column.as_any_mut().downcast_mut::<Column<T>>() {
            for (entity, value) in self.rows.drain(..) {
                column.put(entity, value, revision);
            }
        }
    }
}

/// How rows come into entity order: buffers that are reused from tick to tick.
#[derive(Default)]
pub struct RowOrder {
    /// The entity of each row.
    entities: Vec<Entity>,
    /// Exchanges of two rows, one after another, after which the rows to keep come first, in order.
    swaps: Vec<(usize, usize)>,
    /// How many rows are kept.
    kept: usize,
    /// The rows to keep, in order.
    order: Vec<usize>,
    /// Which row each place holds, and which place each row has, while rows are exchanged.
    row_at: Vec<usize>,
    place_of: Vec<usize>,
}

impl RowOrder {
    /// Finds the exchanges that sort the rows by entity; of rows of one entity the last is kept.
    fn find(&mut self) {
        let Self { entities, swaps, kept, order, row_at, place_of } = self;
        let count = entities.len();
        order.clear();
        order.extend(0..count);
        // Later rows first, so that the first of each entity is the one to keep.
        order.sort_unstable_by_key(|row| (entities[*row], std::cmp::Reverse(*row)));
        order.dedup_by_key(|row| entities[*row]);
        *kept = order.len();
        row_at.clear();
        row_at.extend(0..count);
        place_of.clear();
        place_of.extend(0..count);
        swaps.clear();
        for (place, row) in order.iter().enumerate() {
            let from = place_of[*row];
            if from != place {
                swaps.push((place, from));
                row_at.swap(place, from);
                place_of[row_at[from]] = from;
                place_of[row_at[place]] = place;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What sealing must give: a stable sort, of which the last row of each entity is kept.
    fn sealed_by_sorting(rows: &[(Entity, usize)]) -> Vec<(Entity, usize)> {
        let mut rows = rows.to_vec();
        rows.sort_by_key(|(entity, _)| *entity);
        rows.reverse();
        rows.dedup_by_key(|(entity, _)| *entity);
        rows.reverse();
        rows
    }

    #[test]
    fn rows_come_into_entity_order_and_the_last_put_of_each_is_kept() {
        let mut order = RowOrder::default();
        let mut bits = 7_u64;
        for round in 0..200 {
            let rows: Vec<(Entity, usize)> = (0..round % 40)
                .map(|row| {
                    bits =
                        bits.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                    (Entity::from_bits((bits >> 33) % 23), row)
                })
                .collect();
            order.entities = rows.iter().map(|(entity, _)| *entity).collect();
            order.find();
            let mut moved = rows.clone();
            for (one, other) in &order.swaps {
                moved.swap(*one, *other);
            }
            moved.truncate(order.kept);
            assert_eq!(moved, sealed_by_sorting(&rows), "of {rows:?}");
        }
    }
}
