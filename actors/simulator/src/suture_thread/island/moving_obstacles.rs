//! Obstacles that give way to the thread: rigid bodies that move.
//!
//! Such an obstacle has six unknowns in a substep, how far it gives way to the thread from where it would be without it.
//! They are eliminated from the rod's problem (Schur complement): one solution along the rod for each of them per
//! factorisation. Any weaker coupling, one force after the other, is unstable: a taut thread is far stiffer than the
//! inertia of a light body in a step.

use nalgebra::{DMatrix, DVector, Matrix6, SMatrix, Vector3, Vector6};

use super::{Active, Failure, Island};
use crate::linear_algebra::block_banded::Cell;
use crate::suture_thread::contact::Yielded;
use crate::suture_thread::{ObstacleMobility, Surroundings, ThreadMaterial};

/// How the three separations of a contact change by the six unknowns of its obstacle.
type Motion3x6 = SMatrix<f64, 3, 6>;

/// An obstacle that gives way in the current substep.
#[derive(Clone, Debug)]
pub(super) struct GivingObstacle {
    /// Its index.
    obstacle: usize,
    mobility: ObstacleMobility,
    /// Mass matrix over the substep and the time in which a change of velocity moves it.
    inertia: Matrix6<f64>,
    /// How far it has given way at the iterate, and by how much more in its solution.
    gone: Vector6<f64>,
    change: Vector6<f64>,
}

/// The obstacles that give way, and what eliminates them from the rod's problem with the current factors.
#[derive(Clone, Debug, Default)]
pub(super) struct GivingObstacles {
    list: Vec<GivingObstacle>,
    /// The rod's motion by each unknown.
    columns: Vec<Vec<Cell>>,
    /// Inverse of their own problem with the rod's answer.
    inverse: DMatrix<f64>,
}

impl GivingObstacles {
    /// Halves the change of the iterate.
    pub fn damp(&mut self) {
        self.list.iter_mut().for_each(|giving| giving.change *= 0.5);
    }

    /// Which of them is the obstacle of a contact.
    fn of(&self, with: u32) -> Option<usize> {
        let obstacle = (with as usize).checked_sub(1)?;
        self.list.iter().position(|giving| giving.obstacle == obstacle)
    }
}

impl Island {
    /// Moves the obstacles to where they have given way to, before contacts are sought.
    pub(super) fn begin_giving_way(&mut self, surroundings: &Surroundings, dt: f64) {
        self.giving.list.clear();
        let still = [Vector3::zeros(); 2];
        for (index, obstacle) in surroundings.obstacles.iter().enumerate() {
            let Some(mobility) = obstacle.mobility else { continue };
            let (motion, yielded) = (&mut self.motions[index], &self.yielded[index]);
            motion.from = yielded.of(&motion.from, &mobility);
            motion.to = yielded.after(&mobility, dt, still).of(&motion.to, &mobility);
            let mut inertia = Matrix6::zeros();
            let turning = mobility.inertia_inverse.try_inverse().unwrap_or_default();
            (0..3).for_each(|k| inertia[(k, k)] = mobility.mass_inverse.recip());
            inertia.fixed_view_mut::<3, 3>(3, 3).copy_from(&turning);
            let (gone, change) = (Vector6::zeros(), Vector6::zeros());
            self.giving.list.push(GivingObstacle {
                obstacle: index,
                mobility,
                inertia: inertia / (dt * mobility.lever.unwrap_or(dt)),
                gone,
                change,
            });
        }
    }

    /// Begins the iteration with the obstacles where the forces of the last substep would move them.
    pub(super) fn expect_giving_way(&mut self, material: &ThreadMaterial, surroundings: &Surroundings) {
        if self.giving.list.is_empty() {
            return;
        }
        let mut pushed = vec![Vector6::zeros(); self.giving.list.len()];
        for candidate in &self.candidates.found {
            let Some(at) = self.giving.of(candidate.key.with) else { continue };
            let Some(contact) = self.contact(material, surroundings, candidate.key) else { continue };
            pushed[at] -= self.motion_of(&contact, at).tr_mul(&Vector3::from(contact.force));
        }
        for (at, pushed) in pushed.into_iter().enumerate() {
            let giving = &mut self.giving.list[at];
            giving.change = giving.inertia.try_inverse().unwrap_or_default() * pushed;
        }
        self.advance_obstacles();
    }

    /// How far the separations of a contact decrease by the motion of its obstacle.
    fn motion_of(&self, contact: &Active, at: usize) -> Motion3x6 {
        let giving = &self.giving.list[at];
        let arm = contact.surface - self.motions[giving.obstacle].to * giving.mobility.centre;
        let mut motion = Motion3x6::zeros();
        for (k, direction) in contact.rows.directions.iter().enumerate() {
            let turn = arm.cross(direction);
            motion.fixed_view_mut::<1, 3>(k, 0).copy_from(&direction.transpose());
            motion.fixed_view_mut::<1, 3>(k, 3).copy_from(&turn.transpose());
        }
        motion
    }

    /// Prepares the elimination with new factors; contact compliances are multiplied by `softness`.
    pub(super) fn eliminate_obstacles(&mut self, softness: f64) -> Result<(), Failure> {
        let unknowns = 6 * self.giving.list.len();
        let mut columns = std::mem::take(&mut self.giving.columns);
        columns.clear();
        if unknowns == 0 {
            self.giving.columns = columns;
            return Ok(());
        }
        columns.resize(unknowns, vec![Cell::zeros(); self.right.len()]);
        let mut own = DMatrix::zeros(unknowns, unknowns);
        for (at, giving) in self.giving.list.iter().enumerate() {
            own.fixed_view_mut::<6, 6>(6 * at, 6 * at).copy_from(&giving.inertia);
        }
        // Forces on the rod by each unknown.
        for contact in &self.sprung[..self.with_obstacles] {
            let Some(at) = self.giving.of(contact.key.with) else { continue };
            let motion = self.motion_of(contact, at);
            for k in 0..6 {
                let force = self.linear(contact, motion.column(k).into_owned().into(), softness);
                contact.rows.push(&force, &mut columns[6 * at + k]);
                let on_obstacle = motion.tr_mul(&Vector3::from(force));
                (0..6).for_each(|j| own[(6 * at + j, 6 * at + k)] -= on_obstacle[j]);
            }
        }
        for column in &mut columns {
            self.solve_rod(column);
        }
        for (index, column) in columns.iter().enumerate() {
            let back = self.pull_of(column, softness);
            (0..unknowns).for_each(|row| own[(row, index)] -= back[row]);
        }
        self.giving.columns = columns;
        self.giving.inverse = own
            .try_inverse()
            .ok_or(Failure { node: 0, why: crate::suture_thread::FailureCause::NotPositive })?;
        Ok(())
    }

    /// Force of a contact by its linearised law.
    fn linear(&self, contact: &Active, apart: [f64; 3], softness: f64) -> [f64; 3] {
        contact.coulomb.linear(apart, contact.limit, softness * contact.compliance)
    }

    /// What the contacts' forces by a motion of the rod pull on each unknown.
    fn pull_of(&self, moved: &[Cell], softness: f64) -> DVector<f64> {
        let mut pull = DVector::zeros(6 * self.giving.list.len());
        for contact in &self.sprung[..self.with_obstacles] {
            let Some(at) = self.giving.of(contact.key.with) else { continue };
            let force = self.linear(contact, contact.rows.apart(moved), softness);
            let own = self.motion_of(contact, at).tr_mul(&Vector3::from(force));
            (0..6).for_each(|k| pull[6 * at + k] += own[k]);
        }
        pull
    }

    /// Solves along the rod with the current factors.
    pub(super) fn solve_rod(&mut self, moved: &mut [Cell]) {
        if self.is_knotted() {
            self.sparse.solve(moved);
        } else {
            self.factors.solve(moved);
        }
    }

    /// After a solution along the rod with the obstacles held at the iterate: lets them give way. `forces` are the
    /// additional forces of contacts, if any (their residuals); without, those of the iterate.
    pub(super) fn let_obstacles_give_way(
        &mut self,
        moved: &mut [Cell],
        residuals: Option<&[[f64; 3]]>,
        softness: f64,
    ) -> DVector<f64> {
        let unknowns = 6 * self.giving.list.len();
        if unknowns == 0 {
            return DVector::zeros(0);
        }
        let mut right = -self.pull_of(moved, softness);
        for (index, contact) in self.sprung[..self.with_obstacles].iter().enumerate() {
            let Some(at) = self.giving.of(contact.key.with) else { continue };
            let force = match residuals {
                Some(residuals) => residuals[index],
                None => self.linear(contact, contact.offset, softness),
            };
            let own = self.motion_of(contact, at).tr_mul(&Vector3::from(force));
            (0..6).for_each(|k| right[6 * at + k] -= own[k]);
        }
        if residuals.is_none() {
            for (at, giving) in self.giving.list.iter().enumerate() {
                let held = giving.inertia * giving.gone;
                (0..6).for_each(|k| right[6 * at + k] -= held[k]);
            }
        }
        let change = &self.giving.inverse * right;
        for (column, by) in self.giving.columns.iter().zip(change.iter()).filter(|(_, by)| **by != 0.0) {
            moved.iter_mut().zip(column).for_each(|(moved, column)| *moved -= column * *by);
        }
        change
    }

    /// Sets how far the obstacles give way in the current solution, or adds to it.
    pub(super) fn give_way_by(&mut self, change: &DVector<f64>, adds: bool) {
        for (at, giving) in self.giving.list.iter_mut().enumerate() {
            let by = Vector6::from_fn(|k, _| change[6 * at + k]);
            giving.change = if adds { giving.change + by } else { by };
        }
    }

    /// Separation of a contact's surfaces by a motion of the rod and of its obstacle, from the iterate.
    pub(super) fn apart(&self, contact: &Active, moved: &[Cell], gives: Option<&DVector<f64>>) -> [f64; 3] {
        let mut apart = contact.rows.apart(moved);
        if let Some(at) = self.giving.of(contact.key.with) {
            let by = match gives {
                Some(gives) => Vector6::from_fn(|k, _| gives[6 * at + k]),
                None => self.giving.list[at].change,
            };
            let less = self.motion_of(contact, at) * by;
            (0..3).for_each(|k| apart[k] -= less[k]);
        }
        apart
    }

    /// Whether any obstacle gives way.
    pub(super) fn has_giving(&self) -> bool {
        !self.giving.list.is_empty()
    }

    /// Whether the obstacle of a contact gives way.
    pub(super) fn gives_way(&self, with: u32) -> bool {
        self.giving.of(with).is_some()
    }

    /// Makes the obstacles' solution their iterate.
    pub(super) fn advance_obstacles(&mut self) {
        for giving in &mut self.giving.list {
            let change = std::mem::take(&mut giving.change);
            giving.gone += change;
            let [way, turn] =
                [change.fixed_rows::<3>(0), change.fixed_rows::<3>(3)].map(|of| of.into_owned());
            let by = Yielded { way: [way, turn], ..Yielded::default() };
            let motion = &mut self.motions[giving.obstacle];
            motion.to = by.of(&motion.to, &giving.mobility);
        }
    }

    /// At the end of a substep: the obstacles have given way. Their impulses are those of their own motion in the solution,
    /// since the law of each contact holds to its tolerance only, and momentum holds exactly.
    pub(super) fn end_giving_way(&mut self, dt: f64) {
        for giving in &self.giving.list {
            let wrench = giving.inertia * giving.gone;
            let wrench = [wrench.fixed_rows::<3>(0), wrench.fixed_rows::<3>(3)].map(|of| of.into_owned());
            let yielded = &mut self.yielded[giving.obstacle];
            *yielded = yielded.after(&giving.mobility, dt, wrench);
        }
    }
}
