//! A linear organ that burns: elements leave its inverse by a correction of low rank, at once and exactly, while a job computes
//! the inverse of what it has become. What shrinks does so at once, too; that it is stiffer comes with the job, and is blended
//! in ([`Fading`]).

use std::collections::BTreeSet;

use nalgebra::{Point3, Vector3};
use trocar_scene::Tick;

use super::deformable::Deformable;
use super::heat::{Coagulated, Heated};
use super::linear_fem_fading::Fading;
use super::linear_fem_jobs::built;
use super::parting::{Elements, Split};
use crate::elasticity::Alteration;
use crate::linear_fem::{LinearFem, LinearFemError, REMOVED_MAX};

/// Elements that are taken out of an inverse in one tick at most; the others have to wait for the next.
const TAKEN_MAX: usize = 8;

/// What has become of the elements, and how far the inverse follows.
pub(super) struct Altered {
    /// Of all elements, as the scene has them.
    alterations: Vec<Alteration>,
    /// Gone, and not out of the inverse yet.
    pending: Vec<u32>,
    /// Went since the job began.
    since: Vec<u32>,
    /// Whether anything has changed since the last job began.
    stale: bool,
    /// Whether anything has shrunk since the inverse that serves was told.
    shrinks: bool,
    submitted: bool,
    /// Whether the inverse that serves will have caught up with what went in a tick or a few.
    behind: bool,
    /// The new inverse, which has to wait until the last one is blended in.
    next: Option<Box<LinearFem>>,
}

impl Altered {
    /// Of a body to whose elements that has happened; its first inverse has all of it.
    pub fn new(elements: usize, heated: &Heated) -> Self {
        let mut this = Self {
            alterations: vec![Alteration::NONE; elements],
            pending: Vec::new(),
            since: Vec::new(),
            stale: false,
            shrinks: false,
            submitted: false,
            behind: false,
            next: None,
        };
        this.alter(&heated.coagulated);
        this.remove(&heated.removed);
        (this.stale, this.shrinks) = (false, false);
        (this.pending, this.since) = (Vec::new(), Vec::new());
        this
    }

    /// As they are now, if they are not as at first.
    pub fn alterations(&self) -> Option<Vec<Alteration>> {
        let altered = self.alterations.iter().any(|of| *of != Alteration::NONE);
        altered.then(|| self.alterations.clone())
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

    pub fn alter(&mut self, elements: &[Coagulated]) {
        for of in elements {
            let known = self.alterations.get_mut(of.element as usize);
            if let Some(known) = known.filter(|known| **known != Alteration::GONE) {
                *known = Alteration { stiffness: of.stiffness, length: of.length };
                (self.stale, self.shrinks) = (true, true);
            }
        }
    }

    /// Lets the inverse follow: takes a new one when it has come, which lets the other fade; corrects the one that serves. What cannot be corrected for
    /// waits for the next one. Answers what that is to be computed from, where it is time to begin.
    ///
    /// # Errors
    /// Why there is no new inverse.
    pub fn follow(
        &mut self,
        key: u64,
        solver: &mut Box<LinearFem>,
        fading: &mut Option<Fading>,
        tick: &Tick<'_>,
    ) -> Result<Option<Vec<Alteration>>, String> {
        if self.submitted && self.next.is_none() {
            self.next = built(tick, key)?.map(Box::new);
        }
        if fading.is_none()
            && let Some(new) = self.next.take()
        {
            *fading = Some(Fading::new(std::mem::replace(solver, new)));
            self.submitted = false;
            self.pending.clone_from(&self.since);
            self.shrinks = self.stale;
        }
        let done = self.correct(solver, fading).and_then(|()| {
            if std::mem::take(&mut self.shrinks) { solver.shrink(&self.alterations) } else { Ok(()) }
        });
        done.map_err(|error| error.to_string())?;
        Ok((self.stale && !self.submitted).then(|| self.alterations.clone()))
    }

    /// A job has begun, or could not.
    pub fn begun(&mut self, submitted: bool) {
        self.submitted = submitted;
        if submitted {
            self.stale = false;
            self.since.clear();
        }
    }

    fn correct(&mut self, solver: &mut LinearFem, fading: &mut Option<Fading>) -> Result<(), LinearFemError> {
        let (mut later, mut allowed) = (Vec::new(), TAKEN_MAX);
        let mut next = std::mem::take(&mut self.pending);
        // The first inverse may have been computed after they went.
        next.retain(|&tet| !solver.is_out(tet));
        fading.as_mut().map_or(Ok(()), |fading| fading.remove(&next, TAKEN_MAX))?;
        while !next.is_empty() {
            let room = (REMOVED_MAX - solver.removed().len()).min(allowed);
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
        self.behind = allowed == 0 && !next.is_empty() && solver.removed().len() < REMOVED_MAX;
        later.extend(next);
        self.pending = later;
        Ok(())
    }

    /// Elements that went and are still felt, until the next inverse.
    pub fn waiting(&self, fading: Option<&Fading>) -> usize {
        self.pending.iter().filter(|tet| !fading.is_some_and(|fading| fading.hides(**tet))).count()
    }

    /// Whether a new inverse still has to catch up with what went while it was computed.
    pub fn is_behind(&self) -> bool {
        self.behind
    }
}

/// The elements of an organ with where its nodes are.
pub(super) struct AlteredAt<'a> {
    pub altered: &'a mut Altered,
    pub positions: &'a [Point3<f64>],
}

impl Elements for AlteredAt<'_> {
    fn positions(&self) -> &[Point3<f64>] {
        self.positions
    }

    fn velocities(&self) -> &[Vector3<f64>] {
        // It is not cut.
        &[]
    }

    fn remove(&mut self, elements: &[u32]) -> Result<(), String> {
        self.altered.remove(elements);
        Ok(())
    }

    fn alter(&mut self, elements: &[Coagulated]) -> Result<(), String> {
        self.altered.alter(elements);
        Ok(())
    }

    fn split(&mut self, _body: &Deformable, _split: &Split<'_>) -> Result<(), String> {
        Err("a linear organ does not come apart: 'xpbd' and 'dynamic_fem' do".into())
    }
}
