//! Contact forces for the rod linearised at an iterate.
//!
//! A contact with an obstacle touches two neighbouring nodes: once it is known to be open, sticking or sliding, it is a
//! spring within the band of the rod's matrix. These states are found by Newton's method on the force law (the active
//! sets of Alart, Curnier 1991; Hintermüller, Ito, Kunisch 2002), one factorisation along the rod per iteration for any
//! number of contacts. Contacts between strands are such springs as well, between nodes that are far apart along the
//! rod: each iteration then factorises a sparse matrix.
//!
//! Contacts with compliant bodies and ties to coupled bodies are coupled through those bodies: they are solved as one
//! dense problem with the compliance of all of them, strand contacts included, alternating with the obstacle springs.
//! Where the alternation does not converge, the touched obstacles join the dense problem. Strand contacts as springs
//! beside a dense problem were tried: they cycle where a tied strand pulls on its knot.

use super::coupled_body::{CoupledBody, TieResult};
use super::moving_obstacles::GivingKind;
use super::{Active, Failure, Island, TOLERANCE};
use crate::linear_algebra::block_banded::{Cell, LANES};
use crate::simd::dispatch::wide;
use crate::suture_thread::contact::{CONTACTS_MAX, CoulombState, ForceLaw, FrictionLimit, SOFTENING};
use crate::suture_thread::{FailureCause, ThreadReport};

/// Maximum factorisations in search of the states of contact springs.
const ROUNDS_MAX: usize = 10;
/// The same with each of [`SOFTENING`], where that search cycles.
const SOFTENED_ROUNDS_MAX: usize = 8;
/// Both limits when strand contacts are among the springs.
const KNOTTED_ROUNDS_MAX: (usize, usize) = (24, 20);
/// Maximum factorisations in a solution with limits of friction from the solution before.
const CONVEX_ROUNDS_MAX: usize = 24;
/// The same in all of these solutions together.
const FORMER_FRICTION_ROUNDS_MAX: usize = 6 * CONVEX_ROUNDS_MAX;
/// Maximum alternations between contact springs and the dense problem.
const TURNS_MAX: usize = 5;
/// Force tolerance \[N\]: `TOLERANCE` times the stiffness of a thread with a compliance of a metre per newton, as 2-0
/// silk in steps of a millisecond.
const FORCE_TOLERANCE: f64 = 1e-9;
/// Ties with a larger error require shorter steps \[m\].
const TIE_ERROR_MAX: f64 = 1e-7;
/// A strand pair further apart than this, after motion by the warm-started forces, is no contact \[m\].
const NEAR: f64 = 3e-5;

/// When the states of the contact springs were found.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Found {
    /// The initial ones were right.
    AtOnce,
    Later,
    Not,
}

impl Island {
    /// Solves the linearised island: leaves the change of the iterate in `moved` and the forces in the contacts.
    pub(super) fn answer(
        &mut self,
        companion: &mut impl CoupledBody,
        report: &mut ThreadReport,
    ) -> Result<(), Failure> {
        // With the warm-started forces the rod moves nearly as in the solution; pairs that stay apart are dropped.
        self.with_obstacles = self.sprung.len();
        self.number_giving();
        self.factorise(1.0)?;
        let found = self.search(report)?;
        // With pairs of strands only, this solution is for nothing but to choose among them.
        let chooses = !self.dense.is_empty() && self.dense.iter().all(Active::is_of_strands);
        if !chooses {
            self.fall_back(found, report)?;
        }
        let moved = &self.moved;
        self.dense.retain(|contact| {
            contact.tie.is_some()
                || contact.force[0] > 0.0
                || contact.offset[0] + contact.rows.apart(moved)[0] < NEAR
        });
        let mut contacts = self.dense.iter().filter(|contact| contact.tie.is_none());
        if let Some(beyond) = contacts.nth(CONTACTS_MAX) {
            return Err(Failure { node: beyond.key.edge as usize, why: FailureCause::TooManyContacts });
        }
        // Beside ties and compliant bodies, strand contacts belong to the dense problem.
        if self.dense.iter().all(Active::is_of_strands) {
            self.sprung.append(&mut self.dense);
        }
        if self.is_knotted() {
            self.limit_by_friction();
            self.factorise(1.0)?;
            self.settle(report)?;
        } else if chooses {
            self.fall_back(found, report)?;
        }
        self.dense.sort_unstable_by_key(|contact| (contact.rows.first(), contact.key));
        self.join(companion)?;
        if !self.alternate(report)? && self.promote_obstacle_contacts() {
            self.limit_by_friction();
            self.factorise(1.0)?;
            self.settle(report)?;
            self.join(companion)?;
            self.alternate(report)?;
        }
        self.take_ties()?;
        for contact in self.dense.iter_mut().chain(&mut self.sprung) {
            // Elastic displacement by the contact compliance, sticking or sliding.
            contact.drawn = [-contact.compliance * contact.force[1], -contact.compliance * contact.force[2]];
        }
        Ok(())
    }

    /// Alternates between the dense problem and the contact springs. Returns whether the two agree.
    fn alternate(&mut self, report: &mut ThreadReport) -> Result<bool, Failure> {
        for _ in 0..TURNS_MAX {
            if self.dense.is_empty() {
                return Ok(true);
            }
            self.pose();
            report.sweeps += self.problem.solve(self.sweeps_max.max(1), TOLERANCE);
            for (place, contact) in self.dense.iter_mut().enumerate() {
                contact.force.copy_from_slice(&self.problem.force[3 * place..][..3]);
            }
            if self.settle(report)? {
                return Ok(true);
            }
            self.measure();
            if self.problem.error() <= TOLERANCE {
                return Ok(true);
            }
        }
        Ok(false)
    }

    /// Moves obstacle contacts that are active or nearly so into the dense problem: where a tie is next to one of them,
    /// the alternation cycles. Returns whether there were any.
    fn promote_obstacle_contacts(&mut self) -> bool {
        let before = self.dense.len();
        // The dense problem knows no bodies that move freely; of a led instrument it has all contacts or none.
        let goes = |contact: &Active| match self.giving_kind(contact.key.with) {
            Some(GivingKind::Free) => false,
            Some(GivingKind::Led) => true,
            None => {
                let apart = contact.offset[0] + contact.rows.apart(&self.moved)[0];
                contact.force[0] > 0.0 || contact.next != CoulombState::Open || apart < NEAR
            }
        };
        let goes: Vec<bool> = self.sprung.iter().map(goes).collect();
        let mut goes = goes.into_iter();
        let Self { sprung, dense, .. } = self;
        dense.extend(sprung.extract_if(.., |_| goes.next() == Some(true)));
        self.with_obstacles = self.sprung.len();
        self.number_giving();
        self.dense.sort_unstable_by_key(|contact| (contact.rows.first(), contact.key));
        self.dense.len() > before
    }

    /// Whether strand contacts are in the rod's matrix.
    pub(super) fn is_knotted(&self) -> bool {
        self.sprung.len() > self.with_obstacles
    }

    /// Factorises the rod's matrix with the contact springs, their compliance multiplied by `softness`.
    fn factorise(&mut self, softness: f64) -> Result<(), Failure> {
        self.added.clear(self.right.len());
        for contact in &mut self.sprung {
            contact.coulomb = contact.next;
        }
        let (obstacles, strands) = self.sprung.split_at(self.with_obstacles);
        for contact in obstacles {
            let yields = softness * contact.compliance;
            contact.coulomb.add(&contact.rows, contact.limit, yields, &mut self.added);
        }
        let added = (!obstacles.is_empty()).then_some(&self.added);
        let found = if strands.is_empty() && !self.trial.is_closed() {
            self.factors.find(&self.matrix, added)
        } else {
            let couples = strands.iter().map(|contact| [contact.key.edge, contact.key.feature]);
            self.sparse.analyse(self.right.len(), self.trial.is_closed(), couples);
            self.sparse.begin(&self.matrix, added);
            for (number, contact) in strands.iter().enumerate() {
                if contact.coulomb != CoulombState::Open {
                    let yields = softness * contact.compliance;
                    let (blocks, slanted) = contact.coulomb.blocks(&contact.rows, contact.limit, yields);
                    self.sparse.add_couple(number, &blocks, slanted);
                }
            }
            self.sparse.factorise()
        };
        found.map_err(|node| Failure {
            node,
            why: if self.at.positions[node].iter().all(|x| x.is_finite()) {
                FailureCause::NotPositive
            } else {
                FailureCause::NotFinite
            },
        })?;
        self.eliminate_obstacles(softness)
    }

    /// Moves the rod with the current factors: with the forces of the dense problem, and of springs with their
    /// compliance multiplied by `softness`.
    fn carry(&mut self, softness: f64) {
        self.moved.clone_from(&self.right);
        for contact in &self.dense {
            contact.rows.push(&contact.force, &mut self.moved);
        }
        for contact in &self.sprung {
            let yields = softness * contact.compliance;
            let force = contact.coulomb.linear(contact.offset, contact.limit, yields);
            contact.rows.push(&force, &mut self.moved);
        }
        let mut moved = std::mem::take(&mut self.moved);
        self.solve_rod(&mut moved);
        let change = self.let_obstacles_give_way(&mut moved, None, softness);
        self.give_way_by(&change, false);
        self.moved = moved;
    }

    /// Solves for the states of the contact springs with the forces of the dense problem fixed, starting with the
    /// current factors. Returns whether the initial states were right. Without convergence, the best result is kept.
    fn settle(&mut self, report: &mut ThreadReport) -> Result<bool, Failure> {
        let found = self.search(report)?;
        self.fall_back(found, report)?;
        Ok(found == Found::AtOnce)
    }

    /// The same, by Newton's method on Coulomb's law.
    fn search(&mut self, report: &mut ThreadReport) -> Result<Found, Failure> {
        let knotted = self.is_knotted();
        let (rounds, softened) = if knotted { KNOTTED_ROUNDS_MAX } else { (ROUNDS_MAX, SOFTENED_ROUNDS_MAX) };
        let mut first = true;
        let mut left = if knotted { self.sweeps_max } else { usize::MAX };
        self.nearest.error = f64::INFINITY;
        let plain = std::iter::once((1.0, rounds));
        for (softness, most) in plain.chain(SOFTENING.map(|softness| (softness, softened))) {
            for _ in 0..most {
                if left == 0 {
                    break;
                }
                if !first {
                    report.sweeps += 1;
                    left -= 1;
                    self.limit_by_friction();
                    self.factorise(softness)?;
                }
                self.carry(softness);
                let error = self.error(softness);
                if error <= TOLERANCE && softness == 1.0 {
                    return Ok(if first { Found::AtOnce } else { Found::Later });
                }
                first = false;
                if error <= TOLERANCE {
                    break;
                }
                if knotted && softness == 1.0 && error < self.nearest.error {
                    self.take_nearest(error);
                }
            }
        }
        Ok(Found::Not)
    }

    /// Where that search has not converged: a solution by other means, or the best one so far.
    fn fall_back(&mut self, found: Found, report: &mut ThreadReport) -> Result<(), Failure> {
        if found != Found::Not {
            return Ok(());
        }
        // Between strands the search ends next to a solution; limits of former friction converge around drums, not in knots.
        // A body that moves freely would get another impulse than the thread.
        let is_near = self.is_knotted() && self.nearest.error.is_finite() && !self.has_free_giving();
        if self.has_giving() && !is_near {
            return self.settle_with_former_friction(report);
        }
        self.return_to_nearest();
        Ok(())
    }

    /// Limits each friction to that of the normal force found before, from a solution without friction on. Each such
    /// problem is that of a convex potential; a belt around a drum converges as the series of the exponential function
    /// does.
    fn settle_with_former_friction(&mut self, report: &mut ThreadReport) -> Result<(), Failure> {
        // Until one of these problems is solved, the end of the search.
        self.take_nearest(f64::MAX);
        self.sprung.iter_mut().for_each(|contact| {
            contact.limit = FrictionLimit::Force(0.0);
            contact.next =
                CoulombState::begin([contact.force[0], 0.0, 0.0], contact.offset, 0.0, contact.compliance);
        });
        let mut left = FORMER_FRICTION_ROUNDS_MAX;
        let mut settled = true;
        while left >= CONVEX_ROUNDS_MAX {
            settled = false;
            for _ in 0..CONVEX_ROUNDS_MAX {
                report.sweeps += 1;
                left -= 1;
                self.factorise(1.0)?;
                self.carry(1.0);
                if self.error(1.0) <= TOLERANCE {
                    settled = true;
                    break;
                }
            }
            if !settled {
                break;
            }
            let mut change = 0.0_f64;
            for contact in &mut self.sprung {
                let limit = contact.friction * contact.force[0];
                if let FrictionLimit::Force(former) = contact.limit {
                    change = change.max((limit - former).abs() * contact.compliance);
                }
                contact.limit = FrictionLimit::Force(limit);
            }
            if change <= TOLERANCE {
                break;
            }
            self.take_nearest(change);
        }
        if !settled {
            // Of a led instrument nothing is passed on, so the law may still be off in this iterate: others follow.
            if self.has_free_giving() {
                return Err(Failure { node: 0, why: FailureCause::Unsettled });
            }
            self.return_to_nearest();
        }
        Ok(())
    }

    /// Limits friction by Coulomb's law: a former solution may have ended with limits of its own.
    fn limit_by_friction(&mut self) {
        self.sprung.iter_mut().for_each(|contact| contact.limit = contact.friction.into());
    }

    /// Remembers the current solution, with its error \[m\].
    fn take_nearest(&mut self, error: f64) {
        let Self { nearest, moved, sprung, giving, .. } = self;
        nearest.error = error;
        nearest.moved.clone_from(moved);
        nearest.forces.clear();
        nearest.forces.extend(sprung.iter().map(|contact| contact.force));
        nearest.gives.clear();
        nearest.gives.extend(giving.changes());
    }

    /// Returns to the remembered solution, if there is one.
    fn return_to_nearest(&mut self) {
        if !self.nearest.error.is_finite() {
            return;
        }
        self.moved.clone_from(&self.nearest.moved);
        for (contact, force) in self.sprung.iter_mut().zip(&self.nearest.forces) {
            contact.force = *force;
        }
        self.giving.set_changes(&self.nearest.gives);
    }

    /// Error of the contact springs, compliances multiplied by `softness` \[m\], and their next states. Contacts near
    /// enough are corrected by that error.
    fn error(&mut self, softness: f64) -> f64 {
        let (mut changed, mut off) = (false, false);
        self.rest.clear();
        self.rest.resize(self.right.len(), Cell::zeros());
        let mut sprung = std::mem::take(&mut self.sprung);
        let mut residuals = vec![[0.0; 3]; if self.has_giving() { sprung.len() } else { 0 }];
        for (index, contact) in sprung.iter_mut().enumerate() {
            let by = self.apart(contact, &self.moved, None);
            let apart: [f64; 3] = std::array::from_fn(|k| contact.offset[k] + by[k]);
            let yields = softness * contact.compliance;
            let linear = contact.coulomb.linear(apart, contact.limit, yields);
            let (force, coulomb) = CoulombState::of(apart, contact.limit, yields);
            let lacking: [f64; 3] = std::array::from_fn(|k| force[k] - linear[k]);
            contact.force = force;
            if lacking != [0.0; 3] {
                let size = lacking[0].abs().max(lacking[1].abs()).max(lacking[2].abs());
                let same = std::mem::discriminant(&coulomb) == std::mem::discriminant(&contact.coulomb);
                changed |= !same && size > FORCE_TOLERANCE;
                off = true;
                contact.rows.push(&lacking, &mut self.rest);
                residuals.get_mut(index).into_iter().for_each(|residual| *residual = lacking);
            }
            contact.next = contact.coulomb.next(coulomb, contact.friction);
        }
        self.sprung = sprung;
        if !off {
            return 0.0;
        }
        let knotted = self.is_knotted();
        if changed && !knotted {
            return f64::INFINITY;
        }
        // The residual forces move the rod, and the errors move the contacts.
        let mut rest = std::mem::take(&mut self.rest);
        self.solve_rod(&mut rest);
        let change = self.let_obstacles_give_way(&mut rest, Some(&residuals), softness);
        self.rest = rest;
        let mut largest = 0.0_f64;
        for contact in &self.sprung {
            if contact.next != CoulombState::Open {
                let by = self.apart(contact, &self.rest, Some(&change));
                largest = by.iter().fold(largest, |most, by| most.max(by.abs()));
            }
        }
        if largest <= TOLERANCE {
            for (moved, rest) in self.moved.iter_mut().zip(&self.rest) {
                *moved += rest;
            }
            self.give_way_by(&change, true);
        }
        largest
    }

    /// Gaps of the dense problem with its current forces.
    fn measure(&mut self) {
        for (place, contact) in self.dense.iter().enumerate() {
            let apart = self.apart(contact, &self.moved, None);
            for k in 0..3 {
                self.problem.force[3 * place + k] = contact.force[k];
                self.problem.gap[3 * place + k] =
                    contact.offset[k] + apart[k] + contact.yields()[k] * contact.force[k];
            }
        }
        self.give_way();
    }

    /// Assembles the dense problem: the compliance of its contacts through the rod and its springs, column by column.
    fn pose(&mut self) {
        let places = self.dense.len();
        let rows = 3 * places;
        self.problem.clear(places);
        for contact in &self.dense {
            self.problem.rules.push(contact.law());
            self.problem.yields.push(contact.yields());
        }
        let slanted = self.added.slanted;
        let nodes = self.right.len();
        let begin = self.dense.first().map_or(0, |contact: &Active| contact.rows.first());
        let begin = begin.min(nodes.saturating_sub(1));
        for first in (0..rows).step_by(LANES).take_while(|_| nodes > 0) {
            let columns = first..(first + LANES).min(rows);
            let from = self.dense[first / 3].rows.first().min(nodes - 1);
            self.lanes.clear();
            self.lanes.resize(nodes, [[0.0; LANES]; 4]);
            for column in columns.clone() {
                let of = &self.dense[column / 3].rows;
                for k in 0..of.used {
                    let cell = &mut self.lanes[of.nodes[k] as usize];
                    for axis in 0..4 {
                        cell[axis][column - first] += of.cells[column % 3][k][axis];
                    }
                }
            }
            // Sorted along the thread, no remaining contact lies before the first one; an unsymmetric matrix has to be
            // read everywhere.
            let (until, skipped) = if slanted { (begin, 0) } else { (from, first / 3) };
            self.factors.solve_lanes(&mut self.lanes, from, until);
            let (dense, lanes, compliance) = (&self.dense, &self.lanes, &mut self.problem.compliance);
            wide(
                #[inline(always)]
                || {
                    for (place, contact) in dense.iter().enumerate().skip(skipped) {
                        for k in 0..3 {
                            let apart = contact.rows.apart_lanes(k, lanes);
                            for (column, value) in columns.clone().zip(apart) {
                                compliance[column * rows + 3 * place + k] = value;
                            }
                        }
                    }
                },
            );
        }
        if !slanted {
            for column in 0..rows {
                for row in column + 1..rows {
                    self.problem.compliance[row * rows + column] =
                        self.problem.compliance[column * rows + row];
                }
            }
        }
        for (place, contact) in self.dense.iter().enumerate() {
            for k in 0..3 {
                self.problem.compliance[(3 * place + k) * (rows + 1)] += contact.yields()[k];
            }
        }
        self.add_compliance();
        self.add_led_compliance();
        self.measure();
    }
    /// Results of the ties; an error where they violate their laws.
    fn take_ties(&mut self) -> Result<(), Failure> {
        if self.ties.is_empty() {
            self.tied.clear();
            return Ok(());
        }
        self.tied.resize(self.ties.len(), TieResult::default());
        for (place, contact) in self.dense.iter().enumerate() {
            let Some(tie) = &contact.tie else { continue };
            if self.problem.error_of(place) > TIE_ERROR_MAX {
                return Err(Failure { node: 0, why: FailureCause::Unsettled });
            }
            let gap = self.problem.gap(place);
            let apart = std::array::from_fn(|k| gap[k] - tie.yields[k] * contact.force[k]);
            let gives_way = tie.law.of(apart, tie.yields).1.gives_way();
            self.tied[tie.number] = TieResult { force: contact.force, gap, gives_way };
        }
        Ok(())
    }
}

impl Active {
    fn is_of_strands(&self) -> bool {
        self.tie.is_none() && self.key.with == 0
    }

    fn law(&self) -> ForceLaw {
        self.tie.map_or(ForceLaw::Contact { friction: self.friction }, |tie| tie.law)
    }

    fn yields(&self) -> [f64; 3] {
        self.tie.map_or([self.compliance; 3], |tie| tie.yields)
    }
}
