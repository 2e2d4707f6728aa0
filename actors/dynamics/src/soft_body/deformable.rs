//! A deforming body as the scene has it, whichever method moves it.

use std::sync::Arc;

use nalgebra::{Isometry3, Point3, Vector3};
use trocar_scene::soft_body::one_of;
use trocar_scene::{
    Access, Anchors, Commands, Component, ControllerError, Entity, EntitySet, Frozen, LineMesh,
    RestPositions, Snapshot, SoftAbilities, SurfaceMesh, TetMesh, Tick, VertexPositions, VertexVelocities,
};

use super::PinnedBody;
use super::coupling::CoupledBody;
use crate::faulty::Faulty;

/// A body with vertices that move.
#[derive(Clone, Debug)]
pub struct Deformable {
    /// Whose it is.
    pub entity: Entity,
    /// Its name, for messages and measures.
    pub name: String,
    /// Vertices without any force, in its frame \[m\].
    pub rest: Arc<Vec<Point3<f64>>>,
    /// Vertices where they are, in its frame \[m\].
    pub positions: Arc<Vec<Point3<f64>>>,
    /// Velocities of the vertices \[m/s\].
    pub velocities: Arc<Vec<Vector3<f64>>>,
    /// Its surface.
    pub triangles: Arc<Vec<[u32; 3]>>,
    /// Its volume, if it has one.
    pub tets: Arc<Vec<[u32; 4]>>,
    /// Its line, if it is one, and the radius of that \[m\].
    pub segments: Arc<Vec<[u32; 2]>>,
    /// Radius of the line \[m\].
    pub radius: f64,
    /// Vertices that are held where they are, ascending.
    pub pinned: Vec<u32>,
    /// Where that is.
    pub anchors: Anchors,
    /// Vertices that no element uses any longer, ascending: nothing touches them.
    pub loose: Vec<u32>,
    /// Whether vertices have come apart: then some are where others are.
    pub is_parted: bool,
    /// Whether the scene has its shape at rest already.
    has_rest: bool,
}

impl Deformable {
    /// Every entity that carries `T`, in order.
    pub fn carriers<T: Component>(scene: &Snapshot) -> Vec<Entity> {
        let mut carriers: Vec<Entity> = scene.iter::<T>().map(|(entity, _)| entity).collect();
        carriers.sort_unstable();
        carriers
    }

    /// Reads a body. What is not there yet is as at rest.
    ///
    /// # Errors
    /// It has no vertices, numbers of them that do not go together, or elements that name others than there are; or it is
    /// coupled or pinned, and cannot be.
    pub fn read(scene: &Snapshot, entity: Entity) -> Result<Self, ControllerError> {
        let name = scene.name(entity);
        let wrong = |what: &str| ControllerError::Scene(format!("'{name}' {what}"));
        let Some(vertices) = scene.get::<VertexPositions>(entity) else {
            return Err(wrong("has no vertices to move: give it a mesh"));
        };
        let is_coupled = scene.get::<CoupledBody>(entity).is_some();
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

    /// What jaws may hold of it: its triangles, or of a line its segments, with the last vertex of each twice.
    #[must_use]
    pub fn holdable(&self) -> Arc<Vec<[u32; 3]>> {
        if self.triangles.is_empty() {
            Arc::new(self.segments.iter().map(|&[a, b]| [a, b, b]).collect())
        } else {
            self.triangles.clone()
        }
    }

    /// Finds anew which of its vertices are held where they are.
    pub fn anchor(&mut self) {
        let held = self.rest.iter().enumerate().filter(|(_, point)| self.anchors.hold(point));
        self.pinned = held.map(|(vertex, _)| vertex as u32).collect();
    }

    /// The same of some of them, ascending, that are new or lie otherwise at rest.
    pub fn anchor_again(&mut self, vertices: &[u32]) {
        for &vertex in vertices {
            let held = self.rest.get(vertex as usize).is_some_and(|point| self.anchors.hold(point));
            is_among(&mut self.pinned, vertex, held);
        }
    }

    /// Says of a vertex whether no element uses it any longer.
    pub fn is_loose(&mut self, vertex: u32, is_loose: bool) {
        is_among(&mut self.loose, vertex, is_loose);
    }

    /// Whether nothing moves a vertex.
    #[must_use]
    pub fn is_staying(&self, vertex: u32) -> bool {
        [&self.pinned, &self.loose].into_iter().any(|list| list.binary_search(&vertex).is_ok())
    }

    /// Vertices that nothing moves, ascending: held ones, and those that nothing uses.
    #[must_use]
    pub fn staying(&self) -> Vec<u32> {
        let mut staying: Vec<u32> = self.pinned.iter().chain(&self.loose).copied().collect();
        staying.sort_unstable();
        staying.dedup();
        staying
    }

    /// Of each vertex whether nothing moves it: it is held, or nothing uses it.
    #[must_use]
    pub fn stays(&self) -> Vec<bool> {
        let mut stays = vec![false; self.rest.len()];
        self.pinned.iter().chain(&self.loose).for_each(|&at| stays[at as usize] = true);
        stays
    }

    /// What a controller of deforming bodies reads and writes of them.
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

    /// Tells the scene where the body is.
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

    /// Its shape at rest is another one from now on.
    pub fn changed_topology(&mut self) {
        self.has_rest = false;
    }

    /// Tells everybody that its solver had to stop it where it is.
    pub fn freeze(&self, reason: &dyn std::fmt::Display, tick: &Tick<'_>, out: &mut Commands) {
        out.put(self.entity, Frozen { reason: reason.to_string(), since: tick.time });
        out.event("frozen", self.entity, None, tick.time.as_secs_f64());
    }

    /// A line that lies otherwise than the scene has it, and is at rest so.
    pub fn lie(&mut self, nodes: Vec<Point3<f64>>) {
        self.segments = Arc::new((1..nodes.len() as u32).map(|end| [end - 1, end]).collect());
        self.velocities = Arc::new(vec![Vector3::zeros(); nodes.len()]);
        self.rest = Arc::new(nodes);
        self.anchor();
        self.positions = self.rest.clone();
        self.has_rest = false;
    }

    /// Gravity in its frame \[m/s²\].
    pub fn gravity(gravity_in_world: &Vector3<f64>, world_from_body: &Isometry3<f64>) -> Vector3<f64> {
        world_from_body.rotation.inverse() * gravity_in_world
    }
}

/// Whether elements name vertices that there are; else which do not.
fn within<const N: usize>(kind: &str, elements: &[[u32; N]], vertices: usize) -> Result<(), String> {
    let is_bad = |index: usize| elements[index].iter().any(|&vertex| vertex as usize >= vertices);
    Faulty::among(elements.len(), is_bad).refuse(|faulty| {
        format!(
            "has {vertices} vertices, 0 to {}, and elements ({kind}) that name others: {faulty}",
            vertices.saturating_sub(1)
        )
    })
}

/// Puts it into an ascending list, or takes it out.
fn is_among(list: &mut Vec<u32>, vertex: u32, is: bool) {
    match list.binary_search(&vertex) {
        Err(at) if is => list.insert(at, vertex),
        Ok(at) if !is => drop(list.remove(at)),
        _ => {}
    }
}

/// Writes over a shared list, in place where nobody else has it.
fn fill<T: Copy>(shared: &mut Arc<Vec<T>>, values: &[T]) {
    match Arc::get_mut(shared) {
        Some(own) if own.len() == values.len() => own.copy_from_slice(values),
        _ => *shared = Arc::new(values.to_vec()),
    }
}
