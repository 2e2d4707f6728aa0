//! Extended position-based dynamics with small steps (Macklin, Müller and Chentanez, *XPBD: position-based simulation of
//! compliant constrained dynamics*, 2016; Macklin et al., *Small steps in physics simulation*, 2019): distances with a real
//! stiffness, and volumes as two constraints per tetrahedron (Macklin and Müller, *A constraint-based formulation of
//! stable neo-Hookean materials*, 2021).
//!
//! Constraints are taken in groups that share no node, sequentially or on the rayon pool that the caller runs in: the bits
//! are the same.

mod colouring;
mod constraint;

pub use constraint::{Distance, Elasticity};

use nalgebra::{Point3, Vector3};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::mass_spring::{Faulty, NetworkError, NodeForce, Prescribed, State, StepError, check_elements};
use colouring::Colouring;
use constraint::{Move, Nodes, Tet};

/// Constraints of a group from which on threads are worth their while.
const PARALLEL: usize = 2048;

/// What a body is made of.
#[derive(Clone, Debug, Default)]
pub struct Body<'a> {
    /// Rest shape \[m\].
    pub rest: &'a [Point3<f64>],
    /// Mass of each node beside what tetrahedra give it \[kg\]; may be empty where all nodes have tetrahedra.
    pub masses: &'a [f64],
    /// Distances.
    pub distances: &'a [Distance],
    /// Tetrahedra, positively oriented.
    pub tets: &'a [[u32; 4]],
    /// Of the tetrahedra.
    pub elasticity: Option<Elasticity>,
}

/// How a body is stepped.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct XpbdConfig {
    /// Equal parts of a step, 1 to 1000.
    pub parts: u32,
    /// Iterations over all constraints in each part, 1 to 1000. Small steps want 1.
    pub iterations: u32,
    /// Damping of every motion \[1/s\].
    pub damping: f64,
    /// Speed \[m/s\] above which a node has lost its way.
    pub speed_max: f64,
}

impl Default for XpbdConfig {
    fn default() -> Self {
        Self { parts: 10, iterations: 1, damping: 0.0, speed_max: 100.0 }
    }
}

/// What acts during one step.
#[derive(Clone, Copy, Debug, Default)]
pub struct XpbdInput<'a> {
    /// Acceleration of everything \[m/s²\].
    pub gravity: Vector3<f64>,
    /// Forces on nodes.
    pub forces: &'a [NodeForce],
    /// Nodes that are led, moving evenly.
    pub prescribed: &'a [Prescribed],
}

/// The solver.
#[derive(Clone, Debug)]
pub struct Xpbd {
    config: XpbdConfig,
    state: State,
    mobility: Vec<f64>,
    distances: Vec<Distance>,
    distance_groups: Colouring,
    tets: Vec<Tet>,
    tet_groups: Colouring,
    scratch: Scratch,
}

#[derive(Clone, Debug, Default)]
struct Scratch {
    next: State,
    before: Vec<Point3<f64>>,
    mobility: Vec<f64>,
    forces: Vec<Vector3<f64>>,
    distance_multipliers: Vec<[f64; 2]>,
    tet_multipliers: Vec<[f64; 2]>,
    moves: Vec<Move>,
}

impl Xpbd {
    /// At rest in its rest shape, the listed nodes pinned.
    ///
    /// # Errors
    /// Whatever is wrong with mesh, material or configuration, elements by their index.
    pub fn new(body: &Body<'_>, pinned: &[u32], config: XpbdConfig) -> Result<Self, NetworkError> {
        let nodes = body.rest.len();
        let invalid = |what, value, valid| Err(NetworkError::Parameter { what, value, valid });
        for (what, value) in [("parts", config.parts), ("iterations", config.iterations)] {
            if !(1..=1000).contains(&value) {
                return invalid(what, f64::from(value), "1 to 1000");
            }
        }
        for (what, value) in [("damping", config.damping), ("speed_max", config.speed_max)] {
            if !(value >= 0.0 && value.is_finite()) {
                return invalid(what, value, "0 or more and finite");
            }
        }
        let pairs: Vec<[u32; 2]> = body.distances.iter().map(|distance| distance.nodes).collect();
        check_elements("distance", body.rest, &pairs)?;
        check_elements("tetrahedron", body.rest, body.tets)?;
        Faulty::among(body.distances.len(), |index| {
            let Distance { rest, compliance, .. } = body.distances[index];
            ![rest, compliance].iter().all(|value| *value >= 0.0 && value.is_finite())
        })
        .refuse(|faulty| NetworkError::Numbers { kind: "distance", faulty })?;
        let mut masses = body.masses.to_vec();
        if !masses.is_empty() && masses.len() != nodes {
            return Err(NetworkError::Length { what: "masses", given: masses.len(), expected: nodes });
        }
        masses.resize(nodes, 0.0);
        let mut tets = Vec::with_capacity(body.tets.len());
        if let Some(elasticity) = &body.elasticity {
            let Elasticity { young_modulus, poisson_ratio, density } = *elasticity;
            if !(young_modulus > 0.0 && young_modulus.is_finite()) {
                return invalid("young_modulus", young_modulus, "above 0 and finite");
            } else if !(0.0..0.5).contains(&poisson_ratio) {
                return invalid("poisson_ratio", poisson_ratio, "0 to below 0.5");
            } else if !(density > 0.0 && density.is_finite()) {
                return invalid("density", density, "above 0 and finite");
            }
            let volume = |tet: &[u32; 4]| {
                let [a, b, c, d] = tet.map(|node| body.rest[node as usize]);
                (b - a).cross(&(c - a)).dot(&(d - a)) / 6.0
            };
            Faulty::among(body.tets.len(), |index| volume(&body.tets[index]) <= 1e-30)
                .refuse(|faulty| NetworkError::NoExtent { kind: "tetrahedron", faulty })?;
            for tet in body.tets {
                let share = 0.25 * density * volume(tet);
                tet.iter().for_each(|&node| masses[node as usize] += share);
                tets.push(Tet::new(*tet, body.rest, elasticity));
            }
        } else if !body.tets.is_empty() {
            return invalid("elasticity", 0.0, "given where there are tetrahedra");
        }
        Faulty::among(nodes, |node| !(masses[node] > 0.0 && masses[node].is_finite()))
            .refuse(NetworkError::Masses)?;
        Faulty::among(pinned.len(), |index| pinned[index] as usize >= nodes)
            .refuse(|faulty| NetworkError::Nodes { kind: "pin", nodes, faulty })?;
        let mut mobility: Vec<f64> = masses.iter().map(|mass| 1.0 / mass).collect();
        pinned.iter().for_each(|&node| mobility[node as usize] = 0.0);
        let state = State { positions: body.rest.to_vec(), velocities: vec![Vector3::zeros(); nodes] };
        Ok(Self {
            config,
            state,
            mobility,
            distance_groups: Colouring::new(nodes, &pairs),
            distances: body.distances.to_vec(),
            tet_groups: Colouring::new(nodes, body.tets),
            tets,
            scratch: Scratch::default(),
        })
    }

    /// Continues from a state, bit for bit.
    ///
    /// # Errors
    /// When it is of another body, or not finite; nothing has changed then.
    pub fn restore(&mut self, state: State) -> Result<(), NetworkError> {
        crate::mass_spring::check_state(&state, self.mobility.len())?;
        self.state = state;
        Ok(())
    }

    /// Where every node is, and how it moves.
    #[must_use]
    pub fn state(&self) -> &State {
        &self.state
    }
    /// Tetrahedra that are inside out.
    #[must_use]
    pub fn inverted(&self) -> Faulty {
        Faulty::among(self.tets.len(), |index| self.tets[index].volume_ratio(&self.state.positions) <= 0.0)
    }

    /// Steps by `dt` seconds.
    ///
    /// # Errors
    /// When the input is wrong or the result not finite or too fast; the state is then as it was.
    pub fn step(&mut self, dt: f64, input: &XpbdInput<'_>) -> Result<(), StepError> {
        if !(dt > 0.0 && dt.is_finite()) {
            return Err(StepError::Time(dt));
        }
        let nodes = self.mobility.len();
        let wrong = |what, index, problem| Err(StepError::Input { what, index, problem });
        for (index, force) in input.forces.iter().enumerate() {
            if force.node as usize >= nodes {
                return wrong("force", index, "names a node that does not exist");
            }
        }
        for (index, led) in input.prescribed.iter().enumerate() {
            if led.node as usize >= nodes {
                return wrong("prescribed node", index, "does not exist");
            }
        }
        let scratch = &mut self.scratch;
        scratch.next.positions.clone_from(&self.state.positions);
        scratch.next.velocities.clone_from(&self.state.velocities);
        scratch.mobility.clone_from(&self.mobility);
        scratch.forces.clear();
        scratch.forces.resize(nodes, Vector3::zeros());
        input.forces.iter().for_each(|force| scratch.forces[force.node as usize] += force.force);
        for led in input.prescribed {
            scratch.mobility[led.node as usize] = 0.0;
            let way = led.position - self.state.positions[led.node as usize];
            scratch.next.velocities[led.node as usize] = way / dt;
        }
        let part = dt / f64::from(self.config.parts);
        for _ in 0..self.config.parts {
            self.part(part, input);
        }
        let next = &mut self.scratch.next;
        for led in input.prescribed {
            next.positions[led.node as usize] = led.position;
        }
        let limit = self.config.speed_max;
        for (node, (position, velocity)) in next.positions.iter().zip(&next.velocities).enumerate() {
            let (node, speed) = (node as u32, velocity.norm());
            if !(speed.is_finite() && position.iter().all(|value| value.is_finite())) {
                return Err(StepError::NotFinite { node });
            }
            if speed > limit && self.scratch.mobility[node as usize] > 0.0 {
                return Err(StepError::Runaway { node, speed, limit });
            }
        }
        std::mem::swap(&mut self.state, next);
        Ok(())
    }

    fn part(&mut self, h: f64, input: &XpbdInput<'_>) {
        let scratch = &mut self.scratch;
        let State { positions, velocities } = &mut scratch.next;
        scratch.before.clone_from(positions);
        let kept = 1.0 / (1.0 + h * self.config.damping);
        for (node, velocity) in velocities.iter_mut().enumerate() {
            let mobility = scratch.mobility[node];
            if mobility > 0.0 {
                *velocity = (*velocity + (input.gravity + scratch.forces[node] * mobility) * h) * kept;
            } else if self.mobility[node] == 0.0
                && !input.prescribed.iter().any(|led| led.node as usize == node)
            {
                *velocity = Vector3::zeros();
            }
            positions[node] += *velocity * h;
        }
        for (multipliers, count) in [
            (&mut scratch.distance_multipliers, self.distances.len()),
            (&mut scratch.tet_multipliers, self.tets.len()),
        ] {
            multipliers.clear();
            multipliers.resize(count, [0.0; 2]);
        }
        let mut nodes = Nodes { positions, mobility: &scratch.mobility, rate: 1.0 / (h * h) };
        let (distances, tets, moves) = (&self.distances, &self.tets, &mut scratch.moves);
        for _ in 0..self.config.iterations {
            let of = |index: u32| distances[index as usize].nodes;
            let project = |index: u32, nodes: &Nodes<'_>, multipliers: [f64; 2]| {
                distances[index as usize].project(nodes, multipliers[0])
            };
            sweep(&self.distance_groups, &mut scratch.distance_multipliers, &mut nodes, moves, of, project);
            let of = |index: u32| tets[index as usize].nodes;
            let project =
                |index: u32, nodes: &Nodes<'_>, multipliers| tets[index as usize].project(nodes, multipliers);
            sweep(&self.tet_groups, &mut scratch.tet_multipliers, &mut nodes, moves, of, project);
        }
        for ((velocity, position), (before, mobility)) in
            velocities.iter_mut().zip(positions.iter()).zip(scratch.before.iter().zip(&scratch.mobility))
        {
            if *mobility > 0.0 {
                *velocity = (position - before) / h;
            }
        }
    }
}

/// All constraints of a kind once, group by group.
fn sweep<const N: usize>(
    groups: &Colouring,
    multipliers: &mut [[f64; 2]],
    nodes: &mut Nodes<'_>,
    moves: &mut Vec<Move>,
    of: impl Fn(u32) -> [u32; N],
    project: impl Fn(u32, &Nodes<'_>, [f64; 2]) -> Move + Sync,
) {
    let apply = |index: u32, moved: &Move, nodes: &mut Nodes<'_>, multipliers: &mut [[f64; 2]]| {
        multipliers[index as usize] = moved.multipliers;
        for (node, by) in of(index).into_iter().zip(&moved.by) {
            nodes.positions[node as usize] += by;
        }
    };
    let mut from = 0;
    for &end in &groups.ends {
        let group = &groups.order[from..end];
        from = end;
        if group.len() >= PARALLEL && rayon::current_num_threads() > 1 {
            let (seen, known): (&Nodes<'_>, &[[f64; 2]]) = (nodes, multipliers);
            group
                .par_iter()
                .map(|&index| project(index, seen, known[index as usize]))
                .collect_into_vec(moves);
            for (&index, moved) in group.iter().zip(moves.iter()) {
                apply(index, moved, nodes, multipliers);
            }
        } else {
            for &index in group {
                let moved = project(index, nodes, multipliers[index as usize]);
                apply(index, &moved, nodes, multipliers);
            }
        }
    }
}
