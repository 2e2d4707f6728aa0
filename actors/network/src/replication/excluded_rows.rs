//! Excluded rows: what a station computes itself, and so is neither sent to it nor taken there.

use trocar_scene::{ComponentId, Entity};

use super::delta::RowSet;

/// Single rows, and whole columns.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct ExcludedRows {
    rows: RowSet,
    /// Ascending.
    columns: Vec<ComponentId>,
}

impl ExcludedRows {
    /// These rows, and all rows of these columns.
    pub fn new(rows: RowSet, columns: impl IntoIterator<Item = ComponentId>) -> Self {
        let mut columns: Vec<ComponentId> = columns.into_iter().collect();
        columns.sort_unstable();
        columns.dedup();
        Self { rows, columns }
    }

    /// Whether a row is among them.
    pub fn contains(&self, id: ComponentId, entity: Entity) -> bool {
        self.columns.binary_search(&id).is_ok() || self.rows.contains(&(id, entity))
    }

    /// The single rows.
    pub fn rows(&self) -> &RowSet {
        &self.rows
    }

    /// The whole columns.
    pub fn columns(&self) -> &[ComponentId] {
        &self.columns
    }
}

impl From<RowSet> for ExcludedRows {
    fn from(rows: RowSet) -> Self {
        Self { rows, columns: Vec::new() }
    }
}
