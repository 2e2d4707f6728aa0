//! Penalty contact for detected contacts: an implicit spring and damper along the normal, and Coulomb friction by a
//! tangential spring that slides at the friction limit. All contacts of a controller's bodies are solved together.
//!
//! During a step vertices are treated as free, with their contact forces. The stiffness `k` and damping `c` of a
//! contact of depth `d` are implicit in a step `h`: `F = k (d − h v) − c v`. So no vertex is thrown back faster than it
//! came, whatever `k` and `c` are. Contacts that share vertices are solved in several sweeps. Both bodies of a contact
//! get the same impulse.
//!
//! So a contact is a little softer than its stiffness, and a light vertex held by friction may vibrate by micrometres
//! where its own tissue oscillates within a step.
//!
//! A contact that is already deep when first detected (a slow detector, or a fast body) is stopped there and then
//! released slowly: its spring starts at that depth, and its rest depth returns to the surface within a few hundredths
//! of a second.

use nalgebra::{Isometry3, Vector3};
use trocar_scene::{Entity, Frozen, Motion, RigidBody, SimTime, Snapshot};

use super::bodies::{AppliedImpulses, ContactBody, ContactTarget};
use super::tracking::{AdjacencyCache, ContactPair, FOUND_MAX, Shape, answers, rows};
use super::{ContactSums, PersistentContact, SoftContacts};
use crate::picking::DrivenVertex;
use crate::soft_body::method::ContactParams;

/// Sweeps over all contacts.
const SWEEPS: usize = 10;
/// Fraction of critical damping of the touching vertices.
const DAMPING_RATIO: f64 = 0.7;
/// Time constant for the release of initially deep contacts \[s\].
const LET_OUT: f64 = 0.05;

/// A body of this controller that answers contacts.
pub(crate) struct RespondingBody<'a> {
    pub entity: Entity,
    pub shape: Shape<'a>,
    pub terms: ContactParams<'a>,
    pub driven: &'a [DrivenVertex],
    pub gravity_in_body: Vector3<f64>,
    /// Forces on it in this tick; its contact forces are added, in its frame \[N\].
    pub forces: Vec<(u32, Vector3<f64>)>,
    pub memory: SoftContacts,
    /// Sum of the magnitudes of its contact forces \[N\], and the number of active contacts.
    pub pressed: (f64, usize),
    /// Force by contacts that others have answered for it \[N\].
    pub taken: Vector3<f64>,
    /// Whether there is a change to publish.
    pub changed: bool,
}

impl RespondingBody<'_> {
    /// Publishes the masses by which another body answers for it.
    fn name(&mut self, period: f64) {
        let is_known = self.memory.step == period && *self.memory.masses_inverse == self.terms.masses_inverse;
        if !is_known {
            self.memory.masses_inverse = self.terms.masses_inverse.to_vec().into();
            self.memory.step = period;
            self.changed = true;
        }
    }
}

struct Row {
    body: usize,
    contact: usize,
    met: ContactPair,
    handles: [Option<ContactTarget>; 2],
    stiffness: f64,
    damping: f64,
    friction: f64,
    /// Change of relative velocity per impulse \[1/kg\], and the step over which forces act \[s\].
    yields: f64,
    step: f64,
    slack: f64,
    drawn: Vector3<f64>,
    /// Normal force on the body \[N\].
    normal: f64,
    across: Vector3<f64>,
    /// The part of the friction spring's force beyond Coulomb's limit \[N\].
    beyond: Vector3<f64>,
}

/// Solves all contacts of a controller's bodies.
pub(crate) fn answer<'a>(
    own: &mut [RespondingBody<'a>],
    surroundings: &mut AdjacencyCache,
    scene: &'a Snapshot,
    (now, period, me): (SimTime, f64, Entity),
) {
    take(own, scene, period);
    read_detections(own, surroundings, scene, (now, period, me));
    for body in own.iter_mut() {
        body.pressed = (0.0, 0);
        let presses = [body.memory.force_in_world, body.taken].iter().any(|force| *force != Vector3::zeros());
        body.changed |= !body.memory.contacts.is_empty() || presses;
        body.memory.force_in_world = body.taken;
    }
    if own.iter().all(|body| body.memory.contacts.is_empty()) {
        return;
    }
    // Taken out, so that it can be read while contacts are updated.
    let given = |body: &mut RespondingBody<'_>| AppliedImpulses {
        giver: body.entity,
        vertices: std::mem::take(&mut body.memory.given),
    };
    let given: Vec<AppliedImpulses> = own.iter_mut().map(given).collect();
    let mut movers: Vec<ContactBody<'_>> = own.iter().map(|body| ContactBody::of(body, period)).collect();
    let mut rows = contact_geometry(own, surroundings, scene, (now, period), &given, &mut movers);
    for _ in 0..SWEEPS {
        rows.iter_mut().for_each(|row| row.press(&mut movers));
    }
    let pushed: Vec<Entity> = movers.iter().map(|mover| mover.entity).collect();
    for (body, given) in own.iter_mut().zip(given) {
        body.memory.given = given.vertices;
    }
    give(own, &rows, &pushed, now, period);
}

/// Takes the impulses that others have given and that were not taken yet.
fn take(own: &mut [RespondingBody<'_>], scene: &Snapshot, period: f64) {
    let mine: Vec<Entity> = own.iter().map(|body| body.entity).collect();
    for (giver, contacts) in scene.iter::<SoftContacts>().filter(|(giver, _)| !mine.contains(giver)) {
        for given in &contacts.given {
            let Some(body) = own.iter_mut().find(|body| given.body == Some(body.entity)) else { continue };
            let taken = ContactSums::of(&mut body.memory.taken, giver);
            let body_from_world = body.shape.world_from_body.rotation.inverse();
            let vertices = body.shape.positions.len();
            for (&vertex, sum) in given.vertices.iter().zip(&given.sums) {
                let known = taken.at(vertex);
                let news = sum - *known;
                *known = *sum;
                body.changed |= news != Vector3::zeros();
                if news != Vector3::zeros() && (vertex as usize) < vertices {
                    body.forces.push((vertex, body_from_world * news / period));
                    body.taken += news / period;
                }
            }
        }
    }
}

/// Reads the detectors' lists since the last call.
fn read_detections(
    own: &mut [RespondingBody<'_>],
    surroundings: &mut AdjacencyCache,
    scene: &Snapshot,
    (now, period, me): (SimTime, f64, Entity),
) {
    let until: Vec<Vec<(Entity, SimTime)>> = own.iter().map(|body| body.memory.heard.clone()).collect();
    let mut is_named = vec![false; own.len()];
    for (writer, row) in rows(scene, me, now) {
        let [first, second] = [row.a, row.b].map(|entity| own.iter().position(|body| body.entity == entity));
        // A body named in a contact publishes its masses from now on, whichever side answers.
        for index in [first, second].into_iter().flatten() {
            if !std::mem::replace(&mut is_named[index], true) {
                own[index].name(period);
            }
        }
        let (body, side) = match (first, second) {
            (Some(first), Some(second)) if second < first => (second, 1),
            (Some(first), _) => (first, 0),
            (None, Some(second)) => (second, 1),
            (None, None) => continue,
        };
        let other = if side == 0 { row.b } else { row.a };
        let is_mine = first.is_some() && second.is_some();
        let leaves =
            !is_mine && (is_borne(scene, other) || answers(scene, other) && other < own[body].entity);
        let heard = until[body].iter().find(|(of, _)| *of == writer).map(|(_, time)| *time);
        if leaves || heard.is_some_and(|heard| row.detected_at <= heard) {
            continue;
        }
        let heard = &mut own[body].memory.heard;
        let known = heard.iter_mut().find(|(of, _)| *of == writer);
        let before = known.map(|(_, time)| std::mem::replace(time, row.detected_at));
        if before.is_none() {
            heard.push((writer, row.detected_at));
        }
        let is_first_of_list = before != Some(row.detected_at);
        own[body].changed = true;
        if is_first_of_list {
            // Contacts fixed to points live until the next list of their detector.
            own[body].memory.contacts.retain(|held| held.is_followed() || held.writer != writer);
        }
        let of_other = match own.iter().find(|body| body.entity == other) {
            Some(other) => other.shape.clone(),
            None => Shape::of(scene, other),
        };
        surroundings.look(own[body].entity, &own[body].shape.triangles);
        surroundings.look(other, &of_other.triangles);
        let stars = [surroundings.of(own[body].entity), surroundings.of(other)];
        let found = PersistentContact::new(row, side, writer, [&own[body].shape, &of_other], stars);
        let Some(found) = found else { continue };
        let contacts = &mut own[body].memory.contacts;
        match contacts.iter().position(|held| held.is_of(&found)) {
            Some(at) if contacts[at].presses => contacts[at].seen = found.seen,
            Some(at) => contacts[at] = found,
            None if contacts.len() < FOUND_MAX => contacts.push(found),
            None => {}
        }
    }
}

/// Whether a body is rigid and moves: soft bodies bear it, whatever detectors find ([`crate::soft_body::bearing`]).
fn is_borne(scene: &Snapshot, entity: Entity) -> bool {
    scene.get::<RigidBody>(entity).is_some_and(|body| body.motion == Motion::Dynamic)
        && scene.get::<Frozen>(entity).is_none()
}

/// Computes the current geometry of all contacts, and drops those that have ended.
fn contact_geometry<'a>(
    own: &mut [RespondingBody<'_>],
    surroundings: &mut AdjacencyCache,
    scene: &'a Snapshot,
    (now, period): (SimTime, f64),
    given: &'a [AppliedImpulses],
    movers: &mut Vec<ContactBody<'a>>,
) -> Vec<Row> {
    let shapes: Vec<(Entity, Shape<'_>)> = own.iter().map(|body| (body.entity, body.shape.clone())).collect();
    let mut rows = Vec::new();
    for (index, body) in own.iter_mut().enumerate() {
        let mut contacts = std::mem::take(&mut body.memory.contacts);
        let falls = body.shape.world_from_body.rotation * body.gravity_in_body * period;
        let mut kept = 0;
        contacts.retain_mut(|held| {
            let mine = shapes.iter().position(|(entity, _)| *entity == held.other);
            if held.is_old(now) || is_borne(scene, held.other) {
                return false;
            }
            let known = movers.iter().position(|mover| mover.entity == held.other);
            let other = match mine {
                Some(mine) => Some(mine),
                None if answers(scene, held.other) => {
                    let new = || ContactBody::remote((scene, held.other), &falls, given);
                    match known.or_else(|| new().map(|new| add(movers, new))) {
                        Some(remote) => Some(remote),
                        // It has not published its masses yet.
                        None => {
                            kept += 1;
                            return true;
                        }
                    }
                }
                None => None,
            };
            let shape = mine.map_or_else(|| Shape::of(scene, held.other), |mine| shapes[mine].1.clone());
            if held.is_followed() {
                surroundings.look(body.entity, &body.shape.triangles);
                surroundings.look(held.other, &shape.triangles);
            }
            let stars = [surroundings.of(body.entity), surroundings.of(held.other)];
            let Some(met) = held.contact_geometry([&body.shape, &shape], stars) else { return false };
            if let Some(mut row) = Row::new(met, [Some(index), other], movers, period) {
                let leaving = row.slip(movers).dot(&met.normal_in_world);
                held.slack = match std::mem::replace(&mut held.is_in, met.depth > 0.0) {
                    true => held.slack / (1.0 + period / LET_OUT),
                    false => (met.depth - leaving * period).max(0.0),
                };
                let slip = body.shape.speed(&met.places[0]) - shape.speed(&met.places[1]);
                let drawn = if held.presses { held.drawn + slip * period } else { Vector3::zeros() };
                held.drawn = drawn - met.normal_in_world * met.normal_in_world.dot(&drawn);
                (row.body, row.contact, row.slack, row.drawn) = (index, kept, held.slack, held.drawn);
                rows.push(row);
            }
            kept += 1;
            true
        });
        body.memory.contacts = contacts;
    }
    rows
}

fn add<'a>(movers: &mut Vec<ContactBody<'a>>, mover: ContactBody<'a>) -> usize {
    movers.push(mover);
    movers.len() - 1
}

/// Distributes the impulses to both sides; `pushed` are all movers.
fn give(own: &mut [RespondingBody<'_>], rows: &[Row], pushed: &[Entity], now: SimTime, period: f64) {
    for row in rows {
        let force = row.met.normal_in_world * row.normal + row.across;
        let held = own[row.body].memory.contacts.get_mut(row.contact);
        if let Some(held) = held {
            held.presses = row.normal > 0.0;
            // While sliding, the tangential spring stays at the friction limit.
            if row.stiffness > 0.0 {
                let resists = row.stiffness * row.step + row.damping;
                held.drawn += row.beyond * ((1.0 + resists * row.yields * row.step) / row.stiffness);
            }
            if held.presses {
                held.seen = now;
            }
        }
        if row.normal == 0.0 {
            continue;
        }
        for (side, sign) in [(0, 1.0), (1, -1.0)] {
            let place = &row.met.places[side];
            let shares = place.nodes.into_iter().zip(place.weights).filter(|(_, weight)| *weight != 0.0);
            match row.handles[side].map(|handle| handle.mover) {
                Some(mover) if mover < own.len() => {
                    let body = &mut own[mover];
                    let body_from_world: Isometry3<f64> = body.shape.world_from_body.inverse();
                    let force = force * sign;
                    body.memory.force_in_world += force;
                    body.pressed.0 += force.norm();
                    body.pressed.1 += 1;
                    let own_force = body_from_world.rotation * force;
                    body.forces.extend(shares.map(|(node, weight)| (node, own_force * weight)));
                }
                Some(mover) => {
                    let sums = ContactSums::of(&mut own[row.body].memory.given, pushed[mover]);
                    shares.for_each(|(node, weight)| *sums.at(node) += force * (sign * weight * period));
                }
                None => {}
            }
        }
    }
}

impl Row {
    /// `None` if both sides are immovable.
    fn new(
        met: ContactPair,
        sides: [Option<usize>; 2],
        movers: &mut [ContactBody<'_>],
        period: f64,
    ) -> Option<Self> {
        let handles = [0, 1].map(|side| {
            let mover = sides[side]?;
            Some(movers[mover].hold(mover, &met.places[side]))
        });
        let all = || handles.iter().flatten().map(|handle| (&movers[handle.mover], handle));
        let yields: f64 = all().map(|(mover, handle)| mover.yields(handle)).sum();
        if !(yields > 0.0 && met.depth.is_finite()) {
            return None;
        }
        let all = || all().map(|(mover, _)| mover);
        // Two springs in series; a body of another controller is as stiff as this one.
        let compliance: f64 = all().map(|mover| mover.stiffness.recip()).sum();
        let frictions: Vec<f64> = all().filter_map(|mover| mover.friction).collect();
        let friction = frictions.iter().product::<f64>().powf(1.0 / frictions.len().max(1) as f64);
        let stiffness = if compliance > 0.0 { compliance.recip() } else { 0.0 };
        let step = period + all().map(|mover| mover.step).fold(0.0, f64::max);
        Some(Self {
            body: 0,
            contact: 0,
            met,
            handles,
            stiffness,
            damping: 2.0 * DAMPING_RATIO * (stiffness / yields).sqrt(),
            friction,
            yields,
            step,
            slack: 0.0,
            drawn: Vector3::zeros(),
            normal: 0.0,
            across: Vector3::zeros(),
            beyond: Vector3::zeros(),
        })
    }

    fn slip(&self, movers: &[ContactBody<'_>]) -> Vector3<f64> {
        let speed = |side: usize| {
            let carried = self.met.places[side].carried;
            self.handles[side].map_or(carried, |handle| movers[handle.mover].speed(&handle))
        };
        speed(0) - speed(1)
    }

    fn push(&self, movers: &mut [ContactBody<'_>], force: &Vector3<f64>) {
        for (side, sign) in [(0, 1.0), (1, -1.0)] {
            if let Some(handle) = self.handles[side] {
                movers[handle.mover].push(&handle, &(force * (sign * self.step)));
            }
        }
    }

    /// One Gauss-Seidel update of the contact's force.
    fn press(&mut self, movers: &mut [ContactBody<'_>]) {
        let normal = self.met.normal_in_world;
        let gives = self.yields * self.step;
        let leaving = self.slip(movers).dot(&normal) - self.normal * gives;
        let depth = self.met.depth;
        let resists = self.stiffness * self.step + if depth > 0.0 { self.damping } else { 0.0 };
        let spring = self.stiffness * (depth - self.slack);
        let wanted = (spring - resists * leaving) / (1.0 + resists * gives);
        let change = wanted.max(0.0) - self.normal;
        self.push(movers, &(normal * change));
        self.normal += change;
        let gives = self.yields * self.step;
        let slip = self.slip(movers) - self.across * gives;
        let across = slip - normal * slip.dot(&normal);
        let resists = self.stiffness * self.step + self.damping;
        let wanted = (self.drawn * -self.stiffness - across * resists) / (1.0 + resists * gives);
        let (size, most) = (wanted.norm(), self.friction * self.normal);
        let held = if size > most { wanted * (most / size) } else { wanted };
        self.push(movers, &(held - self.across));
        (self.across, self.beyond) = (held, wanted - held);
    }
}
