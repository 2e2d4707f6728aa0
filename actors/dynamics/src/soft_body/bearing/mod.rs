//! Soft bodies bear rigid ones: contact of a soft body with the rigid bodies that move.
//!
//! The soft body's controller finds these contacts itself, in every step, as it does those of instruments: the vertices
//! of the soft body near the rigid one, and points of the rigid one near the soft surface. So nothing depends on the
//! rate of a detector. A contact that is about to begin counts as well, so that nothing passes in a long step.
//!
//! Each contact is a stiff plane that is fixed to the rigid body, and the rigid body's motion in the step is solved
//! together with the soft body's: exactly by methods that solve a step at once ([`rigid_response`]), in sweeps by those that
//! divide it ([`rigid_motion`]). Friction is a tangential spring at each contact that slides at
//! Coulomb's limit, of the normal force of the last step. The rigid body's controller takes the impulses
//! ([`super::contact::RigidContacts`]), so momentum is conserved for any rates and delays.

mod hysteresis;
pub mod joint;
mod proximity;
pub mod rigid_motion;
mod rigid_proxy;
pub mod rigid_response;
pub(crate) mod rigid_surface;

use std::collections::BTreeMap;
use std::collections::btree_map::Entry;
use std::sync::Arc;

use nalgebra::{Isometry3, Matrix3, Point3, Vector3};
use trocar_collision::moving_surface::MovingSurface;
use trocar_scene::{
    Access, Entity, EntitySet, Frozen, Motion, RigidBody, Shape, SimTime, Snapshot, Velocity,
};

use super::contact::{BearingFeature, BorneContact, ImpulseTotals, RigidContacts, RigidJoint, SoftContacts};
use super::method::ContactParams;
use crate::rigid_world::Inertia;
use crate::rigid_world::mass_properties::enclosed;
use proximity::near_points;
use rigid_proxy::RigidProxy;
use rigid_response::{PlaneContact, RigidInStep};
use rigid_surface::RigidSurface;

/// Maximum number of contacts of one soft body with rigid bodies; the deepest are kept.
pub const BORNE_MAX: usize = 512;
/// Longest step in which a soft body meets rigid ones \[s\]: a longer tick is divided. In longer steps contacts alternate
/// from step to step, because their normals turn by more than they may within a linear step.
pub(crate) const STEP_MAX: f64 = 0.01;
/// Length of the parts of a tick whose impulses are told to the rigid bodies one by one \[s\].
const COURSE_STEP: f64 = 1e-3;
/// Within this distance a rigid body is near a soft one, besides the way that it may go in a tick \[m\].
const NEAR: f64 = 0.02;
/// Speed at which bodies that overlap from the beginning are pushed apart \[m/s\].
const WORKED_OFF: f64 = 0.02;
/// A body that moves further than this fraction of its radius within a step is far from where it is.
const FAR: f64 = 0.3;
/// Fraction of critical damping of a tangential spring.
const DAMPING_RATIO: f64 = 0.7;

/// Whether the controller of a soft body answers its contacts with rigid bodies that move.
pub(crate) fn bears(scene: &Snapshot, entity: Entity) -> bool {
    scene.soft_body(entity).is_some_and(|(_, of)| of.bears) && scene.get::<Frozen>(entity).is_none()
}

/// Reads and writes of a controller whose soft bodies bear rigid ones.
pub fn access(access: Access, bodies: &[Entity]) -> Access {
    access
        .reads::<RigidBody>()
        .reads::<RigidContacts>()
        .reads::<Shape>()
        .reads::<Velocity>()
        .writes::<SoftContacts>(EntitySet::Of(bodies.to_vec()))
}

/// A soft body of the controller, at the beginning of a step.
pub struct Bearer<'a> {
    /// Its entity.
    pub entity: Entity,
    /// Its pose.
    pub world_from_body: Isometry3<f64>,
    /// Vertices in its frame \[m\], and their velocities \[m/s\].
    pub positions: &'a [Point3<f64>],
    /// See above.
    pub velocities: &'a [Vector3<f64>],
    /// Triangles of its surface; segments of a line.
    pub triangles: &'a Arc<Vec<[u32; 3]>>,
    /// See above.
    pub segments: &'a Arc<Vec<[u32; 2]>>,
    /// Distance of its surface from the vertices \[m\].
    pub thickness: f64,
    /// Whether its triangles enclose a volume.
    pub closed: bool,
    /// Its contact parameters.
    pub terms: ContactParams<'a>,
    /// Its contacts in the last step, and the impulses that it gave in it.
    pub known: &'a [BorneContact],
    /// See above.
    pub last: &'a [ImpulseTotals],
    /// Its joints.
    pub joints: &'a [RigidJoint],
}

impl Bearer<'_> {
    /// Whether all these vertices are joined to a rigid body: what has grown onto it does not touch it.
    fn is_joined(&self, vertices: &[u32; 3], body: Entity) -> bool {
        let is = |vertex: &u32| self.joints.iter().any(|joint| joint.body == body && joint.vertex == *vertex);
        !self.joints.is_empty() && vertices.iter().all(is)
    }

    /// A contact that is this deep at the beginning of a step \[m\], with the forces of the last step, if there were any.
    fn touches(&self, body: Entity, feature: BearingFeature, depth: f64, step: f64) -> BorneContact {
        let mut contact = self.known(body, feature);
        contact.overlap = match contact.force > 0.0 {
            true => (contact.overlap - WORKED_OFF * step).clamp(0.0, depth.max(0.0)),
            false => depth.max(0.0),
        };
        contact
    }

    /// A contact with the forces of the last step, if there were any.
    fn known(&self, body: Entity, feature: BearingFeature) -> BorneContact {
        let known = self.known.iter().find(|known| known.body == body && known.feature == feature);
        known.copied().unwrap_or(BorneContact {
            body,
            feature,
            force: 0.0,
            friction: Vector3::zeros(),
            drawn: Vector3::zeros(),
            overlap: 0.0,
        })
    }
}

/// A rigid body that moves, as its soft partners see it within a tick.
#[derive(Clone, Debug)]
pub struct BorneBody {
    /// Its entity.
    pub entity: Entity,
    /// Coulomb friction coefficient.
    friction: f64,
    proxy: RigidProxy,
}

impl BorneBody {
    /// `world_from_body` at the beginning of the step.
    #[must_use]
    pub fn pose(&self) -> &Isometry3<f64> {
        &self.proxy.pose
    }

    /// The same after `step` seconds with everything but the partner's own forces, if it is followed in batches.
    #[must_use]
    pub fn pose_ahead(&self, step: f64) -> Isometry3<f64> {
        let mut ahead = self.proxy.clone();
        ahead.advance(step, [Vector3::zeros(); 2]);
        ahead.pose
    }

    /// How far it goes by a change of velocity in a step of `step` seconds, until its controller moves it at that velocity
    /// \[s\].
    #[must_use]
    pub fn lever(&self, step: f64) -> f64 {
        self.proxy.lever(step)
    }

    /// Its mass properties, and its inverse inertia tensor in world axes \[1/(kg·m²)\].
    #[must_use]
    pub fn inertia(&self) -> (&Inertia, Matrix3<f64>) {
        let inertia = self.proxy.inertia();
        (inertia, inertia.inverse_in_world(&self.proxy.pose))
    }

    /// Ends a step: gives it an impulse \[N·s\] and its moment about the centre of mass \[N·m·s\], in world axes, and moves
    /// it on.
    pub fn end_step(&mut self, step: f64, given: [Vector3<f64>; 2], totals: &mut Vec<ImpulseTotals>) {
        if given != [Vector3::zeros(); 2] {
            let sums = ImpulseTotals::of(totals, self.entity);
            sums.impulse += given[0];
            sums.moment += given[1];
        }
        self.proxy.advance(step, given);
    }
}

/// A contact in the current step.
pub struct Bearing {
    /// Index of the soft body, and of the rigid one.
    pub bearer: usize,
    borne: usize,
    /// Its state, with the forces of the last step; after the step, of this one.
    pub contact: BorneContact,
    /// For the soft body's step.
    pub plane: PlaneContact,
    /// From the rigid body to the soft one, in world.
    normal_in_world: Vector3<f64>,
    /// On the soft surface, and the rigid body's centre of mass when it is there, in world \[m\].
    at_in_world: Point3<f64>,
    centre_in_world: Point3<f64>,
    /// Moment of hysteresis on the rigid body besides those of forces \[N·m\], in world.
    moment: Vector3<f64>,
}

/// Finds and answers the contacts of a controller's soft bodies with rigid ones.
#[derive(Default)]
pub struct Bearings {
    rigid: BTreeMap<Entity, RigidSurface>,
    soft: BTreeMap<Entity, SoftSurface>,
}

/// The surface of a soft body, cached from step to step.
struct SoftSurface {
    triangles: Arc<Vec<[u32; 3]>>,
    segments: Arc<Vec<[u32; 2]>>,
    /// Vertices of its triangles or segments, ascending.
    vertices: Vec<u32>,
    surface: Option<MovingSurface>,
    /// Whether its surface has the positions of this step.
    is_current: bool,
}

impl Bearings {
    /// Number of equal parts of a tick of `period` seconds in which soft bodies meet rigid ones: one while none of them
    /// is near.
    #[must_use]
    pub fn parts(&self, bearers: &[Bearer<'_>], bodies: &[BorneBody], period: f64) -> u32 {
        if period <= STEP_MAX {
            return 1;
        }
        let is_near = |of: &Bearer<'_>, bounds: &[Point3<f64>; 2], body: &BorneBody| {
            let Some(rigid) = self.rigid.get(&body.entity) else { return false };
            let at = of.world_from_body.inverse_transform_point(&body.proxy.pose.translation.vector.into());
            let way = period * (body.proxy.of_origin().linear.norm() + period * body.proxy.pull().norm());
            let far = rigid.reach() + of.thickness + NEAR + way;
            let is_joined = of.joints.iter().any(|joint| joint.body == body.entity);
            is_joined || (0..3).all(|k| at[k] > bounds[0][k] - far && at[k] < bounds[1][k] + far)
        };
        let meets = bearers
            .iter()
            .any(|of| bounds(of).is_some_and(|bounds| bodies.iter().any(|body| is_near(of, &bounds, body))));
        if meets { (period / STEP_MAX * (1.0 - 1e-9)).ceil() as u32 } else { 1 }
    }

    /// The rigid bodies that move, at the beginning of a tick of `period` seconds that ends `now`. `given` are the
    /// impulses that the controller's bodies have given so far. `in_batches`: they are followed as their controllers move
    /// them, to the step, which partners need that are far stiffer than the bodies' inertia.
    pub fn borne_bodies<'a>(
        &mut self,
        scene: &'a Snapshot,
        (now, period): (SimTime, f64),
        gravity_in_world: &Vector3<f64>,
        given: impl Iterator<Item = (Entity, &'a [ImpulseTotals])> + Clone,
        in_batches: bool,
    ) -> Vec<BorneBody> {
        let mut entities: Vec<Entity> = scene
            .iter::<RigidBody>()
            .filter(|(_, body)| body.motion == Motion::Dynamic)
            .map(|(entity, _)| entity)
            .filter(|entity| scene.get::<Frozen>(*entity).is_none())
            .collect();
        entities.sort_unstable();
        self.rigid.retain(|entity, surface| {
            entities.binary_search(entity).is_ok() && surface.is_of(scene, *entity)
        });
        let body = |entity: Entity| {
            let body = scene.get::<RigidBody>(entity)?;
            let surface = match self.rigid.entry(entity) {
                Entry::Occupied(known) => known.into_mut(),
                Entry::Vacant(new) => new.insert(RigidSurface::of(scene, entity)?),
            };
            let told = match scene.get::<RigidContacts>(entity) {
                Some(told) => told,
                None => &first_report(body, surface, gravity_in_world, now)?,
            };
            let proxy = RigidProxy::of(scene, entity, (now, period), told, given.clone(), in_batches)?;
            Some(BorneBody { entity, friction: body.friction, proxy })
        };
        entities.into_iter().filter_map(body).collect()
    }

    /// The contacts of a step of `step` seconds.
    pub fn find(&mut self, bearers: &[Bearer<'_>], bodies: &[BorneBody], step: f64) -> Vec<Bearing> {
        self.soft.retain(|entity, _| bearers.iter().any(|bearer| bearer.entity == *entity));
        let mut found = Vec::new();
        // The rigid bodies with their velocities at the end of the step: those in contact keep theirs. The forces of the
        // last step are no better guess, since a guess that overshoots lets contacts alternate from step to step.
        let is_borne = |body: &BorneBody| {
            let mut last = bearers.iter().flat_map(|of| of.last);
            last.any(|last| last.body == Some(body.entity))
        };
        let ahead = bodies.iter().map(|body| {
            let proxy = body.proxy.clone();
            if is_borne(body) { proxy } else { proxy.pulled(step) }
        });
        let ahead: Vec<RigidProxy> = ahead.collect();
        for (bearer, of) in bearers.iter().enumerate() {
            let first = found.len();
            self.soft
                .entry(of.entity)
                .and_modify(|known| known.follow(of))
                .or_insert_with(|| SoftSurface::new(of));
            let Some(soft) = self.soft.get_mut(&of.entity) else { continue };
            soft.is_current = false;
            let Some(bounds) = bounds(of) else { continue };
            for (borne, (body, ahead)) in bodies.iter().zip(&ahead).enumerate() {
                let Some(rigid) = self.rigid.get(&body.entity) else { continue };
                let seen = Seen::of(&body.proxy, ahead, rigid.reach(), step);
                near_points(soft, of, &bounds, rigid, &seen, step, |near| {
                    if of.is_joined(&near.nodes, body.entity) {
                        return;
                    }
                    let world_from_body = &of.world_from_body;
                    let normal_in_world = world_from_body.rotation * near.normal;
                    let at_in_world = world_from_body * near.at;
                    // Seen where it will be, the body still has to come there.
                    let comes =
                        if seen.is_ahead { normal_in_world.dot(&ahead.speed(&at_in_world)) } else { 0.0 };
                    let depth = near.depth - comes * step;
                    let contact = of.touches(body.entity, near.feature, depth, step);
                    found.push(Bearing {
                        bearer,
                        borne,
                        contact,
                        normal_in_world,
                        at_in_world,
                        centre_in_world: seen.centre(),
                        moment: Vector3::zeros(),
                        plane: PlaneContact {
                            nodes: near.nodes,
                            weights: near.weights,
                            normal: near.normal,
                            depth: depth - contact.overlap,
                            stiffness: of.terms.bearing_stiffness,
                            body: borne as u32,
                            arm: world_from_body.inverse_transform_vector(&(at_in_world - seen.centre())),
                            force: contact.force,
                        },
                    });
                });
            }
            join(&mut found, bearer, of, bodies);
            let own = &mut found[first..];
            own.sort_by(|a, b| b.plane.depth.total_cmp(&a.plane.depth));
            found.truncate(first + BORNE_MAX);
        }
        rub(&mut found, bearers, bodies, step);
        self.add_losses(&mut found, bearers, bodies, step);
        found
    }
}

impl Bearer<'_> {
    /// The rigid bodies in its step, in its frame: those that contacts name, which are renumbered. Impulses that other
    /// soft bodies of the controller gave them in their last step of `step` seconds go on.
    pub fn rigid_in_step(
        &self,
        contacts: &mut [PlaneContact],
        bodies: &[BorneBody],
        others: impl Iterator<Item = ImpulseTotals> + Clone,
        step: f64,
    ) -> Vec<RigidInStep> {
        let mut named: Vec<u32> = contacts.iter().map(|contact| contact.body).collect();
        named.sort_unstable();
        named.dedup();
        for contact in contacts {
            contact.body = named.binary_search(&contact.body).unwrap_or_default() as u32;
        }
        let body = |number: u32| {
            let of = &bodies[number as usize];
            let given = others.clone().filter(|given| given.body == Some(of.entity));
            let given = given.fold([Vector3::zeros(); 2], |[impulse, moment], given| {
                [impulse + given.impulse / step, moment + given.moment / step]
            });
            of.proxy.in_step(&self.world_from_body.rotation, given)
        };
        named.into_iter().map(body).collect()
    }
}

/// Where the contacts of a rigid body are sought.
struct Seen<'a> {
    /// With its velocity at the end of the step.
    proxy: &'a RigidProxy,
    pose: Isometry3<f64>,
    /// Whether that is the pose at the end of the step.
    is_ahead: bool,
}

impl<'a> Seen<'a> {
    /// Where it will be at the end of the step: normals and lever arms that lag behind the motion would drive a rolling
    /// or rocking body. If it goes far in the step, where it is: its first contact counts then.
    fn of(now: &RigidProxy, ahead: &'a RigidProxy, reach: f64, step: f64) -> Self {
        let motion = ahead.of_origin();
        let way = step * (motion.linear.norm() + motion.angular.norm() * reach);
        let is_ahead = way < FAR * reach;
        let pose = if is_ahead { ahead.pose_ahead(step) } else { now.pose };
        Self { proxy: ahead, pose, is_ahead }
    }

    fn centre(&self) -> Point3<f64> {
        self.pose * self.proxy.inertia().centre_in_body
    }
}

/// Adds the joints of a soft body.
fn join(found: &mut Vec<Bearing>, bearer: usize, of: &Bearer<'_>, bodies: &[BorneBody]) {
    for (number, joint) in (0..).zip(of.joints) {
        let Some(borne) = bodies.iter().position(|body| body.entity == joint.body) else { continue };
        let proxy = &bodies[borne].proxy;
        let (place, vertex) = (proxy.pose * joint.place, joint.vertex as usize);
        let at = of.world_from_body * of.positions[vertex];
        let slip = proxy.speed(&place) - of.world_from_body.rotation * of.velocities[vertex];
        // Damping is a lead of the spring.
        let apart = place - at + slip * (joint.damping / joint.stiffness);
        for (direction, normal) in (0..).zip(joint::directions()) {
            let feature = BearingFeature::Joint(number, direction);
            let contact = of.known(joint.body, feature);
            found.push(Bearing {
                bearer,
                borne,
                contact,
                normal_in_world: normal,
                at_in_world: at,
                centre_in_world: *proxy.centre(),
                moment: Vector3::zeros(),
                plane: PlaneContact {
                    nodes: [joint.vertex; 3],
                    weights: [1.0, 0.0, 0.0],
                    normal: of.world_from_body.rotation.inverse() * normal,
                    depth: normal.dot(&apart),
                    stiffness: joint.stiffness,
                    body: borne as u32,
                    arm: of.world_from_body.inverse_transform_vector(&(place - proxy.centre())),
                    force: contact.force,
                },
            });
        }
    }
}

/// Sets the friction of a step.
fn rub(bearings: &mut [Bearing], bearers: &[Bearer<'_>], bodies: &[BorneBody], step: f64) {
    // Contacts on one body share its mobility: a bound of the effect of all of them.
    let mut sums = vec![0.0; bodies.len()];
    let roots: Vec<f64> = bearings
        .iter()
        .map(|bearing| {
            let Bearing { borne, normal_in_world, at_in_world, contact, .. } = bearing;
            let [_, across] = bodies[*borne].proxy.yields(at_in_world, normal_in_world);
            let root = across.max(0.0).sqrt();
            if contact.force > 0.0 {
                sums[*borne] += root;
            }
            root
        })
        .collect();
    // So do contacts at one vertex of a soft body.
    let mut meeting: BTreeMap<(usize, u32), f64> = BTreeMap::new();
    for Bearing { bearer, plane, .. } in bearings.iter().filter(|bearing| bearing.contact.force > 0.0) {
        for (node, weight) in plane.joint() {
            *meeting.entry((*bearer, node)).or_default() += weight;
        }
    }
    for (bearing, root) in bearings.iter_mut().zip(roots) {
        let (of, body) = (&bearers[bearing.bearer], &bodies[bearing.borne]);
        let mobility = |node: u32| of.terms.masses_inverse.get(node as usize).copied().unwrap_or(0.0);
        let shares = bearing.plane.joint().into_iter();
        let soft: f64 = shares
            .map(|(node, weight)| {
                let all = meeting.get(&(bearing.bearer, node)).copied().unwrap_or(weight);
                weight * all * mobility(node)
            })
            .sum();
        bearing.rub(of, body, soft + root * sums[bearing.borne], step);
    }
}

impl Bearing {
    /// The friction of a step, and the displacement of its spring. `yields` is a bound of the mobility of both bodies there,
    /// with all contacts that share it \[1/kg\].
    fn rub(&mut self, of: &Bearer<'_>, body: &BorneBody, yields: f64, step: f64) {
        let stiffness = self.plane.stiffness;
        let Self { contact, plane, normal_in_world: normal, at_in_world: at, .. } = self;
        let across = |of: Vector3<f64>| of - *normal * normal.dot(&of);
        if contact.force == 0.0 || matches!(contact.feature, BearingFeature::Joint(..)) {
            (contact.friction, contact.drawn) = (Vector3::zeros(), Vector3::zeros());
            return;
        }
        let own = || plane.nodes.iter().zip(plane.weights).map(|(&node, weight)| (node, weight));
        let speed: Vector3<f64> = own().map(|(node, weight)| of.velocities[node as usize] * weight).sum();
        let slip = across(of.world_from_body.rotation * speed - body.proxy.speed(at));
        let damping = if yields > 0.0 { 2.0 * DAMPING_RATIO * (stiffness / yields).sqrt() } else { 0.0 };
        let drawn = across(contact.drawn) + slip * step;
        let (resists, gives) = (stiffness * step + damping, yields * step);
        let wanted = (drawn * -stiffness - slip * resists) / (1.0 + resists * gives);
        let friction = (of.terms.friction * body.friction).sqrt();
        let (size, most) = (wanted.norm(), friction * contact.force);
        if size > most {
            // While it slides, the spring stays at the friction limit.
            contact.friction = wanted * (most / size);
            contact.drawn = contact.friction / -stiffness;
        } else {
            (contact.friction, contact.drawn) = (wanted, drawn);
        }
    }

    /// Friction on the soft body's vertices, in its frame \[N\].
    pub fn friction_on<'a>(&'a self, of: &Bearer<'_>) -> impl Iterator<Item = (u32, Vector3<f64>)> + 'a {
        let force = of.world_from_body.rotation.inverse() * self.contact.friction;
        let is_any = force != Vector3::zeros();
        let shares = self.plane.nodes.into_iter().zip(self.plane.weights);
        shares
            .filter(move |(_, weight)| is_any && *weight != 0.0)
            .map(move |(node, weight)| (node, force * weight))
    }

    /// The impulse of the friction on the rigid body in a step.
    pub fn friction_given(&self, step: f64) -> Option<ImpulseTotals> {
        if [self.contact.friction, self.moment] == [Vector3::zeros(); 2] {
            return None;
        }
        let mut given = ImpulseTotals { body: Some(self.contact.body), ..ImpulseTotals::default() };
        given.add(&(self.contact.friction * -step), &(self.at_in_world - self.centre_in_world));
        given.moment += self.moment * step;
        Some(given)
    }

    /// After the step, with the normal force on the soft body \[N\]: gives the rigid body its impulse. Returns the force
    /// on the soft body, in world \[N\].
    pub fn end_step(
        &mut self,
        normal: f64,
        bodies: &[BorneBody],
        step: f64,
        given: &mut Vec<ImpulseTotals>,
        last: &mut Vec<ImpulseTotals>,
        totals: &mut [[Vector3<f64>; 2]],
    ) -> Vector3<f64> {
        self.contact.force = normal;
        let force = self.normal_in_world * normal + self.contact.friction;
        if force != Vector3::zeros() {
            let impulse = force * -step;
            let moment = (self.at_in_world - self.centre_in_world).cross(&impulse) + self.moment * step;
            for sums in [given, last] {
                let sums = ImpulseTotals::of(sums, bodies[self.borne].entity);
                sums.impulse += impulse;
                sums.moment += moment;
            }
            totals[self.borne][0] += impulse;
            totals[self.borne][1] += moment;
        }
        force
    }
}

/// In how many equal parts the impulses of a tick of `period` seconds, of `steps` steps, are told to the rigid bodies: they
/// take them as they were given where they move on meanwhile.
#[must_use]
pub fn course_parts(period: f64, steps: usize) -> usize {
    let most = ((period / COURSE_STEP) as usize).max(1);
    (1..=most.min(steps)).rev().find(|parts| steps.is_multiple_of(*parts)).unwrap_or(1)
}

/// Moves the rigid bodies on by a part of a tick, with the impulses of it and their moments about the centres of mass.
pub fn advance(bodies: &mut [BorneBody], step: f64, impulses: &[[Vector3<f64>; 2]]) {
    for (body, given) in bodies.iter_mut().zip(impulses) {
        body.proxy.advance(step, *given);
    }
}

/// What a rigid body's controller will report of it: before its first tick, a body that falls freely.
fn first_report(
    body: &RigidBody,
    surface: &RigidSurface,
    gravity_in_world: &Vector3<f64>,
    now: SimTime,
) -> Option<RigidContacts> {
    let (points, triangles) = surface.mesh();
    let solid = enclosed(points, triangles)?;
    let inertia = Inertia {
        mass_inverse: body.mass.recip(),
        centre_in_body: solid.centre,
        inertia_inverse_in_body: (solid.inertia * body.mass).try_inverse().unwrap_or_else(Matrix3::zeros),
    };
    Some(RigidContacts {
        inertia,
        time: now,
        pull: [*gravity_in_world, Vector3::zeros()],
        ..RigidContacts::default()
    })
}

/// The box of a soft body's vertices, in its frame \[m\].
fn bounds(of: &Bearer<'_>) -> Option<[Point3<f64>; 2]> {
    let first = *of.positions.first()?;
    Some(of.positions.iter().fold([first; 2], |[low, high], at| [low.inf(at), high.sup(at)]))
}

impl SoftSurface {
    fn new(of: &Bearer<'_>) -> Self {
        let mut vertices: Vec<u32> = of.triangles.iter().flatten().copied().collect();
        if vertices.is_empty() {
            vertices.extend(of.segments.iter().flatten());
        }
        vertices.sort_unstable();
        vertices.dedup();
        Self {
            triangles: of.triangles.clone(),
            segments: of.segments.clone(),
            vertices,
            surface: None,
            is_current: false,
        }
    }

    fn follow(&mut self, of: &Bearer<'_>) {
        if !(Arc::ptr_eq(&self.triangles, of.triangles) && Arc::ptr_eq(&self.segments, of.segments)) {
            *self = Self::new(of);
        }
    }
}
