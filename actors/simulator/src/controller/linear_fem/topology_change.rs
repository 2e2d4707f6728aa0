//! Topology changes of a linear organ (burns, cuts, tears): elements are removed from its inverse, and nodes separated,
//! by an exact low-rank correction, at once, while a background job computes the inverse of the changed body. Shrinkage
//! applies at once, too; the stiffness of coagulated elements comes with the new inverse, and is blended in
//! ([`InverseBlend`]).

use std::collections::BTreeSet;

use nalgebra::{Point3, Vector3};
use trocar_dynamics::elasticity::Alteration;
use trocar_dynamics::soft_body::Deformable;
use trocar_dynamics::soft_body::method::StepContext;
use trocar_dynamics::tet_mesh::{NodeOrigin, TetMesh};
use trocar_scene::{Commands, Tick};

use super::blend::{InverseBlend, catch_up};
use super::contacts::Contacts;
use super::inverse_job::{MeshChange, altered_as_job, built};
use super::{Body, MOBILITY};
use crate::controller::cutting::volume::{Elements, Split};
use crate::controller::thermal_damage::{CoagulatedElement, ThermalDamage};
use crate::linear_fem::{Attachment, LinearFem, LinearFemError};

/// Maximum number of factor entries read per tick for corrections: some 40 ms; at least one element or node is
/// processed.
const READ_MAX: f64 = 3e8;
/// Maximum number of elements removed from an inverse per tick; the others wait. Each costs forward and backward solves
/// with six columns.
const TAKEN_MAX: usize = 8;
/// Maximum number of nodes separated in an inverse per tick, three columns each.
const RELEASED_MAX: usize = 16;

/// How many corrections, each reading the factor this often, fit into a tick, up to `most`.
fn fitting(solver: &LinearFem, reads: f64, most: usize) -> usize {
    let fit = READ_MAX / (reads * solver.factor_entries().max(1) as f64);
    (fit as usize).clamp(1, most)
}

/// Changes of the elements, and the state of the inverse's corrections.
pub(crate) struct MeshChanges {
    /// Of all elements, from the scene.
    alterations: Vec<Alteration>,
    /// Which node each added node duplicates.
    parents: Vec<u32>,
    /// Removed elements that are still in the inverse.
    pending: Vec<u32>,
    /// Elements removed since the job began.
    since: Vec<u32>,
    /// Whether anything has changed since the last job began.
    stale: bool,
    /// Whether shrinkage has changed since it was last applied to the active inverse.
    shrinks: bool,
    submitted: bool,
    /// Whether the active inverse can separate more nodes than it did in this tick.
    releasing: bool,
    /// Whether the active inverse will have caught up with the removals within a few ticks.
    behind: bool,
    /// A new inverse that waits until the last one is blended in.
    next: Option<Box<LinearFem>>,
}

impl MeshChanges {
    /// For a body with this thermal damage and these added nodes; its first inverse includes all of them.
    pub fn new(elements: usize, heated: &ThermalDamage, births: &[NodeOrigin]) -> Self {
        let mut this = Self {
            alterations: vec![Alteration::NONE; elements],
            parents: births.iter().map(|birth| birth.of[0]).collect(),
            pending: Vec::new(),
            since: Vec::new(),
            stale: false,
            shrinks: false,
            submitted: false,
            releasing: false,
            behind: false,
            next: None,
        };
        this.alter(&heated.coagulated);
        this.remove(&heated.removed);
        (this.stale, this.shrinks) = (false, false);
        (this.pending, this.since) = (Vec::new(), Vec::new());
        this
    }

    /// The changes of the body, if there are any.
    pub fn mesh_change(&self) -> Option<MeshChange> {
        let altered = self.alterations.iter().any(|of| *of != Alteration::NONE) || !self.parents.is_empty();
        altered.then(|| self.now())
    }

    fn now(&self) -> MeshChange {
        MeshChange { alterations: self.alterations.clone(), parents: self.parents.clone() }
    }

    pub fn remove(&mut self, elements: &[u32]) {
        for &element in elements {
            let known = self.alterations.get_mut(element as usize);
            if let Some(of) = known.filter(|known| **known != Alteration::GONE) {
                *of = Alteration::GONE;
                self.pending.push(element);
                self.since.push(element);
                self.stale = true;
            }
        }
    }

    pub fn alter(&mut self, elements: &[CoagulatedElement]) {
        for of in elements {
            let known = self.alterations.get_mut(of.element as usize);
            if let Some(known) = known.filter(|known| **known != Alteration::GONE) {
                *known = Alteration { stiffness: of.stiffness, length: of.length };
                (self.stale, self.shrinks) = (true, true);
            }
        }
    }

    /// Updates the inverse: installs a new one when it is ready and starts the blend; corrects the active one. Changes
    /// that cannot be corrected wait for the next inverse. Returns the input of the next job, when it is time to begin
    /// one.
    ///
    /// # Errors
    /// Why there is no new inverse.
    pub fn follow(
        &mut self,
        key: u64,
        mesh: &TetMesh,
        solver: &mut Box<LinearFem>,
        blend: &mut Option<InverseBlend>,
        tick: &Tick<'_>,
    ) -> Result<Option<MeshChange>, String> {
        if self.submitted && self.next.is_none() {
            self.next = built(tick, key)?.map(Box::new);
        }
        // An inverse that has no weight yet is replaced by a later one, which has less to catch up with.
        if blend.as_ref().is_none_or(InverseBlend::has_no_weight)
            && let Some(new) = self.next.take()
        {
            let old = std::mem::replace(solver, new);
            blend.get_or_insert_with(|| InverseBlend::new(old));
            self.submitted = false;
            self.pending.clone_from(&self.since);
            self.shrinks = self.stale;
        }
        let done = self.split_nodes(mesh, solver, blend).and_then(|()| {
            self.correct(solver, blend)?;
            if std::mem::take(&mut self.shrinks) { solver.shrink(&self.alterations) } else { Ok(()) }
        });
        done.map_err(|error| error.to_string())?;
        Ok((self.stale && !self.submitted).then(|| self.now()))
    }

    /// Whether [`Self::follow`] would change nothing in the active inverse, and begin no job.
    pub fn is_up_to_date(&self, mesh: &TetMesh, solver: &LinearFem) -> bool {
        let waits = self.stale || self.submitted || self.shrinks || self.next.is_some();
        let all = solver.mesh().rest().len() == mesh.rest().len();
        !waits && self.pending.is_empty() && all && !solver.can_release()
    }

    /// Whether an element was removed.
    pub fn is_gone(&self, tet: u32) -> bool {
        self.alterations.get(tet as usize) == Some(&Alteration::GONE)
    }

    /// Separates the nodes that are separate in the mesh.
    fn split_nodes(
        &mut self,
        mesh: &TetMesh,
        solver: &mut LinearFem,
        blend: &mut Option<InverseBlend>,
    ) -> Result<(), LinearFemError> {
        let most = fitting(solver, if blend.is_some() { 12.0 } else { 6.0 }, RELEASED_MAX);
        if let Some(blend) = blend {
            blend.split_nodes(mesh, &self.parents, most)?;
        }
        catch_up(solver, mesh, &self.parents)?;
        let released = solver.release_nodes(most)?;
        self.releasing = released > 0 && solver.can_release();
        Ok(())
    }

    /// A job has begun, or could not be submitted.
    pub fn begun(&mut self, submitted: bool) {
        self.submitted = submitted;
        if submitted {
            self.stale = false;
            self.since.clear();
        }
    }

    fn correct(
        &mut self,
        solver: &mut LinearFem,
        blend: &mut Option<InverseBlend>,
    ) -> Result<(), LinearFemError> {
        let most = fitting(solver, if blend.is_some() { 24.0 } else { 12.0 }, TAKEN_MAX);
        let (mut later, mut allowed) = (Vec::new(), most);
        let mut next = std::mem::take(&mut self.pending);
        // The first inverse may have been computed after their removal.
        next.retain(|&tet| !solver.is_out(tet));
        blend.as_mut().map_or(Ok(()), |blend| blend.remove(&next, most))?;
        while !next.is_empty() {
            let room = solver.removable().min(allowed);
            let batch: Vec<u32> = next.drain(..room.min(next.len())).collect();
            if batch.is_empty() {
                break;
            }
            allowed -= batch.len();
            match solver.remove(&batch) {
                Ok(()) => {}
                Err(LinearFemError::Apart { tet }) => {
                    let out: BTreeSet<u32> = solver.removed().iter().copied().collect();
                    next.splice(0..0, batch.into_iter().filter(|at| *at != tet && !out.contains(at)));
                    later.push(tet);
                }
                Err(error) => return Err(error),
            }
        }
        let takes = allowed == 0 && !next.is_empty() && solver.removable() > 0;
        self.behind = takes || self.releasing;
        later.extend(next);
        self.pending = later;
        Ok(())
    }

    /// Removed elements that still contribute to forces, until the next inverse.
    pub fn waiting(&self, blend: Option<&InverseBlend>) -> usize {
        self.pending.iter().filter(|tet| !blend.is_some_and(|blend| blend.hides(**tet))).count()
    }

    /// Separated nodes that still act as one, until the next inverse or for some ticks.
    pub fn nodes_waiting(&self, solver: &LinearFem, blend: Option<&InverseBlend>) -> usize {
        blend.and_then(InverseBlend::waiting).unwrap_or_else(|| solver.waiting())
    }

    /// Whether a new inverse still has to catch up with the removals during its computation.
    pub fn is_behind(&self) -> bool {
        self.behind
    }
}

/// The elements of an organ, with its node positions.
pub(crate) struct OrganElements<'a> {
    pub altered: &'a mut MeshChanges,
    pub positions: &'a mut Vec<Point3<f64>>,
    pub mesh: &'a mut TetMesh,
    /// Whether its inverse includes all changes.
    pub has_followed: bool,
}

impl Elements for OrganElements<'_> {
    fn positions(&self) -> &[Point3<f64>] {
        self.positions
    }

    fn velocities(&self) -> &[Vector3<f64>] {
        // Cuts split none of its elements.
        &[]
    }

    fn can_tear(&self) -> bool {
        self.has_followed
    }

    fn remove(&mut self, elements: &[u32]) -> Result<(), String> {
        self.altered.remove(elements);
        Ok(())
    }

    fn alter(&mut self, elements: &[CoagulatedElement]) -> Result<(), String> {
        self.altered.alter(elements);
        Ok(())
    }

    fn split(&mut self, body: &Deformable, split: &Split<'_>) -> Result<(), String> {
        let first = self.positions.len();
        let parents: Vec<u32> = split.born.iter().map(|birth| birth.of[0]).collect();
        for birth in split.born {
            self.positions.push(birth.mix(self.positions, |a, b, share| a + (b - a) * share));
        }
        *self.mesh = self.mesh.parted(first, &parents, body.tets.to_vec());
        self.altered.parents.extend(parents);
        self.altered.stale = true;
        // Shrinkage forces depend on the elements' nodes.
        self.altered.shrinks |= self.altered.alterations.iter().any(|of| of.length != 1.0);
        Ok(())
    }
}

impl Body {
    /// Applies thermal damage, cuts and tears to its elements.
    pub(super) fn alter(
        &mut self,
        key: u64,
        site: &StepContext<'_>,
        out: &mut Commands,
    ) -> Result<(), String> {
        let Some((divisible, altered)) = &mut self.divisible else { return Ok(()) };
        let blend = self.blend.as_ref();
        let waits = |solver: &LinearFem| altered.waiting(blend) + altered.nodes_waiting(solver, blend);
        let has_followed = self.solver.as_deref().is_some_and(|solver| waits(solver) == 0);
        let (positions, mesh) = (&mut self.positions, &mut self.mesh);
        let mut elements = OrganElements { altered, positions, mesh, has_followed };
        if let Some(reshaped) = divisible.reshape(&mut elements, &mut self.body, site, out)? {
            self.is_pinned = self.body.stays();
            self.mobility.clear();
            self.mobility.extend(self.is_pinned.iter().map(|pinned| if *pinned { 0.0 } else { MOBILITY }));
            self.grips.follow(&reshaped, site, &self.body.triangles, &self.positions);
            self.contacts = Contacts::default();
        }
        let Some(solver) = &mut self.solver else { return Ok(()) };
        if !altered.is_up_to_date(&self.mesh, solver) {
            // Held constraints would be re-entered with every change.
            let nothing = std::iter::empty::<&Attachment>;
            let release = |blend: &mut InverseBlend| blend.keep(nothing());
            self.holding.keep(solver, nothing()).map_err(|error| error.to_string())?;
            self.blend.as_mut().map_or(Ok(()), release).map_err(|error| error.to_string())?;
        }
        if let Some(mesh_change) = altered.follow(key, &self.mesh, solver, &mut self.blend, site.tick)? {
            let material = [self.kind.young_modulus, self.kind.poisson_ratio];
            let job =
                altered_as_job(key, &self.mesh, material, &self.body.pinned, mesh_change, &self.progress);
            altered.begun(site.tick.jobs.submit(job));
        }
        Ok(())
    }
}
