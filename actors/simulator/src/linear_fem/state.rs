//! State of a linear body, to restart it.

use nalgebra::Vector3;

use super::active_set::Packed;
use super::error::LinearFemError;
use super::low_rank_update::Change;
use super::solver::{HeldAttachment, LinearFem};

/// The state; everything else follows from mesh, material and boundary.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LinearFemState {
    /// Constraints, in the order in which they were added.
    pub held: Vec<HeldAttachment>,
    /// The next handle.
    pub next: u64,
    /// Active rows, in the order of the factor of W between them.
    pub active: Vec<u32>,
    /// That factor, its lower triangle by rows.
    pub factor: Vec<f64>,
    /// Multipliers: force along each row \[N\].
    pub multipliers: Vec<f64>,
    /// Constant forces on all nodes \[N\], such as weight; empty for none.
    pub dead_load: Vec<Vector3<f64>>,
    /// Original node of each copy, where nodes were split since the inverse was computed.
    pub parents: Vec<u32>,
    /// The present elements; empty where no node was split.
    pub tets: Vec<[u32; 4]>,
    /// Removed elements and split nodes, in order, grouped as they were processed.
    pub changes: Vec<Vec<Change>>,
}

impl LinearFem {
    /// The state.
    #[must_use]
    pub fn state(&self) -> LinearFemState {
        LinearFemState {
            held: self.held.clone(),
            next: self.next,
            active: self.active.rows.clone(),
            factor: self.active.factor.values.clone(),
            multipliers: self.multipliers.clone(),
            dead_load: self.dead_load.clone(),
            parents: self.correction.parents.clone(),
            tets: if self.correction.parents.is_empty() { Vec::new() } else { self.mesh.tets().to_vec() },
            changes: self.correction.changes(),
        }
    }

    /// Continues from a state, bit for bit.
    ///
    /// # Errors
    /// A state of another body; nothing has changed then.
    pub fn restore(&mut self, state: &LinearFemState) -> Result<(), LinearFemError> {
        let before = (self.state(), std::mem::take(&mut self.loads));
        let done = self.replace(state);
        if done.is_err() {
            // The former state is valid.
            let _ = self.replace(&before.0);
            self.loads = before.1;
        }
        done
    }

    /// Keeps all constraints on a body that has changed; the active set is found anew.
    pub(super) fn enter_anew(&mut self, state: &LinearFemState) -> Result<(), LinearFemError> {
        while !self.held.is_empty() {
            self.leave(self.held.len() - 1);
        }
        self.set_dead_load(&state.dead_load)?;
        for held in &state.held {
            let first = self.rows.len();
            self.enter(held.clone())?;
            for row in first..self.rows.len() {
                // Where it has become dependent, the others hold it.
                let _ = self.rows[row].one_sided || self.active.append(row, &self.w);
            }
        }
        Ok(())
    }

    fn replace(&mut self, state: &LinearFemState) -> Result<(), LinearFemError> {
        while !self.held.is_empty() {
            self.leave(self.held.len() - 1);
        }
        let is_same = state.parents == self.correction.parents
            && (state.parents.is_empty() || state.tets == self.mesh.tets());
        if !is_same || self.correction.changes() != state.changes {
            self.change_again(&state.parents, &state.tets, &state.changes)?;
        }
        self.set_dead_load(&state.dead_load)?;
        for held in &state.held {
            if self.held.last().is_some_and(|last| last.handle >= held.handle) || held.handle.0 >= state.next
            {
                return Err(LinearFemError::State("handles do not ascend"));
            }
            if !held.target.iter().all(|x| x.is_finite()) {
                return Err(LinearFemError::NotFinite { what: "the target of a constraint" });
            }
            self.enter(held.clone())?;
        }
        let (rows, size) = (self.rows.len(), state.active.len());
        let mut seen = state.active.clone();
        seen.sort_unstable();
        seen.dedup();
        if seen.len() != size || seen.last().is_some_and(|&last| last as usize >= rows) {
            return Err(LinearFemError::State("rows that act are not among those held"));
        }
        let sizes = state.factor.len() == size * (size + 1) / 2 && state.multipliers.len() == rows;
        if !sizes || !state.factor.iter().chain(&state.multipliers).all(|x| x.is_finite()) {
            return Err(LinearFemError::State("its numbers are too few, too many or not finite"));
        }
        if (0..size).any(|row| !(state.factor[row * (row + 3) / 2] > 0.0)) {
            return Err(LinearFemError::State("its factor has a pivot that is not positive"));
        }
        self.active.rows.clone_from(&state.active);
        self.active.factor = Packed { values: state.factor.clone(), size };
        self.multipliers.clone_from(&state.multipliers);
        self.next = state.next;
        Ok(())
    }
}
