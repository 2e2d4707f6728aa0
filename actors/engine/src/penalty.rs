//! Penalty contacts from external detectors: one-sided springs with Coulomb friction between the bodies.
//!
//! A detector reports where two bodies touched in the snapshot that it read. The bodies have moved since, and move on
//! until its next list. So both contact points are fixed to their bodies, at the poses of *that* snapshot, and each
//! step evaluates the current depth between them: a contact from a detector at 100 Hz is updated at the engine's rate.

use std::collections::VecDeque;

use nalgebra::ComplexField;
use rapier3d_f64::dynamics::{RigidBody, RigidBodyHandle, RigidBodySet};
use rapier3d_f64::math::{AngularInertia, Pose as RapierPose, Vector};
use trocar_scene::components::Collision;
use trocar_scene::entity::Entity;
use trocar_scene::time::SimTime;

use crate::conversion::vector_to_rapier;

/// Maximum number of contacts answered at a time; the deepest are kept.
pub const PENALTIES_MAX: usize = 512;
/// Steps for which past poses are kept. Contacts found before that are dropped.
const TRAIL_STEPS: usize = 256;
/// Fraction of critical damping of a contact: it hardly bounces.
const DAMPING_RATIO: f64 = 0.6;
/// Friction sweeps over all contacts per step.
const FRICTION_SWEEPS: usize = 8;
/// Maximum of stiffness × mobility × step²: a stiffer explicit spring becomes unstable.
const STIFFNESS_SHARE_MAX: f64 = 0.25;

/// Past poses of a body.
#[derive(Clone, Debug, Default)]
pub(crate) struct PoseHistory(VecDeque<(SimTime, RapierPose)>);

impl PoseHistory {
    pub(crate) fn push(&mut self, now: SimTime, pose: RapierPose) {
        if self.0.len() == TRAIL_STEPS {
            self.0.pop_front();
        }
        self.0.push_back((now, pose));
    }

    /// Its pose in the snapshot of that time. `None`: too long ago.
    fn at(&self, time: SimTime) -> Option<RapierPose> {
        let after = self.0.partition_point(|(then, _)| *then <= time);
        after.checked_sub(1).map(|index| self.0[index].1)
    }
}

/// The world's knowledge of an entity that takes part in a contact.
pub(crate) enum KnownEntity<'a> {
    /// A body that may move, and its past poses.
    Body(RigidBodyHandle, Option<&'a PoseHistory>),
    /// Any other entity: it does not move.
    Fixed,
}

/// Contact parameters that the detector does not report.
pub(crate) struct PenaltyParams {
    /// Used where the detector reports no force \[N/m\].
    pub(crate) stiffness: f64,
    /// Coulomb friction coefficient.
    pub(crate) friction: f64,
    /// Number of contacts between the two bodies: they share the stiffness.
    pub(crate) sharing: f64,
}

/// One of the two bodies of a contact.
#[derive(Clone, Copy, Debug)]
struct Side {
    /// Index of the moving body; `None`: it is fixed.
    mover: Option<usize>,
    /// The contact point, in the body's frame, or in world without a body \[m\].
    point: Vector,
}

/// A contact between two bodies, as a spring.
#[derive(Clone, Copy, Debug)]
struct Penalty {
    sides: [Side; 2],
    /// From the first to the second body, in the frame of the second, else of the first, else in world.
    normal: Vector,
    stiffness: f64,
    friction: f64,
    sharing: f64,
}

/// A contact with a normal force in this step.
#[derive(Clone, Copy, Debug)]
struct ActiveContact {
    penalty: usize,
    point: Vector,
    normal: Vector,
    /// Maximum friction impulse \[N s\].
    limit: f64,
    /// Accumulated friction impulse on the second body.
    rubbed: Vector,
}

/// A body under contact: the contact impulses enter the step as forces, together with gravity.
#[derive(Clone, Copy, Debug)]
struct ContactBody {
    pose: RapierPose,
    centre: Vector,
    linear: Vector,
    angular: Vector,
    inverse_mass: Vector,
    inverse_inertia: AngularInertia,
    /// Velocity that gravity adds in this step.
    falls: Vector,
    impulse: Vector,
    torque: Vector,
}

impl ContactBody {
    fn new(body: &RigidBody, falls: Vector) -> Self {
        let properties = body.mass_properties();
        let moves = body.is_dynamic();
        Self {
            pose: *body.position(),
            centre: properties.world_com,
            linear: body.linvel(),
            angular: body.angvel(),
            inverse_mass: if moves { properties.effective_inv_mass } else { Vector::ZERO },
            inverse_inertia: if moves {
                properties.effective_world_inv_inertia
            } else {
                AngularInertia::zero()
            },
            falls: if moves { falls * body.gravity_scale() } else { Vector::ZERO },
            impulse: Vector::ZERO,
            torque: Vector::ZERO,
        }
    }

    fn speed(&self, point: Vector) -> Vector {
        self.linear + self.angular.cross(point - self.centre)
    }

    /// Its mobility: change of speed along `axis` per impulse at `point` \[1/kg\].
    fn mobility(&self, point: Vector, axis: Vector) -> f64 {
        let lever = (point - self.centre).cross(axis);
        self.inverse_mass.dot(axis * axis) + lever.dot(self.inverse_inertia * lever)
    }

    fn push(&mut self, impulse: Vector, point: Vector) {
        let torque = (point - self.centre).cross(impulse);
        self.impulse += impulse;
        self.torque += torque;
        self.linear += self.inverse_mass * impulse;
        self.angular += self.inverse_inertia * torque;
    }
}

/// All contacts from external detectors.
#[derive(Clone, Debug, Default)]
pub(crate) struct Penalties {
    contacts: Vec<Penalty>,
    handles: Vec<RigidBodyHandle>,
    // Those of the current step.
    movers: Vec<ContactBody>,
    pressed: Vec<ActiveContact>,
}

impl Penalties {
    pub(crate) fn clear(&mut self) {
        self.contacts.clear();
        self.handles.clear();
    }

    /// Fixes one more contact to its bodies, unless it is too old or has no depth.
    pub(crate) fn add<'a>(
        &mut self,
        collision: &Collision,
        bodies: &RigidBodySet,
        known: impl Fn(Entity) -> KnownEntity<'a>,
        terms: &PenaltyParams,
    ) {
        let then = |entity: Entity| match known(entity) {
            KnownEntity::Fixed => Some((None, RapierPose::IDENTITY)),
            KnownEntity::Body(handle, Some(trail)) => Some((Some(handle), trail.at(collision.detected_at)?)),
            KnownEntity::Body(handle, None) => Some((Some(handle), *bodies.get(handle)?.position())),
        };
        let (Some(first), Some(second)) = (then(collision.a), then(collision.b)) else { return };
        let frame = if second.0.is_some() { second.1 } else { first.1 };
        let normal = frame.rotation.inverse() * vector_to_rapier(&collision.normal_in_world);
        let length = normal.length();
        if length < 0.5 {
            return;
        }
        let points = collision.points_in_world.map(|point| vector_to_rapier(&point.coords));
        let sides = [self.side(first, points[0]), self.side(second, points[1])];
        // The detector's ratio of force to depth is the stiffness that it assumes.
        let own = collision.force_in_world.norm() / collision.depth;
        let given = collision.depth > 0.0 && own > 0.0;
        self.contacts.push(Penalty {
            sides,
            normal: normal / length,
            stiffness: if given { own } else { terms.stiffness / terms.sharing },
            friction: terms.friction,
            sharing: terms.sharing,
        });
    }

    fn side(&mut self, (body, pose): (Option<RigidBodyHandle>, RapierPose), point: Vector) -> Side {
        let mover = body.map(|handle| {
            self.handles.iter().position(|known| *known == handle).unwrap_or_else(|| {
                self.handles.push(handle);
                self.handles.len() - 1
            })
        });
        Side { mover, point: pose.inverse().transform_point(point) }
    }

    /// Drops the contacts of a body that was removed.
    pub(crate) fn forget(&mut self, body: RigidBodyHandle) {
        let Some(gone) = self.handles.iter().position(|known| *known == body) else { return };
        self.contacts.retain(|contact| contact.sides.iter().all(|side| side.mover != Some(gone)));
        // The indices of the other bodies stay valid.
        self.handles[gone] = RigidBodyHandle::invalid();
    }

    /// Separates bodies for one step, under this gravity \[m/s²\]: springs first, then friction within Coulomb's limit,
    /// in several sweeps over the contacts, because each one changes the sliding of the others (projected Gauss-Seidel;
    /// Catto, "Iterative dynamics with temporal coherence", 2005).
    pub(crate) fn press(&mut self, bodies: &mut RigidBodySet, gravity: Vector, step_secs: f64) {
        if self.contacts.is_empty() {
            return;
        }
        let fixed = RigidBody::default();
        let mover = |handle: &RigidBodyHandle| {
            ContactBody::new(bodies.get(*handle).unwrap_or(&fixed), gravity * step_secs)
        };
        self.movers.clear();
        self.movers.extend(self.handles.iter().map(mover));
        self.pressed.clear();
        for (index, contact) in self.contacts.iter().enumerate() {
            self.pressed.extend(contact.press(index, &mut self.movers, step_secs));
        }
        for _ in 0..FRICTION_SWEEPS {
            for pressed in &mut self.pressed {
                self.contacts[pressed.penalty].apply_friction(&mut self.movers, pressed);
            }
        }
        for (handle, mover) in self.handles.iter().zip(&self.movers) {
            if let Some(body) = bodies.get_mut(*handle).filter(|body| body.is_dynamic()) {
                body.add_force(mover.impulse / step_secs, true);
                body.add_torque(mover.torque / step_secs, true);
            }
        }
    }
}

impl Penalty {
    /// The spring's normal force and its point of application.
    fn press(&self, penalty: usize, movers: &mut [ContactBody], step_secs: f64) -> Option<ActiveContact> {
        let [first, second] = self.sides;
        let body = |side: Side| side.mover.map(|index| movers[index]);
        let place = |side: Side| body(side).map_or(side.point, |body| body.pose.transform_point(side.point));
        let frame = body(second).or(body(first));
        let normal = frame.map_or(self.normal, |body| body.pose.rotation * self.normal);
        let depth = (place(first) - place(second)).dot(normal);
        if depth <= 0.0 {
            return None;
        }
        let point = (place(first) + place(second)) * 0.5;
        let both = [body(first), body(second)];
        let along: f64 = both.iter().flatten().map(|body| body.mobility(point, normal)).sum();
        if along <= 0.0 {
            return None;
        }
        let stable = STIFFNESS_SHARE_MAX / (along * step_secs * step_secs * self.sharing);
        let stiffness = self.stiffness.min(stable);
        let damping = 2.0 * DAMPING_RATIO * ComplexField::sqrt(stiffness / (along * self.sharing));
        let speed = |side| body(side).map_or(Vector::ZERO, |body| body.speed(point));
        let apart = (speed(second) - speed(first)).dot(normal);
        let impulse = (stiffness * depth - damping * apart).max(0.0) * step_secs;
        self.push(movers, normal * impulse, point);
        Some(ActiveContact { penalty, point, normal, limit: self.friction * impulse, rubbed: Vector::ZERO })
    }

    /// Adds the remaining friction impulse. Gravity's contribution in this step counts towards the sliding velocity.
    fn apply_friction(&self, movers: &mut [ContactBody], pressed: &mut ActiveContact) {
        let [first, second] = self.sides.map(|side| side.mover.map(|index| movers[index]));
        let speed = |body: Option<ContactBody>| {
            body.map_or(Vector::ZERO, |body| body.speed(pressed.point) + body.falls)
        };
        let apart = speed(second) - speed(first);
        let sliding = apart - pressed.normal * apart.dot(pressed.normal);
        let fast = sliding.length();
        if fast <= 0.0 {
            return;
        }
        let axis = sliding / fast;
        let bodies = [first, second].into_iter().flatten();
        let mobility: f64 = bodies.map(|body| body.mobility(pressed.point, axis)).sum();
        let stops = pressed.rubbed - axis * (fast / mobility.max(f64::MIN_POSITIVE));
        let rubs = stops.clamp_length_max(pressed.limit);
        self.push(movers, rubs - pressed.rubbed, pressed.point);
        pressed.rubbed = rubs;
    }

    fn push(&self, movers: &mut [ContactBody], impulse_on_second: Vector, point: Vector) {
        for (side, impulse) in self.sides.iter().zip([-impulse_on_second, impulse_on_second]) {
            if let Some(index) = side.mover {
                movers[index].push(impulse, point);
            }
        }
    }
}
