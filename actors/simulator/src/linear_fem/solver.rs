//! Run-time solver: constraints are added and removed, and every cycle computes their reaction forces.

use std::sync::Arc;

use nalgebra::Vector3;
use trocar_dynamics::elasticity::Elastic;
use trocar_dynamics::tet_mesh::TetMesh;

use super::active_set::{ActiveSet, Packed};
use super::attachment::{Attachment, Handle, check_weights};
use super::bounds::ROWS_MAX;
use super::compliance::{Boundary, Compliance, Limits, factor};
use super::error::LinearFemError;
use super::low_rank_update::{CorrectedForce, Correction};
use crate::linear_algebra::SupernodalCholesky;
use crate::stiffness::Bonds;

/// A force distributed over free surface nodes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Load<'a> {
    /// Nodes and weights, which add up to 1; see [`patch`](super::patch()).
    pub weights: &'a [(u32, f64)],
    /// The force \[N\].
    pub force: Vector3<f64>,
}

/// The reaction force of a constraint.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reaction {
    /// The constraint.
    pub handle: Handle,
    /// The force on the body \[N\]; a hand feels its opposite.
    pub force: Vector3<f64>,
}

/// Result of one cycle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Solution<'a> {
    /// One per constraint, in the order in which they were added.
    pub reactions: &'a [Reaction],
    /// Active-set iterations for the one-sided constraints; 1 where there are none.
    pub rounds: usize,
}

/// A constraint.
#[derive(Clone, Debug, PartialEq)]
pub struct HeldAttachment {
    /// Its handle.
    pub handle: Handle,
    /// The attachment.
    pub attachment: Attachment,
    /// Target: the displacement of the mean from rest \[m\].
    pub target: Vector3<f64>,
}

/// One constrained direction.
#[derive(Clone, Debug)]
pub(super) struct Row {
    pub(super) held: usize,
    pub(super) direction: Vector3<f64>,
    pub(super) one_sided: bool,
    /// Displacements of the free surface nodes per force along it \[m/N\], without the correction `through`.
    pub(super) compliance: Vec<f32>,
    /// Correction for changes of the body.
    pub(super) through: Option<CorrectedForce>,
    /// Displacement by the dead load along it \[m\].
    dead: f64,
}

/// State to restore when a cycle fails.
#[derive(Default)]
struct SolverBackup {
    multipliers: Vec<f64>,
    rows: Vec<u32>,
    factor: Vec<f64>,
}

/// A linear elastic body with contact on its surface.
pub struct LinearFem {
    pub(super) mesh: TetMesh,
    pub(super) boundary: Boundary,
    pub(super) material: Elastic,
    pub(super) factor: SupernodalCholesky,
    pub(super) compliance: Arc<Compliance>,
    pub(super) correction: Correction,
    /// Free surface nodes: those of the compliance, and their copies.
    pub(super) touched: Vec<u32>,
    pub(super) held: Vec<HeldAttachment>,
    pub(super) next: u64,
    pub(super) rows: Vec<Row>,
    pub(super) w: Packed,
    pub(super) active: ActiveSet,
    pub(super) multipliers: Vec<f64>,
    pub(super) dead_load: Vec<Vector3<f64>>,
    /// Displacements of all free nodes by the dead load.
    pub(super) dead: Vec<f64>,
    /// The correction's unknowns for the dead load.
    pub(super) dead_unknowns: Vec<f64>,
    reactions: Vec<Reaction>,
    /// Loads by surface node.
    pub(super) loads: Vec<(u32, Vector3<f64>)>,
    loads_before: Vec<(u32, Vector3<f64>)>,
    before: SolverBackup,
    right: Vec<f64>,
    trial: Vec<f64>,
    skipped: Vec<bool>,
    pub(super) single: Vec<f32>,
    spare: Vec<Vec<f32>>,
}

impl LinearFem {
    /// Precomputes the compliance and begins at rest.
    ///
    /// # Errors
    /// As [`Compliance::precompute`].
    pub fn new(
        mesh: TetMesh,
        material: &Elastic,
        fixed: &[u32],
        limits: &Limits,
        progress: &mut dyn FnMut(f64) -> bool,
    ) -> Result<Self, LinearFemError> {
        let boundary = Boundary::new(&mesh, fixed)?;
        let factor = factor(&mesh, material, &[], &Bonds::default(), &boundary, limits)?;
        let fingerprint = super::serialization::fingerprint(&mesh, material, fixed);
        let compliance = Compliance::from_factor(fingerprint, &boundary, &factor, progress)?;
        Ok(Self::assembled(mesh, *material, boundary, factor, compliance))
    }

    /// Begins at rest with a precomputed compliance.
    ///
    /// # Errors
    /// A compliance of another body; otherwise as [`Compliance::precompute`].
    pub fn with_compliance(
        mesh: TetMesh,
        material: &Elastic,
        fixed: &[u32],
        limits: &Limits,
        compliance: Compliance,
    ) -> Result<Self, LinearFemError> {
        if compliance.fingerprint != super::serialization::fingerprint(&mesh, material, fixed) {
            return Err(LinearFemError::OtherCompliance);
        }
        let boundary = Boundary::new(&mesh, fixed)?;
        let factor = factor(&mesh, material, &[], &Bonds::default(), &boundary, limits)?;
        Ok(Self::assembled(mesh, *material, boundary, factor, compliance))
    }

    pub(super) fn assembled(
        mesh: TetMesh,
        material: Elastic,
        boundary: Boundary,
        factor: SupernodalCholesky,
        compliance: Compliance,
    ) -> Self {
        let (rows, free) = (3 * boundary.surface.len(), 3 * boundary.free());
        let correction = Correction::of(mesh.rest().len());
        let touched = boundary.surface.clone();
        Self {
            mesh,
            boundary,
            material,
            factor,
            compliance: Arc::new(compliance),
            correction,
            touched,
            held: Vec::new(),
            next: 0,
            rows: Vec::new(),
            w: Packed::default(),
            active: ActiveSet::default(),
            multipliers: Vec::new(),
            dead_load: Vec::new(),
            dead: vec![0.0; free],
            dead_unknowns: Vec::new(),
            reactions: Vec::new(),
            loads: Vec::new(),
            loads_before: Vec::new(),
            before: SolverBackup::default(),
            right: Vec::new(),
            trial: Vec::new(),
            skipped: Vec::new(),
            single: vec![0.0; rows],
            spare: Vec::new(),
        }
    }

    /// Its mesh.
    #[must_use]
    pub fn mesh(&self) -> &TetMesh {
        &self.mesh
    }

    /// The precomputed inverse, to be saved.
    #[must_use]
    pub fn compliance(&self) -> &Compliance {
        &self.compliance
    }

    /// The same, to be shared with another solver.
    #[must_use]
    pub fn shared_compliance(&self) -> Arc<Compliance> {
        self.compliance.clone()
    }

    /// Constraints, in the order in which they were added.
    #[must_use]
    pub fn held(&self) -> &[HeldAttachment] {
        &self.held
    }

    /// Sets constant forces on all nodes \[N\], such as weight; an empty slice for none. A sparse solve, too slow for
    /// every cycle.
    ///
    /// # Errors
    /// A number of forces other than that of nodes, a non-finite force.
    pub fn set_dead_load(&mut self, forces: &[Vector3<f64>]) -> Result<(), LinearFemError> {
        let nodes = self.mesh.rest().len();
        if !forces.is_empty() && forces.len() != nodes {
            return Err(LinearFemError::Forces { found: forces.len(), nodes });
        }
        if !forces.iter().flatten().all(|x| x.is_finite()) {
            return Err(LinearFemError::NotFinite { what: "a dead load" });
        }
        self.dead_load = forces.to_vec();
        self.dead.fill(0.0);
        for (number, force) in self.boundary.numbers.iter().zip(forces) {
            if let Some(number) = number {
                (0..3).for_each(|axis| self.dead[3 * *number as usize + axis] += force[axis]);
            }
        }
        if !forces.is_empty() {
            self.factor.solve(&mut self.dead);
        }
        let pulls = self.correction.pulls((0..).zip(forces.iter().copied()));
        let unknowns = self.correction.correct(&mut self.dead, pulls);
        self.dead_unknowns = unknowns.as_slice().to_vec();
        for index in 0..self.rows.len() {
            let Row { held, direction, .. } = self.rows[index];
            self.rows[index].dead = self.dead_mean(&self.held[held].attachment.weights, &direction);
        }
        Ok(())
    }

    /// Mean displacement by the dead load, along a direction \[m\].
    fn dead_mean(&self, weights: &[(u32, f64)], direction: &Vector3<f64>) -> f64 {
        let own = |&(node, weight): &(u32, f64)| {
            weight * self.correction.own(node, &self.dead_unknowns).dot(direction)
        };
        mean(&self.boundary, &self.dead, weights, direction) + weights.iter().map(own).sum::<f64>()
    }

    /// Adds a constraint, with the rest position as target; move it with [`Self::set_target`]. With surface nodes only,
    /// it costs a few rows of the compliance; with interior nodes, a sparse solve.
    ///
    /// # Errors
    /// Invalid weights, too many constraints, or a redundant one.
    pub fn hold(&mut self, attachment: Attachment) -> Result<Handle, LinearFemError> {
        let handle = Handle(self.next);
        let first = self.rows.len();
        self.enter(HeldAttachment { handle, attachment, target: Vector3::zeros() })?;
        for row in first..self.rows.len() {
            if !self.rows[row].one_sided && !self.active.append(row, &self.w) {
                let node = self.held[self.held.len() - 1].attachment.weights[0].0;
                self.leave(self.held.len() - 1);
                return Err(LinearFemError::Dependent { node });
            }
        }
        self.next += 1;
        Ok(handle)
    }

    /// Removes a constraint.
    ///
    /// # Errors
    /// An unknown handle.
    pub fn release(&mut self, handle: Handle) -> Result<(), LinearFemError> {
        let index = self.index(handle)?;
        self.leave(index);
        Ok(())
    }

    /// Moves a constraint: the target displacement of its mean from rest \[m\]; a constraint along a direction uses the
    /// component along it.
    ///
    /// # Errors
    /// An unknown handle, a non-finite number.
    pub fn set_target(&mut self, handle: Handle, target: Vector3<f64>) -> Result<(), LinearFemError> {
        let index = self.index(handle)?;
        if !target.iter().all(|x| x.is_finite()) {
            return Err(LinearFemError::NotFinite { what: "the target of a constraint" });
        }
        self.held[index].target = target;
        Ok(())
    }

    fn index(&self, handle: Handle) -> Result<usize, LinearFemError> {
        self.held
            .binary_search_by_key(&handle, |held| held.handle)
            .map_err(|_| LinearFemError::NoHandle(handle))
    }

    /// Adds the rows of a constraint to W, inactive at first.
    pub(super) fn enter(&mut self, held: HeldAttachment) -> Result<(), LinearFemError> {
        held.attachment.check(self.mesh.rest().len())?;
        let (directions, count) = held.attachment.hold.directions();
        if self.rows.len() + count > ROWS_MAX {
            return Err(LinearFemError::Full);
        }
        if !held.attachment.hold.is_finite() {
            return Err(LinearFemError::NotFinite { what: "the compliance of a constraint" });
        }
        if !directions.iter().flatten().all(|x| x.is_finite()) {
            return Err(LinearFemError::NotFinite { what: "the direction of a constraint" });
        }
        let weights = &held.attachment.weights;
        let one_sided = held.attachment.hold.is_one_sided();
        let inner = weights.iter().any(|&(node, _)| {
            self.boundary.numbers[node as usize].is_some() && self.boundary.surface_row(node).is_none()
        });
        let own = self.held.len();
        for direction in &directions[..count] {
            let mut compliance = self.spare.pop().unwrap_or_else(|| vec![0.0; self.single.len()]);
            compliance.fill(0.0);
            let full = if inner {
                let mut full = vec![0.0; 3 * self.boundary.free()];
                spread(&self.boundary, &mut full, weights, direction);
                self.factor.solve(&mut full);
                for (to, row) in compliance.chunks_exact_mut(3).zip(self.boundary.rows_of_surface()) {
                    (0..3).for_each(|axis| to[axis] = full[3 * row + axis] as f32);
                }
                Some(full)
            } else {
                for &(node, weight) in weights {
                    let Some(index) = self.boundary.surface_row(node) else { continue };
                    for axis in 0..3 {
                        add(
                            &mut compliance,
                            self.compliance.row(index, axis),
                            (weight * direction[axis]) as f32,
                        );
                    }
                }
                None
            };
            let forces = weights.iter().map(|&(node, weight)| (node, direction * weight));
            let through = self.correction.through(&self.boundary, forces);
            let dead = self.dead_mean(weights, direction);
            self.rows.push(Row { held: own, direction: *direction, one_sided, compliance, through, dead });
            // Couplings with every row, itself last: from the new row's displacements if it is interior, as these are
            // known everywhere; else from the other row's displacements on the surface, where the new row acts.
            let new = &self.rows[self.rows.len() - 1];
            for row in &self.rows {
                let entry = match &full {
                    Some(full) => {
                        let other =
                            if row.held == own { weights } else { &self.held[row.held].attachment.weights };
                        mean(&self.boundary, full, other, &row.direction)
                    }
                    None => surface_mean(&self.boundary, &row.compliance, weights, &new.direction),
                };
                let corrected = between(new.through.as_ref(), row.through.as_ref());
                let hold = &held.attachment.hold;
                let by_body = match self.held.get(row.held) {
                    Some(other) => hold.coupling(&other.attachment.hold, false),
                    None => hold.coupling(hold, true),
                };
                self.w.values.push(entry + corrected + by_body);
            }
            self.w.size += 1;
            self.multipliers.push(0.0);
        }
        self.held.push(held);
        Ok(())
    }

    /// Removes a constraint and its rows.
    pub(super) fn leave(&mut self, index: usize) {
        while let Some(row) = self.rows.iter().rposition(|row| row.held == index) {
            if let Some(place) = self.active.rows.iter().position(|&active| active as usize == row) {
                self.active.delete(place);
            }
            self.active
                .rows
                .iter_mut()
                .filter(|active| **active as usize > row)
                .for_each(|active| *active -= 1);
            self.spare.push(self.rows.remove(row).compliance);
            self.w.remove(row);
            self.multipliers.remove(row);
        }
        self.rows.iter_mut().filter(|row| row.held > index).for_each(|row| row.held -= 1);
        self.held.remove(index);
    }

    /// One cycle: the forces that hold every constraint at its target under these loads, which replace those of the
    /// previous cycle.
    ///
    /// # Errors
    /// An invalid load; nothing has changed then.
    pub fn solve(&mut self, loads: &[Load]) -> Result<Solution<'_>, LinearFemError> {
        for load in loads {
            check_weights(load.weights, self.mesh.rest().len())?;
            if !load.force.iter().all(|x| x.is_finite()) {
                return Err(LinearFemError::NotFinite { what: "a load" });
            }
            if let Some(&(node, _)) =
                load.weights.iter().find(|(n, _)| self.boundary.surface_row(*n).is_none())
            {
                return Err(LinearFemError::NotOnSurface { node });
            }
        }
        std::mem::swap(&mut self.loads, &mut self.loads_before);
        self.loads.clear();
        for load in loads {
            for &(node, weight) in load.weights {
                self.loads.push((node, load.force * weight));
            }
        }
        let through = self.correction.through(&self.boundary, self.loads.iter().copied());
        self.right.clear();
        for row in &self.rows {
            let target = self.held[row.held].target.dot(&row.direction);
            let by = |(node, force): &(u32, Vector3<f64>)| {
                Some(at(&row.compliance, self.boundary.surface_row(*node)?).dot(force))
            };
            let loaded: f64 = self.loads.iter().filter_map(by).sum();
            let loaded = loaded + between(through.as_ref(), row.through.as_ref());
            self.right.push(target - row.dead - loaded);
        }
        self.before.multipliers.clone_from(&self.multipliers);
        self.before.rows.clone_from(&self.active.rows);
        self.before.factor.clone_from(&self.active.factor.values);
        let rounds = match self.settle() {
            Ok(rounds) => rounds,
            Err(error) => {
                std::mem::swap(&mut self.loads, &mut self.loads_before);
                self.multipliers.clone_from(&self.before.multipliers);
                self.active.rows.clone_from(&self.before.rows);
                self.active.factor.values.clone_from(&self.before.factor);
                self.active.factor.size = self.before.rows.len();
                return Err(error);
            }
        };
        self.reactions.clear();
        self.reactions
            .extend(self.held.iter().map(|held| Reaction { handle: held.handle, force: Vector3::zeros() }));
        for (row, multiplier) in self.rows.iter().zip(&self.multipliers) {
            self.reactions[row.held].force += row.direction * *multiplier;
        }
        Ok(Solution { reactions: &self.reactions, rounds })
    }

    /// Solves for the forces and the active one-sided rows: the active-set method for non-negative least squares
    /// (Lawson, Hanson 1974) on W, warm-started from the last cycle.
    fn settle(&mut self) -> Result<usize, LinearFemError> {
        let rounds_max = 16 + 8 * self.rows.len();
        self.skipped.clear();
        self.skipped.resize(self.rows.len(), false);
        let mut rounds = 0;
        loop {
            rounds += 1;
            if rounds > rounds_max {
                return Err(LinearFemError::NotSettled(rounds_max));
            }
            self.trial.clear();
            self.trial.extend(self.active.rows.iter().map(|&row| self.right[row as usize]));
            self.active.solve(&mut self.trial);
            // Step towards the solution, limited where a one-sided row would become tensile.
            let mut share = 1.0;
            let mut blocking = None;
            for (place, (&row, &value)) in self.active.rows.iter().zip(&self.trial).enumerate() {
                let now = self.multipliers[row as usize];
                if self.rows[row as usize].one_sided && value < 0.0 {
                    let until = now / (now - value);
                    if blocking.is_none() || until < share {
                        (share, blocking) = (until, Some(place));
                    }
                }
            }
            for (&row, &value) in self.active.rows.iter().zip(&self.trial) {
                let now = &mut self.multipliers[row as usize];
                *now = if blocking.is_none() { value } else { *now + share * (value - *now) };
            }
            if let Some(place) = blocking {
                self.multipliers[self.active.rows[place] as usize] = 0.0;
                self.active.delete(place);
                continue;
            }
            let Some(row) = self.most_violated() else { return Ok(rounds) };
            if !self.active.append(row, &self.w) {
                self.skipped[row] = true;
            }
        }
    }

    /// The inactive one-sided row furthest below its target, if any.
    fn most_violated(&self) -> Option<usize> {
        let mut deepest = None;
        // Tolerance: a billionth of the largest target displacement, far below anything perceptible.
        let mut least = 1e-9 * self.right.iter().fold(0.0_f64, |most, b| most.max(b.abs()));
        for (row, own) in self.rows.iter().enumerate() {
            if !own.one_sided || self.skipped[row] || self.active.rows.contains(&(row as u32)) {
                continue;
            }
            let reached: f64 = self
                .active
                .rows
                .iter()
                .map(|&k| self.w.at(row, k as usize) * self.multipliers[k as usize])
                .sum();
            let depth = self.right[row] - reached;
            if depth > least {
                (least, deepest) = (depth, Some(row));
            }
        }
        deepest
    }
}

/// The correction's part of the displacement along one row by a force along the other.
fn between(one: Option<&CorrectedForce>, other: Option<&CorrectedForce>) -> f64 {
    match (one, other) {
        (Some(one), Some(other)) => one.parts.dot(&other.shares),
        _ => 0.0,
    }
}

/// to += factor · from.
pub(super) fn add(to: &mut [f32], from: &[f32], factor: f32) {
    if factor != 0.0 {
        to.iter_mut().zip(from).for_each(|(to, from)| *to += factor * from);
    }
}

/// The vector at a surface node.
fn at(values: &[f32], index: usize) -> Vector3<f64> {
    Vector3::from_fn(|axis, _| f64::from(values[3 * index + axis]))
}

/// The weighted mean over free surface nodes, along a direction.
fn surface_mean(
    boundary: &Boundary,
    values: &[f32],
    weights: &[(u32, f64)],
    direction: &Vector3<f64>,
) -> f64 {
    let parts = weights
        .iter()
        .filter_map(|&(node, weight)| Some(weight * at(values, boundary.surface_row(node)?).dot(direction)));
    parts.sum()
}

/// The weighted mean over free nodes, along a direction.
fn mean(boundary: &Boundary, values: &[f64], weights: &[(u32, f64)], direction: &Vector3<f64>) -> f64 {
    let parts = weights.iter().filter_map(|&(node, weight)| {
        let own = &values[3 * boundary.numbers[node as usize]? as usize..][..3];
        Some(weight * Vector3::from_column_slice(own).dot(direction))
    });
    parts.sum()
}

/// Adds a force, distributed over free nodes.
pub(super) fn spread(boundary: &Boundary, values: &mut [f64], weights: &[(u32, f64)], force: &Vector3<f64>) {
    for &(node, weight) in weights {
        if let Some(number) = boundary.numbers[node as usize] {
            (0..3).for_each(|axis| values[3 * number as usize + axis] += weight * force[axis]);
        }
    }
}
