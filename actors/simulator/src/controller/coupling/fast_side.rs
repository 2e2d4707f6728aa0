//! The faster side of couplings: a position-based body. Bodies of other controllers take part in each step as ghost
//! nodes, and receive the accumulated impulses; bodies of its own controller are stepped with it as one island.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use nalgebra::{Isometry3, Point3, Vector3};
use trocar_collision::Surface;
use trocar_dynamics::coupling::external_nodes::{
    ExternalNodes, GhostImpulses, GhostMoved, GhostNode, NodeContact, Tie,
};
use trocar_dynamics::coupling::{SlowBodyReport, SurfaceContactParams, SurfaceContacts};
use trocar_dynamics::particles::State;
use trocar_dynamics::soft_body::Deformable;
use trocar_dynamics::soft_body::bearing::joint::is_rigid;
use trocar_dynamics::soft_body::coupling::components::GivenImpulses;
use trocar_dynamics::soft_body::coupling::{CoupledBody, CoupledWith, CouplingGiven, CouplingTaken, Joined};
use trocar_dynamics::soft_body::method::{Measures, StepContext};
use trocar_scene::soft_body::one_of;
use trocar_scene::{
    Access, Commands, Entity, EntitySet, Snapshot, SoftAbilities, SurfaceMesh, TetMesh, VertexPositions,
    VertexVelocities,
};

use super::attachment::{FusedBody, grafts};
use crate::controller::thermal_damage::RemovedElements;

/// Age of a report, in steps of the body that sent it, above which that body counts as late. Its ghosts then stand
/// still and take no more impulses: a prediction is for one step, and a ghost that went on along it would be metres away
/// before the body is back.
const LATE: f64 = 2.0;
/// Maximum age of a report, however long the steps \[s\].
const STALE: f64 = 0.5;

/// A body that it is coupled with.
pub(crate) struct Partner {
    pub(crate) entity: Entity,
    rule: CoupledWith,
    pub(crate) given: GivenImpulses,
    /// The ghost of each coupled vertex.
    ghost_of: BTreeMap<u32, u32>,
    tets: Arc<Vec<[u32; 4]>>,
    triangles: Arc<Vec<[u32; 3]>>,
    /// The other body's surface in ghost numbers, if the body lies on it.
    pub(crate) surface: Vec<[u32; 3]>,
    lying: Option<SurfaceContacts>,
    pub(crate) is_wall: bool,
    /// In ghost numbers.
    ties: Vec<Tie>,
    presses: Vec<NodeContact>,
    ghost_nodes: Vec<GhostNode>,
    /// Ghosts that take part in the current step, and the results of all ghosts.
    used: Vec<u32>,
    moved: Vec<GhostMoved>,
    force: [f64; 2],
}

/// All couplings of a body.
pub struct FastSide {
    with: Vec<Partner>,
    fused: Vec<FusedBody>,
    /// Force of the joints within the island, in the last step \[N\].
    fused_force: f64,
    /// Surface vertices that can touch other bodies; valid while the body has these triangles.
    outside: Vec<u32>,
    triangles: Arc<Vec<[u32; 3]>>,
    ghost_nodes: Vec<GhostNode>,
    ties: Vec<Tie>,
    presses: Vec<NodeContact>,
}

impl FastSide {
    /// For a body of the scene; `None` if it is coupled with nothing.
    ///
    /// # Errors
    /// An invalid coupling.
    pub fn new(body: &Deformable, thickness: f64, scene: &Snapshot) -> Result<Option<Self>, String> {
        let Some(coupled) = scene.get::<CoupledBody>(body.entity) else { return Ok(None) };
        let known = scene.get::<CouplingGiven>(body.entity);
        let (mut with, mut fused) = (Vec::new(), Vec::new());
        for rule in coupled.with.iter().filter(|rule| !is_rigid(scene, &rule.body)) {
            let told = |why: String| format!("it is coupled with '{}': {why}", rule.body);
            let other = other(body, rule, scene).map_err(told)?;
            if scene.soft_body(other.entity).is_some_and(|(_, of)| of.couples) {
                fused.push(FusedBody::new(body, &other, rule, scene).map_err(told)?);
                continue;
            }
            let known = known.and_then(|known| known.to.iter().find(|to| to.body == Some(other.entity)));
            with.push(Partner::new(body, &other, thickness, rule, scene, known).map_err(told)?);
        }
        if with.is_empty() && fused.is_empty() {
            return Ok(None);
        }
        let mut coupled = Self {
            with,
            fused,
            fused_force: 0.0,
            outside: Vec::new(),
            triangles: Arc::default(),
            ghost_nodes: Vec::new(),
            ties: Vec::new(),
            presses: Vec::new(),
        };
        coupled.look_outside(body);
        Ok(Some(coupled))
    }

    /// Reads and writes of the faster side.
    pub fn access(access: Access, bodies: &[Entity]) -> Access {
        access
            .reads::<CoupledBody>()
            .reads::<CouplingTaken>()
            .reads::<RemovedElements>()
            .writes::<CouplingGiven>(EntitySet::Of(bodies.to_vec()))
    }

    fn look_outside(&mut self, body: &Deformable) {
        if Arc::ptr_eq(&self.triangles, &body.triangles) {
            return;
        }
        self.triangles = body.triangles.clone();
        self.outside = body.triangles.iter().flatten().copied().collect();
        self.outside.sort_unstable();
        self.outside.dedup();
    }

    /// Before a step: reads the other bodies' reports, and lists the external nodes.
    ///
    /// # Errors
    /// Why it cannot continue.
    pub fn begin_step(
        &mut self,
        body: &Deformable,
        state: &State,
        site: &StepContext<'_>,
    ) -> Result<(), String> {
        self.look_outside(body);
        self.ghost_nodes.clear();
        self.ties.clear();
        self.presses.clear();
        for partner in &mut self.with {
            partner.follow(site)?;
            partner.receive(body.entity, site)?;
            partner.touch(body, &self.outside, state, site.period_secs())?;
            partner.join(self.ghost_nodes.len() as u32, &mut self.ties, &mut self.presses);
            let (ghost_nodes, used) = (&partner.ghost_nodes, &partner.used);
            self.ghost_nodes.extend(used.iter().map(|&ghost| ghost_nodes[ghost as usize]));
        }
        Ok(())
    }

    /// The external nodes of the step.
    #[must_use]
    pub fn external_nodes(&self) -> ExternalNodes<'_> {
        ExternalNodes { ghost_nodes: &self.ghost_nodes, ties: &self.ties, presses: &self.presses }
    }

    /// After a step: processes the results of the external nodes.
    pub fn end_step(&mut self, moved: &GhostImpulses, positions: &[Point3<f64>], dt: f64) {
        let (mut ghost_node, mut tie, mut press) = (0, 0, 0);
        for partner in &mut self.with {
            let [ghost_nodes, ties, presses] =
                [partner.used.len(), partner.ties.len(), partner.presses.len()];
            let ties_moved = &moved.ties[tie..tie + ties];
            let presses_moved = &moved.presses[press..press + presses];
            partner.moved.clear();
            partner.moved.extend(partner.ghost_nodes.iter().map(|ghost_node| {
                let mut alone = *ghost_node;
                alone.go(dt, &Vector3::zeros());
                let GhostNode { position, velocity, path, .. } = alone;
                GhostMoved { position, velocity, path, ..GhostMoved::default() }
            }));
            for (&ghost, moved) in
                partner.used.iter().zip(&moved.ghost_nodes[ghost_node..ghost_node + ghost_nodes])
            {
                partner.moved[ghost as usize] = *moved;
            }
            partner.force = [
                ties_moved.iter().map(|tied| tied.force.norm()).sum(),
                presses_moved.iter().map(|pressed| pressed.force.norm()).sum(),
            ];
            if !partner.is_wall {
                let lost = ties_moved.iter().map(|tied| tied.lost);
                let lost: f64 = lost.chain(presses_moved.iter().map(|pressed| pressed.lost)).sum();
                partner.given.ghosts.end_step(dt, &partner.moved, lost);
            }
            if let Some(lying) = &mut partner.lying {
                lying.end_step(&partner.presses, presses_moved, &partner.moved, positions);
                partner.given.anchors.clear();
                partner.given.anchors.extend_from_slice(lying.anchors());
            }
            (ghost_node, tie, press) = (ghost_node + ghost_nodes, tie + ties, press + presses);
        }
    }

    /// Bodies of the same island.
    #[must_use]
    pub fn fused(&self) -> &[FusedBody] {
        &self.fused
    }

    /// Sets the force of the island's joints, summed over its vertices, in the last step \[N\].
    pub fn fused_by(&mut self, force: f64) {
        self.fused_force = force;
    }

    /// Publishes the impulses given to the other bodies.
    pub fn publish(&self, body: Entity, out: &mut Commands) {
        if !self.with.is_empty() {
            let to = self.with.iter().map(|partner| partner.given.clone()).collect();
            out.put(body, CouplingGiven { to });
        }
    }

    /// Measures: forces of joints and contacts, and position errors of the ghosts.
    pub fn measure(&self, measures: &mut Measures<'_>) {
        let sum = |k: usize| self.with.iter().map(|partner| partner.force[k]).sum::<f64>();
        measures.put("joined_force_n", sum(0) + self.fused_force);
        measures.put("lying_force_n", sum(1));
        let count: usize = self.with.iter().map(|partner| partner.ties.len()).sum();
        let fused: usize = self.fused.iter().map(|fused| fused.count()).sum();
        measures.put("joined_vertices", (count + fused) as f64);
        let behind = self.with.iter().map(|partner| partner.given.ghosts.position_error_max());
        let tank: f64 = self.with.iter().map(|partner| partner.given.ghosts.tank()).sum();
        measures.put("coupling_tank_j", tank);
        measures.put("coupling_behind_m", behind.fold(0.0, f64::max));
    }
}

/// The body that a coupling names.
pub(crate) fn other(body: &Deformable, rule: &CoupledWith, scene: &Snapshot) -> Result<Deformable, String> {
    let entity = scene.find(&rule.body).ok_or("the scene has no such entity")?;
    if entity == body.entity {
        return Err("that is itself".into());
    }
    let can = |of: &SoftAbilities| of.answers_couplings || of.couples;
    if !scene.soft_body(entity).is_some_and(|(_, of)| can(&of)) {
        let valid = one_of(&scene.registry().soft_bodies_that(can));
        return Err(format!("that is to be moved by {valid}"));
    }
    let other = Deformable::read(scene, entity).map_err(|error| error.to_string())?;
    if other.tets.is_empty() {
        return Err("that has no volume: it needs a mesh of tetrahedra".into());
    }
    Ok(other)
}

impl Partner {
    pub(crate) fn new(
        body: &Deformable,
        other: &Deformable,
        thickness: f64,
        rule: &CoupledWith,
        scene: &Snapshot,
        known: Option<&GivenImpulses>,
    ) -> Result<Self, String> {
        let entity = other.entity;
        let body_from_other = scene.world_pose(body.entity).inverse() * scene.world_pose(entity);
        let given = match known.filter(|known| known.body == Some(entity)) {
            Some(known) if known.ghosts.is_sound(known.vertices.len()) => known.clone(),
            _ => {
                let grafts = match &rule.joined {
                    Some(joined) => grafts(body, other, &body_from_other, joined)?,
                    None => Vec::new(),
                };
                GivenImpulses { body: Some(entity), grafts: Arc::new(grafts), ..GivenImpulses::default() }
            }
        };
        let ghost_of = given.vertices.iter().zip(0..).map(|(&vertex, ghost)| (vertex, ghost)).collect();
        let mut partner = Self {
            entity,
            rule: rule.clone(),
            given,
            ghost_of,
            tets: Arc::default(),
            triangles: Arc::default(),
            surface: Vec::new(),
            lying: None,
            is_wall: true,
            ties: Vec::new(),
            presses: Vec::new(),
            ghost_nodes: Vec::new(),
            used: Vec::new(),
            moved: Vec::new(),
            force: [0.0; 2],
        };
        partner.take_over(&other.tets, &other.triangles, &[], &other.positions, &body_from_other)?;
        if let Some(lies) = rule.lies {
            let rule = SurfaceContactParams { thickness, stiffness: lies.stiffness, friction: lies.friction };
            let places = partner.given.ghosts.positions();
            let surface = Surface::new(places, &partner.surface).map_err(|error| error.to_string())?;
            let mut lying = SurfaceContacts::new(rule, &surface);
            lying.hold(&partner.given.anchors);
            partner.lying = Some(lying);
        }
        Ok(partner)
    }

    /// Updates the elements and the surface of the other body.
    fn take_over(
        &mut self,
        tets: &Arc<Vec<[u32; 4]>>,
        triangles: &Arc<Vec<[u32; 3]>>,
        removed: &[u32],
        positions: &[Point3<f64>],
        body_from_other: &Isometry3<f64>,
    ) -> Result<(), String> {
        (self.tets, self.triangles) = (tets.clone(), triangles.clone());
        let gone: BTreeSet<u32> = removed.iter().copied().collect();
        if !gone.is_empty() {
            Arc::make_mut(&mut self.given.grafts).retain(|graft| !gone.contains(&graft.element));
        }
        let of_grafts = self.given.grafts.iter().filter_map(|graft| tets.get(graft.element as usize));
        let of_surface = triangles.iter().flatten().filter(|_| self.rule.lies.is_some());
        let new: BTreeSet<u32> = of_grafts
            .flatten()
            .chain(of_surface)
            .copied()
            .filter(|vertex| !self.ghost_of.contains_key(vertex))
            .collect();
        let mut places = Vec::with_capacity(new.len());
        for vertex in new {
            let place = positions.get(vertex as usize).ok_or("its mesh names a vertex that it has not")?;
            places.push(body_from_other * place);
            self.ghost_of.insert(vertex, self.ghost_of.len() as u32);
            Arc::make_mut(&mut self.given.vertices).push(vertex);
        }
        self.given.ghosts.more(&places).map_err(|error| error.to_string())?;
        let ghost = |vertex: u32| self.ghost_of.get(&vertex).copied().unwrap_or_default();
        self.surface.clear();
        if self.rule.lies.is_some() {
            self.surface.extend(triangles.iter().map(|corners| corners.map(ghost)));
        }
        let Joined { stiffness, damping, .. } = self.rule.joined.unwrap_or_default();
        self.ties.clear();
        self.ties.extend(self.given.grafts.iter().filter_map(|graft| {
            let corners = tets.get(graft.element as usize)?;
            let ghost_nodes = [0, 1, 2, 3].map(|k| (ghost(corners[k]), graft.weights[k]));
            Some(Tie { node: graft.vertex, ghost_nodes, stiffness, damping })
        }));
        Ok(())
    }

    /// Checks for topology changes of the other body.
    pub(crate) fn follow(&mut self, site: &StepContext<'_>) -> Result<(), String> {
        let scene = site.scene;
        let (Some(volume), Some(surface)) =
            (scene.get::<TetMesh>(self.entity), scene.get::<SurfaceMesh>(self.entity))
        else {
            return Ok(());
        };
        let same = Arc::ptr_eq(&volume.tets, &self.tets) && Arc::ptr_eq(&surface.triangles, &self.triangles);
        if same {
            return Ok(());
        }
        let removed = scene.get::<RemovedElements>(self.entity).map(|removed| removed.elements.clone());
        let Some(vertices) = scene.get::<VertexPositions>(self.entity) else { return Ok(()) };
        let body_from_other = site.world_from_body.inverse() * scene.world_pose(self.entity);
        let removed = removed.unwrap_or_default();
        self.take_over(&volume.tets, &surface.triangles, &removed, &vertices.positions, &body_from_other)
    }

    /// Reads the other body's report of its last step.
    pub(crate) fn receive(&mut self, me: Entity, site: &StepContext<'_>) -> Result<(), String> {
        let scene = site.scene;
        self.is_wall = true;
        let Some(told) = scene.get::<CouplingTaken>(self.entity) else { return Ok(()) };
        let age = site.tick.time.as_secs_f64() - site.period_secs() - told.time.as_secs_f64();
        if age > STALE.min(LATE * told.step) {
            return Ok(());
        }
        let Some(from) = told.from.iter().find(|from| from.body == Some(me)) else { return Ok(()) };
        self.is_wall = from.taken.is_empty();
        if told.number == self.given.heard || self.is_wall {
            return Ok(());
        }
        let (Some(vertices), Some(moving)) =
            (scene.get::<VertexPositions>(self.entity), scene.get::<VertexVelocities>(self.entity))
        else {
            return Ok(());
        };
        let body_from_other = site.world_from_body.inverse() * scene.world_pose(self.entity);
        let count = self.given.ghosts.count();
        let (mut positions, mut velocities, mut expected) =
            (Vec::with_capacity(count), Vec::with_capacity(count), Vec::with_capacity(count));
        for (ghost, &vertex) in self.given.vertices.iter().enumerate() {
            let at = vertex as usize;
            let place = vertices.positions.get(at).ok_or("it has lost vertices")?;
            let velocity = moving.velocities.get(at).copied().unwrap_or_default();
            positions.push(body_from_other * place);
            velocities.push(body_from_other.rotation * velocity);
            let ahead = from.expected.get(ghost).copied().unwrap_or(velocity);
            expected.push(body_from_other.rotation * ahead);
        }
        // Ghosts newer than the report are immovable.
        let padded = |list: &[Vector3<f64>]| -> Vec<Vector3<f64>> {
            list.iter().copied().chain(std::iter::repeat(Vector3::zeros())).take(count).collect()
        };
        let padded_numbers = |list: &[f64]| -> Vec<f64> {
            list.iter().copied().chain(std::iter::repeat(0.0)).take(count).collect()
        };
        let news = SlowBodyReport {
            positions: &positions,
            velocities: &velocities,
            expected: &expected,
            mobilities: &padded_numbers(&from.mobilities),
            masses_inverse: &padded_numbers(&from.masses_inverse),
            last: &padded(&from.last),
            given_work: from.given_work,
            received: from.received,
            steps: from.steps,
            step: told.step,
        };
        self.given.ghosts.receive(&news).map_err(|error| error.to_string())?;
        self.given.heard = told.number;
        Ok(())
    }

    /// Finds the contacts with the other body, and corrects the ghosts.
    fn touch(&mut self, body: &Deformable, outside: &[u32], state: &State, dt: f64) -> Result<(), String> {
        self.ties.retain(|tie| body.loose.binary_search(&tie.node).is_err());
        self.presses.clear();
        let State { positions, velocities } = state;
        if let Some(lying) = &mut self.lying {
            let surface = Surface::new(self.given.ghosts.positions(), &self.surface)
                .map_err(|error| error.to_string())?;
            lying.find(&surface, outside, positions, velocities, dt, &mut self.presses);
        }
        self.ghost_nodes.clear();
        let external_nodes = ExternalNodes { ghost_nodes: &[], ties: &self.ties, presses: &self.presses };
        self.given.ghosts.begin_step(&external_nodes, positions, &mut self.ghost_nodes);
        if self.is_wall {
            self.ghost_nodes.iter_mut().for_each(|ghost_node| *ghost_node = ghost_node.as_wall());
        }
        Ok(())
    }

    /// Adds ties and contacts in ghost node numbers, of which `first` are taken, and records which ghosts these are.
    fn join(&mut self, first: u32, ties: &mut Vec<Tie>, presses: &mut Vec<NodeContact>) {
        self.used.clear();
        self.used.extend(self.ties.iter().flat_map(|tie| tie.ghost_nodes.map(|(ghost, _)| ghost)));
        let of_presses = self.presses.iter();
        self.used.extend(
            of_presses.flat_map(|press| press.ghost_nodes.into_iter().chain(press.anchor)).map(|of| of.0),
        );
        self.used.sort_unstable();
        self.used.dedup();
        self.given.near.clone_from(&self.used);
        let used = &self.used;
        let ghost_node = |ghost: u32| first + used.binary_search(&ghost).unwrap_or_default() as u32;
        let of_three = |of: [(u32, f64); 3]| of.map(|(ghost, weight)| (ghost_node(ghost), weight));
        ties.extend(self.ties.iter().map(|tie| Tie {
            ghost_nodes: tie.ghost_nodes.map(|(ghost, weight)| (ghost_node(ghost), weight)),
            ..*tie
        }));
        presses.extend(self.presses.iter().map(|press| NodeContact {
            ghost_nodes: of_three(press.ghost_nodes),
            anchor: of_three(press.anchor),
            ..*press
        }));
    }
}
