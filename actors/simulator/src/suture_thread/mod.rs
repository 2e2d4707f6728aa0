//! Suture thread: a nearly inextensible elastic rod with bending, twist, self-contact, contact with obstacles and
//! static friction.
//!
//! | Part | File |
//! |---|---|
//! | Discrete elastic rod, implicit | `discrete_elastic_rod.rs` |
//! | Direct solvers for the rod's banded matrix, and its sparse matrix with strand contacts | `linear_algebra/block_banded.rs`, `linear_algebra/block_sparse_lu.rs` |
//! | Contact with static friction | `contact/` |
//! | One step of rod, contacts and coupled bodies (needle, tissue) | `island/` |
//! | Elastic bodies that it is tied around | [`elastic`] |
//! | Soft bodies that it lies on, integrated by other solvers | [`soft_support`] |
//! | Adaptive segments: short edges in knots and bends | `adaptive_segments.rs` |
//! | Cutting and breaking | `cut.rs` |
//! | Classification of knots | [`knot`] |
//! | Initial shapes | [`initial_shape`] |
//!
//! Several threads share one state, numbered consecutively, with a dummy edge between two of them
//! ([`Thread::several`]): its matrix blocks are empty, and contact between threads is handled as contact between
//! strands.
//!
//! # Why this method
//! A segment of half a millimetre of 2-0 silk weighs 41 ng and carries newtons: explicit steps would have to be under a
//! microsecond, and iterative projection needs as many sweeps as there are segments to transmit a pull from one end to
//! the other. Here one O(n) factorisation along the rod transmits any tension over the whole length in one iteration.
//! Contacts with obstacles are springs in that factorisation, also O(n). So are contacts between strands, with an
//! elimination order that exploits that a knot is long and thin: a loaded knot is one problem, not a sequence of
//! collisions. Beside coupled or compliant bodies, strand contacts are instead coupled through the compliance of the
//! rod with those springs. All contacts obey Coulomb's law as a function of surface displacement, with a small
//! compliance (`contact/coulomb.rs`), so that Newton's method converges in a few steps even with dozens of sticking and
//! sliding contacts: 180 contacts of a thread at rest on a table cost one factorisation.

pub(crate) mod adaptive_segments;
pub(crate) mod bishop_frame;
pub(crate) mod boundary_conditions;
pub(crate) mod contact;
mod cut;
pub(crate) mod discrete_elastic_rod;
pub mod elastic;
mod error;
pub mod initial_shape;
pub(crate) mod island;
pub mod knot;
pub(crate) mod knot_measures;
mod material;
pub mod soft_support;
mod state;
pub mod suture_table;

pub use adaptive_segments::{Fineness, Renumbered};
pub use boundary_conditions::{HOLD_STIFFNESS, Hold, IgnoredObstacle, Load, TwistHold};
pub use contact::{CONTACTS_MAX, LedInstrument, LedMotion, Obstacle, ObstacleMobility, Shape, Yielded};
pub use cut::{CutAt, CutNumbering};
pub use error::{FailureCause, ThreadError, ThreadStepError};
pub use knot_measures::{Strands, nearest_edges};
pub use material::ThreadMaterial;
pub(crate) use state::PARTED;
pub use state::{CLOSED_NODES_MIN, ContactKey, ContactMemory, NODES_MAX, ThreadState};

use elastic::{ElasticBody, SurfaceForce};
use nalgebra::{Point3, Vector3};

/// Longest step \[s\].
pub const STEP_MAX: f64 = 2e-3;

/// Default limit of Newton steps on strand contacts per linearised solution.
pub const SWEEPS: usize = 200;

/// Surroundings of a thread during one step. All quantities in the world frame.
#[derive(Clone, Copy, Debug, Default)]
pub struct Surroundings<'a> {
    /// Gravity \[m/s²\].
    pub gravity: Vector3<f64>,
    /// Nodes with a prescribed motion.
    pub holds: &'a [Hold],
    /// Edges whose rotation is held.
    pub twist_holds: &'a [TwistHold],
    /// Forces on nodes.
    pub loads: &'a [Load],
    /// Obstacles; an obstacle keeps its index from step to step.
    pub obstacles: &'a [Obstacle<'a>],
    /// Obstacles that are parts of instruments, each led by a hand and coupled to it.
    pub led: &'a [LedInstrument],
    /// Parts of the thread that ignore some of the obstacles.
    pub spared: &'a [IgnoredObstacle],
    /// The obstacle, if any, that is the surface of an elastic body.
    pub elastic: Option<ElasticObstacle<'a>>,
}

/// An obstacle that deforms within the step. Its shape is the mesh of the body at the beginning of the step, at a fixed
/// pose; deform the body by [`Thread::presses`] afterwards.
#[derive(Clone, Copy, Debug)]
pub struct ElasticObstacle<'a> {
    /// The obstacle's index.
    pub obstacle: usize,
    /// The body.
    pub body: &'a ElasticBody,
}

/// Statistics of a step.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ThreadReport {
    /// Number of substeps; 1 when the step was not divided.
    pub parts: usize,
    /// Linear solutions of the rod, over all substeps.
    pub iterations: usize,
    /// Contacts with non-zero force at the end.
    pub contacts: usize,
    /// Newton steps on the contact laws, over all substeps: factorisations with contact springs, and solutions of the
    /// dense problem of coupled bodies.
    pub sweeps: usize,
    /// Largest strain of an edge, as a magnitude.
    pub strain_max: f64,
    /// Largest penetration depth \[m\].
    pub penetration_max: f64,
}

/// Force and torque of the thread on an obstacle, in the world; the torque is about the obstacle's origin at the end of
/// the step.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Reaction {
    /// Force \[N\].
    pub force: Vector3<f64>,
    /// Torque \[N·m\].
    pub torque: Vector3<f64>,
}

/// A thread, or several: material, state and solver.
#[derive(Clone, Debug)]
pub struct Thread {
    material: ThreadMaterial,
    state: ThreadState,
    island: island::Island,
    presses: Vec<SurfaceForce>,
}

impl Thread {
    /// A thread at rest through `positions` \[m\], unstrained and untwisted.
    ///
    /// # Errors
    /// What is wrong with the material, or which nodes and edges are invalid.
    pub fn new(material: ThreadMaterial, positions: &[Point3<f64>]) -> Result<Self, ThreadError> {
        Self::restore(material, ThreadState::at_rest(positions))
    }

    /// Several threads of one material at rest, each through its own positions \[m\]: numbered consecutively, and in
    /// contact with each other as with themselves, in one problem per step.
    ///
    /// # Errors
    /// As [`Thread::new`], with node numbers over all threads.
    pub fn several(material: ThreadMaterial, threads: &[&[Point3<f64>]]) -> Result<Self, ThreadError> {
        Self::restore(material, ThreadState::of_several(threads))
    }

    /// A closed thread at rest through `positions` \[m\]: its last edge leads back to the first node. It is unstrained, and
    /// twisted only by what closing it asks for ([`ThreadState::closed_at_rest`]).
    ///
    /// # Errors
    /// As [`Thread::new`]; fewer than five nodes.
    pub fn closed(material: ThreadMaterial, positions: &[Point3<f64>]) -> Result<Self, ThreadError> {
        Self::restore(material, ThreadState::closed_at_rest(positions))
    }

    /// Restores a thread from `state`, bit for bit.
    ///
    /// # Errors
    /// As [`Thread::new`], and lists of different lengths.
    pub fn restore(material: ThreadMaterial, state: ThreadState) -> Result<Self, ThreadError> {
        material.check()?;
        state.check(material.radius)?;
        Ok(Self { material, state, island: island::Island::new(SWEEPS), presses: Vec::new() })
    }

    /// Limits the Newton steps on strand contacts per linearised solution; default [`SWEEPS`], range 1 to 10,000. A
    /// thread at rest takes none or one, a sliding one about ten.
    pub fn set_sweeps(&mut self, sweeps: usize) {
        self.island.sweeps_max = sweeps.clamp(1, 10_000);
    }

    /// Its material.
    #[must_use]
    pub fn material(&self) -> &ThreadMaterial {
        &self.material
    }

    /// Its state: all that a restart needs.
    #[must_use]
    pub fn state(&self) -> &ThreadState {
        &self.state
    }

    /// Positions of the nodes, in the world \[m\].
    #[must_use]
    pub fn positions(&self) -> &[Point3<f64>] {
        &self.state.positions
    }

    /// Advances the thread by `dt` \[s\].
    ///
    /// # Errors
    /// The name of an invalid input, or the node at which no step converged. The state is then unchanged.
    pub fn step(&mut self, dt: f64, surroundings: &Surroundings) -> Result<ThreadReport, ThreadStepError> {
        check_step(dt)?;
        self.check_around(surroundings)?;
        let Self { material, state, island, presses } = self;
        let Some(elastic) = &surroundings.elastic else {
            presses.clear();
            return island.step(material, state, dt, surroundings, &mut island::coupled_body::NoCoupledBody);
        };
        let mut tied = island::TiedAround {
            body: elastic.body,
            obstacle: elastic.obstacle,
            world_from_body: surroundings.obstacles[elastic.obstacle].to,
            presses: std::mem::take(presses),
        };
        tied.presses.clear();
        tied.presses.extend_from_slice(elastic.body.presses());
        let done = island.step(material, state, dt, surroundings, &mut tied);
        *presses = tied.presses;
        done
    }

    /// Advances by `dt` \[s\] on a soft body that another solver integrates: one of the obstacles is a mesh with
    /// outward triangles whose vertices are the nodes of `surface`. Read the motion of these nodes from `surface`
    /// afterwards.
    ///
    /// # Errors
    /// As [`Thread::step`]; the result in `surface` is then meaningless.
    pub fn step_on(
        &mut self,
        dt: f64,
        surroundings: &Surroundings,
        obstacle: usize,
        surface: &mut soft_support::SoftSurface,
    ) -> Result<ThreadReport, ThreadStepError> {
        check_step(dt)?;
        self.check_around(surroundings)?;
        let given = |why: &str| {
            Err(ThreadStepError::Given { what: "soft surface", index: obstacle, why: why.to_owned() })
        };
        if self.state.is_closed() {
            return given("a closed thread lies on no soft body");
        }
        if surroundings.elastic.is_some() {
            return given("an elastic body gives way already");
        }
        match surroundings.obstacles.get(obstacle).map(|obstacle| obstacle.shape) {
            Some(Shape::Mesh { from, .. }) if from.len() == surface.moved().len() => {}
            _ => return given("that obstacle is not it"),
        }
        let Self { material, state, island, presses } = self;
        presses.clear();
        island.step(material, state, dt, surroundings, &mut soft_support::LyingOn { surface, obstacle })
    }

    fn check_around(&self, surroundings: &Surroundings) -> Result<(), ThreadStepError> {
        surroundings.check(self.state.positions.len(), self.state.rest_lengths.len())?;
        if self.state.is_closed() && surroundings.elastic.is_some() {
            let why = "a closed thread is tied around no elastic body".to_owned();
            return Err(ThreadStepError::Given { what: "elastic body", index: 0, why });
        }
        let nothing = |hold: &TwistHold| !self.state.joins(hold.edge);
        if let Some(index) = surroundings.twist_holds.iter().position(nothing) {
            let why = "its edge is between two threads".to_owned();
            return Err(ThreadStepError::Given { what: "twist hold", index, why });
        }
        Ok(())
    }

    /// Forces of the holds on the thread in the last step, in their order \[N\].
    #[must_use]
    pub fn hold_forces(&self) -> &[Vector3<f64>] {
        self.island.hold_forces()
    }

    /// Torques about their edges of the twist holds on the thread in the last step, in their order \[N·m\].
    #[must_use]
    pub fn hold_torques(&self) -> &[f64] {
        self.island.hold_torques()
    }

    /// Reactions of the obstacles to the thread in the last step, in their order.
    #[must_use]
    pub fn reactions(&self) -> &[Reaction] {
        self.island.reactions()
    }

    /// How the obstacles that move have given way in the last step, in the order of the obstacles.
    #[must_use]
    pub fn yielded(&self) -> &[Yielded] {
        self.island.yielded()
    }

    /// Motions of the led instruments in the last step, in their order.
    #[must_use]
    pub fn led(&self) -> &[LedMotion] {
        self.island.led()
    }

    /// Forces of the thread on the elastic body at the end of the last step.
    #[must_use]
    pub fn presses(&self) -> &[SurfaceForce] {
        &self.presses
    }
}

/// Rejects an invalid step length.
pub(crate) fn check_step(dt: f64) -> Result<(), ThreadStepError> {
    if dt.is_nan() || dt <= 0.0 || dt > STEP_MAX { Err(ThreadStepError::Step(dt)) } else { Ok(()) }
}

impl Surroundings<'_> {
    /// Corners of the surface triangle of a contact.
    pub(crate) fn face(&self, key: &ContactKey) -> Option<[u32; 3]> {
        match self.obstacles.get((key.with as usize).checked_sub(1)?)?.shape {
            Shape::Mesh { triangles, .. } => triangles.get(key.feature as usize).copied(),
            _ => None,
        }
    }

    /// Rejects surroundings that are invalid for a thread of this many nodes.
    pub(crate) fn check(&self, nodes: usize, edges: usize) -> Result<(), ThreadStepError> {
        let surroundings = self;
        let given = |what, index, why: &str| Err(ThreadStepError::Given { what, index, why: why.to_owned() });
        if !surroundings.gravity.iter().all(|x| x.is_finite()) {
            return given("gravity", 0, "not finite");
        }
        for (index, hold) in surroundings.holds.iter().enumerate() {
            if hold.node >= nodes {
                return given(
                    "hold",
                    index,
                    &format!("there is no node {}; valid: below {nodes}", hold.node),
                );
            }
            if !hold.to.iter().all(|x| x.is_finite()) {
                return given("hold", index, "its place is not finite");
            }
            if !(hold.stiffness > 0.0 && hold.stiffness <= 1e9)
                || hold.force_max.is_nan()
                || hold.force_max < 0.0
            {
                return given(
                    "hold",
                    index,
                    "valid: stiffness above 0, at most 1e9 N/m; force_max 0 or more",
                );
            }
        }
        for (index, hold) in surroundings.twist_holds.iter().enumerate() {
            if hold.edge >= edges {
                return given("twist hold", index, &format!("there is no edge {}", hold.edge));
            }
            if !hold.director.iter().all(|x| x.is_finite()) || hold.director.norm() < 1e-9 {
                return given("twist hold", index, "its director is no direction");
            }
        }
        for (index, load) in surroundings.loads.iter().enumerate() {
            if load.node >= nodes {
                return given(
                    "load",
                    index,
                    &format!("there is no node {}; valid: below {nodes}", load.node),
                );
            }
            if !load.force.iter().all(|x| x.is_finite()) {
                return given("load", index, "its force is not finite");
            }
        }
        for (index, obstacle) in surroundings.obstacles.iter().enumerate() {
            if let Some(why) = obstacle.wrong() {
                return given("obstacle", index, &why);
            }
        }
        for (index, led) in surroundings.led.iter().enumerate() {
            if let Some(why) = led.wrong(surroundings.obstacles.len()) {
                return given("led instrument", index, &why);
            }
            let [first, last] = led.obstacles;
            if surroundings.obstacles[first..=last].iter().any(|part| part.mobility.is_some()) {
                return given("led instrument", index, "one of its parts is a body that moves freely");
            }
            if surroundings.led[..index]
                .iter()
                .any(|other| other.obstacles[0] <= last && first <= other.obstacles[1])
            {
                return given("led instrument", index, "another one has the same part");
            }
        }
        if let Some(elastic) = &surroundings.elastic {
            let body = elastic.body;
            let is_surface = |obstacle: &Obstacle| {
                matches!(obstacle.shape, Shape::Mesh { from, triangles, .. }
                    if from.len() == body.positions().len() && triangles.len() == body.triangles().len())
            };
            match surroundings.obstacles.get(elastic.obstacle) {
                Some(obstacle) if !is_surface(obstacle) => {
                    return given("elastic body", elastic.obstacle, "that obstacle is not its surface");
                }
                Some(obstacle) if obstacle.from != obstacle.to => {
                    return given("elastic body", elastic.obstacle, "it has to stay in its place");
                }
                Some(_) => {}
                None => return given("elastic body", elastic.obstacle, "there is no such obstacle"),
            }
        }
        Ok(())
    }
}
