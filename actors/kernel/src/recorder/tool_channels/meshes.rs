//! Coarse meshes of the bodies of a scene, each made once for each of its topologies.

use std::collections::BTreeMap;
use std::sync::Arc;

use trocar_scene::mesh::TetData;
use trocar_scene::{Entity, LineMesh, Revision, Snapshot, SurfaceMesh, TetMesh, VertexPositions};

use super::coarse::{Coarse, coarsen};
use super::decimate::decimate;

/// Bodies with more vertices are left out: the recorder has no time for them.
const VERTICES_MAX: usize = 200_000;

/// The coarse mesh of a body.
#[derive(Clone, Debug)]
pub(super) enum CoarseMesh {
    /// A surface, or the boundary of a volume.
    Surface(Arc<Coarse<3>>),
    /// A thread of that radius \[m\].
    Line(Arc<Coarse<2>>, f64),
}

/// What a coarse mesh was made of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Source {
    topology: Revision,
    count: usize,
    most: usize,
}

/// The coarse meshes so far.
#[derive(Default)]
pub(super) struct Meshes {
    made: BTreeMap<Entity, (Source, CoarseMesh)>,
}

/// Whether an entity has a mesh to be drawn.
pub(super) fn has_mesh(scene: &Snapshot, entity: Entity) -> bool {
    let is_mesh = scene.get::<SurfaceMesh>(entity).is_some()
        || scene.get::<TetMesh>(entity).is_some()
        || scene.get::<LineMesh>(entity).is_some();
    is_mesh && scene.get::<VertexPositions>(entity).is_some()
}

impl Meshes {
    /// The mesh of an entity with at most `most` vertices, if it has one.
    pub(super) fn of(&mut self, scene: &Snapshot, entity: Entity, most: usize) -> Option<CoarseMesh> {
        self.made.retain(|entity, _| scene.get::<VertexPositions>(*entity).is_some());
        let count = scene.get::<VertexPositions>(entity)?.positions.len();
        let changes = [
            scene.changed::<SurfaceMesh>(entity),
            scene.changed::<TetMesh>(entity),
            scene.changed::<LineMesh>(entity),
        ];
        let topology = changes.into_iter().flatten().max()?;
        let source = Source { topology, count, most };
        match self.made.get(&entity) {
            Some((made_of, mesh)) if *made_of == source => return Some(mesh.clone()),
            _ if count > VERTICES_MAX => {
                tracing::warn!("the recording shows viewers no '{}': {count} vertices", scene.name(entity));
                return None;
            }
            _ => {}
        }
        let mesh = made(scene, entity, count, most)?;
        self.made.insert(entity, (source, mesh.clone()));
        Some(mesh)
    }
}

fn made(scene: &Snapshot, entity: Entity, count: usize, most: usize) -> Option<CoarseMesh> {
    if let Some(line) = scene.get::<LineMesh>(entity) {
        return Some(CoarseMesh::Line(Arc::new(coarsen(&line.segments, count, most)), line.radius));
    }
    let positions = &scene.get::<VertexPositions>(entity)?.positions;
    let coarse = match (scene.get::<SurfaceMesh>(entity), scene.get::<TetMesh>(entity)) {
        (Some(mesh), _) => decimate(&mesh.triangles, positions, most),
        (None, Some(volume)) => {
            let tets = volume.tets.to_vec();
            decimate(&TetData { tets, ..TetData::default() }.boundary_triangles(), positions, most)
        }
        (None, None) => return None,
    };
    Some(CoarseMesh::Surface(Arc::new(coarse)))
}
