//! Triangle meshes in the layout of the graphics adapter, built from the scene's components.

use nalgebra::{Point3, Vector3};
use trocar_scene::mesh::{SplitSurface, SurfaceData, TetData};
use trocar_scene::{LineMesh, SurfaceMesh, TetMesh, TextureCoordinates, VertexPositions};

use crate::deform::DeformingSurface;
use crate::tube::{Tube, TubeStyle};

/// Edges of a larger angle stay sharp \[rad\].
const CREASE: f64 = 1.2;

/// A surface to draw: one entry per vertex in the first three.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Geometry {
    /// In the frame of its item \[m\].
    pub positions: Vec<[f32; 3]>,
    /// Unit normals.
    pub normals: Vec<[f32; 3]>,
    /// Texture coordinates.
    pub uvs: Vec<[f32; 2]>,
    /// Corners, three per triangle, counter-clockwise seen from outside.
    pub indices: Vec<u32>,
    /// The entity's vertex for each drawn one; empty for a surface that is not made from the entity's vertices.
    pub sources: Vec<u32>,
    /// Bounding radius about the frame's origin \[m\].
    pub radius: f32,
}

impl Geometry {
    /// From a surface with normals and texture coordinates at its corners.
    pub fn from_surface(surface: &SurfaceData) -> Self {
        Self::from_split(&surface.split())
    }

    fn from_split(split: &SplitSurface) -> Self {
        let single = |vector: &Vector3<f64>| [vector.x as f32, vector.y as f32, vector.z as f32];
        let mut geometry = Self {
            positions: split.positions.iter().map(|point| single(&point.coords)).collect(),
            normals: split.normals.iter().map(single).collect(),
            uvs: split.uvs.iter().map(|uv| uv.map(|part| part as f32)).collect(),
            indices: split.triangles.iter().flatten().copied().collect(),
            sources: split.sources.clone(),
            radius: 0.0,
        };
        geometry.measure();
        geometry
    }

    fn measure(&mut self) {
        let square = |[x, y, z]: &[f32; 3]| x * x + y * y + z * z;
        self.radius = self.positions.iter().map(square).fold(0.0, f32::max).sqrt();
    }
}

/// A surface that follows the vertices of its entity.
#[derive(Debug)]
pub enum Moving {
    /// Triangles, or the boundary of a volume.
    Mesh(Box<DeformingSurface>),
    /// A thread or band.
    Line(Box<Tube>),
}

impl Moving {
    /// From the components of a mesh: its triangles, or else the boundary of its volume. Triangles with invalid
    /// vertices are left out.
    pub fn mesh(
        surface: Option<&SurfaceMesh>,
        volume: Option<&TetMesh>,
        vertices: &VertexPositions,
        uvs: Option<&TextureCoordinates>,
    ) -> Option<(Self, Geometry)> {
        let count = vertices.positions.len();
        let exist = |corners: &[u32]| corners.iter().all(|corner| (*corner as usize) < count);
        let triangles: Vec<[u32; 3]> = match (surface, volume) {
            (Some(mesh), _) => mesh.triangles.iter().filter(|corners| exist(*corners)).copied().collect(),
            (None, Some(volume)) => {
                let tets = volume.tets.iter().filter(|corners| exist(*corners)).copied().collect();
                TetData { tets, ..TetData::default() }.boundary_triangles()
            }
            (None, None) => return None,
        };
        let fitting = uvs.filter(|uvs| uvs.uv.len() == count);
        let uvs = fitting.map(|uvs| {
            let corner = |vertex: u32| uvs.uv[vertex as usize].into();
            triangles.iter().map(|corners| corners.map(corner)).collect()
        });
        let positions = vertices.positions.to_vec();
        let mut rest = SurfaceData { positions, triangles, normals: None, uvs };
        rest.compute_normals(CREASE);
        let split = rest.split();
        Some((Self::Mesh(Box::new(DeformingSurface::new(&split))), Geometry::from_split(&split)))
    }

    /// From the components of a thread.
    pub fn line(line: &LineMesh, vertices: &VertexPositions) -> (Self, Geometry) {
        let mut moving = Self::Line(Box::new(Tube::new(TubeStyle::default())));
        let mut geometry = Geometry::default();
        moving.follow(Some(line), &vertices.positions, &mut geometry);
        (moving, geometry)
    }

    /// Follows new positions; returns whether the triangles changed. Too few positions change nothing.
    pub fn follow(
        &mut self,
        line: Option<&LineMesh>,
        positions: &[Point3<f64>],
        geometry: &mut Geometry,
    ) -> bool {
        let anew = match self {
            Self::Mesh(surface) => {
                if surface.update(positions).is_err() {
                    return false;
                }
                geometry.positions.clone_from_slice(surface.positions());
                geometry.normals.clone_from_slice(surface.normals());
                false
            }
            Self::Line(tube) => {
                let Some(line) = line else { return false };
                tube.update(&line.segments, positions, line.radius);
                let anew = geometry.indices != tube.indices() || geometry.uvs.len() != tube.uvs().len();
                copy(&mut geometry.positions, tube.positions());
                copy(&mut geometry.normals, tube.normals());
                copy(&mut geometry.uvs, tube.uvs());
                copy(&mut geometry.indices, tube.indices());
                anew
            }
        };
        geometry.measure();
        anew
    }
}

fn copy<T: Copy>(into: &mut Vec<T>, from: &[T]) {
    into.clear();
    into.extend_from_slice(from);
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;

    fn tetrahedron() -> (TetMesh, VertexPositions) {
        let corners = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        let positions = VertexPositions { positions: Arc::new(corners.map(Point3::from).to_vec()) };
        (TetMesh { tets: Arc::new(vec![[0, 1, 2, 3]]) }, positions)
    }

    #[test]
    fn the_boundary_of_a_volume_faces_outwards() {
        let (mesh, positions) = tetrahedron();
        let (_, geometry) = Moving::mesh(None, Some(&mesh), &positions, None).unwrap();
        assert_eq!(geometry.indices.len(), 12);
        let centre = Vector3::new(0.25, 0.25, 0.25);
        for (position, normal) in geometry.positions.iter().zip(&geometry.normals) {
            let outwards = Vector3::from(*position) - centre;
            assert!(outwards.dot(&Vector3::from(*normal)) > 0.0);
        }
    }

    #[test]
    fn triangles_of_vertices_that_do_not_exist_are_left_out() {
        let (_, positions) = tetrahedron();
        let mesh = SurfaceMesh { triangles: Arc::new(vec![[0, 1, 2], [0, 1, 9]]) };
        let (_, geometry) = Moving::mesh(Some(&mesh), None, &positions, None).unwrap();
        assert_eq!(geometry.indices.len(), 3);
    }

    #[test]
    fn a_mesh_follows_its_vertices_and_keeps_its_triangles() {
        let (mesh, positions) = tetrahedron();
        let (mut moving, mut geometry) = Moving::mesh(None, Some(&mesh), &positions, None).unwrap();
        let triangles = geometry.indices.clone();
        let moved: Vec<Point3<f64>> = positions.positions.iter().map(|point| point * 2.0).collect();
        assert!(!moving.follow(None, &moved, &mut geometry));
        assert_eq!(geometry.radius, 2.0);
        moving.follow(None, &moved[..2], &mut geometry);
        assert_eq!((geometry.radius, geometry.indices), (2.0, triangles));
    }

    #[test]
    fn a_thread_is_a_tube_of_its_radius() {
        let points = [[0.0, 0.0, 0.0], [0.01, 0.0, 0.0], [0.02, 0.005, 0.0]].map(Point3::from);
        let positions = VertexPositions { positions: Arc::new(points.to_vec()) };
        let line = LineMesh { segments: Arc::new(vec![[0, 1], [1, 2]]), radius: 0.001 };
        let (mut moving, mut geometry) = Moving::line(&line, &positions);
        assert!(geometry.indices.len() > 60);
        let highest = geometry.positions.iter().map(|point| point[2]).fold(0.0, f32::max);
        assert!((highest - 0.001).abs() < 2e-5, "{highest}");
        let bent = [[0.0, 0.0, 0.0], [0.01, 0.0, 0.0], [0.01, 0.01, 0.0]].map(Point3::from);
        moving.follow(Some(&line), &bent, &mut geometry);
        assert_eq!(geometry.positions.len(), geometry.uvs.len());
    }
}
