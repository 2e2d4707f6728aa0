//! Suture thread: a nearly inextensible elastic rod that bends, twists, touches itself and what is around it, and stays
//! where friction holds it.
//!
//! | Part | File |
//! |---|---|
//! | Discrete elastic rod, implicit | `discrete_elastic_rod.rs` |
//! | Direct solvers along the rod, and where its strands push each other | `block_band.rs`, `block_sparse.rs` |
//! | Contact with static friction | `contact/` |
//! | One step of rod and contacts together, and of companions: a needle, a tissue | `island/` |
//! | Elastic bodies that it is tied around | [`elastic`] |
//! | Soft bodies that it lies on and that others move | [`soft_support`] |
//! | Short edges where they are needed | `adaptive_segments.rs` |
//! | Cut or broken | `cut.rs` |
//! | Which knot it is | [`knot`] |
//! | How it lies at the beginning | [`initial_shape`] |
//!
//! Several threads are one state whose nodes follow one after the other, with an edge that joins nothing between two of them
//! ([`Thread::several`]): its blocks of the matrix are empty, and a thread that touches another is one strand that touches
//! another.
//!
//! # Why this method
//! A thread of 2-0 silk weighs 41 ng per segment of a millimetre's half and carries newtons: explicit steps would have
//! to be under a microsecond, and iterative projection needs as many sweeps as there are segments before a pull at one
//! end is felt at the other. Here one factorisation along the rod, O(n), carries any tension over its whole length in
//! one iteration. Contacts with obstacles are springs within that factorisation, O(n) as well. So are contacts of strands
//! with each other, in an order of elimination that makes use of how long and thin a knot is, so that a knot under load is
//! one problem and not a sequence of collisions; beside companions and what gives way they see each other through the
//! compliance of the rod with those springs. All obey Coulomb's law as a function of where the surfaces are, which gives way
//! a little (`contact/law.rs`), so that Newton's method finds it in a few steps even where dozens of places stick and slide
//! on each other: 180 contacts of a thread at rest on a table cost one factorisation.

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

pub use adaptive_segments::{Fineness, Renumbered};
pub use boundary_conditions::{HOLD_STIFFNESS, Hold, Load, Spared, TwistHold};
pub use contact::{CONTACTS_MAX, Obstacle, Shape};
pub use cut::{CutAt, Parted};
pub use error::{ThreadError, ThreadStepError, Trouble};
pub use knot_measures::{Strands, nearest_edges};
pub use material::ThreadMaterial;
pub(crate) use state::PARTED;
pub use state::{ContactKey, ContactMemory, NODES_MAX, ThreadState};

use elastic::{ElasticBody, Press};
use nalgebra::{Point3, Vector3};

/// The longest step \[s\].
pub const STEP_MAX: f64 = 2e-3;

/// Newton steps on the contacts of strands of one linearised solution at most, unless told otherwise.
pub const SWEEPS: usize = 200;

/// What acts on a thread during one step. Everything is in the world.
#[derive(Clone, Copy, Debug, Default)]
pub struct Surroundings<'a> {
    /// \[m/s²\].
    pub gravity: Vector3<f64>,
    /// Nodes that are led.
    pub holds: &'a [Hold],
    /// Edges that are kept from turning.
    pub twist_holds: &'a [TwistHold],
    /// Forces on nodes.
    pub loads: &'a [Load],
    /// What the thread can touch; an obstacle keeps its place in the list from step to step.
    pub obstacles: &'a [Obstacle<'a>],
    /// What of the thread does not touch which of them.
    pub spared: &'a [Spared],
    /// One of the obstacles gives way: it is the surface of an elastic body.
    pub elastic: Option<Elastic<'a>>,
}

/// An obstacle that gives way within the step. Its shape is the mesh of the body as it is when the step begins, in its place
/// from beginning to end; what presses it then is [`Thread::presses`], by which it is to be deformed.
#[derive(Clone, Copy, Debug)]
pub struct Elastic<'a> {
    /// Which obstacle.
    pub obstacle: usize,
    /// The body.
    pub body: &'a ElasticBody,
}

/// How a step went.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ThreadReport {
    /// Parts into which the step had to be divided; 1 when it went as a whole.
    pub parts: usize,
    /// Solutions of the linearised rod, over all parts.
    pub iterations: usize,
    /// Contacts that push at the end.
    pub contacts: usize,
    /// Newton steps on the laws of the contacts, over all parts: factorisations with their springs, and solutions of the dense
    /// problem of companions.
    pub sweeps: usize,
    /// The largest strain of an edge, up to sign.
    pub strain_max: f64,
    /// How deep a contact is at most \[m\].
    pub penetration_max: f64,
}

/// Force and torque of the thread on an obstacle, in the world, the torque about the obstacle's origin at the end of the
/// step.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Reaction {
    /// \[N\].
    pub force: Vector3<f64>,
    /// \[N·m\].
    pub torque: Vector3<f64>,
}

/// A thread.
#[derive(Clone, Debug)]
pub struct Thread {
    material: ThreadMaterial,
    state: ThreadState,
    island: island::Island,
    presses: Vec<Press>,
}

impl Thread {
    /// One at rest through `positions` \[m\], without strain or twist, as long as they are.
    ///
    /// # Errors
    /// What is wrong with the material, or which nodes and edges are not a thread.
    pub fn new(material: ThreadMaterial, positions: &[Point3<f64>]) -> Result<Self, ThreadError> {
        Self::restore(material, ThreadState::at_rest(positions))
    }

    /// Several of one material at rest, each through its own positions \[m\]: their nodes follow one after the other, and
    /// they touch each other as they touch themselves, in one problem per step.
    ///
    /// # Errors
    /// As [`Thread::new`], by the numbers of nodes of all together.
    pub fn several(material: ThreadMaterial, threads: &[&[Point3<f64>]]) -> Result<Self, ThreadError> {
        Self::restore(material, ThreadState::of_several(threads))
    }

    /// One that goes on from `state`, bit for bit.
    ///
    /// # Errors
    /// As [`Thread::new`], and lists of different lengths.
    pub fn restore(material: ThreadMaterial, state: ThreadState) -> Result<Self, ThreadError> {
        material.check()?;
        state.check(material.radius)?;
        Ok(Self { material, state, island: island::Island::new(SWEEPS), presses: Vec::new() })
    }

    /// How many Newton steps on the contacts of strands a linearised solution may take; [`SWEEPS`] unless told, 1 to
    /// 10,000. A thread at rest takes none or one, one that slides about ten.
    pub fn set_sweeps(&mut self, sweeps: usize) {
        self.island.sweeps_max = sweeps.clamp(1, 10_000);
    }

    /// Of what it is made.
    #[must_use]
    pub fn material(&self) -> &ThreadMaterial {
        &self.material
    }

    /// Everything needed to go on from here.
    #[must_use]
    pub fn state(&self) -> &ThreadState {
        &self.state
    }

    /// Of the nodes, in the world \[m\].
    #[must_use]
    pub fn positions(&self) -> &[Point3<f64>] {
        &self.state.positions
    }

    /// Goes on by `dt` \[s\].
    ///
    /// # Errors
    /// Input that makes no sense, by name; or the node at which no step could be found. The state is then what it was.
    pub fn step(&mut self, dt: f64, around: &Surroundings) -> Result<ThreadReport, ThreadStepError> {
        check_step(dt)?;
        self.check_around(around)?;
        let Self { material, state, island, presses } = self;
        let Some(elastic) = &around.elastic else {
            presses.clear();
            return island.step(material, state, dt, around, &mut island::coupled_body::Alone);
        };
        let mut tied = island::TiedAround {
            body: elastic.body,
            obstacle: elastic.obstacle,
            world_from_body: around.obstacles[elastic.obstacle].to,
            presses: std::mem::take(presses),
        };
        tied.presses.clear();
        tied.presses.extend_from_slice(elastic.body.presses());
        let done = island.step(material, state, dt, around, &mut tied);
        *presses = tied.presses;
        done
    }

    /// Goes on by `dt` \[s\] with one of the obstacles giving way: the surface of a soft body that somebody else moves, a mesh
    /// whose triangles are turned outwards, its vertices where the nodes of `surface` are. What became of these that tells
    /// afterwards.
    ///
    /// # Errors
    /// As [`Thread::step`]; what has become of the surface means nothing then.
    pub fn step_on(
        &mut self,
        dt: f64,
        around: &Surroundings,
        obstacle: usize,
        surface: &mut soft_support::SoftSurface,
    ) -> Result<ThreadReport, ThreadStepError> {
        check_step(dt)?;
        self.check_around(around)?;
        let given = |why: &str| {
            Err(ThreadStepError::Given { what: "soft surface", index: obstacle, why: why.to_owned() })
        };
        if around.elastic.is_some() {
            return given("an elastic body gives way already");
        }
        match around.obstacles.get(obstacle).map(|obstacle| obstacle.shape) {
            Some(Shape::Mesh { from, .. }) if from.len() == surface.moved().len() => {}
            _ => return given("that obstacle is not it"),
        }
        let Self { material, state, island, presses } = self;
        presses.clear();
        island.step(material, state, dt, around, &mut soft_support::LyingOn { surface, obstacle })
    }

    fn check_around(&self, around: &Surroundings) -> Result<(), ThreadStepError> {
        around.check(self.state.positions.len())?;
        let nothing = |hold: &TwistHold| !self.state.joins(hold.edge);
        if let Some(index) = around.twist_holds.iter().position(nothing) {
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

    /// What the thread did to the obstacles in the last step, in their order.
    #[must_use]
    pub fn reactions(&self) -> &[Reaction] {
        self.island.reactions()
    }

    /// What the thread did to the elastic body at the end of the last step.
    #[must_use]
    pub fn presses(&self) -> &[Press] {
        &self.presses
    }
}

/// Refuses a step that is none.
pub(crate) fn check_step(dt: f64) -> Result<(), ThreadStepError> {
    if dt.is_nan() || dt <= 0.0 || dt > STEP_MAX { Err(ThreadStepError::Step(dt)) } else { Ok(()) }
}

impl Surroundings<'_> {
    /// Corners of the triangle of a surface that a contact is with.
    pub(crate) fn face(&self, key: &ContactKey) -> Option<[u32; 3]> {
        match self.obstacles.get((key.with as usize).checked_sub(1)?)?.shape {
            Shape::Mesh { triangles, .. } => triangles.get(key.feature as usize).copied(),
            _ => None,
        }
    }

    /// Refuses what makes no sense for a thread of so many nodes.
    pub(crate) fn check(&self, nodes: usize) -> Result<(), ThreadStepError> {
        let around = self;
        let given = |what, index, why: &str| Err(ThreadStepError::Given { what, index, why: why.to_owned() });
        if !around.gravity.iter().all(|x| x.is_finite()) {
            return given("gravity", 0, "not finite");
        }
        for (index, hold) in around.holds.iter().enumerate() {
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
        for (index, hold) in around.twist_holds.iter().enumerate() {
            if hold.edge + 1 >= nodes {
                return given("twist hold", index, &format!("there is no edge {}", hold.edge));
            }
            if !hold.director.iter().all(|x| x.is_finite()) || hold.director.norm() < 1e-9 {
                return given("twist hold", index, "its director is no direction");
            }
        }
        for (index, load) in around.loads.iter().enumerate() {
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
        for (index, obstacle) in around.obstacles.iter().enumerate() {
            if let Some(why) = obstacle.wrong() {
                return given("obstacle", index, &why);
            }
        }
        if let Some(elastic) = &around.elastic {
            let body = elastic.body;
            let is_surface = |obstacle: &Obstacle| {
                matches!(obstacle.shape, Shape::Mesh { from, triangles, .. }
                    if from.len() == body.positions().len() && triangles.len() == body.triangles().len())
            };
            match around.obstacles.get(elastic.obstacle) {
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
