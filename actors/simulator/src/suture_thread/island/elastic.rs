//! Contacts with compliant bodies, coupled through their deformation.

use nalgebra::{Isometry3, Point3, Vector3};
use trocar_collision::primitive::{closest_on_triangle, closest_segments};

use super::coupled_body::{ComplianceRows, CoupledBody, Link};
use super::{Active, Failure, Island};
use crate::suture_thread::contact::{Rows, Side, tangents};
use crate::suture_thread::elastic::{ElasticBody, SurfaceForce, SurfacePoint};
use crate::suture_thread::state::ContactKey;
use crate::suture_thread::{FailureCause, Shape, Surroundings, ThreadMaterial};

/// Maximum contacts of one point of an edge with a compliant body: the bottom of a groove and both of its sides.
const SIDES: usize = 3;
/// Contact points nearer to each other than this are merged, in radii of the thread.
const SAME: f64 = 0.2;
/// Number of points of an edge that may touch a triangle.
const PLACES: u32 = 4;
/// A sharp ridge makes its own contact where it is nearer than the fixed points of the edge by this much, in radii.
const RIDGE: f64 = 0.3;
/// A point deeper than this is inside the body, not on its surface, in radii of the thread.
const DEEP: f64 = 2.0;

/// A triangle of a compliant body near a point of an edge.
#[derive(Clone, Copy, Debug)]
pub(super) struct NearTriangle {
    key: ContactKey,
    /// Whether it was in contact before.
    is_known: bool,
    place: SurfacePoint,
    /// Parameter on the edge, 0 to 1.
    along: f64,
    /// Closest point, in the world \[m\].
    point: Point3<f64>,
    /// Unit normal from there to the edge.
    normal: Vector3<f64>,
    distance: f64,
}

/// Contacts and ties at which coupled bodies move, and their compliance there.
#[derive(Clone, Debug, Default)]
pub(super) struct CoupledLinks {
    /// Which contacts, and their links.
    places: Vec<usize>,
    pub links: Vec<Link>,
    pub forces: Vec<[f64; 3]>,
    base: Vec<f64>,
    compliance: Vec<f64>,
}

impl Island {
    /// Records a triangle near an edge. Two fixed points of an edge make contact, its first end and its middle: all
    /// points of an edge flat on a triangle are equally close, and a point that jumped from end to end would prevent
    /// convergence. Where a sharp ridge of a triangle is clearly nearer than these, it makes contact too.
    pub(super) fn note_near(
        &mut self,
        material: &ThreadMaterial,
        surroundings: &Surroundings,
        key: ContactKey,
        companion: &impl CoupledBody,
    ) {
        let obstacle = &surroundings.obstacles[key.with as usize - 1];
        let Shape::Mesh { from: points, triangles, .. } = &obstacle.shape else { return };
        let Some(&nodes) = triangles.get(key.feature as usize) else { return };
        let corners = nodes.map(|node| obstacle.to * points[node as usize]);
        let outwards = (corners[1] - corners[0]).cross(&(corners[2] - corners[0]));
        let edge = key.edge as usize;
        let [from, to] = [self.at.positions[edge], self.at.positions[edge + 1]];
        let reach = self.reach[edge].max(self.reach[edge + 1]) + material.radius;
        let mut nearest = f64::INFINITY;
        let note = |island: &mut Self, which: u32, along: f64, point: Point3<f64>, weights: [f64; 3]| {
            let way = from.coords.lerp(&to.coords, along) - point.coords;
            let mut distance = way.norm();
            let Some(mut normal) = way.try_normalize(1e-12) else { return };
            // Below the interior of a face the point has sunk in; below an edge it may be beside the body.
            if way.dot(&outwards) < 0.0 && weights.iter().all(|weight| *weight > 0.0) {
                if distance > DEEP * material.radius {
                    return;
                }
                (distance, normal) = (-distance, -normal);
            }
            if distance > reach {
                return;
            }
            let key = ContactKey { feature: PLACES * key.feature + which, ..key };
            let is_known = island.former.binary_search_by_key(&key, |memory| memory.key).is_ok();
            let place = SurfacePoint { nodes, weights };
            island.near.push(NearTriangle { key, is_known, place, along, point, normal, distance });
        };
        // The last edge makes contact with both of its ends.
        let last = edge + 2 == self.at.positions.len();
        for (which, along) in [(0, 0.0), (1, 0.5), (3, 1.0)].into_iter().take(if last { 3 } else { 2 }) {
            let touching = from + (to - from) * along;
            let found = closest_on_triangle(&touching, &corners);
            nearest = nearest.min((touching - found.point).norm());
            note(self, which, along, found.point, found.weights);
        }
        let mut ridge: Option<(f64, f64, Point3<f64>, [f64; 3])> = None;
        for (rim, (k, m)) in [(0, 1), (1, 2), (2, 0)].into_iter().enumerate() {
            if !companion.is_sharp(key.feature, rim) {
                continue;
            }
            let found = closest_segments(&[from, to], &[corners[k], corners[m]]);
            let [along, on_rim] = found.along;
            let distance = found.distance_squared.sqrt();
            if (0.02..=0.98).contains(&along) && ridge.is_none_or(|(known, ..)| distance < known) {
                let mut weights = [0.0; 3];
                (weights[k], weights[m]) = (1.0 - on_rim, on_rim);
                ridge = Some((distance, along, corners[k] + (corners[m] - corners[k]) * on_rim, weights));
            }
        }
        if let Some((distance, along, point, weights)) = ridge
            && distance < nearest - RIDGE * material.radius
        {
            note(self, 2, along, point, weights);
        }
    }

    /// The contacts of the edges with a compliant body of friction coefficient `friction`: one for all triangles
    /// touched at the same point, preferring one that was touched before.
    pub(super) fn touch_elastic(&mut self, material: &ThreadMaterial, friction: f64) {
        self.near.sort_unstable_by(|a, b| {
            let order = |near: &NearTriangle| (near.key.edge, near.key.feature % PLACES, !near.is_known);
            let first = order(a).cmp(&order(b));
            first.then(a.distance.total_cmp(&b.distance)).then(a.key.cmp(&b.key))
        });
        let mut begin = self.dense.len();
        for index in 0..self.near.len() {
            let near = self.near[index];
            let edge = near.key.edge as usize;
            let place_on_edge = |key: &ContactKey| (key.edge, key.feature % PLACES);
            if self
                .dense
                .get(begin)
                .is_some_and(|first| place_on_edge(&first.key) != place_on_edge(&near.key))
            {
                begin = self.dense.len();
            }
            let own = &self.dense[begin..];
            let same = |other: &Active| (other.surface - near.point).norm() < SAME * material.radius;
            if own.len() >= SIDES || own.iter().any(same) {
                continue;
            }
            let side = Side {
                edge,
                along: near.along,
                arm: near.normal * -material.radius,
                tangent: self.at.tangents[edge],
                length: self.at.lengths[edge],
            };
            let [t1, t2] = tangents(&near.normal, &self.at.tangents[edge]);
            let rows = Rows::new(&side, None, [near.normal, t1, t2]);
            let compliance = 0.5 * material.contact_compliance;
            let gap = near.distance - material.radius;
            let remembered =
                self.remembered(near.key, rows, friction, gap, Some([near.point; 2]), compliance);
            self.dense.push(Active { gives: Some(near.place), ..remembered });
        }
    }

    /// Gets the compliance of coupled bodies at their ties and contacts.
    pub(super) fn join(&mut self, companion: &mut impl CoupledBody) -> Result<(), Failure> {
        let CoupledLinks { places, links, base, compliance, .. } = &mut self.joined;
        places.clear();
        links.clear();
        for (index, contact) in self.dense.iter().enumerate() {
            let link = match (&contact.tie, contact.gives) {
                (Some(tie), _) => Link::Tie(tie.number),
                (None, Some(place)) => Link::Surface(place, contact.rows.directions),
                (None, None) => continue,
            };
            places.push(index);
            links.push(link);
        }
        let rows = 3 * places.len();
        for (list, length) in [(&mut *base, rows), (&mut *compliance, rows * rows)] {
            list.clear();
            list.resize(length, 0.0);
        }
        companion.join(links, ComplianceRows { base, compliance }).map_err(|why| Failure { node: 0, why })
    }

    /// Adds the compliance of coupled bodies to the problem's.
    pub(super) fn add_compliance(&mut self) {
        let CoupledLinks { places, compliance, .. } = &self.joined;
        let (own, rows) = (3 * places.len(), self.problem.force.len());
        for (column, first) in places.iter().enumerate() {
            for (row, second) in places.iter().enumerate() {
                for (k, m) in (0..3).flat_map(|k| (0..3).map(move |m| (k, m))) {
                    self.problem.compliance[(3 * first + m) * rows + 3 * second + k] +=
                        compliance[(3 * column + m) * own + 3 * row + k];
                }
            }
        }
    }

    /// Adds the displacement of coupled bodies under the current forces to the gaps.
    pub(super) fn give_way(&mut self) {
        let CoupledLinks { places, base, compliance, .. } = &self.joined;
        let own = 3 * places.len();
        for (row, index) in places.iter().enumerate() {
            for k in 0..3 {
                let mut gap = base[3 * row + k];
                for (column, other) in places.iter().enumerate() {
                    for m in 0..3 {
                        gap += compliance[(3 * column + m) * own + 3 * row + k]
                            * self.problem.force[3 * other + m];
                    }
                }
                self.problem.gap[3 * index + k] += gap;
            }
        }
    }

    /// The current forces of the links.
    pub(super) fn link_forces(&mut self) {
        let CoupledLinks { places, forces, .. } = &mut self.joined;
        forces.clear();
        forces.extend(places.iter().map(|index| self.dense[*index].force));
    }
}

/// An elastic body that a thread is tied around, during one step.
pub(crate) struct TiedAround<'a> {
    pub body: &'a ElasticBody,
    /// Its obstacle index, and its pose in the world.
    pub obstacle: usize,
    pub world_from_body: Isometry3<f64>,
    /// Forces on it at the end of the last substep.
    pub presses: Vec<SurfaceForce>,
}

impl TiedAround<'_> {
    fn in_body(&self, vector: &Vector3<f64>) -> Vector3<f64> {
        self.world_from_body.rotation.inverse_transform_vector(vector)
    }
}

impl CoupledBody for TiedAround<'_> {
    fn surface(&self) -> Option<usize> {
        Some(self.obstacle)
    }

    /// Gaps were measured to the surface as it was at the beginning of the step; slip is counted from the beginning of
    /// the substep.
    fn join(&mut self, links: &[Link], compliance_rows: ComplianceRows<'_>) -> Result<(), FailureCause> {
        let rows = 3 * links.len();
        let on_surface = |link: &Link| match link {
            Link::Surface(place, directions) => Some((*place, directions.map(|of| self.in_body(&of)))),
            Link::Tie(_) => None,
        };
        for (place, link) in links.iter().enumerate() {
            let Some((at, directions)) = on_surface(link) else { continue };
            let from_rest = self.body.displacement(&at, self.body.presses());
            let since = self.body.displacement(&at, &self.presses);
            for (k, moved) in [from_rest, since, since].into_iter().enumerate() {
                compliance_rows.base[3 * place + k] = directions[k].dot(&moved);
            }
            for (other, link) in links[..=place].iter().enumerate() {
                let Some((by, toward)) = on_surface(link) else { continue };
                let block = self.body.between(&at, &by);
                for (k, direction) in directions.iter().enumerate() {
                    let along = block.tr_mul(direction);
                    for (m, toward) in toward.iter().enumerate() {
                        let (row, column) = (3 * place + k, 3 * other + m);
                        compliance_rows.compliance[column * rows + row] = along.dot(toward);
                        compliance_rows.compliance[row * rows + column] = along.dot(toward);
                    }
                }
            }
        }
        Ok(())
    }

    fn advance(&mut self, _links: &[Link], _forces: &[[f64; 3]]) -> Result<f64, FailureCause> {
        // Its compliance is in the problem; it is deformed by the resulting forces after the step.
        Ok(0.0)
    }

    fn finish(&mut self, links: &[Link], forces: &[[f64; 3]]) {
        self.presses.clear();
        for (link, force) in links.iter().zip(forces).filter(|(_, force)| force[0] > 0.0) {
            let Link::Surface(at, [n, t1, t2]) = link else { continue };
            let on_rod = n * force[0] + t1 * force[1] + t2 * force[2];
            self.presses.push(SurfaceForce { at: *at, force: self.in_body(&-on_rod) });
        }
    }
}
