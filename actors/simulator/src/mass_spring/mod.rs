//! Mass-spring: threads, cloth, tubes and volumes as one network of masses, springs and hinges ([`Network`]), stepped
//! explicitly (symplectic Euler) or implicitly (backward Euler; Baraff and Witkin, *Large steps in cloth simulation*,
//! 1998, with springs whose stiffness matrix is never indefinite).
//!
//! Nodes can be pinned, prescribed (held by a jaw) or in contact; contact forces are reported, so that the other object
//! can bear the reaction. The explicit method has a step limit that is safe in any shape (of volumes, in the present one),
//! and rejects or subdivides larger steps; the implicit method takes any step, with numerical damping that grows with it.
//! Tetrahedra of volumes resist their collapse ([`Tet`]).

mod collapse;
mod contact;
mod error;
mod explicit;
mod forces;
mod implicit;
mod jaws;
mod matrix;
mod network;
pub(crate) mod remesh;
pub(crate) mod stability;
pub(crate) mod surface_network;

pub use collapse::Tet;
pub use contact::Contact;
pub use error::NetworkError;
pub use network::{Hinge, LineMaterial, Network, Spring, SurfaceMaterial, VolumeMaterial};
pub use remesh::{ChangedMesh, Edits, NetworkChange};

pub(crate) use contact::check as check_contacts;
pub(crate) use forces::NEARLY_FLAT;
pub(crate) use network::check_elements;
pub(crate) use surface_network::area;

use nalgebra::{Point3, Vector3};
use serde::{Deserialize, Serialize};
use trocar_dynamics::faulty::Faulty;
use trocar_dynamics::particles::{State, StepError};
use trocar_dynamics::soft_body::bearing::rigid_response::{RigidPresses, RigidResponse};
use trocar_dynamics::soft_body::jaw_friction::{GripForce, JawFriction};

use collapse::Resisting;
use implicit::Implicit;
pub use implicit::SheetFactor;
use stability::EigenvalueBound;

/// Handling of a step larger than the stable one.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum TooLarge {
    /// An error that tells the stable step.
    Refuse,
    /// Divide it into equal substeps, at most this many.
    Divide {
        /// The limit; beyond it the step is rejected.
        most: u32,
    },
    /// Take it as it is. Divergence is detected by the node speed and then rejected.
    Accept,
}

/// Solver of an implicit step's linear system.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum LinearSolver {
    /// Matrix-free conjugate gradients with a block Jacobi preconditioner.
    ConjugateGradients {
        /// Relative residual at which it ends.
        tolerance: f64,
        /// Maximum iterations; the step uses the result reached.
        iterations_max: u32,
    },
    /// Conjugate gradients with the factor of the rest-state matrix as preconditioner, rotated with each node's
    /// surroundings: on a sheet an order of magnitude fewer iterations than the other one at short steps (at 1 ms; with
    /// steps of 10 ms on a wrinkled sheet the other one needs fewer). The factor is recomputed when pins or step
    /// change; a changed network uses block Jacobi until it is given a factor ([`MassSpring::take_factor`]). For
    /// networks built from a mesh: others have no known rest shape and fall back to block Jacobi.
    Warped {
        /// Relative residual at which it ends, in the preconditioner's norm.
        tolerance: f64,
        /// Maximum iterations; the step uses the result reached.
        iterations_max: u32,
    },
    /// Sparse Cholesky factorisation; the symbolic part is done once per network.
    Cholesky,
}

/// Time integrator.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Integrator {
    /// Symplectic Euler.
    Explicit {
        /// Handling of large steps.
        too_large: TooLarge,
    },
    /// Backward Euler.
    Implicit {
        /// Linear solver.
        solver: LinearSolver,
        /// Newton iterations, 1 to 50; one is Baraff and Witkin's method.
        newton: u32,
    },
}

/// Solver settings of a network.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Config {
    /// The integrator.
    pub integrator: Integrator,
    /// Damping along springs and hinges: ratio of damping to stiffness \[s\] (Kelvin–Voigt).
    pub lag: f64,
    /// Global damping rate \[1/s\].
    pub damping: f64,
    /// Speed limit \[m/s\]; a faster node counts as diverged.
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
    /// The node.
    pub node: u32,
    /// The force \[N\].
    pub force: Vector3<f64>,
}

/// A prescribed position of a node at the end of a step, approached at constant velocity.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Prescribed {
    /// The node.
    pub node: u32,
    /// The position \[m\].
    pub position: Point3<f64>,
}

/// Inputs of one step.
#[derive(Clone, Copy, Debug, Default)]
pub struct Input<'a> {
    /// Gravity \[m/s²\].
    pub gravity: Vector3<f64>,
    /// Forces on nodes.
    pub forces: &'a [NodeForce],
    /// Nodes with a prescribed position; of two entries for one node the last counts.
    pub prescribed: &'a [Prescribed],
    /// Contacts.
    pub contacts: &'a [Contact],
    /// Contacts with rigid bodies that move.
    pub rigid: RigidPresses<'a>,
    /// How much the jaws hold that prescribe these positions.
    pub jaws: JawFriction<'a>,
}

/// Statistics of a step.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Report {
    /// Number of substeps.
    pub parts: u32,
    /// Largest stable explicit step with these contacts \[s\]; infinite for the implicit method.
    pub safe_step: f64,
    /// Linear solver iterations, over all Newton iterations.
    pub iterations: u32,
    /// Relative residual of the linear system in the last Newton iteration.
    pub residual: f64,
}

/// The solver.
#[derive(Clone, Debug)]
pub struct MassSpring {
    network: Network,
    config: Config,
    state: State,
    pinned: Vec<u32>,
    /// Inverse mass of each node, 0 where it is pinned \[1/kg\].
    mobility: Vec<f64>,
    bound: EigenvalueBound,
    scratch: Scratch,
    implicit: Option<Box<Implicit>>,
}

/// Workspace of a step.
#[derive(Clone, Debug, Default)]
struct Scratch {
    next: State,
    forces: Vec<Vector3<f64>>,
    /// As [`MassSpring::mobility`], also 0 where a node is prescribed.
    mobility: Vec<f64>,
    /// Velocities of the prescribed nodes, in the order of the input.
    driven: Vec<Vector3<f64>>,
    /// Each contact's point at the beginning.
    touched: Vec<Vector3<f64>>,
    contact_forces: Vec<Vector3<f64>>,
    meeting: Vec<f64>,
    /// Of the rigid bodies, each of their contacts' places at the beginning, and its force in the substep.
    rigid: RigidResponse,
    /// The same at a trial of an implicit step.
    rigid_trial: RigidResponse,
    /// Of explicit steps, the tetrahedra that resist their collapse.
    resisting: Resisting,
    rigid_touched: Vec<Vector3<f64>>,
    rigid_pressed: Vec<f64>,
    /// What the jaws of each grip did.
    grips: Vec<GripForce>,
    /// Impulse that stops what they hold within a substep \[N·s\].
    stopping: Vec<Vector3<f64>>,
    /// Of implicit steps in which something slips: what does not, and all forces.
    kept: Vec<Prescribed>,
    given: Vec<NodeForce>,
}

impl MassSpring {
    /// At rest at these positions, with the listed nodes pinned.
    ///
    /// # Errors
    /// Invalid network, positions or configuration.
    pub fn new(
        network: Network,
        positions: Vec<Point3<f64>>,
        pinned: &[u32],
        config: Config,
    ) -> Result<Self, NetworkError> {
        let velocities = vec![Vector3::zeros(); positions.len()];
        Self::restore(network, State { positions, velocities }, pinned, config)
    }

    /// Continues from a state, bit for bit if the network is the same.
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
            bound: EigenvalueBound::default(),
            scratch: Scratch::default(),
            implicit: None,
        };
        solver.pin(pinned)?;
        Ok(solver)
    }

    /// Pins exactly these nodes at their current positions.
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

    /// Continues from a state of as many nodes.
    pub(crate) fn continue_from(&mut self, state: &State) {
        self.state.positions.clone_from(&state.positions);
        self.state.velocities.clone_from(&state.velocities);
    }

    /// Updates what depends on network and pins.
    fn refresh(&mut self) {
        let nodes = self.network.masses.len();
        self.mobility.clear();
        self.mobility.extend(self.network.masses.iter().map(|mass| 1.0 / mass));
        for &node in &self.pinned {
            self.mobility[node as usize] = 0.0;
            self.state.velocities[node as usize] = Vector3::zeros();
        }
        self.bound = EigenvalueBound::new(&self.network, &self.mobility);
        self.scratch.forces.resize(nodes, Vector3::zeros());
        self.scratch.next = self.state.clone();
        self.scratch.resisting.reserve(&self.network);
        self.implicit = match self.config.integrator {
            Integrator::Explicit { .. } => None,
            Integrator::Implicit { solver, .. } => Some(Box::new(Implicit::new(&self.network, solver))),
        };
    }

    /// Selects another linear solver for implicit steps; no effect on explicit ones.
    ///
    /// # Errors
    /// An invalid tolerance or limit; the solver is then unchanged.
    pub fn solve_by(&mut self, by: LinearSolver) -> Result<(), NetworkError> {
        let Integrator::Implicit { newton, .. } = self.config.integrator else { return Ok(()) };
        let config = Config { integrator: Integrator::Implicit { solver: by, newton }, ..self.config };
        check_config(&config)?;
        self.config = config;
        self.implicit = Some(Box::new(Implicit::new(&self.network, by)));
        Ok(())
    }

    /// Updates to a changed mesh: `update` updates the network from its mesh, `carry` gives new nodes a state (and
    /// another one to nodes whose rest position moved), `stays` tells which nodes are pinned. The result equals a
    /// solver built from the whole mesh.
    ///
    /// # Errors
    /// What `update` rejects; the solver is then unchanged. A state that does not fit.
    pub fn follow<const N: usize>(
        &mut self,
        patch: &ChangedMesh<'_, N>,
        stays: impl Fn(u32) -> bool,
        carry: impl FnOnce(&mut State),
        update: impl FnOnce(&mut Network, &ChangedMesh<'_, N>) -> Result<NetworkChange, NetworkError>,
    ) -> Result<NetworkChange, NetworkError> {
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
        self.scratch.resisting.reserve(&self.network);
        if let Some(implicit) = &mut self.implicit {
            implicit.follow(&self.network);
        }
        Ok(followed)
    }

    /// Steps by `dt` seconds.
    ///
    /// # Errors
    /// Invalid input, too large a step, or a result that is not finite or too fast; the state is then unchanged.
    pub fn step(&mut self, dt: f64, input: &Input<'_>) -> Result<Report, StepError> {
        if !(dt > 0.0 && dt.is_finite()) {
            return Err(StepError::Time(dt));
        }
        self.check_input(input)?;
        self.prepare(dt, input);
        let report = match self.config.integrator {
            Integrator::Explicit { too_large } => self.step_explicit(dt, input, too_large)?,
            Integrator::Implicit { newton, .. } => self.step_held(dt, input, newton)?,
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
        for (index, driven) in input.prescribed.iter().enumerate() {
            if driven.node as usize >= nodes {
                return wrong("prescribed node", index, "does not exist");
            } else if !finite(&driven.position.coords) {
                return wrong("prescribed node", index, "has a position that is not finite");
            }
        }
        contact::check(input.contacts, nodes)
    }

    /// Starts from the committed state, with prescribed nodes removed from the unknowns.
    fn prepare(&mut self, dt: f64, input: &Input<'_>) {
        let scratch = &mut self.scratch;
        scratch.next.positions.clone_from(&self.state.positions);
        scratch.next.velocities.clone_from(&self.state.velocities);
        scratch.mobility.clone_from(&self.mobility);
        scratch.driven.clear();
        for (place, driven) in input.prescribed.iter().enumerate() {
            scratch.mobility[driven.node as usize] = 0.0;
            let velocity = (driven.position - self.state.positions[driven.node as usize]) / dt;
            // Watched jaws have to stop what slips in them.
            if input.jaws.watched(place).is_none() {
                scratch.next.velocities[driven.node as usize] = velocity;
            }
            scratch.driven.push(velocity);
        }
        scratch.grips.clear();
        scratch.grips.resize(input.jaws.limits.len(), GripForce::default());
        scratch.touched.clear();
        scratch.touched.extend(input.contacts.iter().map(|contact| contact.point(&self.state.positions)));
        scratch.contact_forces.clear();
        scratch.contact_forces.resize(input.contacts.len(), Vector3::zeros());
        scratch.rigid.forces.clear();
        scratch.rigid.forces.resize(input.rigid.contacts.len(), 0.0);
        scratch.rigid_touched.clear();
        let places = input.rigid.contacts.iter().map(|contact| contact.place(&self.state.positions));
        scratch.rigid_touched.extend(places);
        scratch.rigid_pressed.clear();
        scratch.rigid_pressed.extend(input.rigid.contacts.iter().map(|contact| contact.force));
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

    /// Largest explicit step that is stable without contacts \[s\]: of springs and hinges in any shape, of squeezed
    /// tetrahedra in the present one.
    #[must_use]
    pub fn safe_step(&self) -> f64 {
        let eigenvalue = self.bound.largest();
        let mut resisting = Resisting::default();
        resisting.find(&self.network, &self.state, 0.0);
        let squeezed = resisting.largest(&self.network, &self.mobility, &self.state.positions);
        let damping = self.config.damping + self.config.lag * eigenvalue;
        stability::safe_step(eigenvalue + squeezed, damping)
    }

    /// Whether a step of `dt` seconds without contacts is short enough to be taken, as the network is now.
    ///
    /// # Errors
    /// The step is above the safe one, or needs more substeps than the configuration allows.
    pub fn check_step(&self, dt: f64) -> Result<(), StepError> {
        match self.config.integrator {
            Integrator::Explicit { too_large } => explicit::parts(dt, self.safe_step(), too_large).map(drop),
            Integrator::Implicit { .. } => Ok(()),
        }
    }

    /// Positions and velocities of the nodes.
    #[must_use]
    pub fn state(&self) -> &State {
        &self.state
    }
    /// Masses, springs and hinges.
    #[must_use]
    pub fn network(&self) -> &Network {
        &self.network
    }
    /// Its settings.
    #[must_use]
    pub fn config(&self) -> &Config {
        &self.config
    }
    /// Inverse mass of each node, 0 where it is pinned \[1/kg\].
    #[must_use]
    pub fn mobility(&self) -> &[f64] {
        &self.mobility
    }
    /// Pinned nodes, ascending.
    #[must_use]
    pub fn pinned(&self) -> &[u32] {
        &self.pinned
    }
    /// Force of each contact with a rigid body in the last step, averaged over it, along its normal \[N\].
    #[must_use]
    pub fn rigid_forces(&self) -> &[f64] {
        &self.scratch.rigid.forces
    }

    /// What the jaws of each watched grip did in the last step.
    #[must_use]
    pub fn grip_forces(&self) -> &[GripForce] {
        &self.scratch.grips
    }

    /// Force of each contact of the last step on the network, averaged over it, in the order of the input \[N\]: the
    /// reaction on the other object is the opposite.
    #[must_use]
    pub fn contact_forces(&self) -> &[Vector3<f64>] {
        &self.scratch.contact_forces
    }
    /// Elastic energy of springs, hinges and tetrahedra \[J\].
    #[must_use]
    pub fn elastic_energy(&self) -> f64 {
        forces::elastic_energy(&self.network, &self.state.positions)
    }
    /// Kinetic energy \[J\].
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
    /// Total force of springs, hinges and damping on nodes in the present state \[N\]: a jaw that holds them feels this
    /// force.
    #[must_use]
    pub fn pull_on(&mut self, nodes: &[u32]) -> Vector3<f64> {
        let forces = &mut self.scratch.forces;
        forces.fill(Vector3::zeros());
        let State { positions, velocities } = &self.state;
        forces::add_all_forces(&self.network, self.config.lag, positions, velocities, forces);
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
