//! Bodies of the impulse world: solids made of parts, with their present and past poses.

use std::collections::VecDeque;

use nalgebra::{Isometry3, Point3, UnitQuaternion, Vector3};
use trocar_scene::kinematics::spatial::Wrench;
use trocar_scene::{Motion, Primitive, RigidBody, SimTime, Velocity};

use super::aabb::Bounds;
use super::convex_parts::Part;
use crate::rigid::{RigidMass, RigidState};

/// Number of steps for which past poses are stored. Older detections are dropped.
const TRAIL_STEPS: usize = 256;

/// Parts that move as one, or nearly so.
#[derive(Clone, Debug, Default)]
pub(super) struct Solid {
    pub parts: Vec<Part>,
    /// Name of each part in contacts.
    pub names: Vec<Primitive>,
    /// `world_from_part`.
    pub placed: Vec<Isometry3<f64>>,
    /// Bounding box of each part, and of all.
    pub bounds: Vec<Bounds>,
    pub all: Bounds,
}

impl Solid {
    pub fn new(parts: Vec<Part>, names: Vec<Primitive>) -> Self {
        let placed = vec![Isometry3::identity(); parts.len()];
        let bounds = vec![Bounds::default(); parts.len()];
        Self { parts, names, placed, bounds, all: Bounds::default() }
    }

    /// Places all parts for a pose of the body.
    pub fn place(&mut self, world_from_body: &Isometry3<f64>) {
        for (part, placed) in self.parts.iter().zip(&mut self.placed) {
            *placed = world_from_body * part.pose;
        }
        self.measure();
    }

    pub fn measure(&mut self) {
        self.all = Bounds::default();
        for (bounds, (part, placed)) in self.bounds.iter_mut().zip(self.parts.iter().zip(&self.placed)) {
            *bounds = Bounds::of(part, placed);
            self.all = self.all.with(bounds);
        }
    }
}

/// Past poses of a body.
#[derive(Clone, Debug, Default)]
pub(super) struct PoseHistory(VecDeque<(SimTime, Isometry3<f64>)>);

impl PoseHistory {
    pub fn push(&mut self, now: SimTime, pose: Isometry3<f64>) {
        if self.0.len() == TRAIL_STEPS {
            self.0.pop_front();
        }
        self.0.push_back((now, pose));
    }

    /// Its pose at a past time, as in the scene then. `None`: too long ago.
    pub fn at(&self, time: SimTime) -> Option<Isometry3<f64>> {
        let after = self.0.partition_point(|(then, _)| *then <= time);
        after.checked_sub(1).map(|index| self.0[index].1)
    }
}

/// Prescribed motion of a kinematic body.
#[derive(Clone, Copy, Debug)]
pub(super) struct KinematicMove {
    pub to: Isometry3<f64>,
    /// Remaining steps.
    pub steps: u32,
}

/// A body that is not an instrument.
#[derive(Clone, Debug)]
pub(super) struct Body {
    pub component: RigidBody,
    pub solid: Solid,
    /// Its index in the solver; `None` for a body that is not movable.
    pub slot: Option<usize>,
    /// `body_from_principal`.
    pub principal: Isometry3<f64>,
    /// `world_from_body`.
    pub pose: Isometry3<f64>,
    /// Velocity of its origin.
    pub velocity: Velocity,
    pub travel: Option<KinematicMove>,
    /// Its past poses, if external detectors report its contacts.
    pub trail: Option<PoseHistory>,
    /// How long it has been at rest \[s\].
    pub still_secs: f64,
    pub sleeps: bool,
    /// External wrench, with the torque about the origin of the world.
    pub push: Wrench,
}

impl Body {
    pub fn is_dynamic(&self) -> bool {
        self.component.motion == Motion::Dynamic
    }

    /// Velocity of the body at a point, in world \[m/s\].
    pub fn velocity_at(&self, point: &Point3<f64>) -> Vector3<f64> {
        let lever = point - Point3::from(self.pose.translation.vector);
        self.velocity.linear + self.velocity.angular.cross(&lever)
    }

    /// Its pose at the end of the next step, if it is led along a way.
    pub fn pose_after_step(&self) -> Isometry3<f64> {
        let Some(travel) = self.travel.filter(|travel| travel.steps > 1) else {
            return self.travel.map_or(self.pose, |travel| travel.to);
        };
        let share = 1.0 / f64::from(travel.steps);
        let way = travel.to.translation.vector - self.pose.translation.vector;
        let turn = (travel.to.rotation * self.pose.rotation.inverse()).scaled_axis();
        Isometry3::from_parts(
            (self.pose.translation.vector + way * share).into(),
            UnitQuaternion::from_scaled_axis(turn * share) * self.pose.rotation,
        )
    }

    /// Takes over the solver's state.
    pub fn follow(&mut self, mass: &RigidMass, state: &RigidState) {
        (self.pose, self.velocity) = origin(mass, state, &self.principal);
        self.solid.place(&self.pose);
    }
}

/// Solver state from pose and velocity of the body's origin.
pub(super) fn state_of(
    mass: &RigidMass,
    principal: &Isometry3<f64>,
    pose: &Isometry3<f64>,
    velocity: &Velocity,
) -> RigidState {
    let world_from_principal = pose * principal;
    let lever = world_from_principal.translation.vector - pose.translation.vector;
    let mut state = RigidState {
        position: world_from_principal.translation.vector.into(),
        rotation: world_from_principal.rotation,
        momentum: (velocity.linear + velocity.angular.cross(&lever)) * mass.mass,
        angular_momentum: Vector3::zeros(),
    };
    let spin = state.rotation.inverse() * velocity.angular;
    state.angular_momentum = state.rotation * spin.component_mul(&mass.inertia);
    state
}

/// Pose and velocity of the body's origin from the solver state.
pub(super) fn origin(
    mass: &RigidMass,
    state: &RigidState,
    principal: &Isometry3<f64>,
) -> (Isometry3<f64>, Velocity) {
    let world_from_principal = Isometry3::from_parts(state.position.coords.into(), state.rotation);
    let pose = world_from_principal * principal.inverse();
    let angular = mass.angular_velocity(state);
    let lever = pose.translation.vector - state.position.coords;
    (pose, Velocity { linear: mass.velocity(state) + angular.cross(&lever), angular })
}
