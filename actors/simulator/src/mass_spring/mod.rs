//! Mass-spring: threads, cloth, tubes and volumes as one network of masses, springs and hinges ([`Network`]), stepped
//! explicitly (symplectic Euler) or implicitly (backward Euler; Baraff and Witkin, *Large steps in cloth simulation*,
//! 1998, with springs whose stiffness matrix is never indefinite).
//!
//! Nodes can be pinned, prescribed (a jaw holds them) or pressed by contacts, whose forces on the network are told for
//! the other side to bear. The explicit method knows the largest step that is safe in any shape and refuses larger ones
//! or takes them in parts; the implicit one takes any step, and its numerical damping grows with it.

mod contact;
mod error;
mod explicit;
mod forces;
mod implicit;
mod matrix;
mod network;
pub(crate) mod remesh;
pub(crate) mod stability;
pub(crate) mod surface_network;

pub use contact::Contact;
pub use error::NetworkError;
pub use network::{Hinge, LineMaterial, Network, Spring, SurfaceMaterial, VolumeMaterial};
pub use remesh::{Edits, Followed, Patch};

pub(crate) use contact::check as check_contacts;
pub(crate) use forces::NEARLY_FLAT;
pub(crate) use network::check_elements;
pub(crate) use surface_network::area;

use nalgebra::{Point3, Vector3};
use serde::{Deserialize, Serialize};
use trocar_dynamics::faulty::Faulty;
use trocar_dynamics::particles::{State, StepError};

use implicit::Implicit;
pub use implicit::SheetFactor;
use stability::Bound;

/// What to do with a step that is larger than is safe.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum TooLarge {
    /// An error that names the safe one.
    Refuse,
    /// Take it in equal parts, at most so many.
    Divide {
        /// The limit; beyond it the step is refused.
        most: u32,
    },
    /// Take it as it is. What blows up is found by its speed and refused then.
    Accept,
}

/// How an implicit step's linear system is solved.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum LinearSolver {
    /// Conjugate gradients without forming the matrix, the nodes' own blocks as preconditioner.
    ConjugateGradients {
        /// Residual at which it ends, of the one it began with.
        tolerance: f64,
        /// Iterations at most; the step is taken with what has been reached.
        iterations_max: u32,
    },
    /// Conjugate gradients, the factor of the matrix at rest as preconditioner, turned with each node's surroundings:
    /// on a sheet an order of magnitude fewer iterations than the other while a step is short (at 1 ms; where a wrinkled
    /// sheet makes steps of 10 ms the other needs fewer). The factor is made anew when pins or step change; a network that
    /// has changed goes on with the nodes' own blocks until it is given one ([`MassSpring::take_factor`]). For networks
    /// that a mesh made: others do not know their shape at rest, and fall back to the nodes' blocks.
    Warped {
        /// Residual at which it ends, of the one it began with, in the norm of the preconditioner.
        tolerance: f64,
        /// Iterations at most; the step is taken with what has been reached.
        iterations_max: u32,
    },
    /// Sparse Cholesky factorisation; what depends on the network alone is done once.
    Cholesky,
}

/// How to step.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Integrator {
    /// Symplectic Euler.
    Explicit {
        /// What to do with large steps.
        too_large: TooLarge,
    },
    /// Backward Euler.
    Implicit {
        /// For the linear system.
        solver: LinearSolver,
        /// Newton iterations, 1 to 50; one is Baraff and Witkin's method.
        newton: u32,
    },
}

/// How a network is stepped.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Config {
    /// The method.
    pub integrator: Integrator,
    /// Damping along springs and hinges: the time \[s\] by which their force follows their lengthening (Kelvin–Voigt).
    pub lag: f64,
    /// Damping of every motion \[1/s\].
    pub damping: f64,
    /// Speed \[m/s\] above which a node has lost its way.
    pub speed_max: f64,
}

impl Default for Config {
    fn default() -> Self {
        let too_large = TooLarge::Divide { most: 100 };
        Self { integrator: Integrator::Explicit { too_large }, lag: 0.0, damping: 0.0, speed_max: 100.0 }
    }
}

/// A force on a node for one step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NodeForce {
    /// Which node.
    pub node: u32,
    /// \[N\].
    pub force: Vector3<f64>,
}

/// Where a node has to be at the end of a step, moving there evenly.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Prescribed {
    /// Which node.
    pub node: u32,
    /// \[m\].
    pub position: Point3<f64>,
}

/// What acts on the network during one step.
#[derive(Clone, Copy, Debug, Default)]
pub struct Input<'a> {
    /// Acceleration of everything \[m/s²\].
    pub gravity: Vector3<f64>,
    /// Forces on nodes.
    pub forces: &'a [NodeForce],
    /// Nodes that are led; of two entries for one node the last counts.
    pub prescribed: &'a [Prescribed],
    /// Contacts.
    pub contacts: &'a [Contact],
}

/// How a step went.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Report {
    /// Parts in which it was taken.
    pub parts: u32,
    /// The largest safe explicit step under its contacts \[s\]; infinite for the implicit method.
    pub safe_step: f64,
    /// Iterations of the linear solver, of all Newton iterations.
    pub iterations: u32,
    /// What remains of the linear system, of the right-hand side of its last Newton iteration.
    pub residual: f64,
}

/// The solver.
#[derive(Clone, Debug)]
pub struct MassSpring {
    network: Network,
    config: Config,
    state: State,
    pinned: Vec<u32>,
    /// One over each node's mass, 0 where it is pinned \[1/kg\].
    mobility: Vec<f64>,
    bound: Bound,
    scratch: Scratch,
    implicit: Option<Box<Implicit>>,
}

/// Room for a step.
#[derive(Clone, Debug, Default)]
struct Scratch {
    next: State,
    forces: Vec<Vector3<f64>>,
    /// As [`MassSpring::mobility`], 0 also where a node is led.
    mobility: Vec<f64>,
    /// Velocities of the nodes that are led, in the order of the input.
    led: Vec<Vector3<f64>>,
    /// Where each contact's point began.
    touched: Vec<Vector3<f64>>,
    contact_forces: Vec<Vector3<f64>>,
    meeting: Vec<f64>,
}

impl MassSpring {
    /// At rest where the positions are, the listed nodes pinned.
    ///
    /// # Errors
    /// Whatever is wrong with the network, the positions or the configuration.
    pub fn new(
        network: Network,
        positions: Vec<Point3<f64>>,
        pinned: &[u32],
        config: Config,
    ) -> Result<Self, NetworkError> {
        let velocities = vec![Vector3::zeros(); positions.len()];
        Self::restore(network, State { positions, velocities }, pinned, config)
    }

    /// Continues from a state, bit for bit where its network is the one that led there.
    ///
    /// # Errors
    /// As [`new`](Self::new).
    pub fn restore(
        network: Network,
        state: State,
        pinned: &[u32],
        config: Config,
    ) -> Result<Self, NetworkError> {
        check_config(&config)?;
        network.check(network.masses.len())?;
        check_state(&state, network.masses.len())?;
        let mut solver = Self {
            network,
            config,
            state,
            pinned: Vec::new(),
            mobility: Vec::new(),
            bound: Bound::default(),
            scratch: Scratch::default(),
            implicit: None,
        };
        solver.pin(pinned)?;
        Ok(solver)
    }

    /// Pins these nodes where they are, and no others.
    ///
    /// # Errors
    /// When one of them does not exist.
    pub fn pin(&mut self, pinned: &[u32]) -> Result<(), NetworkError> {
        let nodes = self.network.masses.len();
        Faulty::among(pinned.len(), |index| pinned[index] as usize >= nodes)
            .refuse(|faulty| NetworkError::Nodes { kind: "pin", nodes, faulty })?;
        self.pinned = pinned.to_vec();
        self.pinned.sort_unstable();
        self.pinned.dedup();
        self.refresh();
        Ok(())
    }

    /// Derives what depends on network and pins.
    fn refresh(&mut self) {
        let nodes = self.network.masses.len();
        self.mobility.clear();
        self.mobility.extend(self.network.masses.iter().map(|mass| 1.0 / mass));
        for &node in &self.pinned {
            self.mobility[node as usize] = 0.0;
            self.state.velocities[node as usize] = Vector3::zeros();
        }
        self.bound = Bound::new(&self.network, &self.mobility);
        self.scratch.forces.resize(nodes, Vector3::zeros());
        self.scratch.next = self.state.clone();
        self.implicit = match self.config.integrator {
            Integrator::Explicit { .. } => None,
            Integrator::Implicit { solver, .. } => Some(Box::new(Implicit::new(&self.network, solver))),
        };
    }

    /// Solves implicit steps in another way from now on; explicit ones have nothing to solve.
    ///
    /// # Errors
    /// A tolerance or a limit that is none; it goes on as before.
    pub fn solve_by(&mut self, by: LinearSolver) -> Result<(), NetworkError> {
        let Integrator::Implicit { newton, .. } = self.config.integrator else { return Ok(()) };
        let config = Config { integrator: Integrator::Implicit { solver: by, newton }, ..self.config };
        check_config(&config)?;
        self.config = config;
        self.implicit = Some(Box::new(Implicit::new(&self.network, by)));
        Ok(())
    }

    /// Follows a mesh that has changed where it has: `update` brings the network up to date by its mesh, `carry` gives new nodes
    /// a state (and those that have moved at rest another one), `stays` says which nodes are pinned. What it is then it would
    /// be if it were made of the whole mesh.
    ///
    /// # Errors
    /// What `update` refuses; the solver is then as it was. A state that does not fit.
    pub fn follow<const N: usize>(
        &mut self,
        patch: &Patch<'_, N>,
        stays: impl Fn(u32) -> bool,
        carry: impl FnOnce(&mut State),
        update: impl FnOnce(&mut Network, &Patch<'_, N>) -> Result<Followed, NetworkError>,
    ) -> Result<Followed, NetworkError> {
        let followed = update(&mut self.network, patch)?;
        carry(&mut self.state);
        let nodes = self.network.masses.len();
        let State { positions, velocities } = &mut self.state;
        for (what, given) in [("positions", positions.len()), ("velocities", velocities.len())] {
            if given != nodes {
                return Err(NetworkError::Length { what, given, expected: nodes });
            }
        }
        self.mobility.resize(nodes, 0.0);
        for &node in patch.stale {
            let (at, stays) = (self.pinned.binary_search(&node), stays(node));
            match at {
                Err(at) if stays => self.pinned.insert(at, node),
                Ok(at) if !stays => drop(self.pinned.remove(at)),
                _ => {}
            }
            let index = node as usize;
            self.mobility[index] = if stays { 0.0 } else { 1.0 / self.network.masses[index] };
            if stays {
                velocities[index] = Vector3::zeros();
            }
        }
        let nodes = followed.nodes(&self.network, patch);
        self.bound.follow(&self.network, &self.mobility, &nodes, |node| patch.edges(node));
        self.scratch.forces.resize(self.mobility.len(), Vector3::zeros());
        if let Some(implicit) = &mut self.implicit {
            implicit.follow(&self.network);
        }
        Ok(followed)
    }

    /// Steps by `dt` seconds.
    ///
    /// # Errors
    /// When the input is wrong, the step too large, or the result not finite or too fast; the state is then as it was.
    pub fn step(&mut self, dt: f64, input: &Input<'_>) -> Result<Report, StepError> {
        if !(dt > 0.0 && dt.is_finite()) {
            return Err(StepError::Time(dt));
        }
        self.check_input(input)?;
        self.prepare(dt, input);
        let report = match self.config.integrator {
            Integrator::Explicit { too_large } => self.step_explicit(dt, input, too_large)?,
            Integrator::Implicit { newton, .. } => self.step_implicit(dt, input, newton)?,
        };
        self.check_result()?;
        std::mem::swap(&mut self.state, &mut self.scratch.next);
        Ok(report)
    }

    fn check_input(&self, input: &Input<'_>) -> Result<(), StepError> {
        let nodes = self.network.masses.len();
        let wrong = |what, index, problem| Err(StepError::Input { what, index, problem });
        let finite = |values: &Vector3<f64>| values.iter().all(|value| value.is_finite());
        if !finite(&input.gravity) {
            return wrong("gravity", 0, "is not finite");
        }
        for (index, force) in input.forces.iter().enumerate() {
            if force.node as usize >= nodes {
                return wrong("force", index, "names a node that does not exist");
            } else if !finite(&force.force) {
                return wrong("force", index, "is not finite");
            }
        }
        for (index, led) in input.prescribed.iter().enumerate() {
            if led.node as usize >= nodes {
                return wrong("prescribed node", index, "does not exist");
            } else if !finite(&led.position.coords) {
                return wrong("prescribed node", index, "has a position that is not finite");
            }
        }
        contact::check(input.contacts, nodes)
    }

    /// Starts from the committed state with the led nodes taken out.
    fn prepare(&mut self, dt: f64, input: &Input<'_>) {
        let scratch = &mut self.scratch;
        scratch.next.positions.clone_from(&self.state.positions);
        scratch.next.velocities.clone_from(&self.state.velocities);
        scratch.mobility.clone_from(&self.mobility);
        scratch.led.clear();
        for led in input.prescribed {
            scratch.mobility[led.node as usize] = 0.0;
            let velocity = (led.position - self.state.positions[led.node as usize]) / dt;
            scratch.next.velocities[led.node as usize] = velocity;
            scratch.led.push(velocity);
        }
        scratch.touched.clear();
        scratch.touched.extend(input.contacts.iter().map(|contact| contact.point(&self.state.positions)));
        scratch.contact_forces.clear();
        scratch.contact_forces.resize(input.contacts.len(), Vector3::zeros());
    }

    fn check_result(&self) -> Result<(), StepError> {
        let limit = self.config.speed_max;
        let next = &self.scratch.next;
        for (node, (position, velocity)) in next.positions.iter().zip(&next.velocities).enumerate() {
            let node = node as u32;
            let speed = velocity.norm();
            if !(speed.is_finite() && position.iter().all(|value| value.is_finite())) {
                return Err(StepError::NotFinite { node });
            }
            if speed > limit && self.scratch.mobility[node as usize] > 0.0 {
                return Err(StepError::Runaway { node, speed, limit });
            }
        }
        Ok(())
    }

    /// The largest explicit step that is safe in any shape, without contacts \[s\].
    #[must_use]
    pub fn safe_step(&self) -> f64 {
        let eigenvalue = self.bound.largest();
        stability::safe_step(eigenvalue, self.config.damping + self.config.lag * eigenvalue)
    }
    /// Where every node is, and how it moves.
    #[must_use]
    pub fn state(&self) -> &State {
        &self.state
    }
    /// Masses, springs and hinges.
    #[must_use]
    pub fn network(&self) -> &Network {
        &self.network
    }
    /// How it is stepped.
    #[must_use]
    pub fn config(&self) -> &Config {
        &self.config
    }
    /// One over each node's mass, 0 where it is pinned \[1/kg\].
    #[must_use]
    pub fn mobility(&self) -> &[f64] {
        &self.mobility
    }
    /// Pinned nodes, ascending.
    #[must_use]
    pub fn pinned(&self) -> &[u32] {
        &self.pinned
    }
    /// Force of each contact of the last step on the network, averaged over it, in the order of the input \[N\]: the
    /// other side bears the opposite.
    #[must_use]
    pub fn contact_forces(&self) -> &[Vector3<f64>] {
        &self.scratch.contact_forces
    }
    /// What springs and hinges hold \[J\].
    #[must_use]
    pub fn elastic_energy(&self) -> f64 {
        forces::elastic_energy(&self.network, &self.state.positions)
    }
    /// What motion holds \[J\].
    #[must_use]
    pub fn kinetic_energy(&self) -> f64 {
        let of = |(mass, velocity): (&f64, &Vector3<f64>)| 0.5 * mass * velocity.norm_squared();
        self.network.masses.iter().zip(&self.state.velocities).map(of).sum()
    }
    /// Linear momentum \[kg·m/s\] and angular momentum about the origin \[kg·m²/s\].
    #[must_use]
    pub fn momentum(&self) -> [Vector3<f64>; 2] {
        let mut sum = [Vector3::zeros(); 2];
        let State { positions, velocities } = &self.state;
        for ((mass, position), velocity) in self.network.masses.iter().zip(positions).zip(velocities) {
            sum[0] += velocity * *mass;
            sum[1] += position.coords.cross(velocity) * *mass;
        }
        sum
    }
    /// What springs, hinges and damping exert on a node in the present state \[N\]: the negative of it is what a jaw
    /// that holds the node feels of the network.
    #[must_use]
    pub fn pull_on(&mut self, nodes: &[u32]) -> Vector3<f64> {
        let forces = &mut self.scratch.forces;
        forces.fill(Vector3::zeros());
        let State { positions, velocities } = &self.state;
        forces::add_forces(&self.network, self.config.lag, positions, velocities, forces);
        nodes.iter().filter_map(|&node| forces.get(node as usize)).sum()
    }
}

fn check_config(config: &Config) -> Result<(), NetworkError> {
    network::parameter("lag", config.lag, 0.0)?;
    network::parameter("damping", config.damping, 0.0)?;
    network::parameter("speed_max", config.speed_max, network::LEAST)?;
    if let Integrator::Implicit { solver, newton } = config.integrator {
        let outside = |what, value, valid| Err(NetworkError::Parameter { what, value, valid });
        if !(1..=50).contains(&newton) {
            return outside("newton", f64::from(newton), "1 to 50");
        }
        if let LinearSolver::ConjugateGradients { tolerance, iterations_max }
        | LinearSolver::Warped { tolerance, iterations_max } = solver
        {
            if !(tolerance > 0.0 && tolerance < 1.0) {
                return outside("tolerance", tolerance, "between 0 and 1");
            }
            if iterations_max == 0 {
                return outside("iterations_max", 0.0, "1 or more");
            }
        }
    }
    Ok(())
}

pub(crate) fn check_state(state: &State, nodes: usize) -> Result<(), NetworkError> {
    for (what, given) in [("positions", state.positions.len()), ("velocities", state.velocities.len())] {
        if given != nodes {
            return Err(NetworkError::Length { what, given, expected: nodes });
        }
    }
    let finite = |values: &Vector3<f64>| values.iter().all(|value| value.is_finite());
    Faulty::among(nodes, |node| !(finite(&state.positions[node].coords) && finite(&state.velocities[node])))
        .refuse(NetworkError::NotFinite)
}
