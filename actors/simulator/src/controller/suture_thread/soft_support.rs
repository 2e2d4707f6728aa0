//! A soft body of another controller that a thread lies on: the two exchange impulses through the scene, as coupled
//! bodies do ([`CouplingGiven`]).

use nalgebra::{Isometry3, Point3, Vector3};
use trocar_dynamics::soft_body::Deformable;
use trocar_dynamics::soft_body::bearing::rigid_response::RigidPresses;
use trocar_dynamics::soft_body::coupling::{CoupledWith, CouplingGiven, Lies};
use trocar_dynamics::soft_body::method::StepContext;
use trocar_scene::soft_body::one_of;
use trocar_scene::{Commands, Entity, Snapshot, Tick};

use super::component::LiesOn;
use super::obstacles::DeformableMesh;
use crate::controller::coupling::fast_side::{Partner, other};
use crate::suture_thread::ThreadState;
use crate::suture_thread::soft_support::SoftSurface;

/// Triangles nearer than this to the thread are listed before they touch, so that the other controller predicts their
/// motion in time \[m\].
const NEAR: f64 = 3e-3;
/// Number of thread nodes that share a bounding box.
const RUN: usize = 8;

/// The soft body, in the thread's solver.
pub struct LyingOn {
    partner: Partner,
    friction: f64,
    surface: SoftSurface,
    /// Fraction of the position error that nodes move in this step.
    share: f64,
}

impl LyingOn {
    /// Finds it by name. `thread` is the thread, in whose frame contact is computed.
    ///
    /// # Errors
    /// There is no such body, or the reason why a thread cannot lie on it.
    pub fn new(on: &LiesOn, thread: &Deformable, scene: &Snapshot) -> Result<Self, String> {
        let told = |why: String| format!("it lies on '{}': {why}", on.body);
        let lies = Some(Lies { friction: on.friction, ..Lies::default() });
        let rule = CoupledWith { body: on.body.clone(), joined: None, lies };
        let body = other(thread, &rule, scene).map_err(told)?;
        if let Some((method, _)) = scene.soft_body(body.entity).filter(|(_, of)| !of.answers_couplings) {
            let valid = one_of(&scene.registry().soft_bodies_that(|of| of.answers_couplings));
            return Err(told(format!(
                "that is moved by '{method}', which takes nothing from a thread; valid: {valid}"
            )));
        }
        let known = scene.get::<CouplingGiven>(thread.entity);
        let known = known.and_then(|known| known.to.iter().find(|to| to.body == Some(body.entity)));
        let partner = Partner::new(thread, &body, thread.radius, &rule, scene, known).map_err(told)?;
        Ok(Self { partner, friction: on.friction, surface: SoftSurface::default(), share: 0.0 })
    }

    /// The body.
    #[must_use]
    pub fn entity(&self) -> Entity {
        self.partner.entity
    }

    /// Coulomb friction coefficient on it.
    #[must_use]
    pub fn friction(&self) -> f64 {
        self.friction
    }

    /// Maximum position error of its nodes in the thread's solver \[m\].
    #[must_use]
    pub fn behind(&self) -> f64 {
        self.partner.given.ghosts.position_error_max()
    }

    /// Begins a tick: reads the body's report.
    ///
    /// # Errors
    /// Why it cannot continue.
    pub fn begin_step(
        &mut self,
        thread: Entity,
        world_from_thread: &Isometry3<f64>,
        scene: &Snapshot,
        tick: &Tick<'_>,
    ) -> Result<(), String> {
        let site = StepContext {
            scene,
            tick,
            step_secs: tick.period.as_secs_f64(),
            world_from_body: world_from_thread,
            gravity: Vector3::zeros(),
            rods: &[],
            touches: &[],
            rigid: RigidPresses::default(),
            meets_instruments: false,
            forces: &[],
            driven: &[],
            grip_limits: &[],
        };
        self.partner.follow(&site)?;
        self.partner.receive(thread, &site)?;
        Ok(())
    }

    /// Begins a step of `dt` \[s\], in which nodes move by this fraction of their position error.
    pub fn begin(&mut self, dt: f64, share: f64) {
        self.share = if self.partner.is_wall { 0.0 } else { share };
        let is_wall = self.partner.is_wall;
        let ghosts = &self.partner.given.ghosts;
        let ghost_nodes =
            ghosts.ghost_nodes().map(|ghost_node| if is_wall { ghost_node.as_wall() } else { ghost_node });
        let drift = ghosts.behind().iter().map(|behind| behind * (self.share / dt));
        self.surface.begin(ghost_nodes, drift, &self.partner.surface);
    }

    /// Its nodes and triangles as an obstacle, and its compliance.
    pub fn parts(&mut self) -> (DeformableMesh<'_>, &mut SoftSurface) {
        let nodes: &[Point3<f64>] = self.partner.given.ghosts.positions();
        ((nodes, &self.partner.surface), &mut self.surface)
    }

    /// Ends a step of `dt` \[s\], with the thread's new state.
    pub fn end_step(&mut self, dt: f64, state: &ThreadState) {
        let given = &mut self.partner.given;
        if !self.partner.is_wall {
            given.ghosts.end_step(dt, self.surface.moved(), 0.0);
            given.ghosts.caught_up(self.share);
        }
        near(state, given.ghosts.positions(), &self.partner.surface, &mut given.near);
    }

    /// Publishes the impulses given to the body.
    pub fn publish(&self, thread: Entity, out: &mut Commands) {
        out.put(thread, CouplingGiven { to: vec![self.partner.given.clone()] });
    }
}

/// Lists the nodes of triangles near the thread, ascending.
fn near(state: &ThreadState, nodes: &[Point3<f64>], triangles: &[[u32; 3]], found: &mut Vec<u32>) {
    found.clear();
    let bounds = |points: &mut dyn Iterator<Item = &Point3<f64>>| {
        let none = [Vector3::repeat(f64::INFINITY), Vector3::repeat(f64::NEG_INFINITY)];
        points.fold(none, |[low, high], at| [low.inf(&at.coords), high.sup(&at.coords)])
    };
    let runs: Vec<[Vector3<f64>; 2]> =
        state.positions.chunks(RUN).map(|run| bounds(&mut run.iter())).collect();
    for triangle in triangles {
        let corners = triangle.map(|node| nodes[node as usize]);
        let [low, high] = bounds(&mut corners.iter());
        let is_near = |run: &[Vector3<f64>; 2]| {
            (0..3).all(|axis| run[0][axis] - NEAR <= high[axis] && low[axis] <= run[1][axis] + NEAR)
        };
        if runs.iter().any(is_near) {
            found.extend(triangle);
        }
    }
    found.sort_unstable();
    found.dedup();
}
