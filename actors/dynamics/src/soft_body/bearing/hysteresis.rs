//! Hysteresis of soft matter under a rigid body: while it is pressed in it pushes back with more than its elastic force,
//! while it recovers with less, at any speed. So a body that bounces is damped, and a ball that rolls is held back by
//! more pressure before it than behind it (Greenwood, Minshall and Tabor, *Hysteresis losses in rolling and sliding
//! friction*, 1961).
//!
//! Methods of soft matter have a damping of their own that is small in slow motion, or none: on them a ball that a slight
//! asymmetry has set rolling would not come to rest.
//!
//! Contact points are as far apart as the vertices of the meshes. What a smaller patch of contact resists to rolling is a
//! moment on the rigid body: that of the pressures of Hertz on a ball as large as the body. Its reaction on the soft body,
//! a couple within that patch, is left out.

use nalgebra::{Point3, Vector3};

use super::{Bearer, Bearing, Bearings, BorneBody};
use crate::soft_body::contact::BearingFeature;

/// Force in excess of the elastic one while soft matter is pressed in, as a share of it; the same is missing while it
/// recovers. A fifth is a loss of a third of the energy in a cycle, of the size that soft tissues show (Fung,
/// *Biomechanics: Mechanical Properties of Living Tissues*, 1993, §7.5).
const LOSS: f64 = 0.2;
/// Mean distance of the pressure under a ball from the middle of the contact, and from a line through it, over the
/// contact's radius (Hertz 1881: the pressure is half an ellipsoid).
const FROM_MIDDLE: f64 = 3.0 * std::f64::consts::PI / 16.0;
const FROM_LINE: f64 = 3.0 / 8.0;

/// A soft body and a rigid one that press on each other.
struct Pair {
    bearer: usize,
    borne: usize,
    /// Sum of the normal forces in the last step \[N\], and of them times position and normal.
    force: f64,
    places: Vector3<f64>,
    normals: Vector3<f64>,
    /// Sum of the forces times the square roots of their mobilities along the normal.
    roots: f64,
    /// Sum of the forces times their distance from the middle.
    distances: f64,
}

/// Square root of the mobility of a rigid body at a contact, along its normal \[kg^-½\].
fn root(bearing: &Bearing, bodies: &[BorneBody]) -> f64 {
    let [along, _] = bodies[bearing.borne].proxy.yields(&bearing.at_in_world, &bearing.normal_in_world);
    along.max(0.0).sqrt()
}

/// The pairs of soft volumes with rigid bodies, by contacts that pressed in the last step.
fn pairs(found: &[Bearing], bearers: &[Bearer<'_>], bodies: &[BorneBody]) -> Vec<Pair> {
    let mut pairs: Vec<Pair> = Vec::new();
    for bearing in found.iter().filter(|bearing| loses(bearing, bearers)) {
        let (bearer, borne, force) = (bearing.bearer, bearing.borne, bearing.contact.force);
        let known = pairs.iter().position(|pair| (pair.bearer, pair.borne) == (bearer, borne));
        let at = known.unwrap_or_else(|| {
            let zero = Vector3::zeros();
            pairs.push(Pair {
                bearer,
                borne,
                force: 0.0,
                places: zero,
                normals: zero,
                roots: 0.0,
                distances: 0.0,
            });
            pairs.len() - 1
        });
        pairs[at].force += force;
        pairs[at].places += bearing.at_in_world.coords * force;
        pairs[at].normals += bearing.normal_in_world * force;
        pairs[at].roots += force * root(bearing, bodies);
    }
    pairs
}

/// Whether a contact has hysteresis.
fn loses(bearing: &Bearing, bearers: &[Bearer<'_>]) -> bool {
    let is_joint = matches!(bearing.contact.feature, BearingFeature::Joint(..));
    bearing.contact.force > 0.0 && bearers[bearing.bearer].terms.young_modulus > 0.0 && !is_joint
}

impl Bearings {
    /// Adds the losses of a step of `step` seconds to the contacts' friction, and their moments on rolling bodies.
    pub(super) fn add_losses(
        &self,
        found: &mut [Bearing],
        bearers: &[Bearer<'_>],
        bodies: &[BorneBody],
        step: f64,
    ) {
        let mut pairs = pairs(found, bearers, bodies);
        for pair in &mut pairs {
            let middle = Point3::from(pair.places / pair.force);
            let own = found.iter().filter(|of| (of.bearer, of.borne) == (pair.bearer, pair.borne));
            let own = own.filter(|bearing| loses(bearing, bearers));
            pair.distances = own.map(|of| of.contact.force * (of.at_in_world - middle).norm()).sum();
        }
        for pair in &pairs {
            let (of, body) = (&bearers[pair.bearer], &bodies[pair.borne]);
            let step = body.proxy.own_step().max(step);
            let mean = of.velocities.iter().sum::<Vector3<f64>>() / of.velocities.len().max(1) as f64;
            let soft_moves = of.world_from_body.rotation * mean;
            let moment = self.rolling_moment(pair, of, body, step);
            let own = found.iter_mut().filter(|of| (of.bearer, of.borne) == (pair.bearer, pair.borne));
            for bearing in own.filter(|bearing| loses(bearing, bearers)) {
                let (force, normal) = (bearing.contact.force, bearing.normal_in_world);
                let pressed = normal.dot(&(body.proxy.speed(&bearing.at_in_world) - soft_moves));
                // Slower than this, all of the loss would turn the body back within a step of its controller.
                let slow = 2.0 * LOSS * step * root(bearing, bodies) * pair.roots;
                let share = if slow > 0.0 { (pressed / slow).clamp(-1.0, 1.0) } else { 0.0 };
                bearing.contact.friction += normal * (LOSS * share * force);
                bearing.moment = moment * (force / pair.force);
            }
        }
    }

    /// The moment against rolling that the contact points are too far apart to show \[N·m\], in world.
    fn rolling_moment(&self, pair: &Pair, of: &Bearer<'_>, body: &BorneBody, step: f64) -> Vector3<f64> {
        let Some(rigid) = self.rigid.get(&body.entity) else { return Vector3::zeros() };
        let Some(normal) = pair.normals.try_normalize(0.0) else { return Vector3::zeros() };
        let radius = (0.75 * pair.force * rigid.reach() / of.terms.young_modulus).cbrt().min(rigid.reach());
        let shown = pair.distances / pair.force;
        let hidden = (radius - shown / FROM_MIDDLE).max(0.0);
        let most = LOSS * FROM_LINE * hidden * pair.force;
        let spin = body.proxy.of_origin().angular;
        let rolls = spin - normal * normal.dot(&spin);
        let speed = rolls.norm();
        let inverse = body.proxy.inertia().inverse_in_world(&body.proxy.pose);
        let slow = 2.0 * step * most * (inverse * rolls).norm() / speed;
        if !(speed > 0.0 && most > 0.0 && slow > 0.0) {
            return Vector3::zeros();
        }
        rolls * (-most / speed.max(slow))
    }
}
