//! Surfaces and tetrahedral volumes as plain vectors.

use std::collections::BTreeMap;

use nalgebra::{Isometry3, Point3, Vector3};

/// A triangle surface.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SurfaceData {
    /// Vertices \[m\].
    pub positions: Vec<Point3<f64>>,
    /// Vertices of each triangle, counter-clockwise seen from outside.
    pub triangles: Vec<[u32; 3]>,
    /// Unit normals of each triangle's three corners, one entry per triangle.
    pub normals: Option<Vec<[Vector3<f64>; 3]>>,
    /// Texture coordinates of each triangle's three corners, one entry per triangle.
    pub uvs: Option<Vec<[[f64; 2]; 3]>>,
}

/// A surface with one vertex for every distinct position, normal and texture coordinate, as renderers need it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SplitSurface {
    /// Vertices \[m\].
    pub positions: Vec<Point3<f64>>,
    /// Unit normal of each vertex.
    pub normals: Vec<Vector3<f64>>,
    /// Texture coordinate of each vertex; (0, 0) where the surface has none.
    pub uvs: Vec<[f64; 2]>,
    /// Vertices of each triangle, in the order of the surface it came from.
    pub triangles: Vec<[u32; 3]>,
    /// The vertex of the surface that each vertex came from, so that deformation can be carried over.
    pub sources: Vec<u32>,
}

/// One or several polylines.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LineData {
    /// Vertices \[m\].
    pub positions: Vec<Point3<f64>>,
    /// Vertices at both ends of each piece.
    pub segments: Vec<[u32; 2]>,
}

impl LineData {
    /// Multiplies every coordinate by `factor` (for files that are not in metres).
    #[must_use]
    pub fn scaled(mut self, factor: f64) -> Self {
        for position in &mut self.positions {
            position.coords *= factor.abs();
        }
        self
    }

    /// Removes vertices without a segment; the others keep their order.
    pub fn compact(&mut self) {
        let mut numbers = vec![u32::MAX; self.positions.len()];
        self.segments.iter().flatten().for_each(|&vertex| numbers[vertex as usize] = 0);
        let mut kept = Vec::new();
        for (number, position) in numbers.iter_mut().zip(&self.positions).filter(|(number, _)| **number == 0)
        {
            *number = kept.len() as u32;
            kept.push(*position);
        }
        self.positions = kept;
        for vertex in self.segments.iter_mut().flatten() {
            *vertex = numbers[*vertex as usize];
        }
    }
}

/// A volume of tetrahedra.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TetData {
    /// Vertices \[m\].
    pub positions: Vec<Point3<f64>>,
    /// Vertices of each tetrahedron; positive volume means (b−a)×(c−a)·(d−a) > 0.
    pub tets: Vec<[u32; 4]>,
    /// Region of each tetrahedron: the first physical group of its file, 0 when it has none.
    pub tags: Vec<i32>,
}

impl SurfaceData {
    /// The corners of a triangle \[m\]. Panics when `triangle` is out of range.
    pub fn corners(&self, triangle: usize) -> [Point3<f64>; 3] {
        self.triangles[triangle].map(|vertex| self.positions[vertex as usize])
    }

    /// Twice the area of a triangle times its unit normal \[m²\].
    pub fn area_vector(&self, triangle: usize) -> Vector3<f64> {
        let [a, b, c] = self.corners(triangle);
        (b - a).cross(&(c - a))
    }

    /// Area \[m²\].
    pub fn area(&self) -> f64 {
        (0..self.triangles.len()).map(|t| self.area_vector(t).norm() / 2.0).sum()
    }

    /// Enclosed volume \[m³\] by the divergence theorem: meaningful for closed surfaces, positive when the
    /// triangles are oriented outwards.
    pub fn volume(&self) -> f64 {
        // About the first vertex rather than the origin, so that a distant body loses no digits.
        let Some(origin) = self.positions.first() else { return 0.0 };
        self.triangles
            .iter()
            .map(|t| {
                let [a, b, c] = t.map(|v| self.positions[v as usize] - origin);
                a.dot(&b.cross(&c)) / 6.0
            })
            .sum()
    }

    /// Moves every vertex, and turns the normals with them.
    pub fn transformed(mut self, to_from: &Isometry3<f64>) -> Self {
        for position in &mut self.positions {
            *position = to_from * *position;
        }
        for normal in self.normals.iter_mut().flatten().flatten() {
            *normal = to_from.rotation * *normal;
        }
        self
    }

    /// Multiplies every coordinate by `factor` (for files that are not in metres). Negative factors would turn
    /// the surface inside out, so its size is used.
    pub fn scaled(mut self, factor: f64) -> Self {
        for position in &mut self.positions {
            position.coords *= factor.abs();
        }
        self
    }

    /// Adds another surface as a body of its own. Attributes survive only where both have them.
    pub fn append(&mut self, other: &SurfaceData) {
        let offset = self.positions.len() as u32;
        let was_empty = self.triangles.is_empty();
        self.positions.extend_from_slice(&other.positions);
        self.triangles.extend(other.triangles.iter().map(|t| t.map(|v| v + offset)));
        self.normals = merge_attribute(was_empty, self.normals.take(), other.normals.as_deref());
        self.uvs = merge_attribute(was_empty, self.uvs.take(), other.uvs.as_deref());
    }

    /// Gives every corner the area-weighted mean of the triangles around its vertex that meet its own triangle
    /// at less than `crease` \[rad\]: smooth where the surface is smooth, sharp where it is sharp.
    pub fn compute_normals(&mut self, crease: f64) {
        let area_vectors: Vec<Vector3<f64>> =
            (0..self.triangles.len()).map(|t| self.area_vector(t)).collect();
        let units: Vec<Vector3<f64>> =
            area_vectors.iter().map(|v| v.try_normalize(0.0).unwrap_or_else(Vector3::zeros)).collect();
        let mut around: Vec<Vec<u32>> = vec![Vec::new(); self.positions.len()];
        for (t, triangle) in self.triangles.iter().enumerate() {
            for &vertex in triangle {
                around[vertex as usize].push(t as u32);
            }
        }
        let threshold = crease.cos();
        let corner_normal = |own: usize, vertex: u32| {
            let sum: Vector3<f64> = around[vertex as usize]
                .iter()
                .filter(|&&other| units[own].dot(&units[other as usize]) >= threshold)
                .map(|&other| area_vectors[other as usize])
                .sum();
            sum.try_normalize(0.0).unwrap_or(units[own])
        };
        let normals = self.triangles.iter().enumerate().map(|(t, tri)| tri.map(|v| corner_normal(t, v)));
        self.normals = Some(normals.collect());
    }

    /// Merges vertices whose coordinates are equal bit for bit (0 and −0 count as equal), as files without
    /// shared vertices need it (STL, glTF). Keeps the order of first appearance.
    pub fn weld_identical(&mut self) {
        let mut first_of = BTreeMap::new();
        let mut kept: Vec<Point3<f64>> = Vec::new();
        let renamed: Vec<u32> = self
            .positions
            .iter()
            .map(|position| {
                let key = position.coords.map(|x| (x + 0.0).to_bits());
                *first_of.entry([key.x, key.y, key.z]).or_insert_with(|| {
                    kept.push(*position);
                    (kept.len() - 1) as u32
                })
            })
            .collect();
        self.positions = kept;
        for vertex in self.triangles.iter_mut().flatten() {
            *vertex = renamed[*vertex as usize];
        }
    }

    /// One vertex per distinct combination of position, normal and texture coordinate. Computes normals with a
    /// crease of 40° where there are none.
    pub fn split(&self) -> SplitSurface {
        let with_normals;
        let surface = if self.normals.is_some() {
            self
        } else {
            let mut copy = self.clone();
            copy.compute_normals(40f64.to_radians());
            with_normals = copy;
            &with_normals
        };
        let normals = surface.normals.as_deref().unwrap_or_default();
        let mut split = SplitSurface::default();
        let mut seen = BTreeMap::new();
        for (t, triangle) in surface.triangles.iter().enumerate() {
            let corner = |k: usize| {
                let source = triangle[k];
                let normal = normals[t][k];
                let uv = surface.uvs.as_ref().map_or([0.0; 2], |uvs| uvs[t][k]);
                let bits = [normal.x, normal.y, normal.z, uv[0], uv[1]].map(|x| (x + 0.0).to_bits());
                *seen.entry((source, bits)).or_insert_with(|| {
                    split.positions.push(surface.positions[source as usize]);
                    split.normals.push(normal);
                    split.uvs.push(uv);
                    split.sources.push(source);
                    (split.sources.len() - 1) as u32
                })
            };
            let corners = [0, 1, 2].map(corner);
            split.triangles.push(corners);
        }
        split
    }
}

fn merge_attribute<T: Copy>(was_empty: bool, own: Option<Vec<T>>, other: Option<&[T]>) -> Option<Vec<T>> {
    let other = other?;
    match own {
        Some(mut own) => {
            own.extend_from_slice(other);
            Some(own)
        }
        None if was_empty => Some(other.to_vec()),
        None => None,
    }
}

impl TetData {
    /// Signed volume of a tetrahedron \[m³\]. Panics when `tet` is out of range.
    pub fn tet_volume(&self, tet: usize) -> f64 {
        let [a, b, c, d] = self.tets[tet].map(|vertex| self.positions[vertex as usize]);
        (b - a).cross(&(c - a)).dot(&(d - a)) / 6.0
    }

    /// Sum of the signed volumes \[m³\].
    pub fn volume(&self) -> f64 {
        (0..self.tets.len()).map(|t| self.tet_volume(t)).sum()
    }

    /// Multiplies every coordinate by the size of `factor` (for files that are not in metres).
    pub fn scaled(mut self, factor: f64) -> Self {
        for position in &mut self.positions {
            position.coords *= factor.abs();
        }
        self
    }

    /// Swaps two vertices of every tetrahedron of negative volume; returns how many there were.
    pub fn flip_inverted(&mut self) -> usize {
        let inverted: Vec<usize> = (0..self.tets.len()).filter(|&t| self.tet_volume(t) < 0.0).collect();
        for &t in &inverted {
            self.tets[t].swap(2, 3);
        }
        inverted.len()
    }

    /// Drops vertices that no tetrahedron uses (points of a CAD model, vertices of surface elements): they would
    /// be degrees of freedom without stiffness. Keeps the order; returns how many were dropped.
    pub fn compact(&mut self) -> usize {
        let mut used = vec![false; self.positions.len()];
        for &vertex in self.tets.iter().flatten() {
            used[vertex as usize] = true;
        }
        let mut renamed = vec![0u32; self.positions.len()];
        let mut kept = Vec::with_capacity(self.positions.len());
        for (old, position) in self.positions.iter().enumerate() {
            if used[old] {
                renamed[old] = kept.len() as u32;
                kept.push(*position);
            }
        }
        for vertex in self.tets.iter_mut().flatten() {
            *vertex = renamed[*vertex as usize];
        }
        let dropped = self.positions.len() - kept.len();
        self.positions = kept;
        dropped
    }

    /// The triangles that belong to one tetrahedron only, oriented outwards (for positive volumes), with the
    /// vertex numbers of the volume, ordered by tetrahedron.
    pub fn boundary_triangles(&self) -> Vec<[u32; 3]> {
        let mut faces: Vec<([u32; 3], usize, [u32; 3])> = Vec::with_capacity(self.tets.len() * 4);
        for (t, tet) in self.tets.iter().enumerate() {
            for local in OUTWARD_FACES {
                let face = local.map(|k| tet[k]);
                let mut key = face;
                key.sort_unstable();
                faces.push((key, t, face));
            }
        }
        faces.sort_unstable();
        let mut boundary: Vec<(usize, [u32; 3])> = faces
            .chunk_by(|a, b| a.0 == b.0)
            .filter(|group| group.len() == 1)
            .map(|group| (group[0].1, group[0].2))
            .collect();
        boundary.sort_unstable();
        boundary.into_iter().map(|(_, face)| face).collect()
    }

    /// The boundary as a surface of its own; the second value gives, for each of its vertices, the vertex of the
    /// volume.
    pub fn boundary(&self) -> (SurfaceData, Vec<u32>) {
        let mut triangles = self.boundary_triangles();
        let mut sources: Vec<u32> = triangles.iter().flatten().copied().collect();
        sources.sort_unstable();
        sources.dedup();
        for vertex in triangles.iter_mut().flatten() {
            // Every vertex was put into the sorted list above.
            *vertex = sources.binary_search(vertex).unwrap_or(0) as u32;
        }
        let positions = sources.iter().map(|&vertex| self.positions[vertex as usize]).collect();
        (SurfaceData { positions, triangles, normals: None, uvs: None }, sources)
    }
}

/// Local vertices of a tetrahedron's faces, counter-clockwise seen from outside when its volume is positive.
pub(super) const OUTWARD_FACES: [[usize; 3]; 4] = [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]];

#[cfg(test)]
mod tests {
    use super::*;

    fn two_tets() -> TetData {
        let positions = [[0., 0., 0.], [1., 0., 0.], [0., 1., 0.], [0., 0., 1.], [1., 1., 1.], [9., 9., 9.]];
        TetData {
            positions: positions.iter().map(|p| Point3::from(*p)).collect(),
            tets: vec![[0, 1, 2, 3], [1, 2, 3, 4]],
            tags: vec![0; 2],
        }
    }

    #[test]
    fn the_boundary_encloses_the_volume_of_the_tets() {
        let mut tets = two_tets();
        tets.flip_inverted();
        let (surface, sources) = tets.boundary();
        assert_eq!(surface.triangles.len(), 6);
        assert_eq!(sources, [0, 1, 2, 3, 4]);
        assert!((surface.volume() - tets.volume()).abs() < 1e-15);
        assert!((tets.volume() - (1.0 / 6.0 + 1.0 / 3.0)).abs() < 1e-15);
    }

    #[test]
    fn flipping_makes_every_volume_positive_and_is_counted() {
        let mut tets = two_tets();
        tets.tets[0].swap(0, 1);
        let inverted = (0..2).filter(|&t| tets.tet_volume(t) < 0.0).count();
        assert!(inverted >= 1);
        assert_eq!(tets.flip_inverted(), inverted);
        assert!((0..2).all(|t| tets.tet_volume(t) > 0.0));
        assert_eq!(tets.flip_inverted(), 0);
    }

    #[test]
    fn compacting_drops_only_unused_vertices() {
        let mut tets = two_tets();
        tets.positions.insert(0, Point3::new(7.0, 7.0, 7.0));
        tets.tets.iter_mut().flatten().for_each(|v| *v += 1);
        let volume = tets.volume();
        assert_eq!(tets.compact(), 2);
        assert_eq!(tets.positions.len(), 5);
        assert_eq!(tets.volume(), volume);
    }

    #[test]
    fn splitting_keeps_geometry_and_names_the_source_of_each_vertex() {
        let (surface, _) = two_tets().boundary();
        let split = surface.split();
        assert_eq!(split.triangles.len(), surface.triangles.len());
        for (t, triangle) in split.triangles.iter().enumerate() {
            for (k, &vertex) in triangle.iter().enumerate() {
                assert_eq!(split.sources[vertex as usize], surface.triangles[t][k]);
                assert_eq!(split.positions[vertex as usize], surface.corners(t)[k]);
                assert!((split.normals[vertex as usize].norm() - 1.0).abs() < 1e-12);
            }
        }
    }
}
