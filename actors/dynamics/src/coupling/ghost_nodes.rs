//! Ghost nodes: the faster body's model of a slower body's nodes between two of the slower body's steps.

use std::collections::VecDeque;

use nalgebra::{Point3, Vector3};
use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::external_nodes::{ExternalNodes, GhostMoved, GhostNode, PredictedPath};

/// Maximum number of remembered steps.
const PAST_MAX: usize = 512;
/// Time constant in which a deficit of the energy tank is forgiven, since any body dissipates energy itself \[s\].
const FORGIVEN: f64 = 0.5;
/// Steps of the slower body that its untaken impulses span before it counts as having missed some.
const MISSED: f64 = 1.5;
/// Bisection steps for the fraction of a correction that the tank can pay for.
const HALVINGS: u32 = 16;

/// Why a report was rejected; the ghosts are unchanged.
#[derive(Clone, Copy, Debug, Error, PartialEq)]
pub enum GhostNodesError {
    /// A list of the wrong length.
    #[error("{what} of {found} nodes: there are {expected} ghosts")]
    Size {
        /// The list.
        what: &'static str,
        /// Its length.
        found: usize,
        /// Number of ghosts.
        expected: usize,
    },
    /// A value that is not finite, or negative.
    #[error("{0} is not a finite number, or below 0")]
    Number(&'static str),
}

/// Report of the slower body after a step, for the nodes with ghosts.
#[derive(Clone, Copy, Debug)]
pub struct SlowBodyReport<'a> {
    /// Positions \[m\].
    pub positions: &'a [Point3<f64>],
    /// Velocities \[m/s\].
    pub velocities: &'a [Vector3<f64>],
    /// Velocities after one more step with the impulses of the last \[m/s\].
    pub expected: &'a [Vector3<f64>],
    /// Mobility: change of velocity per additional impulse \[1/kg\]; 0 for a fixed node. An upper bound is safer than a
    /// lower one.
    pub mobilities: &'a [f64],
    /// Inverse masses: the mobility without elastic restraint \[1/kg\].
    pub masses_inverse: &'a [f64],
    /// Impulses taken in the last step \[N·s\].
    pub last: &'a [Vector3<f64>],
    /// [`GhostNodes::work`] as of the last impulses taken \[J\].
    pub given_work: f64,
    /// Total work of all impulses taken, on the slower body \[J\].
    pub received: f64,
    /// [`GhostNodes::steps`] as of the last impulses taken.
    pub steps: u64,
    /// Length of its steps \[s\].
    pub step: f64,
}

/// A step of the faster body that the slower one has not reported on yet.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
struct UnreportedStep {
    /// Its length \[s\].
    dt: f64,
    /// Impulses on the ghosts \[N·s\]; zero ones omitted.
    given: Vec<(u32, Vector3<f64>)>,
}

/// Ghost nodes of one slower body; all quantities in one non-rotating frame.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct GhostNodes {
    positions: Vec<Point3<f64>>,
    velocities: Vec<Vector3<f64>>,
    masses_inverse: Vec<f64>,
    /// Predicted path of each ghost, with a force \[N\], and a spring to the path \[N/m\].
    paths: Vec<PredictedPath>,
    pulls: Vec<Vector3<f64>>,
    springs: Vec<f64>,
    /// Damping of its motion relative to the path \[N·s/m\].
    dampers: Vec<f64>,
    /// Position error of each ghost, still to be corrected \[m\].
    behind: Vec<Vector3<f64>>,
    given: Vec<Vector3<f64>>,
    /// Number of steps so far, and the most recent ones, oldest first.
    steps: u64,
    past: VecDeque<UnreportedStep>,
    /// Total work on the ghosts, and the part of it whose impulses the slower body has taken \[J\].
    work: f64,
    given_work: f64,
    /// Work of those impulses on the slower body \[J\].
    received: f64,
    /// Energy dissipated by dampers and friction \[J\].
    lost: f64,
    /// Energy spent on correcting the ghosts \[J\].
    paid: f64,
    /// Sum of the magnitudes of all impulses so far \[N·s\].
    exchanged: f64,
}

impl GhostNodes {
    /// For nodes at rest at these positions \[m\]; immovable until the first report.
    ///
    /// # Errors
    /// A non-finite position.
    pub fn new(positions: &[Point3<f64>]) -> Result<Self, GhostNodesError> {
        let mut ghosts = Self::default();
        ghosts.more(positions)?;
        Ok(ghosts)
    }

    /// Adds nodes, after the existing ones.
    ///
    /// # Errors
    /// A non-finite position.
    pub fn more(&mut self, positions: &[Point3<f64>]) -> Result<(), GhostNodesError> {
        finite("a place", positions.iter().flat_map(|at| at.iter()))?;
        self.positions.extend_from_slice(positions);
        let count = self.positions.len();
        let still = positions
            .iter()
            .map(|position| PredictedPath { position: *position, ..PredictedPath::default() });
        self.paths.extend(still);
        self.masses_inverse.resize(count, 0.0);
        self.springs.resize(count, 0.0);
        self.dampers.resize(count, 0.0);
        for list in [&mut self.velocities, &mut self.pulls, &mut self.behind, &mut self.given] {
            list.resize(count, Vector3::zeros());
        }
        Ok(())
    }

    /// Number of ghosts.
    #[must_use]
    pub fn count(&self) -> usize {
        self.positions.len()
    }

    /// Positions \[m\].
    #[must_use]
    pub fn positions(&self) -> &[Point3<f64>] {
        &self.positions
    }

    /// Velocities \[m/s\].
    #[must_use]
    pub fn velocities(&self) -> &[Vector3<f64>] {
        &self.velocities
    }

    /// Cumulative impulse on each ghost \[N·s\]: the slower body applies the difference to what it has taken before.
    #[must_use]
    pub fn given(&self) -> &[Vector3<f64>] {
        &self.given
    }

    /// Number of steps of the faster body.
    #[must_use]
    pub fn steps(&self) -> u64 {
        self.steps
    }

    /// By how much of the impulses given since step number `since` a body moves in one of its own steps of `step`
    /// seconds, when it has taken all that were given before: 1, unless it missed steps.
    ///
    /// A body that missed steps has not moved in them, under no force at all. So it does not take the impulses of that
    /// time at once, as a blow of many times the force, but the mean force for the step that it makes.
    #[must_use]
    pub fn share_of_a_step(&self, since: u64, step: f64) -> f64 {
        let steps = self.steps.saturating_sub(since) as usize;
        let over: f64 = self.past.iter().rev().take(steps).map(|step| step.dt).sum();
        // Without a missed step the two bodies' steps are out of phase by at most one of the faster body's.
        let out_of_phase = self.past.back().map_or(0.0, |last| last.dt);
        if over > MISSED * step + out_of_phase { step / over } else { 1.0 }
    }

    /// Total work on the ghosts \[J\].
    #[must_use]
    pub fn work(&self) -> f64 {
        self.work
    }

    /// Sum of the magnitudes of all impulses so far \[N·s\].
    #[must_use]
    pub fn exchanged(&self) -> f64 {
        self.exchanged
    }

    /// Energy in the tank, available for corrections \[J\]. Counts only the part of the work on the ghosts for which
    /// the work on the slower body is known.
    #[must_use]
    pub fn tank(&self) -> f64 {
        self.lost + self.given_work - self.received - self.paid
    }

    /// Largest position error of any ghost \[m\].
    #[must_use]
    pub fn position_error_max(&self) -> f64 {
        self.behind.iter().map(|behind| behind.norm()).fold(0.0, f64::max)
    }

    /// Position error of each ghost, still to be corrected \[m\].
    #[must_use]
    pub fn behind(&self) -> &[Vector3<f64>] {
        &self.behind
    }

    /// Marks a fraction of the position error as corrected within a step of the faster body, apart from the results
    /// passed to [`end_step`](Self::end_step).
    pub fn caught_up(&mut self, share: f64) {
        self.behind.iter_mut().for_each(|behind| *behind *= 1.0 - share);
    }

    /// Processes the slower body's report after a step.
    ///
    /// # Errors
    /// A list of the wrong length, or a non-finite value.
    pub fn receive(&mut self, report: &SlowBodyReport<'_>) -> Result<(), GhostNodesError> {
        let expected = self.count();
        for (what, found) in [
            ("places", report.positions.len()),
            ("velocities", report.velocities.len()),
            ("mobilities", report.mobilities.len()),
            ("masses", report.masses_inverse.len()),
            ("expected velocities", report.expected.len()),
            ("impulses", report.last.len()),
        ] {
            if found != expected {
                return Err(GhostNodesError::Size { what, found, expected });
            }
        }
        finite("a place", report.positions.iter().flat_map(|at| at.iter()))?;
        finite("a velocity", report.velocities.iter().chain(report.expected).flatten())?;
        finite("an impulse", report.last.iter().flatten())?;
        finite("a work", [report.given_work, report.received].iter())?;
        let mut positive = report.mobilities.iter().chain(report.masses_inverse).chain([&report.step]);
        if !positive.all(|value| *value >= 0.0 && value.is_finite()) {
            return Err(GhostNodesError::Number("a time or a mobility"));
        }
        // Replay the impulses that it has not taken yet, from its reported state.
        let since = self.steps.saturating_sub(report.steps) as usize;
        self.past.drain(..self.past.len().saturating_sub(since));
        let mut ghost_nodes: Vec<GhostNode> = (0..expected).map(|node| expect(report, node)).collect();
        for UnreportedStep { dt, given } in &self.past {
            let mut given = given.iter().peekable();
            for (ghost, ghost_node) in ghost_nodes.iter_mut().enumerate() {
                let impulse = given.next_if(|(of, _)| *of as usize == ghost).map(|(_, impulse)| *impulse);
                ghost_node.go(*dt, &impulse.unwrap_or_default());
            }
        }
        for (ghost, ghost_node) in ghost_nodes.into_iter().enumerate() {
            self.behind[ghost] = ghost_node.position - self.positions[ghost];
            self.velocities[ghost] = ghost_node.velocity;
            self.masses_inverse[ghost] = ghost_node.mobility;
            self.pulls[ghost] = ghost_node.pull;
            self.springs[ghost] = ghost_node.stiffness;
            self.dampers[ghost] = ghost_node.damping;
            self.paths[ghost] = ghost_node.path;
        }
        (self.given_work, self.received) = (report.given_work, report.received);
        Ok(())
    }

    /// Begins a step of the faster body: corrects the ghosts as far as the tank pays, and adds them to the list. Ties
    /// and contacts refer to ghosts by their numbers here; `nodes` are the positions of the faster body's nodes \[m\].
    pub fn begin_step(
        &mut self,
        external_nodes: &ExternalNodes<'_>,
        nodes: &[Point3<f64>],
        ghost_nodes: &mut Vec<GhostNode>,
    ) {
        // Tank energy beyond the springs' current energy is of no use, and part of it never was kinetic: opposing
        // forces on a light node cancel in every step.
        self.paid += (self.tank() - self.stored(external_nodes, nodes)).max(0.0);
        let tank = self.tank().max(0.0);
        let mut share = 1.0;
        if self.cost(external_nodes, nodes, share) > tank {
            let mut more = 1.0;
            share = 0.0;
            for _ in 0..HALVINGS {
                more *= 0.5;
                if self.cost(external_nodes, nodes, share + more) <= tank {
                    share += more;
                }
            }
        }
        self.paid += self.cost(external_nodes, nodes, share);
        for (position, behind) in self.positions.iter_mut().zip(&mut self.behind) {
            *position += *behind * share;
            *behind *= 1.0 - share;
        }
        ghost_nodes.extend(self.ghost_nodes());
    }

    /// The current ghosts, as ghost nodes.
    pub fn ghost_nodes(&self) -> impl Iterator<Item = GhostNode> {
        (0..self.count()).map(|ghost| GhostNode {
            position: self.positions[ghost],
            velocity: self.velocities[ghost],
            mobility: self.masses_inverse[ghost],
            pull: self.pulls[ghost],
            path: self.paths[ghost],
            stiffness: self.springs[ghost],
            damping: self.dampers[ghost],
        })
    }

    /// Energy stored in the springs \[J\].
    fn stored(&self, external_nodes: &ExternalNodes<'_>, nodes: &[Point3<f64>]) -> f64 {
        let over = |node: u32, of: &[(u32, f64)]| {
            of.iter().fold(nodes[node as usize].coords, |sum, &(ghost, weight)| {
                sum - self.positions[ghost as usize].coords * weight
            })
        };
        let ties = external_nodes.ties.iter();
        let ties = ties.map(|tie| 0.5 * tie.stiffness * over(tie.node, &tie.ghost_nodes).norm_squared());
        let presses = external_nodes.presses.iter().map(|press| {
            let depth = press.thickness - press.normal.dot(&over(press.node, &press.ghost_nodes));
            0.5 * press.stiffness * depth.max(0.0).powi(2)
        });
        ties.sum::<f64>() + presses.sum::<f64>()
    }

    /// Increase of the springs' energy when a fraction of the position error is corrected \[J\].
    fn cost(&self, external_nodes: &ExternalNodes<'_>, nodes: &[Point3<f64>], share: f64) -> f64 {
        let place = |of: &[(u32, f64)]| -> [Vector3<f64>; 2] {
            of.iter().fold([Vector3::zeros(); 2], |[at, behind], &(ghost, weight)| {
                let ghost = ghost as usize;
                [at + self.positions[ghost].coords * weight, behind + self.behind[ghost] * weight]
            })
        };
        let ties = external_nodes.ties.iter().map(|tie| {
            let [at, behind] = place(&tie.ghost_nodes);
            let apart = nodes[tie.node as usize].coords - at;
            tie.stiffness * share * (0.5 * share * behind.norm_squared() - apart.dot(&behind))
        });
        let presses = external_nodes.presses.iter().map(|press| {
            let [at, behind] = place(&press.ghost_nodes);
            let depth = press.thickness - press.normal.dot(&(nodes[press.node as usize].coords - at));
            let then = depth + share * press.normal.dot(&behind);
            0.5 * press.stiffness * (then.max(0.0).powi(2) - depth.max(0.0).powi(2))
        });
        ties.sum::<f64>() + presses.sum::<f64>()
    }

    /// Ends a step of the faster body of `dt` seconds, with the ghost nodes' results and the energy that ties and
    /// contacts dissipated \[J\].
    pub fn end_step(&mut self, dt: f64, ghost_nodes: &[GhostMoved], lost: f64) {
        if self.past.len() == PAST_MAX {
            self.past.pop_front();
        }
        let given = ghost_nodes.iter().zip(0..).filter(|(after, _)| after.impulse != Vector3::zeros());
        self.past.push_back(UnreportedStep {
            dt,
            given: given.map(|(after, ghost)| (ghost, after.impulse)).collect(),
        });
        self.steps += 1;
        for (ghost, after) in ghost_nodes.iter().enumerate().take(self.count()) {
            self.positions[ghost] = after.position;
            self.velocities[ghost] = after.velocity;
            self.paths[ghost] = after.path;
            self.given[ghost] += after.impulse;
            self.exchanged += after.impulse.norm();
            self.work += after.work;
        }
        self.lost += lost;
        self.paid += self.tank().min(0.0) * (dt / FORGIVEN).min(1.0);
    }

    /// Checks it against a body with this many ghosts; all values must be finite.
    #[must_use]
    pub fn is_sound(&self, count: usize) -> bool {
        let vectors = [&self.velocities, &self.pulls, &self.behind, &self.given];
        let sums = [self.work, self.given_work, self.received, self.lost, self.paid, self.exchanged];
        let paths = self.paths.iter();
        let paths =
            paths.flat_map(|path| path.velocity.iter().chain(&path.acceleration).chain([&path.lasts]));
        let places = self.positions.iter().chain(self.paths.iter().map(|path| &path.position));
        let sizes = [&self.masses_inverse, &self.springs, &self.dampers];
        vectors.iter().all(|list| list.len() == count && list.iter().flatten().all(|x| x.is_finite()))
            && self.positions.len() == count
            && self.paths.len() == count
            && places.flat_map(|at| at.iter()).chain(paths).chain(&sums).all(|x| x.is_finite())
            && sizes.iter().all(|list| list.len() == count)
            && sizes.iter().all(|list| list.iter().all(|x| *x >= 0.0 && x.is_finite()))
    }
}

/// A node with the motion that the slower body predicts from the time of its report.
fn expect(report: &SlowBodyReport<'_>, node: usize) -> GhostNode {
    let (mass_inverse, velocity) = (report.masses_inverse[node], report.velocities[node]);
    let mobility = report.mobilities[node].min(mass_inverse);
    // A node whose mass nothing restrains continues its motion. A restrained node is at the equilibrium of its forces:
    // it takes its predicted velocity at once.
    let loose = if mass_inverse > 0.0 { mobility / mass_inverse } else { 1.0 };
    let change = report.expected[node] - velocity;
    let per_step = if report.step > 0.0 { report.step.recip() } else { 0.0 };
    let begin = velocity + change * (1.0 - loose);
    let held = if mobility > 0.0 { mobility.recip() - mass_inverse.recip() } else { 0.0 };
    GhostNode {
        position: report.positions[node],
        velocity: begin,
        mobility: if mobility > 0.0 { mass_inverse } else { 0.0 },
        // Balance of the last step's impulse: in equilibrium nothing moves.
        pull: report.last[node] * -per_step,
        path: PredictedPath {
            position: report.positions[node],
            velocity: begin,
            acceleration: change * (loose * per_step),
            lasts: report.step,
        },
        stiffness: held.max(0.0) * per_step * per_step,
        damping: damping(held.max(0.0), mass_inverse) * per_step,
    }
}

/// Damping of a ghost relative to its path, times the slower body's step h \[kg\]; `held` is K h² of the spring to the path
/// \[kg\].
///
/// The slower body's implicit step damps what is faster than the step; a ghost without that would swing on its ties between
/// two reports, and a report that arrives late would give its swing more energy each time. With this damper a constant force
/// takes the ghost, within a step, as far as it takes the slower body by backward Euler's rule: K h² / (m + K h²) of the
/// spring's equilibrium, which an overdamped one reaches by 1 − exp(−K h / c).
fn damping(held: f64, mass_inverse: f64) -> f64 {
    held / (held * mass_inverse).ln_1p().max(1.0)
}

fn finite<'a>(what: &'static str, values: impl IntoIterator<Item = &'a f64>) -> Result<(), GhostNodesError> {
    values.into_iter().all(|x| x.is_finite()).then_some(()).ok_or(GhostNodesError::Number(what))
}
