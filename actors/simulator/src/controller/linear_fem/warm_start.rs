//! What an inverse holds from tick to tick.
//!
//! Of a tick's list everything up to the first difference to the last one stays held, with its part of the factor of W, as long
//! as it is held in both directions: pins of the inside, whose rows take sparse solves, and what jaws hold. The rest is let go
//! and comes anew by updates of rank one. What only pushes is never kept: in which order rods came to act would be in the
//! factor, and in its rounding, so that another life would not find the same numbers. As it is, it finds the same to the bit.

use nalgebra::Vector3;

use crate::linear_fem::{Attachment, Handle, Hold, LinearFem, LinearFemError};

/// What is held, in the order of a list.
#[derive(Default)]
pub(crate) struct Holding {
    held: Vec<(Attachment, Vec<Handle>)>,
    /// How many of them have been kept from an earlier tick.
    kept: usize,
}

impl Holding {
    /// Keeps as much as is the same in a new list, and lets go of the rest.
    pub fn keep<'a>(
        &mut self,
        solver: &mut LinearFem,
        wanted: impl Iterator<Item = &'a Attachment>,
    ) -> Result<(), LinearFemError> {
        let is_same = |((known, _), wanted): &(&(Attachment, Vec<Handle>), &Attachment)| {
            known == *wanted && !matches!(known.hold, Hold::AtLeast(_))
        };
        self.kept = self.held.iter().zip(wanted).take_while(is_same).count();
        // The last first: nothing of what stays is touched.
        for (_, handles) in self.held.drain(self.kept..).rev() {
            handles.into_iter().rev().try_for_each(|handle| solver.release(handle))?;
        }
        Ok(())
    }

    /// Holds the next of the list at a target \[m\], if that is not held already.
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

    /// Moves what is held.
    pub fn set_target(
        &self,
        solver: &mut LinearFem,
        place: usize,
        target: Vector3<f64>,
    ) -> Result<(), LinearFemError> {
        let handles = self.held.get(place).map_or(&[][..], |(_, handles)| handles);
        handles.iter().try_for_each(|&handle| solver.set_target(handle, target))
    }

    /// Solves, and answers the force on each of the list \[N\]; none of what others hold already.
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

    /// Whether anything is held of one of the list.
    pub fn holds(&self, place: usize) -> bool {
        self.held.get(place).is_some_and(|(_, handles)| !handles.is_empty())
    }

    /// How many have been kept since the last tick.
    pub fn kept(&self) -> usize {
        self.kept
    }
}
