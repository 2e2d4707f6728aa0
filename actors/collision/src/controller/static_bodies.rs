//! The bodies of a scene that never move, as one surface in world.

use nalgebra::{Isometry3, Point3, Vector3};
use trocar_scene::components::{Motion, RigidBody, Shape, SurfaceMesh, VertexPositions};
use trocar_scene::shapes::{Detail, surface_of};
use trocar_scene::{Entity, Revision, Snapshot};

use crate::Surface;
use crate::moving_surface::MovingSurface;
use crate::pseudonormal::pseudonormal;

/// Tessellation of shapes: 0.2 % of a radius between a circle and its polygon.
const DETAIL: Detail = Detail { segments: 48, fine_segments: 24 };

/// What a body was read from.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Source {
    entity: Entity,
    world_from_body: Isometry3<f64>,
    geometry: [Option<Revision>; 3],
}

/// A point of the surface, in world.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StaticPoint {
    /// Where it is \[m\].
    pub point_in_world: Point3<f64>,
    /// Unit normal, outwards.
    pub outwards_in_world: Vector3<f64>,
}

/// All static bodies of a scene. Read again when one of them comes, goes, or is another.
pub struct StaticBodies {
    sources: Vec<Source>,
    surface: MovingSurface,
}

impl StaticBodies {
    /// Those of the scene at present.
    pub fn new(scene: &Snapshot) -> Self {
        let sources: Vec<Source> = sources(scene).collect();
        let (vertices, triangles) = corners(scene, &sources);
        let surface = MovingSurface::new(&Surface::trusted(&vertices, &triangles));
        Self { sources, surface }
    }

    /// Reads them again if they have changed.
    pub fn follow(&mut self, scene: &Snapshot) {
        // Compared as they are read: nothing is allocated while nothing changes.
        if sources(scene).eq(self.sources.iter().copied()) {
            return;
        }
        self.sources.clear();
        self.sources.extend(sources(scene));
        let (vertices, triangles) = corners(scene, &self.sources);
        self.surface.follow(&Surface::trusted(&vertices, &triangles));
    }

    /// Their surface, in world.
    pub fn surface(&self) -> &MovingSurface {
        &self.surface
    }

    /// The point of the surface nearest to `at`, within `radius` \[m\].
    pub fn nearest(&self, at: &Point3<f64>, radius: f64) -> Option<StaticPoint> {
        let surface = self.surface.surface();
        let found = self.surface.tree().nearest_to_point(&surface, at, radius).ok()??;
        let weights = &found.nearest.weights;
        let outwards = pseudonormal(&surface, self.surface.topology(), found.triangle, weights)?;
        Some(StaticPoint {
            point_in_world: found.nearest.point,
            outwards_in_world: outwards.try_normalize(0.0)?,
        })
    }
}

fn sources(scene: &Snapshot) -> impl Iterator<Item = Source> + '_ {
    let fixed = scene.iter::<RigidBody>().filter(|(_, body)| body.motion == Motion::Static);
    let source = move |(entity, _): (Entity, &RigidBody)| Source {
        entity,
        world_from_body: scene.world_pose(entity),
        geometry: [
            scene.changed::<Shape>(entity),
            scene.changed::<SurfaceMesh>(entity),
            scene.changed::<VertexPositions>(entity),
        ],
    };
    fixed.map(source)
}

fn corners(scene: &Snapshot, sources: &[Source]) -> (Vec<Point3<f64>>, Vec<[u32; 3]>) {
    let (mut vertices, mut triangles) = (Vec::new(), Vec::new());
    for source in sources {
        let first = vertices.len() as u32;
        let mut add = |positions: &[Point3<f64>], corners: &[[u32; 3]]| {
            // A body that cannot be used is not felt.
            if Surface::new(positions, corners).is_ok() {
                vertices.extend(positions.iter().map(|position| source.world_from_body * position));
                triangles.extend(corners.iter().map(|corners| corners.map(|corner| first + corner)));
            }
        };
        let entity = source.entity;
        if let Some(made) = scene.get::<Shape>(entity).and_then(|shape| surface_of(shape, &DETAIL).ok()) {
            add(&made.positions, &made.triangles);
        } else if let (Some(mesh), Some(positions)) =
            (scene.get::<SurfaceMesh>(entity), scene.get::<VertexPositions>(entity))
        {
            add(&positions.positions, &mesh.triangles);
        }
    }
    (vertices, triangles)
}
