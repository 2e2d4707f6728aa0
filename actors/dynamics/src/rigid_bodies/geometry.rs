//! What rigid bodies are made of, as the scene has it.

use std::sync::Arc;

use nalgebra::Point3;
use trocar_scene::{Entity, Shape, Snapshot, SurfaceMesh, VertexPositions};

/// What a body is made of.
#[derive(Clone, Debug)]
pub(crate) enum Geometry {
    Shape(Shape),
    /// A surface that has been looked at: contacts are found by others.
    Surface(Arc<Vec<Point3<f64>>>, Arc<Vec<[u32; 3]>>),
}

impl Geometry {
    /// Of an entity; a shape, where it has both.
    pub fn of(scene: &Snapshot, entity: Entity) -> Option<Self> {
        if let Some(shape) = scene.get::<Shape>(entity) {
            return Some(Self::Shape(shape.clone()));
        }
        let (vertices, surface) = (scene.get::<VertexPositions>(entity)?, scene.get::<SurfaceMesh>(entity)?);
        Some(Self::Surface(vertices.positions.clone(), surface.triangles.clone()))
    }

    /// Whether an entity has any; asked in every tick, so that nothing is copied.
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
