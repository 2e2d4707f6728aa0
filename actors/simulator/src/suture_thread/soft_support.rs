//! A soft body that a thread lies on and that another solver integrates: its surface nodes are mass points
//! ([`GhostNode`]) that yield to the thread within the step, solved in one problem with it. The thread's impulses on
//! them are reported afterwards, so that the other solver can apply the same numbers: action and reaction are identical
//! impulses.

use std::collections::BTreeMap;

use nalgebra::{Point3, Vector3};
use trocar_dynamics::coupling::external_nodes::{GhostMoved, GhostNode};

use super::FailureCause;
use super::contact::Motion;
use super::elastic::SurfacePoint;
use super::island::coupled_body::{ComplianceRows, CoupledBody, Link};

/// Cosine of the dihedral angle beyond which an edge between faces counts as a sharp ridge: 40°.
const SHARP: f64 = 0.77;

/// The surface of such a body, and its state during a step, in the frame of the thread.
#[derive(Clone, Debug, Default)]
pub struct SoftSurface {
    triangles: Vec<[u32; 3]>,
    /// The neighbouring triangle across each edge of each triangle.
    beyond: Vec<[Option<u32>; 3]>,
    /// Whether that edge is a sharp ridge.
    sharp: Vec<[bool; 3]>,
    normals: Vec<Vector3<f64>>,
    /// Nodes at the beginning of the step, and of its current part \[m\].
    start: Vec<Point3<f64>>,
    began: Vec<Point3<f64>>,
    /// The nodes at the beginning of the part.
    now: Vec<GhostNode>,
    /// Where the nodes would be at the end of the part without contact \[m\], and their compliance \[m/N\].
    free: Vec<Point3<f64>>,
    yields: Vec<f64>,
    /// Nodes at the iterate \[m\].
    at: Vec<Point3<f64>>,
    /// Forces on the nodes \[N\].
    forces: Vec<Vector3<f64>>,
    /// Correction velocity of each node in this step \[m/s\].
    drift: Vec<Vector3<f64>>,
    /// Duration of the part \[s\].
    part: f64,
    moved: Vec<GhostMoved>,
}

impl SoftSurface {
    /// Sets the nodes and triangles at the beginning of a step, those of the obstacle in the same order. During the
    /// step each node also moves with its `drift` velocity \[m/s\], if given, to correct the prediction error of its
    /// position: a surface that jumped could jump past the thread.
    pub fn begin(
        &mut self,
        ghost_nodes: impl Iterator<Item = GhostNode>,
        drift: impl Iterator<Item = Vector3<f64>>,
        triangles: &[[u32; 3]],
    ) {
        self.drift.clear();
        self.drift.extend(drift);
        self.now.clear();
        self.now.extend(ghost_nodes);
        self.drift.resize(self.now.len(), Vector3::zeros());
        self.start.clear();
        self.start.extend(self.now.iter().map(|ghost_node| ghost_node.position));
        self.began.clone_from(&self.start);
        self.at.clone_from(&self.start);
        self.moved.clear();
        self.moved.resize(self.now.len(), GhostMoved::default());
        self.update_moved();
        if self.triangles != triangles {
            self.triangles.clear();
            self.triangles.extend_from_slice(triangles);
            self.find_neighbours();
        }
        self.find_ridges();
    }

    fn find_neighbours(&mut self) {
        // Neighbouring triangles traverse a common edge in opposite directions.
        let mut across = BTreeMap::new();
        for (index, triangle) in self.triangles.iter().enumerate() {
            for k in 0..3 {
                across.insert((triangle[(k + 1) % 3], triangle[k]), index as u32);
            }
        }
        let beyond = |triangle: &[u32; 3]| {
            [0, 1, 2].map(|k| across.get(&(triangle[k], triangle[(k + 1) % 3])).copied())
        };
        self.beyond = self.triangles.iter().map(beyond).collect();
    }

    fn find_ridges(&mut self) {
        let Self { triangles, start, normals, sharp, beyond, .. } = self;
        normals.clear();
        normals.extend(triangles.iter().map(|triangle| {
            let [a, b, c] = triangle.map(|node| start.get(node as usize).copied().unwrap_or_default());
            (b - a).cross(&(c - a)).try_normalize(0.0).unwrap_or_else(Vector3::zeros)
        }));
        sharp.clear();
        sharp.extend(beyond.iter().zip(&*normals).map(|(beyond, own)| {
            beyond.map(|other| other.is_none_or(|other| normals[other as usize].dot(own) < SHARP))
        }));
    }

    /// The nodes at the end of the step.
    #[must_use]
    pub fn moved(&self) -> &[GhostMoved] {
        &self.moved
    }

    fn update_moved(&mut self) {
        for (moved, ghost_node) in self.moved.iter_mut().zip(&self.now) {
            (moved.position, moved.velocity, moved.path) =
                (ghost_node.position, ghost_node.velocity, ghost_node.path);
        }
    }

    /// Displacement of a surface point from these node positions \[m\], by the free motion of the nodes.
    fn drift(&self, place: &SurfacePoint, from: &[Point3<f64>]) -> Vector3<f64> {
        let of = |(node, weight): (&u32, f64)| (self.free[*node as usize] - from[*node as usize]) * weight;
        place.nodes.iter().zip(place.weights).map(of).sum()
    }

    /// Compliance of one surface point to a force at another one, isotropic \[m/N\].
    fn between(&self, place: &SurfacePoint, other: &SurfacePoint) -> f64 {
        let mut sum = 0.0;
        for (node, weight) in place.nodes.iter().zip(place.weights) {
            for (by, share) in other.nodes.iter().zip(other.weights) {
                if node == by {
                    sum += weight * share * self.yields[*node as usize];
                }
            }
        }
        sum
    }

    /// Distributes the link forces on the thread to the nodes, with opposite sign.
    fn gather(&mut self, links: &[Link], forces: &[[f64; 3]]) {
        self.forces.clear();
        self.forces.resize(self.now.len(), Vector3::zeros());
        for (link, force) in links.iter().zip(forces).filter(|(_, force)| force[0] > 0.0) {
            let Link::Surface(place, [n, t1, t2]) = link else { continue };
            let on_thread = n * force[0] + t1 * force[1] + t2 * force[2];
            for (node, weight) in place.nodes.iter().zip(place.weights) {
                self.forces[*node as usize] -= on_thread * weight;
            }
        }
    }
}

/// A soft surface during a step.
pub(crate) struct LyingOn<'a> {
    pub surface: &'a mut SoftSurface,
    /// The obstacle's index.
    pub obstacle: usize,
}

impl CoupledBody for LyingOn<'_> {
    fn surface(&self) -> Option<usize> {
        Some(self.obstacle)
    }

    fn begin(&mut self, dt: f64, _motions: &[Motion]) {
        let soft = &mut *self.surface;
        soft.part = dt;
        soft.free.clear();
        soft.yields.clear();
        soft.began.clear();
        for (ghost_node, drift) in soft.now.iter().zip(&soft.drift) {
            let mut alone = *ghost_node;
            alone.go(dt, &Vector3::zeros());
            soft.began.push(ghost_node.position);
            soft.free.push(alone.position + drift * dt);
            soft.yields.push(ghost_node.mobility_in(dt) * dt * dt);
        }
        soft.at.clone_from(&soft.free);
    }

    fn is_sharp(&self, triangle: u32, rim: usize) -> bool {
        self.surface.sharp.get(triangle as usize).is_some_and(|rims| rims[rim])
    }

    fn swept(&self) -> Option<[&[Point3<f64>]; 2]> {
        Some([&self.surface.began, &self.surface.at])
    }

    /// Gaps were measured to the surface as it was at the beginning of the step; slides are counted from the beginning
    /// of the part.
    fn join(&mut self, links: &[Link], compliance_rows: ComplianceRows<'_>) -> Result<(), FailureCause> {
        let soft = &*self.surface;
        let rows = 3 * links.len();
        for (row, link) in links.iter().enumerate() {
            let Link::Surface(place, directions) = link else { continue };
            let drifts = [soft.drift(place, &soft.start), soft.drift(place, &soft.began)];
            for (k, direction) in directions.iter().enumerate() {
                compliance_rows.base[3 * row + k] = -direction.dot(&drifts[k.min(1)]);
            }
            for (column, other) in links.iter().enumerate() {
                let Link::Surface(by, toward) = other else { continue };
                let goes = soft.between(place, by);
                if goes == 0.0 {
                    continue;
                }
                for (k, direction) in directions.iter().enumerate() {
                    for (m, toward) in toward.iter().enumerate() {
                        compliance_rows.compliance[(3 * column + m) * rows + 3 * row + k] =
                            goes * direction.dot(toward);
                    }
                }
            }
        }
        Ok(())
    }

    fn advance(&mut self, links: &[Link], forces: &[[f64; 3]]) -> Result<f64, FailureCause> {
        let soft = &mut *self.surface;
        soft.gather(links, forces);
        let mut most = 0.0_f64;
        for (node, force) in soft.forces.iter().enumerate() {
            let to = soft.free[node] + force * soft.yields[node];
            most = most.max((to - soft.at[node]).norm());
            soft.at[node] = to;
        }
        if most.is_finite() { Ok(most) } else { Err(FailureCause::NotFinite) }
    }

    fn finish(&mut self, links: &[Link], forces: &[[f64; 3]]) {
        let soft = &mut *self.surface;
        soft.gather(links, forces);
        let of_nodes = soft.now.iter_mut().zip(&soft.forces).zip(&soft.drift).zip(&mut soft.moved);
        for (((ghost_node, force), drift), moved) in of_nodes {
            let impulse = force * soft.part;
            ghost_node.go(soft.part, &impulse);
            ghost_node.position += drift * soft.part;
            moved.impulse += impulse;
            moved.work += impulse.dot(&ghost_node.velocity);
        }
        soft.update_moved();
    }
}
