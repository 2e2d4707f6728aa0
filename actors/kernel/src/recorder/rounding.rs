//! Rounding of sampled values: the leaves of a row as a recording stores them.

use std::sync::Arc;

use trocar_scene::{
    Commands, ComponentError, ComponentId, Entity, EntityAllocator, ErasedColumn, ErasedPuts, Leaves,
    RecordPolicy, Registry,
};

/// How the values of each component are kept, by its id.
#[derive(Clone, Debug)]
pub(super) struct Policies {
    /// The step of the rounding of sampled components.
    steps: Vec<Option<f64>>,
}

impl Policies {
    /// The policies that the components declare; `exact` keeps every value to the last bit.
    pub(super) fn new(registry: &Registry, exact: bool) -> Self {
        let step = |policy: RecordPolicy| match policy {
            RecordPolicy::Sampled(sampling) if !exact => Some(sampling.step()),
            _ => None,
        };
        Self { steps: registry.iter().map(|(_, entry)| step(entry.record)).collect() }
    }
    pub(super) fn is_sampled(&self, component: ComponentId) -> bool {
        self.steps[usize::from(component.0)].is_some()
    }
}

/// Rounds rows. The same value always gives the same leaves.
pub(super) struct Rounder {
    policies: Policies,
    registry: Arc<Registry>,
    commands: Commands,
    /// The leaves of the last row.
    pub(super) leaves: Leaves,
    /// Their postcard encoding.
    pub(super) bytes: Vec<u8>,
}

impl Rounder {
    pub(super) fn new(registry: &Arc<Registry>, policies: Policies) -> Self {
        Self {
            policies,
            registry: registry.clone(),
            commands: Commands::new(registry.clone(), EntityAllocator::new(0, 0)),
            leaves: Leaves::default(),
            bytes: Vec::new(),
        }
    }

    /// Takes a row of a column; `false` when there is none.
    ///
    /// # Errors
    /// When the value cannot be recorded.
    pub(super) fn column_row(
        &mut self,
        component: ComponentId,
        column: &dyn ErasedColumn,
        entity: Entity,
    ) -> Result<bool, ComponentError> {
        if !column.leaves(entity, &mut self.leaves)? {
            return Ok(false);
        }
        if !self.round(component, entity) {
            column.leaves(entity, &mut self.leaves)?;
        }
        self.encode();
        Ok(true)
    }

    /// Takes a row of a batch.
    ///
    /// # Errors
    /// When the value cannot be recorded.
    pub(super) fn put_row(
        &mut self,
        component: ComponentId,
        puts: &dyn ErasedPuts,
        index: usize,
    ) -> Result<(), ComponentError> {
        puts.leaves(index, &mut self.leaves)?;
        if !self.round(component, puts.entity(index)) {
            puts.leaves(index, &mut self.leaves)?;
        }
        self.encode();
        Ok(())
    }

    /// Rounds the leaves; `false` when the component refuses the rounded value (it lies at the limit of what is valid).
    fn round(&mut self, component: ComponentId, entity: Entity) -> bool {
        let Some(step) = self.policies.steps[usize::from(component.0)] else { return true };
        self.leaves.round(step);
        self.encode();
        self.commands.clear();
        self.registry.put_postcard(component, &mut self.commands, entity, &self.bytes).is_ok()
    }

    fn encode(&mut self) {
        self.bytes.clear();
        self.leaves.encode(&mut self.bytes);
    }
}
