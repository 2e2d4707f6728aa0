//! Constraint rows that an inverse keeps from tick to tick.
//!
//! Constraints up to the first difference from the last tick's list are kept, with their part of the factor of W, if
//! they are bilateral: pinned interior points, whose rows need sparse solves, and vertices held by jaws. The others are
//! released and added anew by rank-one updates. Contacts (unilateral) are never kept: their order of activation would
//! be in the factor, and in its rounding, so that a restart would give other numbers. As it is, a restart is
//! bit-identical.

use nalgebra::Vector3;

use crate::linear_fem::{Attachment, Handle, LinearFem, LinearFemError};

/// The held constraints, in list order.
#[derive(Default)]
pub(crate) struct HeldConstraints {
    held: Vec<(Attachment, Vec<Handle>)>,
    /// How many of them were kept from an earlier tick.
    kept: usize,
}

impl HeldConstraints {
    /// Keeps the common prefix with a new list, and releases the rest.
    pub fn keep<'a>(
        &mut self,
        solver: &mut LinearFem,
        wanted: impl Iterator<Item = &'a Attachment>,
    ) -> Result<(), LinearFemError> {
        let is_same = |((known, _), wanted): &(&(Attachment, Vec<Handle>), &Attachment)| {
            known == *wanted && !known.hold.is_one_sided()
        };
        self.kept = self.held.iter().zip(wanted).take_while(is_same).count();
        // Last first: the kept rows are not touched.
        for (_, handles) in self.held.drain(self.kept..).rev() {
            handles.into_iter().rev().try_for_each(|handle| solver.release(handle))?;
        }
        Ok(())
    }

    /// Holds the next entry of the list at a target \[m\], unless it is held already.
    pub fn hold(
        &mut self,
        solver: &mut LinearFem,
        place: usize,
        attachment: &Attachment,
        target: Vector3<f64>,
    ) -> Result<(), LinearFemError> {
        if place < self.held.len() {
            return self.set_target(solver, place, target);
        }
        let handles = solver.hold_at(attachment, target)?;
        self.held.push((attachment.clone(), handles));
        Ok(())
    }

    /// Moves a held constraint.
    pub fn set_target(
        &self,
        solver: &mut LinearFem,
        place: usize,
        target: Vector3<f64>,
    ) -> Result<(), LinearFemError> {
        let handles = self.held.get(place).map_or(&[][..], |(_, handles)| handles);
        handles.iter().try_for_each(|&handle| solver.set_target(handle, target))
    }

    /// Solves, and returns the force of each entry of the list \[N\]; none for what other constraints hold already.
    pub fn forces(
        &self,
        solver: &mut LinearFem,
        forces: &mut Vec<Vector3<f64>>,
    ) -> Result<(), LinearFemError> {
        let mut reactions = solver.solve(&[])?.reactions.iter();
        forces.clear();
        forces.extend(self.held.iter().map(|(_, handles)| {
            reactions.by_ref().take(handles.len()).map(|reaction| reaction.force).sum::<Vector3<f64>>()
        }));
        Ok(())
    }

    /// Whether an entry of the list is held.
    pub fn holds(&self, place: usize) -> bool {
        self.held.get(place).is_some_and(|(_, handles)| !handles.is_empty())
    }

    /// How many were kept since the last tick.
    pub fn kept(&self) -> usize {
        self.kept
    }
}
