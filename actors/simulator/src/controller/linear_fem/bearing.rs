//! Rigid bodies on linear organs. An organ without mass answers within a tick; a rigid body yields by its inertia.

use nalgebra::Vector3;
use trocar_dynamics::soft_body::bearing::rigid_response::{PlaneContact, RigidInStep, RigidResponse};
use trocar_dynamics::soft_body::bearing::{Bearer, Bearing, BorneBody};
use trocar_dynamics::soft_body::contact::SoftContacts;
use trocar_dynamics::soft_body::method::{ContactParams, StepContext};
use trocar_scene::{Commands, Snapshot, Tick};

use super::contacts::{ConstraintReaction, ConstraintSource};
use super::{Body, LinearFemController};

/// Coulomb friction coefficient of an organ.
const FRICTION: f64 = 0.3;

impl LinearFemController {
    /// The rigid bodies that move, and for each organ its contacts with them.
    pub(super) fn press(&mut self, scene: &Snapshot, tick: &Tick<'_>) -> (Vec<BorneBody>, Vec<OnOrgan>) {
        let Self { bodies, bearings, gravity_in_world, .. } = self;
        let period = tick.period.as_secs_f64();
        let given = bodies.iter().map(|of| (of.body.entity, &of.borne.given_whole[..]));
        let borne = bearings.borne_bodies(scene, (tick.time, period), gravity_in_world, given, false);
        let mut found: Vec<OnOrgan> = bodies.iter().map(|_| OnOrgan::default()).collect();
        if borne.is_empty() {
            return (borne, found);
        }
        let ready: Vec<usize> = (0..bodies.len()).filter(|&at| !bodies[at].frozen).collect();
        let still: Vec<Vec<Vector3<f64>>> =
            ready.iter().map(|&at| vec![Vector3::zeros(); bodies[at].positions.len()]).collect();
        let with = ready.iter().zip(&still);
        let bearers: Vec<Bearer<'_>> =
            with.map(|(&at, velocities)| bodies[at].bearer(scene, velocities)).collect();
        for bearing in bearings.find(&bearers, &borne, period) {
            found[ready[bearing.bearer]].bearings.push(bearing);
        }
        for (of, &at) in bearers.iter().zip(&ready) {
            let OnOrgan { bearings, presses, rigid } = &mut found[at];
            presses.extend(bearings.iter().map(|bearing| bearing.plane));
            let others =
                bearers.iter().filter(|other| other.entity != of.entity).flat_map(|other| other.last);
            let friction = bearings.iter().filter_map(|bearing| bearing.friction_given(period));
            *rigid = of.rigid_in_step(presses, &borne, others.copied().chain(friction), period);
        }
        (borne, found)
    }
}

/// The contacts of an organ with rigid bodies in a tick.
#[derive(Default)]
pub(super) struct OnOrgan {
    pub bearings: Vec<Bearing>,
    pub presses: Vec<PlaneContact>,
    pub rigid: Vec<RigidInStep>,
}

impl Body {
    fn bearer<'a>(&'a self, scene: &Snapshot, velocities: &'a [Vector3<f64>]) -> Bearer<'a> {
        Bearer {
            entity: self.body.entity,
            world_from_body: scene.world_pose(self.body.entity),
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

    /// Gives the rigid bodies their impulses, by the organ's reactions.
    pub(super) fn bear(
        &mut self,
        answers: &[ConstraintReaction],
        bearings: &mut [Bearing],
        borne: &[BorneBody],
        tick: &Tick<'_>,
        out: &mut Commands,
    ) {
        let before = std::mem::take(&mut self.borne.borne);
        self.borne.last_given.clear();
        self.borne_force = 0.0;
        for answer in answers {
            let ConstraintSource::Body(number) = answer.by else { continue };
            let Some(bearing) = bearings.get_mut(number) else { continue };
            let normal = answer.force.dot(&bearing.plane.normal).max(0.0);
            let mut moved = vec![[Vector3::zeros(); 2]; borne.len()];
            let step = tick.period.as_secs_f64();
            let SoftContacts { given_whole, last_given, .. } = &mut self.borne;
            let force = bearing.end_step(normal, borne, step, given_whole, last_given, &mut moved);
            self.borne_force += force.norm();
            if force != Vector3::zeros() {
                self.borne.borne.push(bearing.contact);
            }
        }
        if !(before.is_empty() && self.borne.borne.is_empty()) {
            self.borne.step = tick.period.as_secs_f64();
            out.put(self.body.entity, self.borne.clone());
        }
    }
}
