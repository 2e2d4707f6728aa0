//! Sutured tissue: a linear elastic body with compliance at any interior or surface point, and straight paths through
//! its elements.

use std::collections::BTreeMap;
use std::sync::Arc;

use nalgebra::{Matrix3, Point3, Vector3};
use serde::{Deserialize, Serialize};
use trocar_dynamics::elasticity::Elastic;
use trocar_dynamics::tet_mesh::TetMesh;

use super::SutureError;
use crate::linear_fem::Columns;
use crate::suture_thread::elastic::SurfacePoint;

/// Maximum number of nodes with compliance columns: about as many as 150 channel points touch.
pub const NODES_MAX: usize = 1200;
/// Maximum number of elements on one path.
const WALK_MAX: usize = 4096;
/// Cosine of the dihedral angle beyond which an edge between triangles counts as a ridge: 40°.
const SHARP: f64 = 0.77;
/// A point is inside an element when no barycentric weight is below this.
const INSIDE: f64 = -1e-9;
/// Corners of the face opposite to each corner, counter-clockwise seen from outside.
const OPPOSITE: [[usize; 3]; 4] = [[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]];

/// A material point: an element and its barycentric weights.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct MaterialPoint {
    /// The element.
    pub tet: u32,
    /// Barycentric weights; they add up to 1.
    pub weights: [f64; 4],
}

/// An interior point, or a surface point by its triangle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum TissueFeature {
    Inside(MaterialPoint),
    Surface(SurfacePoint),
}

/// End of a straight path through the tissue.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum PathEnd {
    /// Inside the tissue.
    Ends(MaterialPoint),
    /// At the surface, where the path leaves; with the triangle.
    Leaves(MaterialPoint, u32),
}

/// An intersection with the surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Crossing {
    /// The surface triangle.
    pub triangle: u32,
    /// The point.
    pub place: MaterialPoint,
    /// When, as a fraction of the path.
    pub share: f64,
}

/// Elastic tissue, fixed at some nodes.
pub struct Tissue {
    mesh: TetMesh,
    columns: Columns,
    /// Surface triangles; shared with a step, during which the body changes.
    triangles: Arc<Vec<[u32; 3]>>,
    /// Neighbour across the face opposite to each corner: another element, or a surface triangle.
    beyond: Vec<[FaceNeighbour; 4]>,
    /// The element behind each surface triangle.
    behind: Vec<u32>,
    /// Which edges of each surface triangle are ridges: from each corner to the next.
    sharp: Vec<[bool; 3]>,
    material: Elastic,
    /// Typical element size \[m\].
    size: f64,
    positions: Vec<Point3<f64>>,
    before: Vec<Point3<f64>>,
    forces: Vec<(u32, Vector3<f64>)>,
    full: Vec<f64>,
    moved: Vec<Vector3<f64>>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum FaceNeighbour {
    Element(u32),
    Surface(u32),
}

impl Tissue {
    /// Tissue with a mesh in the world frame, fixed at the nodes `fixed`.
    ///
    /// # Errors
    /// A body without fixed nodes, or too large.
    pub fn new(mesh: TetMesh, material: &Elastic, fixed: &[u32]) -> Result<Self, SutureError> {
        let columns = Columns::new(&mesh, material, fixed, NODES_MAX)?;
        let mut faces: Vec<([u32; 3], u32, u8)> = Vec::with_capacity(4 * mesh.tets().len());
        for (tet, nodes) in mesh.tets().iter().enumerate() {
            for (corner, opposite) in OPPOSITE.iter().enumerate() {
                let mut key = opposite.map(|other| nodes[other]);
                key.sort_unstable();
                faces.push((key, tet as u32, corner as u8));
            }
        }
        faces.sort_unstable();
        let mut beyond = vec![[FaceNeighbour::Surface(0); 4]; mesh.tets().len()];
        for pair in faces.windows(2).filter(|pair| pair[0].0 == pair[1].0) {
            beyond[pair[0].1 as usize][pair[0].2 as usize] = FaceNeighbour::Element(pair[1].1);
            beyond[pair[1].1 as usize][pair[1].2 as usize] = FaceNeighbour::Element(pair[0].1);
        }
        let mut behind = Vec::with_capacity(mesh.surface().len());
        for (index, triangle) in mesh.surface().iter().enumerate() {
            let mut key = *triangle;
            key.sort_unstable();
            let at = faces.partition_point(|face| face.0 < key);
            let (_, tet, corner) = faces[at];
            beyond[tet as usize][corner as usize] = FaceNeighbour::Surface(index as u32);
            behind.push(tet);
        }
        let positions = mesh.rest().to_vec();
        let before = positions.clone();
        let (forces, full, moved) = Default::default();
        let size = (6.0 * mesh.volume() / mesh.tets().len().max(1) as f64).cbrt();
        let material = *material;
        let triangles = Arc::new(mesh.surface().to_vec());
        let sharp = ridges(&mesh);
        Ok(Self {
            mesh,
            columns,
            triangles,
            sharp,
            beyond,
            behind,
            material,
            size,
            positions,
            before,
            forces,
            full,
            moved,
        })
    }

    /// The body at rest.
    #[must_use]
    pub fn mesh(&self) -> &TetMesh {
        &self.mesh
    }

    /// Corners of the surface triangles.
    pub(super) fn triangles(&self) -> Arc<Vec<[u32; 3]>> {
        self.triangles.clone()
    }

    /// Positions of the nodes, in the world \[m\].
    #[must_use]
    pub fn positions(&self) -> &[Point3<f64>] {
        &self.positions
    }

    /// Current forces on the nodes \[N\].
    #[must_use]
    pub fn forces(&self) -> &[(u32, Vector3<f64>)] {
        &self.forces
    }

    /// Elastic energy \[J\].
    #[must_use]
    pub fn energy(&self) -> f64 {
        let work = |(node, force): &(u32, Vector3<f64>)| {
            force.dot(&(self.positions[*node as usize] - self.mesh.rest()[*node as usize]))
        };
        0.5 * self.forces.iter().map(work).sum::<f64>()
    }

    /// Largest displacement of a node \[m\].
    #[must_use]
    pub fn displacement_max(&self) -> f64 {
        let far = self.positions.iter().zip(self.mesh.rest()).map(|(now, rest)| (now - rest).norm());
        far.fold(0.0, f64::max)
    }

    /// Local compliance to a transverse line load on a wire of this radius \[m\], per length \[m²/N\], which elements
    /// cannot resolve: Kelvin's line load in plane strain, from the radius to the element size. Without it, several
    /// points in one element would pinch the wire.
    #[must_use]
    pub fn gives_way_about(&self, radius: f64) -> f64 {
        let poisson = self.material.poisson_ratio();
        let through =
            (3.0 - 4.0 * poisson) / (8.0 * std::f64::consts::PI * self.material.mu() * (1.0 - poisson));
        through * (self.size / radius).ln().max(0.0)
    }

    /// Whether a point belongs to this mesh.
    #[must_use]
    pub fn has(&self, place: &MaterialPoint) -> bool {
        (place.tet as usize) < self.mesh.tets().len()
            && place.weights.iter().all(|weight| (-0.01..=1.01).contains(weight))
            && (place.weights.iter().sum::<f64>() - 1.0).abs() < 1e-6
    }

    /// The nodes of a point and their weights.
    fn nodes_of(&self, feature: &TissueFeature) -> ([u32; 4], [f64; 4]) {
        match feature {
            TissueFeature::Inside(place) => (self.mesh.tets()[place.tet as usize], place.weights),
            TissueFeature::Surface(SurfacePoint { nodes: [a, b, c], weights: [u, v, w] }) => {
                ([*a, *b, *c, *a], [*u, *v, *w, 0.0])
            }
        }
    }

    /// Adds the compliance columns of a point's nodes; `false` when there is no room for more.
    pub(super) fn name(&mut self, place: &MaterialPoint) -> bool {
        self.name_spot(&TissueFeature::Inside(*place))
    }

    /// The same for a point of either kind.
    pub(super) fn name_spot(&mut self, feature: &TissueFeature) -> bool {
        let (nodes, weights) = self.nodes_of(feature);
        nodes.iter().zip(weights).all(|(node, weight)| weight == 0.0 || self.columns.name(*node))
    }

    /// Displacement at `a` per force at `b`, both of which have been named \[m/N\].
    pub(super) fn between(&self, a: &TissueFeature, b: &TissueFeature) -> Matrix3<f64> {
        let mut sum = Matrix3::zeros();
        let ((of_a, us), (of_b, vs)) = (self.nodes_of(a), self.nodes_of(b));
        for (m, u) in of_a.iter().zip(us) {
            for (n, v) in of_b.iter().zip(vs) {
                if u != 0.0 && v != 0.0 {
                    sum += self.columns.between(*m, *n) * (u * v);
                }
            }
        }
        sum
    }

    /// Displacement of a point for these node positions \[m\].
    pub(super) fn displaced_when(&self, feature: &TissueFeature, positions: &[Point3<f64>]) -> Vector3<f64> {
        let (nodes, weights) = self.nodes_of(feature);
        mean(positions, &nodes, &weights) - mean(self.mesh.rest(), &nodes, &weights)
    }

    /// Current displacement of a point \[m\].
    pub(super) fn displaced(&self, feature: &TissueFeature) -> Vector3<f64> {
        self.displaced_when(feature, &self.positions)
    }

    /// Its displacement at the beginning of the substep \[m\].
    pub(super) fn displaced_before(&self, feature: &TissueFeature) -> Vector3<f64> {
        self.displaced_when(feature, &self.before)
    }

    /// Node positions at the beginning of the substep \[m\].
    pub(super) fn before(&self) -> &[Point3<f64>] {
        &self.before
    }

    /// Rest position of a material point \[m\].
    #[must_use]
    pub fn at_rest(&self, place: &MaterialPoint) -> Point3<f64> {
        mean(self.mesh.rest(), &self.mesh.tets()[place.tet as usize], &place.weights)
    }

    /// Current position of a material point \[m\].
    #[must_use]
    pub fn now(&self, place: &MaterialPoint) -> Point3<f64> {
        mean(&self.positions, &self.mesh.tets()[place.tet as usize], &place.weights)
    }

    /// The material point now at a point of the world, or the nearest by its smallest weight. Searches all elements.
    #[must_use]
    pub fn locate(&self, point: &Point3<f64>) -> MaterialPoint {
        let mut best = (MaterialPoint::default(), f64::NEG_INFINITY);
        for tet in 0..self.mesh.tets().len() as u32 {
            let weights = self.weights(tet, point);
            let least = weights.iter().copied().fold(f64::INFINITY, f64::min);
            if least > best.1 {
                best = (MaterialPoint { tet, weights }, least);
            }
        }
        best.0
    }

    fn weights(&self, tet: u32, point: &Point3<f64>) -> [f64; 4] {
        let [a, b, c, d] = self.mesh.tets()[tet as usize].map(|node| self.positions[node as usize]);
        let inverse = Matrix3::from_columns(&[b - a, c - a, d - a]).try_inverse();
        let inner = inverse.map_or_else(|| Vector3::repeat(f64::NAN), |inverse| inverse * (point - a));
        [1.0 - inner.sum(), inner.x, inner.y, inner.z]
    }

    /// The straight path from a material point to a point of the world, through the deformed elements.
    #[must_use]
    pub fn walk(&self, from: &MaterialPoint, to: &Point3<f64>) -> PathEnd {
        let start = self.now(from);
        let mut tet = from.tet;
        let mut came_from = None;
        let mut place = *from;
        for _ in 0..WALK_MAX {
            let (first, last) = (self.weights(tet, &start), self.weights(tet, to));
            if last.iter().all(|weight| *weight >= INSIDE) {
                return PathEnd::Ends(MaterialPoint { tet, weights: last });
            }
            // The first face crossed of those that lie ahead.
            let mut nearest: Option<(usize, f64)> = None;
            for corner in 0..4 {
                if last[corner] >= INSIDE || came_from == Some(self.beyond[tet as usize][corner]) {
                    continue;
                }
                let share = (first[corner] / (first[corner] - last[corner])).clamp(0.0, 1.0);
                if nearest.is_none_or(|(_, known)| share < known) {
                    nearest = Some((corner, share));
                }
            }
            let Some((corner, share)) = nearest else { break };
            let mut weights: [f64; 4] = std::array::from_fn(|k| first[k] + (last[k] - first[k]) * share);
            weights[corner] = 0.0;
            place = MaterialPoint { tet, weights: sound(weights) };
            match self.beyond[tet as usize][corner] {
                FaceNeighbour::Surface(triangle) => return PathEnd::Leaves(place, triangle),
                FaceNeighbour::Element(next) => {
                    came_from = Some(FaceNeighbour::Element(tet));
                    tet = next;
                }
            }
        }
        // A cycle of elements without volume: stop here.
        PathEnd::Ends(place)
    }

    /// First intersection of a point moving from `from` to `to` \[m\] during the step with the surface from outside;
    /// the surface moves from its position at the beginning of the step to the current one. Sides are compared at both
    /// ends of the step.
    pub(super) fn entry_crossing(&self, from: &Point3<f64>, to: &Point3<f64>) -> Option<Crossing> {
        let low = from.coords.inf(&to.coords);
        let high = from.coords.sup(&to.coords);
        let mut first: Option<Crossing> = None;
        for (index, triangle) in self.mesh.surface().iter().enumerate() {
            let new = triangle.map(|node| self.positions[node as usize]);
            let old = triangle.map(|node| self.before[node as usize]);
            let apart = |k: usize| {
                let of = |points: &[Point3<f64>; 3], f: fn(f64, f64) -> f64, start: f64| {
                    points.iter().fold(start, |sum, point| f(sum, point[k]))
                };
                let least = of(&new, f64::min, of(&old, f64::min, f64::INFINITY));
                let most = of(&new, f64::max, of(&old, f64::max, f64::NEG_INFINITY));
                low[k] > most || high[k] < least
            };
            if (0..3).any(apart) {
                continue;
            }
            let (Some(start), Some(end)) = (above(&old, from), above(&new, to)) else { continue };
            if start.0 < 0.0 || end.0 >= 0.0 {
                continue;
            }
            let share = start.0 / (start.0 - end.0);
            let weights: [f64; 3] = std::array::from_fn(|k| start.1[k] + (end.1[k] - start.1[k]) * share);
            if weights.iter().all(|weight| *weight >= -1e-9) && first.is_none_or(|known| share < known.share)
            {
                let place = self.on_surface(index as u32, &weights);
                first = Some(Crossing { triangle: index as u32, place, share });
            }
        }
        first
    }

    /// A point of a surface triangle.
    #[must_use]
    pub fn on_surface(&self, triangle: u32, weights: &[f64; 3]) -> MaterialPoint {
        let tet = self.behind[triangle as usize];
        let corners = self.mesh.surface()[triangle as usize];
        let of = self.mesh.tets()[tet as usize].map(|node| {
            let corner = corners.iter().position(|corner| *corner == node);
            corner.map_or(0.0, |corner| weights[corner])
        });
        MaterialPoint { tet, weights: sound(of) }
    }

    /// Outward rest normal of a surface triangle: under a needle tip the facets of a mesh tilt more than the tissue
    /// does, and displacements are small.
    #[must_use]
    pub fn normal(&self, triangle: u32) -> Vector3<f64> {
        let [a, b, c] = self.mesh.surface()[triangle as usize].map(|node| self.mesh.rest()[node as usize]);
        (b - a).cross(&(c - a)).try_normalize(0.0).unwrap_or_else(Vector3::z)
    }

    /// Whether a surface triangle meets its neighbour in a ridge, along the edge from its corner of this number.
    pub(super) fn is_sharp(&self, triangle: u32, rim: usize) -> bool {
        self.sharp[triangle as usize][rim]
    }

    /// The surface point nearest to a point of the world, and its triangle.
    #[must_use]
    pub fn nearest(&self, point: &Point3<f64>) -> (MaterialPoint, u32) {
        let mut best = (0, [1.0, 0.0, 0.0], f64::INFINITY);
        for (index, triangle) in self.mesh.surface().iter().enumerate() {
            let corners = triangle.map(|node| self.positions[node as usize]);
            let hit = trocar_collision::primitive::closest_on_triangle(point, &corners);
            let distance = (hit.point - point).norm_squared();
            if distance < best.2 {
                best = (index, hit.weights, distance);
            }
        }
        (self.on_surface(best.0 as u32, &best.1), best.0 as u32)
    }

    /// Stores the current positions as the beginning of a step.
    pub(super) fn begin(&mut self) {
        self.before.clone_from(&self.positions);
    }

    /// Deforms the tissue by these forces at points that have been named.
    pub(super) fn deform(&mut self, forces: impl Iterator<Item = (TissueFeature, Vector3<f64>)>) {
        let mut on_nodes = std::mem::take(&mut self.forces);
        on_nodes.clear();
        for (feature, force) in forces {
            let (nodes, weights) = self.nodes_of(&feature);
            for (node, weight) in nodes.into_iter().zip(weights) {
                if weight != 0.0 {
                    on_nodes.push((node, force * weight));
                }
            }
        }
        self.forces = on_nodes;
        self.forces.sort_by_key(|(node, _)| *node);
        self.forces.dedup_by(|next, sum| {
            let same = next.0 == sum.0;
            if same {
                sum.1 += next.1;
            }
            same
        });
        self.columns.displacements(&self.forces, &mut self.full, &mut self.moved);
        for ((now, rest), by) in self.positions.iter_mut().zip(self.mesh.rest()).zip(&self.moved) {
            *now = rest + by;
        }
    }
}

/// Which edges of each surface triangle, from each corner to the next, are ridges at rest.
fn ridges(mesh: &TetMesh) -> Vec<[bool; 3]> {
    let normal = |triangle: &[u32; 3]| {
        let [a, b, c] = triangle.map(|node| mesh.rest()[node as usize]);
        (b - a).cross(&(c - a)).try_normalize(0.0).unwrap_or_else(Vector3::zeros)
    };
    // Neighbouring triangles traverse a common edge in opposite directions.
    let mut across = BTreeMap::new();
    for triangle in mesh.surface() {
        for k in 0..3 {
            across.insert((triangle[(k + 1) % 3], triangle[k]), normal(triangle));
        }
    }
    let sharp = |triangle: &[u32; 3]| {
        [0, 1, 2].map(|k| {
            let other = across.get(&(triangle[k], triangle[(k + 1) % 3]));
            other.is_none_or(|other| other.dot(&normal(triangle)) < SHARP)
        })
    };
    mesh.surface().iter().map(sharp).collect()
}

/// Weights normalised to add up to 1.
fn sound(weights: [f64; 4]) -> [f64; 4] {
    let weights = weights.map(|weight| weight.max(0.0));
    let sum: f64 = weights.iter().sum();
    weights.map(|weight| weight / sum)
}

fn mean(positions: &[Point3<f64>], nodes: &[u32; 4], weights: &[f64; 4]) -> Point3<f64> {
    let sum: Vector3<f64> =
        nodes.iter().zip(weights).map(|(node, weight)| positions[*node as usize].coords * *weight).sum();
    Point3::from(sum)
}

/// Height above a triangle \[m\], and the barycentric weights of the foot point.
fn above([a, b, c]: &[Point3<f64>; 3], point: &Point3<f64>) -> Option<(f64, [f64; 3])> {
    let (e, f, to) = (b - a, c - a, point - a);
    let normal = e.cross(&f);
    let square = normal.norm_squared();
    if square <= 0.0 {
        return None;
    }
    let v = to.cross(&f).dot(&normal) / square;
    let w = e.cross(&to).dot(&normal) / square;
    Some((to.dot(&normal) / square.sqrt(), [1.0 - v - w, v, w]))
}
