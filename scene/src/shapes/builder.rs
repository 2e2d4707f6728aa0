//! Collects triangles with the normals and texture coordinates of their corners.

use nalgebra::{Point3, Vector3};

use crate::mesh::SurfaceData;

/// A corner of a triangle.
#[derive(Clone, Copy)]
pub(super) struct Corner {
    pub vertex: u32,
    pub normal: Vector3<f64>,
    pub uv: [f64; 2],
}

#[derive(Default)]
pub(super) struct Builder {
    positions: Vec<Point3<f64>>,
    triangles: Vec<[u32; 3]>,
    normals: Vec<[Vector3<f64>; 3]>,
    uvs: Vec<[[f64; 2]; 3]>,
}

impl Builder {
    pub fn vertex(&mut self, x: f64, y: f64, z: f64) -> u32 {
        self.positions.push(Point3::new(x, y, z));
        (self.positions.len() - 1) as u32
    }

    pub fn triangle(&mut self, corners: [Corner; 3]) {
        self.triangles.push(corners.map(|corner| corner.vertex));
        self.normals.push(corners.map(|corner| corner.normal));
        self.uvs.push(corners.map(|corner| corner.uv));
    }

    /// Two triangles over four corners in counter-clockwise order.
    pub fn quad(&mut self, [a, b, c, d]: [Corner; 4]) {
        self.triangle([a, b, c]);
        self.triangle([a, c, d]);
    }

    pub fn build(self) -> SurfaceData {
        SurfaceData {
            positions: self.positions,
            triangles: self.triangles,
            normals: Some(self.normals),
            uvs: Some(self.uvs),
        }
    }
}
