//! Obstacles that give way to the thread: rigid bodies that move, and instruments that a hand leads.
//!
//! Such an obstacle has six unknowns in a substep, how far it gives way to the thread from where it would be without it;
//! a led instrument does not turn. They are eliminated from the rod's problem (Schur complement): one solution along the
//! rod for each of them per factorisation. Any weaker coupling, one force after the other, is unstable: a taut thread is
//! far stiffer than the inertia of a light body in a step.

use nalgebra::{DMatrix, DVector, Isometry3, Matrix6, SMatrix, Vector3, Vector6};

use super::{Active, Failure, Island};
use crate::linear_algebra::block_banded::Cell;
use crate::suture_thread::contact::{Motion, Yielded};
use crate::suture_thread::{LedInstrument, ObstacleMobility, Surroundings, ThreadMaterial};

/// How the three separations of a contact change by the six unknowns of its obstacle.
type Motion3x6 = SMatrix<f64, 3, 6>;

/// Whether an obstacle that gives way moves freely or is led.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum GivingKind {
    Free,
    Led,
}

/// How an obstacle gives way in the current substep.
#[derive(Clone, Copy, Debug)]
#[expect(clippy::large_enum_variant, reason = "there are a handful of them, and a step allocates nothing")]
enum Yielding {
    /// A body that moves freely, with its mass matrix over the substep and the time in which a change of velocity moves
    /// it.
    Free(ObstacleMobility, Matrix6<f64>),
    /// A led instrument, by its index, at the beginning of a substep of this length \[s\].
    Led(usize, LedInstrument, f64),
}

/// An obstacle that gives way in the current substep.
#[derive(Clone, Debug)]
pub(super) struct GivingObstacle {
    /// Its first and last part among the obstacles.
    parts: [usize; 2],
    how: Yielding,
    /// Its place among those that a contact may touch, whose unknowns are solved with the rod.
    slot: Option<usize>,
    /// How far it has given way at the iterate, and by how much more in its solution.
    gone: Vector6<f64>,
    change: Vector6<f64>,
    /// Of a led instrument: where its first part's motion ended when contacts were sought \[m\].
    seen: Vector3<f64>,
}

impl GivingObstacle {
    /// The force and torque that its change needs, and their derivative.
    fn needed(&self) -> (Vector6<f64>, Matrix6<f64>) {
        match &self.how {
            Yielding::Free(_, inertia) => (inertia * self.gone, *inertia),
            Yielding::Led(_, led, dt) => {
                let (force, stiffness) = led.needed(&self.gone.fixed_rows::<3>(0).into_owned(), *dt);
                let (mut needed, mut change) = (Vector6::zeros(), Matrix6::identity());
                needed.fixed_rows_mut::<3>(0).copy_from(&force);
                change.fixed_view_mut::<3, 3>(0, 0).copy_from(&stiffness);
                (needed, change)
            }
        }
    }

    fn is_free(&self) -> bool {
        matches!(self.how, Yielding::Free(..))
    }
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

    /// By how much each of them gives way in its solution.
    pub fn changes(&self) -> impl Iterator<Item = Vector6<f64>> + '_ {
        self.list.iter().map(|giving| giving.change)
    }

    /// Sets that.
    pub fn set_changes(&mut self, changes: &[Vector6<f64>]) {
        self.list.iter_mut().zip(changes).for_each(|(giving, change)| giving.change = *change);
    }

    /// Which of them is the obstacle of a contact.
    fn of(&self, with: u32) -> Option<usize> {
        let obstacle = (with as usize).checked_sub(1)?;
        self.list.iter().position(|giving| (giving.parts[0]..=giving.parts[1]).contains(&obstacle))
    }

    /// The first of its unknowns in the problem of those that are touched.
    fn first_unknown(&self, at: usize) -> usize {
        6 * self.list[at].slot.unwrap_or_default()
    }

    /// Number of unknowns.
    fn unknowns(&self) -> usize {
        6 * self.list.iter().filter(|giving| giving.slot.is_some()).count()
    }
}

impl Island {
    /// Moves the obstacles to where they have given way to, before contacts are sought.
    pub(super) fn begin_giving_way(&mut self, surroundings: &Surroundings, dt: f64) {
        self.giving.list.clear();
        let still = [Vector3::zeros(); 2];
        let zero = Vector6::zeros();
        for (index, obstacle) in surroundings.obstacles.iter().enumerate() {
            let Some(mobility) = obstacle.mobility else { continue };
            let (motion, yielded) = (&mut self.motions[index], &self.yielded[index]);
            motion.from = yielded.of(&motion.from, &mobility);
            motion.to = yielded.after(&mobility, dt, still).of(&motion.to, &mobility);
            let mut inertia = Matrix6::zeros();
            let turning = mobility.inertia_inverse.try_inverse().unwrap_or_default();
            (0..3).for_each(|k| inertia[(k, k)] = mobility.mass_inverse.recip());
            inertia.fixed_view_mut::<3, 3>(3, 3).copy_from(&turning);
            self.giving.list.push(GivingObstacle {
                parts: [index; 2],
                how: Yielding::Free(mobility, inertia / (dt * mobility.lever.unwrap_or(dt))),
                slot: None,
                gone: zero,
                change: zero,
                seen: Vector3::zeros(),
            });
        }
        for (index, led) in surroundings.led.iter().enumerate() {
            let led = led.at(&self.led[index]);
            let by = led.freely(dt);
            for motion in &mut self.motions[led.obstacles[0]..=led.obstacles[1]] {
                shift(&mut motion.from, &led.offset);
                shift(&mut motion.to, &(led.offset + by));
            }
            let mut gone = zero;
            gone.fixed_rows_mut::<3>(0).copy_from(&by);
            self.giving.list.push(GivingObstacle {
                parts: led.obstacles,
                how: Yielding::Led(index, led, dt),
                slot: None,
                gone,
                change: zero,
                seen: Vector3::zeros(),
            });
        }
    }

    /// Begins the iteration with the obstacles where the forces of the last substep would move them.
    pub(super) fn expect_giving_way(&mut self, material: &ThreadMaterial, surroundings: &Surroundings) {
        if self.giving.list.is_empty() {
            return;
        }
        // Nothing has moved yet; what these contain is of another step, maybe of another number of nodes.
        for moved in [&mut self.moved, &mut self.expected] {
            moved.clear();
            moved.resize(self.at.positions.len(), Cell::zeros());
        }
        let mut pushed: Vec<Option<Vector6<f64>>> = vec![None; self.giving.list.len()];
        for candidate in &self.candidates.found {
            let Some(at) = self.giving.of(candidate.key.with) else { continue };
            let Some(contact) = self.contact(material, surroundings, candidate.key) else { continue };
            let by = pushed[at].get_or_insert_with(Vector6::zeros);
            *by -= self.motion_of(&contact, at).tr_mul(&Vector3::from(contact.force));
        }
        for (giving, pushed) in self.giving.list.iter_mut().zip(pushed) {
            let Some(pushed) = pushed else { continue };
            let (needed, stiffness) = giving.needed();
            giving.change = stiffness.try_inverse().unwrap_or_default() * (pushed - needed);
        }
        self.advance_obstacles();
    }

    /// Numbers the obstacles that a contact of this iterate may touch.
    pub(super) fn number_giving(&mut self) {
        self.giving.list.iter_mut().for_each(|giving| giving.slot = None);
        let mut count = 0;
        for contact in &self.sprung {
            let Some(at) = self.giving.of(contact.key.with) else { continue };
            if self.giving.list[at].slot.is_none() {
                self.giving.list[at].slot = Some(count);
                count += 1;
            }
        }
    }

    /// Remembers where the led instruments are as contacts are sought.
    pub(super) fn see_led(&mut self) {
        for giving in self.giving.list.iter_mut().filter(|giving| !giving.is_free()) {
            giving.seen = self.motions[giving.parts[0]].to.translation.vector;
        }
    }

    /// Whether a led instrument has left, by more than `margin` \[m\], the way on which contacts were sought.
    pub(super) fn led_beyond(&self, margin: f64) -> bool {
        self.giving.list.iter().filter(|giving| !giving.is_free()).any(|giving| {
            let Motion { from, to, .. } = &self.motions[giving.parts[0]];
            let (from, way) = (from.translation.vector, giving.seen - from.translation.vector);
            let now = to.translation.vector - from;
            let along = (now.dot(&way) / way.norm_squared().max(f64::MIN_POSITIVE)).clamp(0.0, 1.0);
            (now - way * along).norm() > margin
        })
    }

    /// How far the separations of a contact decrease by the motion of its obstacle.
    fn motion_of(&self, contact: &Active, at: usize) -> Motion3x6 {
        let giving = &self.giving.list[at];
        let mut motion = Motion3x6::zeros();
        for (k, direction) in contact.rows.directions.iter().enumerate() {
            motion.fixed_view_mut::<1, 3>(k, 0).copy_from(&direction.transpose());
        }
        if let Yielding::Free(mobility, _) = &giving.how {
            let arm = contact.surface - self.motions[giving.parts[0]].to * mobility.centre;
            for (k, direction) in contact.rows.directions.iter().enumerate() {
                motion.fixed_view_mut::<1, 3>(k, 3).copy_from(&arm.cross(direction).transpose());
            }
        }
        motion
    }

    /// Prepares the elimination with new factors; contact compliances are multiplied by `softness`.
    pub(super) fn eliminate_obstacles(&mut self, softness: f64) -> Result<(), Failure> {
        let unknowns = self.giving.unknowns();
        let mut columns = std::mem::take(&mut self.giving.columns);
        columns.clear();
        if unknowns == 0 {
            self.giving.columns = columns;
            return Ok(());
        }
        columns.resize(unknowns, vec![Cell::zeros(); self.right.len()]);
        let mut own = DMatrix::zeros(unknowns, unknowns);
        for giving in &self.giving.list {
            let Some(slot) = giving.slot else { continue };
            own.fixed_view_mut::<6, 6>(6 * slot, 6 * slot).copy_from(&giving.needed().1);
        }
        // Forces on the rod by each unknown.
        for contact in &self.sprung[..self.with_obstacles] {
            let Some(at) = self.giving.of(contact.key.with) else { continue };
            let (motion, first) = (self.motion_of(contact, at), self.giving.first_unknown(at));
            for k in 0..6 {
                let force = self.linear(contact, motion.column(k).into_owned().into(), softness);
                contact.rows.push(&force, &mut columns[first + k]);
                let on_obstacle = motion.tr_mul(&Vector3::from(force));
                (0..6).for_each(|j| own[(first + j, first + k)] -= on_obstacle[j]);
            }
        }
        let acts = |column: &&mut Vec<Cell>| column.iter().any(|cell| *cell != Cell::zeros());
        for column in columns.iter_mut().filter(acts) {
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
        let mut pull = DVector::zeros(self.giving.unknowns());
        for contact in &self.sprung[..self.with_obstacles] {
            let Some(at) = self.giving.of(contact.key.with) else { continue };
            let force = self.linear(contact, contact.rows.apart(moved), softness);
            let own = self.motion_of(contact, at).tr_mul(&Vector3::from(force));
            let first = self.giving.first_unknown(at);
            (0..6).for_each(|k| pull[first + k] += own[k]);
        }
        pull
    }

    /// Solves along the rod with the current factors.
    pub(super) fn solve_rod(&mut self, moved: &mut [Cell]) {
        if self.is_knotted() || self.trial.is_closed() {
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
        if self.giving.unknowns() == 0 {
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
            let first = self.giving.first_unknown(at);
            (0..6).for_each(|k| right[first + k] -= own[k]);
        }
        if residuals.is_none() {
            for giving in &self.giving.list {
                let Some(slot) = giving.slot else { continue };
                let needed = giving.needed().0;
                (0..6).for_each(|k| right[6 * slot + k] -= needed[k]);
            }
            // Ties of a coupled body on led instruments.
            for contact in &self.dense {
                let Some(at) = self.giving.of(contact.key.with) else { continue };
                if self.giving.list[at].slot.is_some() {
                    let own = self.motion_of(contact, at).tr_mul(&Vector3::from(contact.force));
                    let first = self.giving.first_unknown(at);
                    (0..6).for_each(|k| right[first + k] -= own[k]);
                }
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
        for at in 0..self.giving.list.len() {
            let by = match self.giving.list[at].slot {
                Some(slot) => Vector6::from_fn(|k, _| change[6 * slot + k]),
                None if adds => continue,
                // No spring of the rod's matrix is on it: it moves by the forces of the dense problem, if any.
                None => {
                    let (needed, stiffness) = self.giving.list[at].needed();
                    let own = |contact: &&Active| self.giving.of(contact.key.with) == Some(at);
                    let pushed = self.dense.iter().filter(own).fold(-needed, |sum, contact| {
                        sum - self.motion_of(contact, at).tr_mul(&Vector3::from(contact.force))
                    });
                    stiffness.try_inverse().unwrap_or_default() * pushed
                }
            };
            let giving = &mut self.giving.list[at];
            giving.change = if adds { giving.change + by } else { by };
        }
    }

    /// Separation of a contact's surfaces by a motion of the rod and of its obstacle, from the iterate.
    pub(super) fn apart(&self, contact: &Active, moved: &[Cell], gives: Option<&DVector<f64>>) -> [f64; 3] {
        let mut apart = contact.rows.apart(moved);
        if let Some(at) = self.giving.of(contact.key.with) {
            let by = match gives {
                Some(_) if self.giving.list[at].slot.is_none() => Vector6::zeros(),
                Some(gives) => Vector6::from_fn(|k, _| gives[self.giving.first_unknown(at) + k]),
                None => self.giving.list[at].change,
            };
            let less = self.motion_of(contact, at) * by;
            (0..3).for_each(|k| apart[k] -= less[k]);
        }
        apart
    }

    /// Whether a contact may touch an obstacle that gives way.
    pub(super) fn has_giving(&self) -> bool {
        self.giving.list.iter().any(|giving| giving.slot.is_some())
    }

    /// Whether a contact may touch a body that moves freely.
    pub(super) fn has_free_giving(&self) -> bool {
        self.giving.list.iter().any(|giving| giving.slot.is_some() && giving.is_free())
    }

    /// How the obstacle of a contact gives way, if it does.
    pub(super) fn giving_kind(&self, with: u32) -> Option<GivingKind> {
        let is_free = self.giving.list[self.giving.of(with)?].is_free();
        Some(if is_free { GivingKind::Free } else { GivingKind::Led })
    }

    /// Adds to the dense problem how its contacts move the led instruments that they touch.
    pub(super) fn add_led_compliance(&mut self) {
        let rows = 3 * self.dense.len();
        for (number, giving) in self.giving.list.iter().enumerate().filter(|(_, giving)| !giving.is_free()) {
            let own = |contact: &&Active| self.giving.of(contact.key.with) == Some(number);
            if !self.dense.iter().any(|contact| own(&contact)) {
                continue;
            }
            let yields = giving.needed().1.try_inverse().unwrap_or_default();
            for (of, pushed) in self.dense.iter().enumerate().filter(|(_, contact)| own(contact)) {
                let by = yields * self.motion_of(pushed, number).transpose();
                for (place, contact) in self.dense.iter().enumerate().filter(|(_, contact)| own(contact)) {
                    let apart = self.motion_of(contact, number) * by;
                    for (column, row) in (0..9).map(|k| (k / 3, k % 3)) {
                        self.problem.compliance[(3 * of + column) * rows + 3 * place + row] +=
                            apart[(row, column)];
                    }
                }
            }
        }
    }

    /// Makes the obstacles' solution their iterate; returns the largest way of a led instrument \[m\].
    pub(super) fn advance_obstacles(&mut self) -> f64 {
        let mut largest = 0.0_f64;
        for giving in &mut self.giving.list {
            let change = std::mem::take(&mut giving.change);
            giving.gone += change;
            let [way, turn] =
                [change.fixed_rows::<3>(0), change.fixed_rows::<3>(3)].map(|of| of.into_owned());
            match &giving.how {
                Yielding::Free(mobility, _) => {
                    let by = Yielded { way: [way, turn], ..Yielded::default() };
                    let motion = &mut self.motions[giving.parts[0]];
                    motion.to = by.of(&motion.to, mobility);
                }
                Yielding::Led(..) => {
                    let parts = &mut self.motions[giving.parts[0]..=giving.parts[1]];
                    parts.iter_mut().for_each(|motion| shift(&mut motion.to, &way));
                    largest = largest.max(way.norm());
                }
            }
        }
        largest
    }

    /// At the end of a substep: the obstacles have given way. Their impulses are those of their own motion in the solution,
    /// since the law of each contact holds to its tolerance only, and momentum holds exactly.
    pub(super) fn end_giving_way(&mut self, dt: f64) {
        for giving in &self.giving.list {
            match &giving.how {
                Yielding::Free(mobility, inertia) => {
                    let wrench = inertia * giving.gone;
                    let wrench =
                        [wrench.fixed_rows::<3>(0), wrench.fixed_rows::<3>(3)].map(|of| of.into_owned());
                    let yielded = &mut self.yielded[giving.parts[0]];
                    *yielded = yielded.after(mobility, dt, wrench);
                }
                Yielding::Led(index, led, _) => {
                    let by = giving.gone.fixed_rows::<3>(0).into_owned();
                    self.led[*index] = led.after(&self.led[*index], &by, dt);
                }
            }
        }
    }
}

/// Moves a pose without turning it.
fn shift(pose: &mut Isometry3<f64>, by: &Vector3<f64>) {
    pose.translation.vector += by;
}
