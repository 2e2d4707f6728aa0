//! The geometry of rigid bodies, as the scene stores it.

use std::sync::Arc;

use nalgebra::Point3;
use trocar_scene::{Entity, Shape, Snapshot, SurfaceMesh, VertexPositions};

/// Geometry of a body.
#[derive(Clone, Debug)]
pub(crate) enum Geometry {
    Shape(Shape),
    /// A validated surface mesh: external detectors find its contacts.
    Surface(Arc<Vec<Point3<f64>>>, Arc<Vec<[u32; 3]>>),
}

impl Geometry {
    /// The geometry of an entity; the analytic shape, where it has both.
    pub fn of(scene: &Snapshot, entity: Entity) -> Option<Self> {
        if let Some(shape) = scene.get::<Shape>(entity) {
            return Some(Self::Shape(shape.clone()));
        }
        let (vertices, surface) = (scene.get::<VertexPositions>(entity)?, scene.get::<SurfaceMesh>(entity)?);
        Some(Self::Surface(vertices.positions.clone(), surface.triangles.clone()))
    }

    /// Whether an entity has geometry; copies nothing, because it is called in every tick.
    pub fn is_there(scene: &Snapshot, entity: Entity) -> bool {
        let surface =
            || scene.get::<VertexPositions>(entity).is_some() && scene.get::<SurfaceMesh>(entity).is_some();
        scene.get::<Shape>(entity).is_some() || surface()
    }

    pub fn is_same(&self, other: &Self) -> bool {
        match (self, other) {
            (Self::Shape(one), Self::Shape(other)) => one == other,
            (Self::Surface(a, b), Self::Surface(c, d)) => Arc::ptr_eq(a, c) && Arc::ptr_eq(b, d),
            _ => false,
        }
    }
}
