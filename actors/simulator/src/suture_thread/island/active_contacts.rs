//! Active contacts of a substep, and their depth.

use nalgebra::{Point3, Vector3};

use super::coupled_body::CoupledBody;
use super::{Active, BodyTie, Failure, Island};
use crate::linear_algebra::block_banded::Cell;
use crate::suture_thread::contact::{
    CoulombState, FrictionLimit, Rows, Side, nearest_on_obstacle, nearest_segments, place, tangents,
};
use crate::suture_thread::state::{ContactKey, ContactMemory, end_of};
use crate::suture_thread::{Surroundings, ThreadMaterial};

/// Penetration beyond this fraction of a diameter requires shorter steps.
const DEPTH_MAX: f64 = 0.15;

impl Island {
    /// Builds the rows of near candidates with warm-started forces: contacts with other strands and with the elastic
    /// body in `dense` for now, those with obstacles in `sprung`. `ahead` is how long the present motion is
    /// extrapolated \[s\].
    pub(super) fn gather(
        &mut self,
        material: &ThreadMaterial,
        surroundings: &Surroundings,
        ahead: f64,
        companion: &mut impl CoupledBody,
    ) -> Result<(), Failure> {
        self.moved.clear();
        self.moved.extend((0..self.at.positions.len()).map(|node| {
            let by = self.at.positions[node] - self.trial.positions[node];
            Cell::new(by.x, by.y, by.z, self.at.turns.get(node).copied().unwrap_or(0.0))
        }));
        self.expected.clear();
        self.expected.extend(self.trial.velocities.iter().enumerate().map(|(node, velocity)| {
            let by = velocity * ahead;
            Cell::new(by.x, by.y, by.z, self.trial.spins.get(node).copied().unwrap_or(0.0) * ahead)
        }));
        self.dense.clear();
        self.sprung.clear();
        self.near.clear();
        let surface = companion.surface();
        for index in 0..self.candidates.found.len() {
            let key = self.candidates.found[index].key;
            if surface.is_some_and(|surface| key.with as usize == surface + 1) {
                self.note_near(material, surroundings, key, companion);
            } else if let Some(active) = self.contact(material, surroundings, key) {
                let list = if key.with == 0 { &mut self.dense } else { &mut self.sprung };
                list.push(active);
            }
        }
        if let Some(surface) = surface {
            self.touch_elastic(material, surroundings.obstacles[surface].friction);
        }
        self.ties.clear();
        companion.tie(&self.at, &self.motions, &mut self.ties).map_err(|why| Failure { node: 0, why })?;
        let Self { ties, dense, .. } = self;
        dense.extend(ties.iter().enumerate().map(|(number, tie)| Active {
            key: ContactKey {
                with: tie.obstacle.map_or(u32::MAX, |obstacle| 1 + obstacle as u32),
                edge: 0,
                feature: number as u32,
            },
            rows: tie.rows,
            friction: 0.0,
            limit: FrictionLimit::Coefficient(0.0),
            // The rod's own motion is already in the gap.
            offset: tie.gap,
            force: tie.force,
            compliance: 0.0,
            coulomb: CoulombState::Open,
            next: CoulombState::Open,
            surface: Point3::origin(),
            drawn: [0.0; 2],
            gives: None,
            tie: Some(BodyTie { number, law: tie.law, yields: tie.yields }),
        }));
        Ok(())
    }

    pub(super) fn contact(
        &self,
        material: &ThreadMaterial,
        surroundings: &Surroundings,
        key: ContactKey,
    ) -> Option<Active> {
        let edge = key.edge as usize;
        let nodes = self.at.positions.len();
        let of = |edge: usize| [self.at.positions[edge], self.at.positions[end_of(edge, nodes)]];
        let room = |edge: usize| self.reach[edge].max(self.reach[end_of(edge, nodes)]);
        let radius = material.radius;
        let side = |edge: usize, along: f64, arm: Vector3<f64>| Side {
            edge,
            along,
            arm,
            tangent: self.at.tangents[edge],
            length: self.at.lengths[edge],
        };
        if key.with == 0 {
            let other = key.feature as usize;
            let (first, second) = (of(edge), of(other));
            let [s, t] = nearest_segments(&first, &second);
            let between = place(&first, s) - place(&second, t);
            let distance = between.norm();
            let gap = distance - 2.0 * radius;
            if gap > room(edge) + room(other) || distance.is_nan() || distance < 1e-9 {
                return None;
            }
            let normal = between / distance;
            let [t1, t2] = tangents(&normal, &self.at.tangents[edge]);
            let rows = Rows::new(
                &side(edge, s, normal * -radius),
                Some(&side(other, t, normal * radius)),
                [normal, t1, t2],
            )
            .around(nodes);
            return Some(self.remembered(
                key,
                rows,
                material.friction,
                gap,
                None,
                material.contact_compliance,
            ));
        }
        let index = key.with as usize - 1;
        let obstacle = &surroundings.obstacles[index];
        let found = nearest_on_obstacle(&obstacle.shape, &self.motions[index], key.feature, &of(edge))?;
        let gap = found.distance - radius;
        let way = (found.surface[1] - found.surface[0]).norm();
        if gap > room(edge) + way {
            return None;
        }
        let [t1, t2] = tangents(&found.normal, &self.at.tangents[edge]);
        let rows = Rows::new(&side(edge, found.along, found.normal * -radius), None, [found.normal, t1, t2])
            .around(nodes);
        let compliance = 0.5 * material.contact_compliance;
        Some(self.remembered(key, rows, obstacle.friction, gap, Some(found.surface), compliance))
    }

    pub(super) fn remembered(
        &self,
        key: ContactKey,
        rows: Rows,
        friction: f64,
        gap: f64,
        surface: Option<[Point3<f64>; 2]>,
        compliance: f64,
    ) -> Active {
        let of = |list: &[ContactMemory]| {
            list.binary_search_by_key(&key, |memory| memory.key).ok().map(|place| list[place])
        };
        // The force of the last iteration, but the displacement from where it stuck at the beginning of the step.
        let force = of(&self.former).map_or(Vector3::zeros(), |memory| memory.force);
        let drawn = of(&self.trial.contacts).map_or(Vector3::zeros(), |memory| memory.drawn);
        let apart = rows.apart(&self.moved);
        let carried = surface.map_or(Vector3::zeros(), |[from, to]| to - from);
        let slipped = |k: usize| drawn.dot(&rows.directions[k]) + apart[k] - carried.dot(&rows.directions[k]);
        let normal = force.dot(&rows.directions[0]).max(0.0);
        let held = [force.dot(&rows.directions[1]), force.dot(&rows.directions[2])];
        let size = held[0].hypot(held[1]);
        let scale = if size > friction * normal { friction * normal / size } else { 1.0 };
        let offset = [gap, slipped(1), slipped(2)];
        let expected = rows.apart(&self.expected);
        let expected: [f64; 3] = std::array::from_fn(|k| offset[k] + expected[k]);
        let force = [normal, held[0] * scale, held[1] * scale];
        let coulomb = CoulombState::begin(force, expected, friction, compliance);
        Active {
            key,
            rows,
            friction,
            limit: friction.into(),
            offset,
            force,
            compliance,
            coulomb,
            next: coulomb,
            surface: surface.map_or_else(Point3::origin, |[_, to]| to),
            drawn: [0.0; 2],
            gives: None,
            tie: None,
        }
    }

    /// Largest penetration of the contacts at the end \[m\].
    pub(super) fn penetration(&self, material: &ThreadMaterial, surroundings: &Surroundings) -> f64 {
        self.contacts().fold(0.0, |most, contact| {
            // The elastic surface has deformed since the gap was measured: only the contact's own compliance is left.
            let gap = match contact.gives {
                Some(_) => -contact.compliance * contact.force[0],
                None => self.gap(material, surroundings, &contact.key, &self.at.positions),
            };
            f64::max(most, -gap)
        })
    }

    /// An edge that has penetrated deeply, contact or not, and deeper than before.
    pub(super) fn deepest_penetration(
        &self,
        material: &ThreadMaterial,
        surroundings: &Surroundings,
        companion: &impl CoupledBody,
    ) -> Option<usize> {
        let deep = -DEPTH_MAX * material.diameter();
        let surface = companion.surface();
        let gives = |key: &ContactKey| surface.is_some_and(|surface| key.with as usize == surface + 1);
        let sunk = |key: &ContactKey| {
            if gives(key) {
                return false;
            }
            let gap = self.gap(material, surroundings, key, &self.at.positions);
            gap < deep && gap < self.gap(material, surroundings, key, &self.trial.positions)
        };
        let found = self.candidates.found.iter().find(|candidate| sunk(&candidate.key));
        found.map(|candidate| candidate.key.edge as usize)
    }

    /// Gap between two surfaces at the end of the substep, with the thread at these `positions` \[m\].
    fn gap(
        &self,
        material: &ThreadMaterial,
        surroundings: &Surroundings,
        key: &ContactKey,
        positions: &[Point3<f64>],
    ) -> f64 {
        let of =
            |edge: u32| [edge as usize, end_of(edge as usize, positions.len())].map(|node| positions[node]);
        if key.with == 0 {
            let (first, second) = (of(key.edge), of(key.feature));
            let [s, t] = nearest_segments(&first, &second);
            return (place(&first, s) - place(&second, t)).norm() - 2.0 * material.radius;
        }
        let index = key.with as usize - 1;
        let shape = &surroundings.obstacles[index].shape;
        nearest_on_obstacle(shape, &self.motions[index], key.feature, &of(key.edge))
            .map_or(0.0, |found| found.distance - material.radius)
    }
}
