//! Contact between nodes of a faster body and the surface of a slower one.

use nalgebra::{Point3, Vector3};
use serde::{Deserialize, Serialize};
use trocar_collision::moving_surface::MovingSurface;
use trocar_collision::{Surface, pseudonormal};

use super::external_nodes::{GhostMoved, NodeContact, NodeContactResult};

/// Nodes deeper in the body than this are ignored \[m\].
const DEEP: f64 = 0.01;
/// Nodes nearer than this are listed before they touch, so that the slower body predicts the motion there in time
/// \[m\].
const NEAR: f64 = 0.003;

/// Contact parameters.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SurfaceContactParams {
    /// Distance of nodes from the surface \[m\].
    pub thickness: f64,
    /// Stiffness: force per penetration depth of a node \[N/m\].
    pub stiffness: f64,
    /// Coulomb friction coefficient.
    pub friction: f64,
}

/// The point on the surface where friction makes a node stick.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct StickPoint {
    /// A node of the faster body.
    pub node: u32,
    /// Vertices of the surface, with their weights.
    pub at: [(u32, f64); 3],
}

/// Nodes in contact with another solver's surface.
#[derive(Clone, Debug)]
pub struct SurfaceContacts {
    rule: SurfaceContactParams,
    surface: MovingSurface,
    /// Ascending.
    anchors: Vec<StickPoint>,
}

impl SurfaceContacts {
    /// For the surface of a volume, its triangles oriented outwards.
    #[must_use]
    pub fn new(rule: SurfaceContactParams, surface: &Surface<'_>) -> Self {
        Self { rule, surface: MovingSurface::new(surface), anchors: Vec::new() }
    }

    /// Stick points, to continue from.
    #[must_use]
    pub fn anchors(&self) -> &[StickPoint] {
        &self.anchors
    }

    /// Continues from these stick points.
    pub fn hold(&mut self, anchors: &[StickPoint]) {
        self.anchors.clear();
        let known = self.surface.surface().vertices().len();
        let sound = |anchor: &&StickPoint| {
            anchor.at.iter().all(|(vertex, weight)| (*vertex as usize) < known && weight.is_finite())
        };
        self.anchors.extend(anchors.iter().filter(sound));
        self.anchors.sort_unstable_by_key(|anchor| anchor.node);
    }

    /// Lists the contacts of a step of `dt` seconds, from the current surface, and the positions \[m\] and velocities
    /// \[m/s\] of the faster body's nodes that can lie on it.
    pub fn find(
        &mut self,
        surface: &Surface<'_>,
        nodes: &[u32],
        positions: &[Point3<f64>],
        velocities: &[Vector3<f64>],
        dt: f64,
        presses: &mut Vec<NodeContact>,
    ) {
        presses.clear();
        self.surface.follow(surface);
        let SurfaceContactParams { thickness, stiffness, friction } = self.rule;
        let surface = self.surface.surface();
        let Some(bounds) = self.surface.tree().bounds() else { return };
        for &node in nodes {
            let (at, velocity) = (positions[node as usize], velocities[node as usize]);
            let reach = thickness + NEAR + 2.0 * dt * velocity.norm();
            let far = reach.max(DEEP);
            let outside = (0..3).any(|k| at[k] < bounds.min[k] - far || at[k] > bounds.max[k] + far);
            if outside {
                continue;
            }
            let found = self.surface.tree().nearest_to_point(&surface, &at, far);
            let Ok(Some(nearest)) = found else { continue };
            let weights = nearest.nearest.weights;
            let Some(outwards) = pseudonormal(&surface, self.surface.topology(), nearest.triangle, &weights)
            else {
                continue;
            };
            let away = at.coords - nearest.nearest.point.coords;
            let below = away.dot(&outwards) < 0.0;
            let gap = if below { -nearest.distance } else { nearest.distance };
            if gap > reach {
                continue;
            }
            let away = if below { -away } else { away };
            let Some(normal) = away.try_normalize(1e-9).or_else(|| outwards.try_normalize(1e-12)) else {
                continue;
            };
            let corners = surface.triangles()[nearest.triangle as usize];
            let ghost_nodes = [0, 1, 2].map(|k| (corners[k], weights[k]));
            let held = self.anchors.binary_search_by_key(&node, |anchor| anchor.node);
            let anchor = held.map_or(ghost_nodes, |at| self.anchors[at].at);
            presses.push(NodeContact { node, ghost_nodes, anchor, normal, thickness, stiffness, friction });
        }
    }

    /// After the step: a contact sticks at its current point, or, while sliding, at the friction limit ahead of it.
    /// Contacts as found, ghost nodes in the order of the surface's vertices, the faster body's nodes \[m\].
    pub fn end_step(
        &mut self,
        presses: &[NodeContact],
        moved: &[NodeContactResult],
        ghost_nodes: &[GhostMoved],
        positions: &[Point3<f64>],
    ) {
        let mut held = Vec::with_capacity(presses.len());
        for (press, pressed) in presses.iter().zip(moved) {
            if !pressed.holds {
                continue;
            }
            if !pressed.slides {
                held.push(StickPoint { node: press.node, at: press.anchor });
                continue;
            }
            let place =
                |(ghost_node, weight): (u32, f64)| ghost_nodes[ghost_node as usize].position.coords * weight;
            let foot = press.ghost_nodes.into_iter().map(place).sum::<Vector3<f64>>();
            let over = positions[press.node as usize].coords - foot;
            let ahead = foot + (over - press.normal * press.normal.dot(&over)) + pressed.drawn;
            // In the plane of its triangle: a little beyond the edge is still the same point.
            let [a, b, c] =
                press.ghost_nodes.map(|(ghost_node, _)| ghost_nodes[ghost_node as usize].position.coords);
            if let Some(at) = weights_in_plane(&[a, b, c], &ahead) {
                let at = [0, 1, 2].map(|k| (press.ghost_nodes[k].0, at[k]));
                held.push(StickPoint { node: press.node, at });
            }
        }
        self.anchors = held;
    }
}

/// Barycentric weights of a point, projected into the plane of three corners.
fn weights_in_plane([a, b, c]: &[Vector3<f64>; 3], place: &Vector3<f64>) -> Option<[f64; 3]> {
    let (u, v, w) = (b - a, c - a, place - a);
    let (uu, uv, vv) = (u.norm_squared(), u.dot(&v), v.norm_squared());
    let (wu, wv) = (w.dot(&u), w.dot(&v));
    let determinant = uu * vv - uv * uv;
    if determinant.is_nan() || determinant <= 1e-12 * uu * vv {
        return None;
    }
    let (second, third) = ((vv * wu - uv * wv) / determinant, (uu * wv - uv * wu) / determinant);
    Some([1.0 - second - third, second, third])
}
