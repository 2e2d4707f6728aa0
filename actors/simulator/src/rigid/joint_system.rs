//! All joints that hang together, solved at once and exactly: the impulses for which every joint is closed at the end of
//! the step.
//!
//! The impulses act along the joints as they are at the beginning of the step, and the bodies then move freely to its end
//! (the method of Ryckaert, Ciccotti and Berendsen, *Numerical integration of the Cartesian equations of motion of a system
//! with constraints*, 1977). With a symplectic integrator the step stays symplectic (Leimkuhler and Skeel, *Symplectic
//! numerical integrators in constrained Hamiltonian systems*, 1994): energy oscillates and does not drift. The end of the
//! step depends on the impulses nonlinearly, so Newton's method is used, with the matrix of the beginning: each round
//! reduces the error by about the angle that bodies turn in a step. Where they turn by more than a radian, and touch nothing,
//! the step is taken in parts (`joint_parts.rs`).

use nalgebra::Matrix3;
use trocar_scene::disjoint_sets::DisjointSets;

use super::body_joint::{BodyJoint, JointEnd, JointImpulse, JointRows, Locked, errors, with_twist};
use super::contact_constraint::Twist;
use super::islands::Islands;
use super::joint_factor::JointFactor;
use super::joint_parts::StepParts;
use super::{Integrator, RigidMass, RigidState};

/// Frames that are closer than this are closed by the impulses; farther ones, which were put there from outside, gently
/// by velocities that are discarded \[m, rad\].
pub(super) const NEAR: f64 = 1e-8;
/// Share of such a distance that a step corrects, and the fastest correction \[m/s, rad/s\].
const CORRECTION: f64 = 0.2;
const CORRECTION_MAX: [f64; 2] = [1.0, 50.0];
/// Frames at this distance are closed \[m, rad\].
pub(super) const CLOSED: [f64; 2] = [1e-13, 1e-11];
/// Newton iterations at most.
pub(super) const ROUNDS_MAX: u32 = 16;
/// It has failed where an iteration ends at so many times the least error so far.
const WORSE: f64 = 2.0;

/// The joints of all bodies.
#[derive(Clone, Debug, Default)]
pub(super) struct JointSystem {
    pub joints: Vec<BodyJoint>,
    rows: Vec<JointRows>,
    factor: JointFactor,
    /// The joints of each cluster, in the order in which they are eliminated, and the end of each.
    members: Vec<u32>,
    ends: Vec<u32>,
    /// Clusters by island, and the island of each; those without contacts come last.
    of_island: Vec<(u32, u32)>,
    unknowns: Vec<Locked>,
    /// States at the end of the step, as far as they are predicted.
    predicted: Vec<RigidState>,
    /// Least error so far, by cluster; negative once no further round is made.
    least: Vec<f64>,
    /// Rounds so far.
    rounds: Vec<u32>,
    /// Clusters that did not close in a whole step, and what moves them in parts of it.
    failed: Vec<u32>,
    parts: StepParts,
}

/// Clusters without contacts.
pub(super) const ALONE: u32 = u32::MAX;

impl JointSystem {
    /// Takes over joints. Returns the number of block products of a factorisation if they are more than `most`.
    pub fn set(&mut self, joints: &[BodyJoint], bodies: usize, most: usize) -> Result<(), usize> {
        self.joints.clear();
        self.joints.extend_from_slice(joints);
        let mut joined = DisjointSets::default();
        joined.reset(bodies);
        let mut of_body: Vec<Vec<u32>> = vec![Vec::new(); bodies];
        for (index, joint) in joints.iter().enumerate() {
            of_body[joint.body as usize].push(index as u32);
            if let JointEnd::Body { body, .. } = joint.other {
                of_body[body as usize].push(index as u32);
                joined.join(joint.body as usize, body as usize);
            }
        }
        let pairs = of_body.iter().flat_map(|all| {
            all.iter().enumerate().flat_map(|(at, &a)| all[at + 1..].iter().map(move |&b| (a, b)))
        });
        self.factor.analyse(joints.len(), pairs, most)?;
        // By cluster, and within it in elimination order.
        let mut all: Vec<(usize, u32, u32)> = Vec::with_capacity(joints.len());
        for (index, joint) in (0..).zip(joints) {
            all.push((joined.root(joint.body as usize), self.factor.position(index), index));
        }
        all.sort_unstable();
        self.members.clear();
        self.ends.clear();
        for (at, (root, _, joint)) in all.iter().enumerate() {
            if at > 0 && all[at - 1].0 != *root {
                self.ends.push(at as u32);
            }
            self.members.push(*joint);
        }
        if !all.is_empty() {
            self.ends.push(all.len() as u32);
        }
        Ok(())
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.joints.is_empty()
    }

    fn cluster(&self, cluster: u32) -> std::ops::Range<usize> {
        let begin = if cluster == 0 { 0 } else { self.ends[cluster as usize - 1] };
        begin as usize..self.ends[cluster as usize] as usize
    }

    /// Connects the bodies of all joints.
    pub fn join(&self, islands: &mut Islands) {
        for joint in &self.joints {
            if let JointEnd::Body { body, .. } = joint.other {
                islands.join(joint.body as usize, body as usize);
            }
        }
    }

    /// Begins a step of bodies in these states; the world is the last of `inverse`.
    pub fn begin(&mut self, dt: f64, states: &[RigidState], inverse: &[(f64, Matrix3<f64>)]) {
        self.rows.clear();
        for joint in &self.joints {
            let mut rows = JointRows::new(joint, states, inverse);
            let size = rows.allowed.iter().take(rows.count).fold(0.0, |most: f64, x| most.max(x.abs()));
            if size <= NEAR {
                rows.allowed = [0.0; 6];
            } else {
                let undo = rows.allowed.map(|apart| -CORRECTION * apart / dt);
                let fastest = |of: &[f64]| of.iter().fold(0.0, |most: f64, x| most.max(x.abs()));
                let slowed =
                    [fastest(&undo[..3]) / CORRECTION_MAX[0], fastest(&undo[3..]) / CORRECTION_MAX[1]];
                let share = 1.0 / slowed[0].max(slowed[1]).max(1.0);
                rows.undo = undo.map(|speed| speed * share);
            }
            self.rows.push(rows);
        }
        self.factor.factorise(&self.members, &self.rows);
        self.unknowns.clear();
        self.unknowns.resize(self.rows.len(), [0.0; 6]);
        self.predicted.clear();
        self.predicted.extend_from_slice(states);
        self.least.clear();
        self.least.resize(self.ends.len(), f64::INFINITY);
        self.rounds.clear();
        self.rounds.resize(self.ends.len(), 0);
        self.failed.clear();
        self.parts.moved.clear();
    }

    /// Sorts the clusters by islands of contacts.
    pub fn sort(&mut self, islands: &mut Islands) {
        self.of_island.clear();
        for cluster in 0..self.ends.len() as u32 {
            let first = self.members[self.cluster(cluster).start];
            let island = islands.island_of(self.joints[first as usize].body as usize);
            self.of_island.push((island.unwrap_or(ALONE), cluster));
        }
        self.of_island.sort_unstable();
    }

    fn clusters(&self, island: u32) -> std::ops::Range<usize> {
        let begin = self.of_island.partition_point(|(of, _)| *of < island);
        let end = self.of_island.partition_point(|(of, _)| *of <= island);
        begin..end
    }

    /// Whether an island has joints.
    pub fn is_in(&self, island: u32) -> bool {
        !self.clusters(island).is_empty()
    }

    /// Gives the joints of an island their velocities.
    pub fn solve(&mut self, island: u32, twists: &mut [Twist], undo: &mut [Twist]) {
        for at in self.clusters(island) {
            let members = self.cluster(self.of_island[at].1);
            self.solve_cluster(members.clone(), twists, false);
            let is_apart = |joint: &u32| self.rows[*joint as usize].undo.iter().any(|speed| *speed != 0.0);
            let is_moved = |joint: &u32| {
                self.rows[*joint as usize].sides.iter().any(|side| undo[side.body] != Twist::default())
            };
            if self.members[members.clone()].iter().any(|joint| is_apart(joint) || is_moved(joint)) {
                self.solve_cluster(members, undo, true);
            }
        }
    }

    fn solve_cluster(&mut self, members: std::ops::Range<usize>, twists: &mut [Twist], is_undo: bool) {
        let Self { rows, factor, members: all, unknowns, .. } = self;
        let members = &all[members];
        for &joint in members {
            let of = &rows[joint as usize];
            let (speed, wanted) = (of.speed(twists), if is_undo { &of.undo } else { &of.wanted });
            unknowns[joint as usize] =
                std::array::from_fn(|k| if k < of.count { wanted[k] - speed[k] } else { 0.0 });
        }
        factor.solve(members, unknowns);
        for &joint in members {
            let (of, impulse) = (&mut rows[joint as usize], &unknowns[joint as usize]);
            of.push(impulse, twists);
            if !is_undo {
                of.impulse.iter_mut().zip(impulse).for_each(|(sum, more)| *sum += more);
            }
        }
    }

    /// After the velocities were found: corrects those that are wanted by how far the joints would be open at the end of
    /// the step. Returns whether it has to be solved again.
    pub fn look_ahead(
        &mut self,
        island: u32,
        dt: f64,
        masses: &[RigidMass],
        next: &[RigidState],
        twists: &[Twist],
        integrator: Integrator,
    ) -> bool {
        let mut is_open = false;
        for at in self.clusters(island) {
            let cluster = self.of_island[at].1;
            let members = self.cluster(cluster);
            let Self { joints, rows, members: all, predicted, least, rounds, failed, .. } = self;
            let (least, rounds) = (&mut least[cluster as usize], &mut rounds[cluster as usize]);
            if *least < 0.0 {
                continue;
            }
            let members = &all[members];
            for &joint in members {
                for side in &rows[joint as usize].sides {
                    let Some(state) = next.get(side.body) else { continue };
                    let state = with_twist(&masses[side.body], state, &twists[side.body]);
                    predicted[side.body] = match integrator {
                        // It has moved already.
                        Integrator::ExplicitEuler => state,
                        _ => masses[side.body].moved(&state, dt, integrator),
                    };
                }
            }
            let open = |rows: &JointRows, joint: u32| {
                let error = rows.error(&joints[joint as usize], predicted);
                std::array::from_fn::<f64, 6, _>(|k| {
                    if k < rows.count { error[k] - rows.allowed[k] } else { 0.0 }
                })
            };
            let worst = members.iter().fold(0.0, |worst: f64, &joint| {
                let error = open(&rows[joint as usize], joint);
                let of = error.iter().enumerate().map(|(k, x)| x.abs() / CLOSED[usize::from(k >= 3)]);
                of.fold(worst, f64::max)
            });
            if worst <= 1.0 {
                continue;
            }
            *rounds += 1;
            is_open = true;
            if worst < *least {
                *least = worst;
                for &joint in members {
                    rows[joint as usize].keep_wanted();
                }
            }
            // It may not converge: bodies that turn by more than a radian in a step, or joints that contacts hold open.
            if *rounds == ROUNDS_MAX || worst.is_nan() || worst > WORSE * *least {
                *least = -1.0;
                members.iter().for_each(|joint| rows[*joint as usize].take_best());
                failed.push(cluster);
                continue;
            }
            for &joint in members {
                let error = open(&rows[joint as usize], joint);
                let wanted = &mut rows[joint as usize].wanted;
                wanted.iter_mut().zip(error).for_each(|(wanted, open)| *wanted -= open / dt);
            }
        }
        is_open
    }

    /// Takes the step of clusters that did not close, and touch nothing, in parts: more and more of them.
    pub fn divide(
        &mut self,
        dt: f64,
        masses: &[RigidMass],
        states: &[RigidState],
        next: &[RigidState],
        integrator: Integrator,
    ) {
        if integrator == Integrator::ExplicitEuler {
            return;
        }
        for index in 0..self.failed.len() {
            let cluster = self.failed[index];
            if !self.of_island.contains(&(ALONE, cluster)) {
                continue;
            }
            let members = self.cluster(cluster);
            let Self { joints, rows, members: all, parts, factor, .. } = self;
            let impulses =
                parts.divide(&all[members], joints, factor, dt, (masses, states, next), integrator);
            for (joint, impulse) in impulses {
                rows[*joint as usize].set_total(impulse);
            }
        }
    }

    /// Takes over the bodies that were moved in parts of the step.
    pub fn take_divided(&self, next: &mut [RigidState]) {
        for (body, state) in &self.parts.moved {
            next[*body] = *state;
        }
    }

    /// Adds the impulses to the momenta.
    pub fn end(&self, next: &mut [RigidState], impulses: &mut Vec<JointImpulse>) {
        impulses.clear();
        for rows in &self.rows {
            let total = rows.total();
            for (side, sign) in rows.sides.iter().zip([1.0, -1.0]) {
                if let Some(state) = next.get_mut(side.body) {
                    state.momentum += total.impulse * sign;
                    state.angular_momentum += (side.arm.cross(&total.impulse) + total.turn) * sign;
                }
            }
            impulses.push(total);
        }
    }

    /// How far a joint is open after a step: distance \[m\] and angle \[rad\].
    pub fn errors(&self, joint: usize, states: &[RigidState]) -> [f64; 2] {
        self.joints.get(joint).map_or([0.0; 2], |joint| errors(joint, states))
    }
}
