//! Contacts of soft bodies with rigid ones. The soft body computes what both exert on each other, the rigid one giving way
//! by the mass and the inertia that its controller tells; that controller takes the impulses and answers none of these contacts
//! itself.
//!
//! What passes is a sum of impulses and one of their moments about the origin of the world, of which the rigid body takes what
//! it has not taken: of momentum and of angular momentum it gets what the other loses, at whatever rates the two are, and
//! whoever is late or begins another life. Of one whose steps are longer it takes them over the time of such a step, not at a blow.

use nalgebra::{Isometry3, Matrix3, Point3, Translation3, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};
use trocar_scene::{Component, ComponentError, Entity, Frozen, SimTime, Snapshot, Velocity};

use super::SoftContacts;
use super::bodies::AppliedImpulses;
use crate::rigid_world::{Inertia, Wrench, most_across};

/// Impulses on a body that moves as a whole.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ImpulseTotals {
    /// Of or to whom.
    pub body: Option<Entity>,
    /// All so far, in world \[N·s\].
    pub impulse: Vector3<f64>,
    /// Their moments about the origin of the world \[N·m·s\].
    pub moment: Vector3<f64>,
}

/// What a rigid body has taken from one soft body.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct AppliedTotals {
    /// What it has taken.
    pub taken: ImpulseTotals,
    /// What it had been given when it looked last.
    pub seen: ImpulseTotals,
    /// Over which time it is to take the rest \[s\].
    pub left: f64,
}

/// What a rigid body tells soft ones that touch it, and what it has taken from them.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RigidContacts {
    /// How it gives way.
    pub inertia: Inertia,
    /// Length of the steps in which it takes impulses \[s\].
    pub step: f64,
    /// When it took some last: its pose and its velocity are those of then.
    pub time: SimTime,
    /// What all else does to its motion, as an acceleration of its centre of mass \[m/s²\] and an angular one \[rad/s²\], in
    /// world: what goes on, not blows. And the same of its last step with all that was in it.
    pub pull: [Vector3<f64>; 2],
    /// See above.
    pub last_pull: [Vector3<f64>; 2],
    /// What it has taken, by giver.
    pub taken: Vec<AppliedTotals>,
}

impl Component for RigidContacts {
    const NAME: &'static str = "rigid_contacts";
    fn check(&self) -> Result<(), ComponentError> {
        trocar_scene::finite::check(self)?;
        let inverse = self.inertia.mass_inverse;
        ComponentError::range("inertia.mass_inverse", inverse, 0.0..=f64::MAX, "0 or more, in 1/kg")?;
        ComponentError::range("step", self.step, 0.0..=f64::MAX, "0 or more, in s")
    }
}

impl ImpulseTotals {
    /// Of one body among several; a new one if there is none.
    pub(crate) fn of(all: &mut Vec<Self>, body: Entity) -> &mut Self {
        let at = all.iter().position(|sums| sums.body == Some(body)).unwrap_or_else(|| {
            all.push(Self { body: Some(body), ..Self::default() });
            all.len() - 1
        });
        &mut all[at]
    }

    /// One more, at a place in world.
    pub(crate) fn add(&mut self, impulse: &Vector3<f64>, at_in_world: &Point3<f64>) {
        self.impulse += impulse;
        self.moment += at_in_world.coords.cross(impulse);
    }

    fn less(&self, other: &Self) -> [Vector3<f64>; 2] {
        [self.impulse - other.impulse, self.moment - other.moment]
    }
}

impl RigidContacts {
    /// Whether soft bodies answer for it.
    pub(crate) fn gives_way(&self) -> bool {
        self.inertia.mass_inverse > 0.0
    }

    /// Learns what all else did to its motion in a step, as an acceleration and an angular one; whether that is news.
    pub(crate) fn learn(&mut self, pull: [Vector3<f64>; 2]) -> bool {
        let before = std::mem::replace(&mut self.last_pull, pull);
        // What goes on is in two steps one after the other.
        let goes_on = |side: usize| {
            let smaller = |a: f64, b: f64| if a * b > 0.0 { a.signum() * a.abs().min(b.abs()) } else { 0.0 };
            pull[side].zip_map(&before[side], smaller)
        };
        let pull = [goes_on(0), goes_on(1)];
        let is_news =
            (0..2).any(|side| (pull[side] - self.pull[side]).norm() > 1e-3 * (1.0 + self.pull[side].norm()));
        if is_news {
            self.pull = pull;
        }
        is_news
    }

    /// Takes what it has been given, over a time \[s\]: as a force \[N\], and its torque about the origin of the world \[N·m\].
    /// `None` where nothing has changed.
    pub(crate) fn take(&mut self, me: Entity, scene: &Snapshot, time: f64) -> Option<Wrench> {
        let (mut wrench, mut has_changed) = (Wrench::default(), false);
        for (giver, contacts) in scene.iter::<SoftContacts>() {
            for given in contacts.given_whole.iter().filter(|given| given.body == Some(me)) {
                let at = self.taken.iter().position(|known| known.taken.body == Some(giver));
                let at = at.unwrap_or_else(|| {
                    let none = ImpulseTotals { body: Some(giver), ..ImpulseTotals::default() };
                    self.taken.push(AppliedTotals { taken: none, seen: none, left: 0.0 });
                    self.taken.len() - 1
                });
                let known = self.taken[at];
                let AppliedTotals { taken, seen, left } = &mut self.taken[at];
                if given.less(seen) != [Vector3::zeros(); 2] {
                    *left = contacts.step;
                    (seen.impulse, seen.moment) = (given.impulse, given.moment);
                }
                let [impulse, moment] = given.less(taken);
                // A nanosecond: periods are whole ones.
                let share = if *left > time + 1e-9 { time / *left } else { 1.0 };
                *left = (*left - time).max(0.0);
                if share < 1.0 {
                    taken.impulse += impulse * share;
                    taken.moment += moment * share;
                } else {
                    (taken.impulse, taken.moment) = (given.impulse, given.moment);
                }
                let [impulse, moment] = taken.less(&known.taken);
                wrench.force += impulse / time;
                wrench.torque += moment / time;
                has_changed |= self.taken[at] != known;
            }
        }
        has_changed.then_some(wrench)
    }
}

/// How a rigid body moves: its centre of mass \[m/s\], and its angular velocity \[rad/s\], in world.
pub(crate) fn motion(inertia: &Inertia, pose: &Isometry3<f64>, of_origin: &Velocity) -> [Vector3<f64>; 2] {
    let lever = pose.rotation * inertia.centre_in_body.coords;
    [of_origin.linear + of_origin.angular.cross(&lever), of_origin.angular]
}

impl Inertia {
    /// The inverse of its inertia, in world axes \[1/(kg·m²)\].
    pub(crate) fn inverse_in_world(&self, pose: &Isometry3<f64>) -> Matrix3<f64> {
        let turn = pose.rotation.to_rotation_matrix();
        turn.matrix() * self.inertia_inverse_in_body * turn.matrix().transpose()
    }

    /// What an impulse and its moment about the origin of the world do to the motion of a body.
    pub(crate) fn change(&self, pose: &Isometry3<f64>, given: [Vector3<f64>; 2]) -> [Vector3<f64>; 2] {
        let [impulse, moment] = given;
        let centre = (pose * self.centre_in_body).coords;
        [impulse * self.mass_inverse, self.inverse_in_world(pose) * (moment - centre.cross(&impulse))]
    }
}

/// A rigid body that contacts push.
pub(crate) struct RigidProxy {
    /// `world_from_body`, where it is by now.
    pub(crate) pose: Isometry3<f64>,
    centre: Point3<f64>,
    velocity: Vector3<f64>,
    spin: Vector3<f64>,
    mass_inverse: f64,
    /// In world axes \[1/(kg·m²)\].
    inertia_inverse: Matrix3<f64>,
}

impl RigidProxy {
    /// One whose controller takes impulses, for a step of `period` seconds that ends `now`. Since it was heard of last it has gone on as it moved, and what it has been given and has not taken yet moves it
    /// already.
    pub fn of(
        scene: &Snapshot,
        entity: Entity,
        (now, period): (SimTime, f64),
        own: &[AppliedImpulses],
    ) -> Option<Self> {
        let told = scene.get::<RigidContacts>(entity)?;
        if !told.gives_way() || scene.get::<Frozen>(entity).is_some() {
            return None;
        }
        let pose = scene.world_pose(entity);
        let is_own = |giver: Entity| own.iter().any(|given| given.giver == giver);
        let others = scene.iter::<SoftContacts>().filter(|(giver, _)| !is_own(*giver));
        let others = others.map(|(giver, contacts)| (giver, &contacts.given_whole));
        let all = others.chain(own.iter().map(|given| (given.giver, &given.wholes)));
        let mut late = [Vector3::zeros(); 2];
        for (giver, given) in all {
            for given in given.iter().filter(|given| given.body == Some(entity)) {
                let known = told.taken.iter().find(|known| known.taken.body == Some(giver));
                let [impulse, moment] = given.less(&known.map(|known| known.taken).unwrap_or_default());
                late = [late[0] + impulse, late[1] + moment];
            }
        }
        let inertia = &told.inertia;
        let since = (now.0.saturating_sub(told.time.0) as f64 * 1e-9 - period).clamp(0.0, told.step);
        let velocity = scene.get::<Velocity>(entity).copied().unwrap_or_default();
        let [linear, spin] = motion(inertia, &pose, &velocity);
        let [faster, more_spin] = inertia.change(&pose, late);
        // Half of it, as it came little by little.
        let gone = (linear + (told.pull[0] * since + faster) * 0.5) * since;
        let turned = (spin + (told.pull[1] * since + more_spin) * 0.5) * since;
        let centre = pose * inertia.centre_in_body;
        let turn = Translation3::from(centre.coords + gone)
            * UnitQuaternion::from_scaled_axis(turned)
            * Translation3::from(-centre.coords);
        let there = turn * pose;
        let whole = Self {
            pose: there,
            centre: there * inertia.centre_in_body,
            velocity: linear + told.pull[0] * (since + period) + faster,
            spin: spin + told.pull[1] * (since + period) + more_spin,
            mass_inverse: inertia.mass_inverse,
            inertia_inverse: inertia.inverse_in_world(&there),
        };
        Some(whole)
    }

    /// How its origin moves.
    pub fn of_origin(&self) -> Velocity {
        let linear = self.speed(&self.pose.translation.vector.into());
        Velocity { linear, angular: self.spin }
    }

    /// How much faster a place is for each impulse on it, along a direction, and at most across it \[1/kg\].
    pub fn yields(&self, at: &Point3<f64>, normal: &Vector3<f64>) -> [f64; 2] {
        let lever = (at - self.centre).cross_matrix();
        let feels = Matrix3::identity() * self.mass_inverse - lever * self.inertia_inverse * lever;
        [normal.dot(&(feels * normal)), most_across(&feels, normal)]
    }

    /// How a place moves \[m/s\].
    pub fn speed(&self, at: &Point3<f64>) -> Vector3<f64> {
        self.velocity + self.spin.cross(&(at - self.centre))
    }

    /// Gives a place an impulse \[N·s\].
    pub fn push(&mut self, at: &Point3<f64>, impulse: &Vector3<f64>) {
        self.velocity += impulse * self.mass_inverse;
        self.spin += self.inertia_inverse * (at - self.centre).cross(impulse);
    }
}
