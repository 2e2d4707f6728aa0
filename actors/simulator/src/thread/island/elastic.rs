//! Contacts with an elastic body: what one of them pushes in, others feel.

use nalgebra::{Isometry3, Point3, Vector3, center};
use trocar_collision::primitive::closest_on_triangle;

use super::{Active, Island};
use crate::thread::contact::{Rows, Side, tangents};
use crate::thread::elastic::{Press, SurfacePlace};
use crate::thread::state::ContactKey;
use crate::thread::{Surroundings, ThreadMaterial};

/// A contact with the elastic body: which one, where, and its directions in the body's frame.
type GivingPlace = (usize, SurfacePlace, [Vector3<f64>; 3]);

/// How the elastic body gives way where it is touched.
#[derive(Clone, Debug, Default)]
pub(super) struct Giving {
    places: Vec<GivingPlace>,
    /// Of each row, how far it was displaced before \[m\].
    base: Vec<f64>,
    /// Between their rows, column by column \[m/N\].
    compliance: Vec<f64>,
}

/// Contacts of one place of an edge with an elastic body at most: the bottom of a groove and both of its sides.
const SIDES: usize = 3;
/// Places that are nearer to each other than this are one, in radii of the thread.
const SAME: f64 = 0.2;

/// A triangle of the elastic body near to a place of an edge.
#[derive(Clone, Copy, Debug)]
pub(super) struct Near {
    key: ContactKey,
    /// It is touched already.
    is_known: bool,
    place: SurfacePlace,
    /// In the world \[m\].
    point: Point3<f64>,
    /// From there to the edge, unit.
    normal: Vector3<f64>,
    distance: f64,
}

impl Island {
    /// Takes down a triangle that is near to an edge. Two places of an edge touch, its first end and its middle, always the
    /// same: of an edge that lies flat on a triangle every place is nearest, and one that jumps from end to end would not let
    /// the step come to its end.
    pub(super) fn note_near(&mut self, material: &ThreadMaterial, around: &Surroundings, key: ContactKey) {
        let Some(elastic) = &around.elastic else { return };
        let Some(&nodes) = elastic.body.triangles().get(key.feature as usize) else { return };
        let world_from_body = around.obstacles[elastic.obstacle].to;
        let corners = nodes.map(|node| world_from_body * elastic.body.positions()[node as usize]);
        let edge = key.edge as usize;
        let [from, to] = [self.at.positions[edge], self.at.positions[edge + 1]];
        for (which, touching) in [from, center(&from, &to)].into_iter().enumerate() {
            let found = closest_on_triangle(&touching, &corners);
            let way = touching - found.point;
            let distance = way.norm();
            let Some(normal) = way.try_normalize(1e-12) else { continue };
            if distance - material.radius > self.reach[edge].max(self.reach[edge + 1]) {
                continue;
            }
            let key = ContactKey { feature: 2 * key.feature + which as u32, ..key };
            let is_known = self.former.binary_search_by_key(&key, |memory| memory.key).is_ok();
            let place = SurfacePlace { nodes, weights: found.weights };
            self.near.push(Near { key, is_known, place, point: found.point, normal, distance });
        }
    }

    /// The contacts of the edges with the elastic body: of triangles that are touched at the same place one, and rather one
    /// that was touched before.
    pub(super) fn touch_elastic(&mut self, material: &ThreadMaterial, around: &Surroundings) {
        let Some(elastic) = &around.elastic else { return };
        let friction = around.obstacles[elastic.obstacle].friction;
        self.near.sort_unstable_by(|a, b| {
            let order = |near: &Near| (near.key.edge, near.key.feature % 2, !near.is_known);
            let first = order(a).cmp(&order(b));
            first.then(a.distance.total_cmp(&b.distance)).then(a.key.cmp(&b.key))
        });
        let mut begin = self.dense.len();
        for index in 0..self.near.len() {
            let near = self.near[index];
            let edge = near.key.edge as usize;
            let place_on_edge = |key: &ContactKey| (key.edge, key.feature % 2);
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
                along: 0.5 * f64::from(near.key.feature % 2),
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

    /// Finds how the body gives way at its contacts. Gaps were measured to the surface as it was when the step began; how far
    /// the thread has slid is counted from the beginning of the part.
    pub(super) fn find_giving(&mut self, around: &Surroundings) {
        let Giving { places, base, compliance } = &mut self.giving;
        places.clear();
        base.clear();
        let Some(elastic) = &around.elastic else { return };
        let body = elastic.body;
        let world_from_body = around.obstacles[elastic.obstacle].to;
        places.extend(self.dense.iter().enumerate().filter_map(|(index, contact)| {
            let directions = contact.rows.directions;
            let in_body = directions.map(|of| world_from_body.rotation.inverse_transform_vector(&of));
            Some((index, contact.gives?, in_body))
        }));
        let rows = 3 * places.len();
        compliance.clear();
        compliance.resize(rows * rows, 0.0);
        for (place, (_, at, directions)) in places.iter().enumerate() {
            let from_rest = body.displacement(at, body.presses());
            let since = body.displacement(at, &self.presses);
            base.extend(
                directions
                    .iter()
                    .zip([from_rest, since, since])
                    .map(|(direction, moved)| direction.dot(&moved)),
            );
            for (other, (_, by, toward)) in places[..=place].iter().enumerate() {
                let block = body.between(at, by);
                for (k, direction) in directions.iter().enumerate() {
                    let along = block.tr_mul(direction);
                    for (m, toward) in toward.iter().enumerate() {
                        let (row, column) = (3 * place + k, 3 * other + m);
                        compliance[column * rows + row] = along.dot(toward);
                        compliance[row * rows + column] = along.dot(toward);
                    }
                }
            }
        }
    }

    /// Adds the body's compliance to the contacts' problem.
    pub(super) fn add_giving(&mut self) {
        let Giving { places, compliance, .. } = &self.giving;
        let (own, rows) = (3 * places.len(), self.problem.force.len());
        for (column, (first, ..)) in places.iter().enumerate() {
            for (row, (second, ..)) in places.iter().enumerate() {
                for (k, m) in (0..3).flat_map(|k| (0..3).map(move |m| (k, m))) {
                    self.problem.compliance[(3 * first + m) * rows + 3 * second + k] +=
                        compliance[(3 * column + m) * own + 3 * row + k];
                }
            }
        }
    }

    /// Adds to the gaps how far the body gives way to the forces as they are.
    pub(super) fn give_way(&mut self) {
        let Giving { places, base, compliance } = &self.giving;
        let own = 3 * places.len();
        for (row, (index, ..)) in places.iter().enumerate() {
            for k in 0..3 {
                let mut gap = base[3 * row + k];
                for (column, (other, ..)) in places.iter().enumerate() {
                    for m in 0..3 {
                        gap += compliance[(3 * column + m) * own + 3 * row + k]
                            * self.problem.force[3 * other + m];
                    }
                }
                self.problem.gap[3 * index + k] += gap;
            }
        }
    }

    /// Takes down what presses the body at the end of a part.
    pub(super) fn press(&mut self, around: &Surroundings) {
        let Some(elastic) = &around.elastic else { return };
        let world_from_body: Isometry3<f64> = around.obstacles[elastic.obstacle].to;
        self.presses.clear();
        for contact in self.dense.iter().filter(|contact| contact.force[0] > 0.0) {
            let Some(at) = contact.gives else { continue };
            let force = contact.rows.vector(&contact.force);
            self.presses
                .push(Press { at, force: world_from_body.rotation.inverse_transform_vector(&-force) });
        }
    }
}
