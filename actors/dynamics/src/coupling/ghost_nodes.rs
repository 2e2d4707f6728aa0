//! Nodes of a slower body as a faster one meets them between two steps of it.

use std::collections::VecDeque;

use nalgebra::{Point3, Vector3};
use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::external_nodes::{ExternalNodes, GhostMoved, GhostNode, Path};

/// Steps that are remembered at most.
const PAST_MAX: usize = 512;
/// In this time most of what the tank lacks is forgiven, as any body loses more by itself \[s\].
const FORGIVEN: f64 = 0.5;
/// Halvings of how far ghosts are put right, where not all of it can be paid.
const HALVINGS: u32 = 16;

/// Why news were not taken; the ghosts are as they were.
#[derive(Clone, Copy, Debug, Error, PartialEq)]
pub enum GhostsError {
    /// Lists of another length.
    #[error("{what} of {found} nodes: there are {expected} ghosts")]
    Size {
        /// What it is.
        what: &'static str,
        /// Of how many it came.
        found: usize,
        /// Ghosts there are.
        expected: usize,
    },
    /// A number that is none, or out of range.
    #[error("{0} is not a finite number, or below 0")]
    Number(&'static str),
}

/// What the slower body tells after a step, of the nodes that have ghosts.
#[derive(Clone, Copy, Debug)]
pub struct News<'a> {
    /// Where they are \[m\].
    pub positions: &'a [Point3<f64>],
    /// How they move \[m/s\].
    pub velocities: &'a [Vector3<f64>],
    /// How they would move after one more step in which they take what they took in the last \[m/s\].
    pub expected: &'a [Vector3<f64>],
    /// How much faster they would move for each impulse more \[1/kg\]; 0 for one that is held. Rather too much than too little.
    pub mobilities: &'a [f64],
    /// The same without anything that holds them back but their masses \[1/kg\].
    pub masses_inverse: &'a [f64],
    /// What each took in the last step \[N·s\].
    pub last: &'a [Vector3<f64>],
    /// [`Ghosts::work`] when it last took something \[J\].
    pub given_work: f64,
    /// Work that all it took so far has done on it \[J\].
    pub received: f64,
    /// [`Ghosts::steps`] when it last took something.
    pub steps: u64,
    /// Length of its steps \[s\].
    pub step: f64,
}

/// A step of the faster body that the slower one has not been heard of since.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
struct Past {
    /// How long it was \[s\].
    dt: f64,
    /// What ghosts were given in it \[N·s\]; those that were given nothing left out.
    given: Vec<(u32, Vector3<f64>)>,
}

/// Everything is in one frame that does not turn.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Ghosts {
    positions: Vec<Point3<f64>>,
    velocities: Vec<Vector3<f64>>,
    masses_inverse: Vec<f64>,
    /// What the slower body does to each if nothing changes: its path, a pull \[N\], a spring to the path \[N/m\].
    paths: Vec<Path>,
    pulls: Vec<Vector3<f64>>,
    springs: Vec<f64>,
    /// How far each has to go to be where its node is \[m\].
    behind: Vec<Vector3<f64>>,
    given: Vec<Vector3<f64>>,
    /// Steps so far, and the last of them, the oldest first.
    steps: u64,
    past: VecDeque<Past>,
    /// Work done on the ghosts so far, and how much of that the slower body has taken the impulses of \[J\].
    work: f64,
    given_work: f64,
    /// What that was to it \[J\].
    received: f64,
    /// What dampers and friction took \[J\].
    lost: f64,
    /// What it has cost to put ghosts right \[J\].
    paid: f64,
    /// Sum of the magnitudes of all impulses so far \[N·s\].
    exchanged: f64,
}

impl Ghosts {
    /// Of nodes that are here \[m\], at rest; until something is heard of them nothing moves them.
    ///
    /// # Errors
    /// A place that is none.
    pub fn new(positions: &[Point3<f64>]) -> Result<Self, GhostsError> {
        let mut ghosts = Self::default();
        ghosts.more(positions)?;
        Ok(ghosts)
    }

    /// More nodes, behind those there are.
    ///
    /// # Errors
    /// A place that is none.
    pub fn more(&mut self, positions: &[Point3<f64>]) -> Result<(), GhostsError> {
        finite("a place", positions.iter().flat_map(|at| at.iter()))?;
        self.positions.extend_from_slice(positions);
        let count = self.positions.len();
        let still = positions.iter().map(|position| Path { position: *position, ..Path::default() });
        self.paths.extend(still);
        self.masses_inverse.resize(count, 0.0);
        self.springs.resize(count, 0.0);
        for list in [&mut self.velocities, &mut self.pulls, &mut self.behind, &mut self.given] {
            list.resize(count, Vector3::zeros());
        }
        Ok(())
    }

    /// How many there are.
    #[must_use]
    pub fn count(&self) -> usize {
        self.positions.len()
    }

    /// Where they are \[m\].
    #[must_use]
    pub fn positions(&self) -> &[Point3<f64>] {
        &self.positions
    }

    /// How they move \[m/s\].
    #[must_use]
    pub fn velocities(&self) -> &[Vector3<f64>] {
        &self.velocities
    }

    /// All that each was given so far \[N·s\]: the slower body takes what of that it has not taken.
    #[must_use]
    pub fn given(&self) -> &[Vector3<f64>] {
        &self.given
    }

    /// Steps of the faster body so far.
    #[must_use]
    pub fn steps(&self) -> u64 {
        self.steps
    }

    /// Work done on them so far \[J\].
    #[must_use]
    pub fn work(&self) -> f64 {
        self.work
    }

    /// Sum of the magnitudes of all impulses so far \[N·s\].
    #[must_use]
    pub fn exchanged(&self) -> f64 {
        self.exchanged
    }

    /// What may be spent on putting them right \[J\]. Of the work on them only that counts of which is known what it was to
    /// the slower body.
    #[must_use]
    pub fn tank(&self) -> f64 {
        self.lost + self.given_work - self.received - self.paid
    }

    /// How far the one is from its node that is furthest away \[m\].
    #[must_use]
    pub fn furthest_behind(&self) -> f64 {
        self.behind.iter().map(|behind| behind.norm()).fold(0.0, f64::max)
    }

    /// How far each has to go to be where its node is \[m\].
    #[must_use]
    pub fn behind(&self) -> &[Vector3<f64>] {
        &self.behind
    }

    /// They have gone such a share of that within a step of the faster body, beside what [`met`](Self::met) is told of it.
    pub fn caught_up(&mut self, share: f64) {
        self.behind.iter_mut().for_each(|behind| *behind *= 1.0 - share);
    }

    /// Takes what the slower body tells after a step.
    ///
    /// # Errors
    /// Lists of another length, numbers that are none.
    pub fn hear(&mut self, news: &News<'_>) -> Result<(), GhostsError> {
        let expected = self.count();
        for (what, found) in [
            ("places", news.positions.len()),
            ("velocities", news.velocities.len()),
            ("mobilities", news.mobilities.len()),
            ("masses", news.masses_inverse.len()),
            ("expected velocities", news.expected.len()),
            ("impulses", news.last.len()),
        ] {
            if found != expected {
                return Err(GhostsError::Size { what, found, expected });
            }
        }
        finite("a place", news.positions.iter().flat_map(|at| at.iter()))?;
        finite("a velocity", news.velocities.iter().chain(news.expected).flatten())?;
        finite("an impulse", news.last.iter().flatten())?;
        finite("a work", [news.given_work, news.received].iter())?;
        let mut positive = news.mobilities.iter().chain(news.masses_inverse).chain([&news.step]);
        if !positive.all(|value| *value >= 0.0 && value.is_finite()) {
            return Err(GhostsError::Number("a time or a mobility"));
        }
        // What it has not taken yet happens to the ghosts once more, from where it begins.
        let since = self.steps.saturating_sub(news.steps) as usize;
        self.past.drain(..self.past.len().saturating_sub(since));
        let mut guests: Vec<GhostNode> = (0..expected).map(|node| expect(news, node)).collect();
        for Past { dt, given } in &self.past {
            let mut given = given.iter().peekable();
            for (ghost, guest) in guests.iter_mut().enumerate() {
                let impulse = given.next_if(|(of, _)| *of as usize == ghost).map(|(_, impulse)| *impulse);
                guest.go(*dt, &impulse.unwrap_or_default());
            }
        }
        for (ghost, guest) in guests.into_iter().enumerate() {
            self.behind[ghost] = guest.position - self.positions[ghost];
            self.velocities[ghost] = guest.velocity;
            self.masses_inverse[ghost] = guest.mobility;
            self.pulls[ghost] = guest.pull;
            self.springs[ghost] = guest.stiffness;
            self.paths[ghost] = guest.path;
        }
        (self.given_work, self.received) = (news.given_work, news.received);
        Ok(())
    }

    /// A step of the faster body is due: puts the ghosts right as far as that can be paid, and adds them to the guests. Ties
    /// and presses name ghosts by their numbers here, `nodes` are the faster body's nodes where they are \[m\].
    pub fn meet(&mut self, company: &ExternalNodes<'_>, nodes: &[Point3<f64>], guests: &mut Vec<GhostNode>) {
        // What it holds beyond what the springs do now is no use, and not all of it was motion once: what pulls a light node
        // and what holds it undo each other in every step.
        self.paid += (self.tank() - self.stored(company, nodes)).max(0.0);
        let tank = self.tank().max(0.0);
        let mut share = 1.0;
        if self.cost(company, nodes, share) > tank {
            let mut more = 1.0;
            share = 0.0;
            for _ in 0..HALVINGS {
                more *= 0.5;
                if self.cost(company, nodes, share + more) <= tank {
                    share += more;
                }
            }
        }
        self.paid += self.cost(company, nodes, share);
        for (position, behind) in self.positions.iter_mut().zip(&mut self.behind) {
            *position += *behind * share;
            *behind *= 1.0 - share;
        }
        guests.extend(self.guests());
    }

    /// As they are now, as guests.
    pub fn guests(&self) -> impl Iterator<Item = GhostNode> {
        (0..self.count()).map(|ghost| GhostNode {
            position: self.positions[ghost],
            velocity: self.velocities[ghost],
            mobility: self.masses_inverse[ghost],
            pull: self.pulls[ghost],
            path: self.paths[ghost],
            stiffness: self.springs[ghost],
        })
    }

    /// What springs hold \[J\].
    fn stored(&self, company: &ExternalNodes<'_>, nodes: &[Point3<f64>]) -> f64 {
        let over = |node: u32, of: &[(u32, f64)]| {
            of.iter().fold(nodes[node as usize].coords, |sum, &(ghost, weight)| {
                sum - self.positions[ghost as usize].coords * weight
            })
        };
        let ties = company.ties.iter();
        let ties = ties.map(|tie| 0.5 * tie.stiffness * over(tie.node, &tie.guests).norm_squared());
        let presses = company.presses.iter().map(|press| {
            let depth = press.thickness - press.normal.dot(&over(press.node, &press.guests));
            0.5 * press.stiffness * depth.max(0.0).powi(2)
        });
        ties.sum::<f64>() + presses.sum::<f64>()
    }

    /// What springs hold more when ghosts are put right by so much \[J\].
    fn cost(&self, company: &ExternalNodes<'_>, nodes: &[Point3<f64>], share: f64) -> f64 {
        let place = |of: &[(u32, f64)]| -> [Vector3<f64>; 2] {
            of.iter().fold([Vector3::zeros(); 2], |[at, behind], &(ghost, weight)| {
                let ghost = ghost as usize;
                [at + self.positions[ghost].coords * weight, behind + self.behind[ghost] * weight]
            })
        };
        let ties = company.ties.iter().map(|tie| {
            let [at, behind] = place(&tie.guests);
            let apart = nodes[tie.node as usize].coords - at;
            tie.stiffness * share * (0.5 * share * behind.norm_squared() - apart.dot(&behind))
        });
        let presses = company.presses.iter().map(|press| {
            let [at, behind] = place(&press.guests);
            let depth = press.thickness - press.normal.dot(&(nodes[press.node as usize].coords - at));
            let then = depth + share * press.normal.dot(&behind);
            0.5 * press.stiffness * (then.max(0.0).powi(2) - depth.max(0.0).powi(2))
        });
        ties.sum::<f64>() + presses.sum::<f64>()
    }

    /// The faster body has made its step of `dt` seconds: what became of the ghosts as guests, and what its ties and presses
    /// lost \[J\].
    pub fn met(&mut self, dt: f64, guests: &[GhostMoved], lost: f64) {
        if self.past.len() == PAST_MAX {
            self.past.pop_front();
        }
        let given = guests.iter().zip(0..).filter(|(after, _)| after.impulse != Vector3::zeros());
        self.past.push_back(Past { dt, given: given.map(|(after, ghost)| (ghost, after.impulse)).collect() });
        self.steps += 1;
        for (ghost, after) in guests.iter().enumerate().take(self.count()) {
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

    /// Whether it fits a body of so many ghosts, with numbers that are some.
    #[must_use]
    pub fn is_sound(&self, count: usize) -> bool {
        let vectors = [&self.velocities, &self.pulls, &self.behind, &self.given];
        let sums = [self.work, self.given_work, self.received, self.lost, self.paid, self.exchanged];
        let paths = self.paths.iter();
        let paths =
            paths.flat_map(|path| path.velocity.iter().chain(&path.acceleration).chain([&path.lasts]));
        let places = self.positions.iter().chain(self.paths.iter().map(|path| &path.position));
        let sizes = [&self.masses_inverse, &self.springs];
        vectors.iter().all(|list| list.len() == count && list.iter().flatten().all(|x| x.is_finite()))
            && self.positions.len() == count
            && self.paths.len() == count
            && places.flat_map(|at| at.iter()).chain(paths).chain(&sums).all(|x| x.is_finite())
            && sizes.iter().all(|list| list.len() == count)
            && sizes.iter().all(|list| list.iter().all(|x| *x >= 0.0 && x.is_finite()))
    }
}

/// A node as the slower body expects it to move, from the moment of which it tells.
fn expect(news: &News<'_>, node: usize) -> GhostNode {
    let (mass_inverse, velocity) = (news.masses_inverse[node], news.velocities[node]);
    let mobility = news.mobilities[node].min(mass_inverse);
    // A mass that nothing else holds goes on as it moves. One that is held is wherever the forces on it balance: it moves at
    // once as it is expected to.
    let loose = if mass_inverse > 0.0 { mobility / mass_inverse } else { 1.0 };
    let change = news.expected[node] - velocity;
    let per_step = if news.step > 0.0 { news.step.recip() } else { 0.0 };
    let begin = velocity + change * (1.0 - loose);
    let held = if mobility > 0.0 { mobility.recip() - mass_inverse.recip() } else { 0.0 };
    GhostNode {
        position: news.positions[node],
        velocity: begin,
        mobility: if mobility > 0.0 { mass_inverse } else { 0.0 },
        // It is held against what it took in the last step: nothing moves where the two are in balance.
        pull: news.last[node] * -per_step,
        path: Path {
            position: news.positions[node],
            velocity: begin,
            acceleration: change * (loose * per_step),
            lasts: news.step,
        },
        stiffness: held.max(0.0) * per_step * per_step,
    }
}

fn finite<'a>(what: &'static str, values: impl IntoIterator<Item = &'a f64>) -> Result<(), GhostsError> {
    values.into_iter().all(|x| x.is_finite()).then_some(()).ok_or(GhostsError::Number(what))
}
