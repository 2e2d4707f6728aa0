//! Contacts with an elastic body: what one of them pushes in, others feel.

use nalgebra::{Isometry3, Point3, Vector3, center};
use trocar_collision::primitive::closest_on_triangle;

use super::{Active, Island};
use crate::thread::contact::{Rows, Side, tangents};
use crate::thread::elastic::{Press, SurfacePlace};
use crate::thread::state::ContactKey;
use crate::thread::{Surroundings, ThreadMaterial};

/// A contact with the elastic body: which one, where, and its directions in the body's frame.
pub(super) type GivingPlace = (usize, SurfacePlace, [Vector3<f64>; 3]);

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
        let mut begin = self.active.len();
        for index in 0..self.near.len() {
            let near = self.near[index];
            let edge = near.key.edge as usize;
            let place_on_edge = |key: &ContactKey| (key.edge, key.feature % 2);
            if self
                .active
                .get(begin)
                .is_some_and(|first| place_on_edge(&first.key) != place_on_edge(&near.key))
            {
                begin = self.active.len();
            }
            let own = &self.active[begin..];
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
            self.active.push(Active { gives: Some(near.place), ..remembered });
        }
    }

    /// Adds the body's compliance to the contacts' problem that stands, and to their gaps how far the body gives way to
    /// their forces as they are. Gaps were measured to the surface as it was when the step began; how far the thread has
    /// slid is counted from the beginning of the part.
    pub(super) fn yield_to_each_other(&mut self, around: &Surroundings) {
        let Some(elastic) = &around.elastic else { return };
        let body = elastic.body;
        let world_from_body = around.obstacles[elastic.obstacle].to;
        let mut places = std::mem::take(&mut self.places);
        places.clear();
        places.extend(self.active.iter().enumerate().filter_map(|(index, contact)| {
            let directions = contact.rows.directions;
            let in_body = directions.map(|of| world_from_body.rotation.inverse_transform_vector(&of));
            Some((index, contact.gives?, in_body))
        }));
        let rows = self.problem.force.len();
        for (place, (index, at, directions)) in places.iter().enumerate() {
            let from_rest = body.displacement(at, body.presses());
            let since =
                if self.presses.is_empty() { Vector3::zeros() } else { body.displacement(at, &self.presses) };
            for (k, direction) in directions.iter().enumerate() {
                let moved = if k == 0 { &from_rest } else { &since };
                self.problem.gap[3 * index + k] += direction.dot(moved);
            }
            for (other, by, toward) in &places[..=place] {
                let block = body.between(at, by);
                for (k, direction) in directions.iter().enumerate() {
                    let along = block.tr_mul(direction);
                    for (m, toward) in toward.iter().enumerate() {
                        let value = along.dot(toward);
                        let (row, column) = (3 * index + k, 3 * other + m);
                        self.problem.compliance[column * rows + row] += value;
                        if index != other {
                            self.problem.compliance[row * rows + column] += value;
                            self.problem.gap[column] += value * self.problem.force[row];
                        }
                        self.problem.gap[row] += value * self.problem.force[column];
                    }
                }
            }
        }
        self.places = places;
    }

    /// Takes down what presses the body at the end of a part.
    pub(super) fn press(&mut self, around: &Surroundings) {
        let Some(elastic) = &around.elastic else { return };
        let world_from_body: Isometry3<f64> = around.obstacles[elastic.obstacle].to;
        self.presses.clear();
        for contact in self.active.iter().filter(|contact| contact.force[0] > 0.0) {
            let Some(at) = contact.gives else { continue };
            let force = contact.rows.vector(&contact.force);
            self.presses
                .push(Press { at, force: world_from_body.rotation.inverse_transform_vector(&-force) });
        }
    }
}
