//! A deformable body as the scene stores it, for every method.

use std::sync::Arc;

use nalgebra::{Isometry3, Point3, Vector3};
use trocar_scene::soft_body::one_of;
use trocar_scene::{
    Access, Anchors, Commands, Component, ControllerError, Entity, EntitySet, Frozen, LineMesh,
    RestPositions, Snapshot, SoftAbilities, SurfaceMesh, TetMesh, Tick, VertexPositions, VertexVelocities,
};

use super::PinnedBody;
use super::bearing::joint::is_with_rigid_only;
use super::coupling::CoupledBody;
use crate::faulty::Faulty;

/// A body with moving vertices.
#[derive(Clone, Debug)]
pub struct Deformable {
    /// Its entity.
    pub entity: Entity,
    /// Its name, for messages and measures.
    pub name: String,
    /// Rest positions of the vertices, in the body's frame \[m\].
    pub rest: Arc<Vec<Point3<f64>>>,
    /// Current positions of the vertices, in the body's frame \[m\].
    pub positions: Arc<Vec<Point3<f64>>>,
    /// Velocities of the vertices \[m/s\].
    pub velocities: Arc<Vec<Vector3<f64>>>,
    /// Its surface triangles.
    pub triangles: Arc<Vec<[u32; 3]>>,
    /// Its tetrahedra, if it is a volume.
    pub tets: Arc<Vec<[u32; 4]>>,
    /// Its segments, if it is a line.
    pub segments: Arc<Vec<[u32; 2]>>,
    /// Radius of the line \[m\].
    pub radius: f64,
    /// Fixed vertices, ascending.
    pub pinned: Vec<u32>,
    /// Their anchors.
    pub anchors: Anchors,
    /// Vertices that no element uses any longer, ascending: nothing touches them.
    pub loose: Vec<u32>,
    /// Whether vertices were duplicated: duplicates may coincide.
    pub is_parted: bool,
    /// Whether the scene already has its rest shape.
    has_rest: bool,
}

impl Deformable {
    /// All entities that carry `T`, in order.
    pub fn carriers<T: Component>(scene: &Snapshot) -> Vec<Entity> {
        let mut carriers: Vec<Entity> = scene.iter::<T>().map(|(entity, _)| entity).collect();
        carriers.sort_unstable();
        carriers
    }

    /// Reads a body. Missing state is as at rest.
    ///
    /// # Errors
    /// It has no vertices, lists of different lengths, or elements with invalid vertices; or it is coupled or pinned by
    /// a method that does not support it.
    pub fn read(scene: &Snapshot, entity: Entity) -> Result<Self, ControllerError> {
        let name = scene.name(entity);
        let wrong = |what: &str| ControllerError::Scene(format!("'{name}' {what}"));
        let Some(vertices) = scene.get::<VertexPositions>(entity) else {
            return Err(wrong("has no vertices to move: give it a mesh"));
        };
        let coupled = scene.get::<CoupledBody>(entity);
        let is_coupled = coupled.is_some_and(|coupled| !is_with_rigid_only(scene, coupled));
        let can = scene.soft_body(entity).map_or(SoftAbilities::NONE, |(_, can)| can);
        let those = |ability: fn(&SoftAbilities) -> bool| one_of(&scene.registry().soft_bodies_that(ability));
        if is_coupled && !can.couples {
            let valid = those(|of| of.couples);
            return Err(wrong(&format!(
                "is 'coupled', which goes with {valid} only: couple that with it instead"
            )));
        }
        if scene.get::<PinnedBody>(entity).is_some() && !can.is_pinnable {
            let valid = those(|of| of.is_pinnable);
            return Err(wrong(&format!(
                "is 'pinned', which goes with {valid} only: anchor it, or let jaws hold it"
            )));
        }
        let positions = vertices.positions.clone();
        let rest = scene.get::<RestPositions>(entity);
        let has_rest = rest.is_some();
        let rest = rest.map_or_else(|| positions.clone(), |rest| rest.positions.clone());
        let velocities = scene.get::<VertexVelocities>(entity);
        let velocities = match velocities {
            Some(velocities) => velocities.velocities.clone(),
            None => Arc::new(vec![Vector3::zeros(); positions.len()]),
        };
        if rest.len() != positions.len() || velocities.len() != positions.len() {
            return Err(wrong("has other numbers of vertices, of vertices at rest and of velocities"));
        }
        let anchors = scene.get::<Anchors>(entity).cloned().unwrap_or_default();
        let line = scene.get::<LineMesh>(entity);
        let triangles = scene.get::<SurfaceMesh>(entity).map(|surface| surface.triangles.clone());
        let tets = scene.get::<TetMesh>(entity).map(|volume| volume.tets.clone());
        let (triangles, tets) = (triangles.unwrap_or_default(), tets.unwrap_or_default());
        let segments = line.map(|line| line.segments.clone()).unwrap_or_default();
        let nodes = positions.len();
        within("triangle", &triangles, nodes).map_err(|what| wrong(&what))?;
        within("tetrahedron", &tets, nodes).map_err(|what| wrong(&what))?;
        within("segment", &segments, nodes).map_err(|what| wrong(&what))?;
        let mut body = Self {
            entity,
            rest,
            positions,
            velocities,
            triangles,
            tets,
            segments,
            radius: line.map_or(0.0, |line| line.radius),
            pinned: Vec::new(),
            anchors,
            loose: Vec::new(),
            is_parted: false,
            has_rest,
            name,
        };
        body.anchor();
        Ok(body)
    }

    /// The parts that jaws may hold: its triangles, or of a line its segments, with the last vertex of each twice.
    #[must_use]
    pub fn holdable(&self) -> Arc<Vec<[u32; 3]>> {
        if self.triangles.is_empty() {
            Arc::new(self.segments.iter().map(|&[a, b]| [a, b, b]).collect())
        } else {
            self.triangles.clone()
        }
    }

    /// Recomputes its fixed vertices from the anchors.
    pub fn anchor(&mut self) {
        let held = self.rest.iter().enumerate().filter(|(_, point)| self.anchors.hold(point));
        self.pinned = held.map(|(vertex, _)| vertex as u32).collect();
    }

    /// The same for some vertices, ascending, that are new or have new rest positions.
    pub fn anchor_again(&mut self, vertices: &[u32]) {
        for &vertex in vertices {
            let held = self.rest.get(vertex as usize).is_some_and(|point| self.anchors.hold(point));
            is_among(&mut self.pinned, vertex, held);
        }
    }

    /// Sets whether no element uses a vertex any longer.
    pub fn is_loose(&mut self, vertex: u32, is_loose: bool) {
        is_among(&mut self.loose, vertex, is_loose);
    }

    /// Whether a vertex is immovable.
    #[must_use]
    pub fn is_staying(&self, vertex: u32) -> bool {
        [&self.pinned, &self.loose].into_iter().any(|list| list.binary_search(&vertex).is_ok())
    }

    /// Immovable vertices, ascending: fixed ones and unused ones.
    #[must_use]
    pub fn staying(&self) -> Vec<u32> {
        let mut staying: Vec<u32> = self.pinned.iter().chain(&self.loose).copied().collect();
        staying.sort_unstable();
        staying.dedup();
        staying
    }

    /// Whether each vertex is immovable: fixed or unused.
    #[must_use]
    pub fn stays(&self) -> Vec<bool> {
        let mut stays = vec![false; self.rest.len()];
        self.pinned.iter().chain(&self.loose).for_each(|&at| stays[at as usize] = true);
        stays
    }

    /// What a controller of deformable bodies reads and writes of them.
    pub fn access(bodies: &[Entity]) -> Access {
        let all = || EntitySet::Of(bodies.to_vec());
        Access::new()
            .reads::<Anchors>()
            .reads::<SurfaceMesh>()
            .reads::<TetMesh>()
            .reads::<LineMesh>()
            .reads::<Frozen>()
            .writes::<VertexPositions>(all())
            .writes::<VertexVelocities>(all())
            .writes::<RestPositions>(all())
            .writes::<Frozen>(all())
    }

    /// Writes the body's state to the scene.
    pub fn write(&mut self, positions: &[Point3<f64>], velocities: &[Vector3<f64>], out: &mut Commands) {
        if !self.has_rest {
            out.put(self.entity, RestPositions { positions: self.rest.clone() });
            self.has_rest = true;
        }
        fill(&mut self.positions, positions);
        fill(&mut self.velocities, velocities);
        out.put(self.entity, VertexPositions { positions: self.positions.clone() });
        out.put(self.entity, VertexVelocities { velocities: self.velocities.clone() });
    }

    /// Marks the rest shape as changed.
    pub fn changed_topology(&mut self) {
        self.has_rest = false;
    }

    /// Reports that the solver had to freeze the body.
    pub fn freeze(&self, reason: &dyn std::fmt::Display, tick: &Tick<'_>, out: &mut Commands) {
        out.put(self.entity, Frozen { reason: reason.to_string(), since: tick.time });
        out.event("frozen", self.entity, None, tick.time.as_secs_f64());
    }

    /// Replaces the scene's line by another one, which is also its rest shape.
    pub fn replace_line(&mut self, nodes: Vec<Point3<f64>>) {
        self.segments = Arc::new((1..nodes.len() as u32).map(|end| [end - 1, end]).collect());
        self.velocities = Arc::new(vec![Vector3::zeros(); nodes.len()]);
        self.rest = Arc::new(nodes);
        self.anchor();
        self.positions = self.rest.clone();
        self.has_rest = false;
    }

    /// Gravity in the body's frame \[m/s²\].
    pub fn gravity(gravity_in_world: &Vector3<f64>, world_from_body: &Isometry3<f64>) -> Vector3<f64> {
        world_from_body.rotation.inverse() * gravity_in_world
    }
}

/// Checks that elements refer to existing vertices; the error names those that do not.
fn within<const N: usize>(kind: &str, elements: &[[u32; N]], vertices: usize) -> Result<(), String> {
    let is_bad = |index: usize| elements[index].iter().any(|&vertex| vertex as usize >= vertices);
    Faulty::among(elements.len(), is_bad).refuse(|faulty| {
        format!(
            "has {vertices} vertices, 0 to {}, and elements ({kind}) that name others: {faulty}",
            vertices.saturating_sub(1)
        )
    })
}

/// Inserts a vertex into an ascending list, or removes it.
fn is_among(list: &mut Vec<u32>, vertex: u32, is: bool) {
    match list.binary_search(&vertex) {
        Err(at) if is => list.insert(at, vertex),
        Ok(at) if !is => drop(list.remove(at)),
        _ => {}
    }
}

/// Overwrites a shared list, in place if it has no other owner.
fn fill<T: Copy>(shared: &mut Arc<Vec<T>>, values: &[T]) {
    match Arc::get_mut(shared) {
        Some(own) if own.len() == values.len() => own.copy_from_slice(values),
        _ => *shared = Arc::new(values.to_vec()),
    }
}
