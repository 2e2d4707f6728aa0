//! The slower side of a coupling: a body applies the impulses that others have given its vertices, and publishes their
//! work and its predicted motion.

use nalgebra::{UnitQuaternion, Vector3};
use trocar_scene::{Access, Commands, Entity, EntitySet, Registry, Snapshot};

use super::components::{GivenImpulses, TakenImpulses};
use super::{CouplingGiven, CouplingTaken};
use crate::soft_body::Deformable;
use crate::soft_body::method::{StepContext, StepPrediction};

/// The slower side of a body's couplings.
pub struct SlowSide {
    me: Entity,
    told: CouplingTaken,
    /// Vertices with active or imminent external forces, ascending.
    active: Vec<u32>,
    /// Velocities of the coupled vertices before the step, for each giver.
    before: Vec<Vec<Vector3<f64>>>,
    outlook: StepPrediction,
}

impl SlowSide {
    /// For a body of the scene; empty if nothing is coupled with it.
    #[must_use]
    pub fn new(body: &Deformable, scene: &Snapshot) -> Option<Self> {
        let givers = scene.partners_of(&body.name);
        if givers.is_empty() {
            return None;
        }
        let mut told = scene.get::<CouplingTaken>(body.entity).cloned().unwrap_or_default();
        let known = std::mem::take(&mut told.from);
        told.from = givers
            .iter()
            .map(|giver| {
                let of = known.iter().find(|from| from.body == Some(*giver));
                of.cloned()
                    .unwrap_or_else(|| TakenImpulses { body: Some(*giver), ..TakenImpulses::default() })
            })
            .collect();
        let before = vec![Vec::new(); givers.len()];
        Some(Self { me: body.entity, told, active: Vec::new(), before, outlook: StepPrediction::default() })
    }

    /// Reads and writes of the slower side.
    pub fn access(access: Access, registry: &Registry, bodies: &[Entity]) -> Access {
        access
            .reads_named(registry.components_with_partners())
            .reads::<CouplingGiven>()
            .writes::<CouplingTaken>(EntitySet::Of(bodies.to_vec()))
    }

    fn given<'a>(&self, scene: &'a Snapshot, giver: Entity) -> Option<&'a GivenImpulses> {
        scene.get::<CouplingGiven>(giver)?.to.iter().find(|to| to.body == Some(self.me))
    }

    /// Takes the outstanding impulses as forces on vertices over the step, in the body's frame \[N\]; after missed
    /// steps their mean force ([`share_of_a_step`](crate::coupling::GhostNodes::share_of_a_step)). Velocities are those
    /// before the step \[m/s\].
    pub fn take(
        &mut self,
        site: &StepContext<'_>,
        velocities: &[Vector3<f64>],
        forces: &mut Vec<(u32, Vector3<f64>)>,
    ) {
        self.active.clear();
        for index in 0..self.told.from.len() {
            let Some(giver) = self.told.from[index].body else { continue };
            let Some(to) = self.given(site.scene, giver) else { continue };
            let body_from_giver = self.body_from_giver(site, giver);
            let (from, before) = (&mut self.told.from[index], &mut self.before[index]);
            before.clear();
            let given = to.ghosts.given();
            let share = to.ghosts.share_of_a_step(from.steps, site.period_secs());
            from.taken.resize(given.len(), Vector3::zeros());
            from.last.resize(given.len(), Vector3::zeros());
            let sums = from.taken.iter_mut().zip(&mut from.last);
            for ((&vertex, given), (taken, last)) in to.vertices.iter().zip(given).zip(sums) {
                *last = (given - *taken) * share;
                *taken = *given;
                let known = velocities.get(vertex as usize);
                before.push(known.copied().unwrap_or_default());
                if *last != Vector3::zeros() && known.is_some() {
                    forces.push((vertex, body_from_giver * *last / site.tick.period.as_secs_f64()));
                    self.active.push(vertex);
                }
            }
            let near = to.near.iter().filter_map(|&ghost| to.vertices.get(ghost as usize));
            self.active.extend(near);
            from.given_work = to.ghosts.work();
            from.steps = to.ghosts.steps();
        }
        self.active.sort_unstable();
        self.active.dedup();
    }

    fn body_from_giver(&self, site: &StepContext<'_>, giver: Entity) -> UnitQuaternion<f64> {
        site.world_from_body.rotation.inverse() * site.scene.world_pose(giver).rotation
    }

    /// Predicts the next step, for the vertices with active or imminent external forces.
    pub fn look(&mut self, look: impl FnOnce(&[u32], &mut StepPrediction)) {
        look(&self.active, &mut self.outlook);
    }

    /// Publishes the results of the step and the prediction. Velocities are those after it \[m/s\].
    pub fn publish(
        &mut self,
        site: &StepContext<'_>,
        stays: &[bool],
        velocities: &[Vector3<f64>],
        out: &mut Commands,
    ) {
        let StepPrediction { expected, yielding, masses } = &self.outlook;
        let parts = site.tick.period.as_secs_f64() / site.period_secs();
        for index in 0..self.told.from.len() {
            let Some(giver) = self.told.from[index].body else { continue };
            let Some(to) = self.given(site.scene, giver) else { continue };
            let body_from_giver = self.body_from_giver(site, giver);
            let (from, before) = (&mut self.told.from[index], &self.before[index]);
            from.expected.clear();
            from.mobilities.clear();
            from.masses_inverse.clear();
            for ((&vertex, last), before) in to.vertices.iter().zip(&from.last).zip(before) {
                let at = vertex as usize;
                let now = velocities.get(at).copied().unwrap_or_default();
                from.received += (body_from_giver * last).dot(&(0.5 * (before + now)));
                let is_led = site.driven.binary_search_by_key(&vertex, |driven| driven.vertex).is_ok();
                let holds = is_led || stays.get(at).copied().unwrap_or(true);
                let mass = masses.get(at).copied().filter(|mass| *mass > 0.0 && !holds);
                let alone = mass.map_or(0.0, f64::recip);
                let yields = self.active.binary_search(&vertex).ok().and_then(|at| yielding.get(at)).copied();
                let in_part = NodePrediction { expected: expected.get(at).copied().unwrap_or(now), yields };
                let NodePrediction { expected, yields } = in_part.of_tick(&now, alone, parts);
                from.masses_inverse.push(alone);
                from.mobilities.push(if holds { 0.0 } else { yields.unwrap_or(alone) });
                from.expected.push(expected);
            }
        }
        self.told.number += 1;
        self.told.time = site.tick.time;
        self.told.step = site.tick.period.as_secs_f64();
        out.put(self.me, self.told.clone());
    }
}

/// The predicted motion of a node in a step.
struct NodePrediction {
    /// Its velocity at the end \[m/s\].
    expected: Vector3<f64>,
    /// Its effective inverse mass \[1/kg\]; `None` where nothing was computed.
    yields: Option<f64>,
}

impl NodePrediction {
    /// Converts the prediction of one part into that of the whole tick of `parts` parts. The node is a mass on a spring by
    /// backward Euler's rule: in a step h it yields 1/(m + K h²), and under an unbalanced force F its velocity changes from v
    /// by (h F − K h² v)/(m + K h²). `now` is v \[m/s\], and `alone` is 1/m \[1/kg\].
    fn of_tick(self, now: &Vector3<f64>, alone: f64, parts: f64) -> Self {
        let Some(yields) = self.yields.filter(|yields| *yields > 0.0 && alone > 0.0 && parts > 1.0 + 1e-9)
        else {
            return self;
        };
        let mass = alone.recip();
        // K h² of the part, in kg.
        let spring = (yields.recip() - mass).max(0.0);
        let impulse = (self.expected - now) * (mass + spring) + now * spring;
        let resists = mass + spring * parts * parts;
        let change = (impulse * parts - now * (spring * parts * parts)) / resists;
        Self { expected: now + change, yields: Some(resists.recip()) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// One step of a mass on a spring, by backward Euler's rule: its change of velocity, and what it yields to an impulse.
    fn step(mass: f64, stiffness: f64, force: f64, velocity: f64, h: f64) -> (f64, f64) {
        let resists = mass + stiffness * h * h;
        ((h * force - stiffness * h * h * velocity) / resists, resists.recip())
    }

    #[test]
    fn the_prediction_of_a_part_becomes_that_of_the_tick() {
        for (mass, stiffness) in [(1e-3, 0.0), (1e-3, 5.0), (2e-4, 800.0)] {
            let (force, velocity, period, parts) = (0.03, -0.2, 0.05, 5.0);
            let (change, yields) = step(mass, stiffness, force, velocity, period / parts);
            let now = Vector3::x() * velocity;
            let part = NodePrediction { expected: now + Vector3::x() * change, yields: Some(yields) };
            let whole = part.of_tick(&now, mass.recip(), parts);
            let (change, yields) = step(mass, stiffness, force, velocity, period);
            assert!((whole.expected.x - velocity - change).abs() < 1e-9 * change.abs());
            assert!((whole.yields.expect("a number") / yields - 1.0).abs() < 1e-9);
        }
    }
}
