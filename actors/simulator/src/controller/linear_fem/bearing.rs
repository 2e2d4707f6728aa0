//! Rigid bodies on linear organs. An organ without mass answers within a tick; a rigid body yields by its inertia.

use nalgebra::Vector3;
use trocar_dynamics::soft_body::bearing::rigid_response::{
    PlaneContact, RigidInStep, RigidPresses, RigidResponse,
};
use trocar_dynamics::soft_body::bearing::{Bearer, Bearing, Bearings, BorneBody, advance};
use trocar_dynamics::soft_body::contact::SoftContacts;
use trocar_dynamics::soft_body::method::{ContactParams, StepContext};
use trocar_scene::{Commands, Snapshot, Tick};

use super::contacts::{ConstraintReaction, ConstraintSource};
use super::{Body, LinearFemController};

/// Coulomb friction coefficient of an organ.
const FRICTION: f64 = 0.3;

impl LinearFemController {
    /// Solves all organs with the rigid bodies on them, in parts of a tick where rigid bodies are near.
    pub(super) fn solve(&mut self, scene: &Snapshot, tick: &Tick<'_>, out: &mut Commands) {
        let Self { bodies, bearings, gravity_in_world, .. } = self;
        let period = tick.period.as_secs_f64();
        let given = bodies.iter().map(|of| (of.body.entity, &of.borne.given_whole[..]));
        let mut borne = bearings.borne_bodies(scene, (tick.time, period), gravity_in_world, given, false);
        // An organ without mass has no velocities; nothing is made where no rigid body moves.
        let still = |of: &Body| vec![Vector3::zeros(); of.positions.len()];
        let still: Vec<Vec<Vector3<f64>>> =
            if borne.is_empty() { Vec::new() } else { bodies.iter().map(still).collect() };
        let parts =
            if borne.is_empty() { 1 } else { bearings.parts(&bearers(bodies, &still).1, &borne, period) };
        let step = period / f64::from(parts);
        for of in bodies.iter_mut() {
            of.borne.course.clear();
            of.borne_changed = false;
        }
        for part in 0..parts {
            let found =
                if borne.is_empty() { Vec::new() } else { press(bodies, &still, bearings, &borne, step) };
            let mut found = found.into_iter();
            let mut moved = vec![[Vector3::zeros(); 2]; borne.len()];
            for of in bodies.iter_mut().filter(|of| !of.frozen) {
                if parts > 1 {
                    of.borne.course.push(of.borne.given_whole.clone());
                }
                let OnOrgan { mut bearings, presses, rigid } = found.next().unwrap_or_default();
                let rigid = RigidPresses { bodies: &rigid, contacts: &presses };
                match of.step(step, rigid, scene, tick, out) {
                    Ok(()) => of.bear(&mut bearings, &borne, step, &mut moved),
                    Err(why) => of.freeze(&why, tick, out),
                }
            }
            if part + 1 < parts {
                advance(&mut borne, step, &moved);
            }
        }
        for of in bodies.iter_mut().filter(|of| !of.frozen && of.borne_changed) {
            of.borne.step = period;
            out.put(of.body.entity, of.borne.clone());
        }
    }
}

/// The organs that answer, by their numbers.
fn bearers<'a>(bodies: &'a [Body], still: &'a [Vec<Vector3<f64>>]) -> (Vec<usize>, Vec<Bearer<'a>>) {
    let ready = bodies.iter().zip(still).enumerate().filter(|(_, (of, _))| !of.frozen);
    ready.map(|(at, (of, still))| (at, of.bearer(still))).unzip()
}

/// The contacts of a step of `step` seconds, of each organ that answers.
fn press(
    bodies: &[Body],
    still: &[Vec<Vector3<f64>>],
    bearings: &mut Bearings,
    borne: &[BorneBody],
    step: f64,
) -> Vec<OnOrgan> {
    let (_, bearers) = bearers(bodies, still);
    let mut found: Vec<OnOrgan> = bearers.iter().map(|_| OnOrgan::default()).collect();
    for bearing in bearings.find(&bearers, borne, step) {
        found[bearing.bearer].bearings.push(bearing);
    }
    for (of, OnOrgan { bearings, presses, rigid }) in bearers.iter().zip(&mut found) {
        presses.extend(bearings.iter().map(|bearing| bearing.plane));
        let others = bearers.iter().filter(|other| other.entity != of.entity).flat_map(|other| other.last);
        let friction = bearings.iter().filter_map(|bearing| bearing.friction_given(step));
        *rigid = of.rigid_in_step(presses, borne, others.copied().chain(friction), step);
    }
    found
}

/// The contacts of an organ with rigid bodies in a step.
#[derive(Default)]
pub(super) struct OnOrgan {
    pub bearings: Vec<Bearing>,
    pub presses: Vec<PlaneContact>,
    pub rigid: Vec<RigidInStep>,
}

impl Body {
    fn bearer<'a>(&'a self, velocities: &'a [Vector3<f64>]) -> Bearer<'a> {
        Bearer {
            entity: self.body.entity,
            world_from_body: self.world_from_body,
            positions: &self.positions,
            velocities,
            triangles: &self.body.triangles,
            segments: &self.body.segments,
            thickness: 0.0,
            closed: true,
            terms: ContactParams {
                masses_inverse: &self.mobility,
                stiffness: self.bearing_stiffness,
                bearing_stiffness: self.bearing_stiffness,
                young_modulus: self.kind.young_modulus,
                friction: FRICTION,
            },
            known: &self.borne.borne,
            last: &self.borne.last_given,
            joints: &[],
        }
    }

    /// The reactions of an organ whose inverse is not ready yet: it bears as it is, without a deformation.
    pub(super) fn bear_undeformed(&self, site: &StepContext<'_>) -> Vec<ConstraintReaction> {
        let mut response = RigidResponse::default();
        site.rigid.answer(site.period_secs(), |_| 0.0, &mut response);
        let of = |(number, press): (usize, &PlaneContact)| ConstraintReaction {
            force: press.normal * response.forces[number],
            ..self.body_constraint(number, press, site)
        };
        site.rigid.contacts.iter().enumerate().map(of).collect()
    }

    /// Gives the rigid bodies their impulses of a step of `step` seconds, by the organ's reactions.
    fn bear(
        &mut self,
        bearings: &mut [Bearing],
        borne: &[BorneBody],
        step: f64,
        moved: &mut [[Vector3<f64>; 2]],
    ) {
        let SoftContacts { borne: kept, given_whole, last_given, .. } = &mut self.borne;
        self.borne_changed |= !kept.is_empty();
        kept.clear();
        last_given.clear();
        self.borne_force = 0.0;
        for answer in &self.answers {
            let ConstraintSource::Body(number) = answer.by else { continue };
            let Some(bearing) = bearings.get_mut(number) else { continue };
            let normal = answer.force.dot(&bearing.plane.normal).max(0.0);
            let force = bearing.end_step(normal, borne, step, given_whole, last_given, moved);
            self.borne_force += force.norm();
            if force != Vector3::zeros() {
                kept.push(bearing.contact);
            }
        }
        self.borne_changed |= !kept.is_empty();
    }
}
