//! Contacts of soft bodies with rigid ones. The soft body computes the contact force for both, with the mass and
//! inertia that the rigid body's controller publishes; that controller takes the impulses and does not answer these
//! contacts itself.
//!
//! The exchanged quantities are the cumulative impulse and its cumulative moment about the world origin. The rigid body
//! takes the difference to what it has taken before: momentum and angular momentum are conserved for any pair of rates,
//! delays and restarts. Impulses from a soft body with longer steps are spread over such a step, not applied at once.

use nalgebra::{Isometry3, Matrix3, Point3, Translation3, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};
use trocar_scene::kinematics::spatial::Wrench;
use trocar_scene::{Component, ComponentError, Entity, Frozen, SimTime, Snapshot, Velocity};

use super::SoftContacts;
use super::bodies::AppliedImpulses;
use crate::rigid_world::{Inertia, tangential_mobility_max};

/// Cumulative impulse on a body that moves as a whole.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ImpulseTotals {
    /// The other body.
    pub body: Option<Entity>,
    /// Cumulative impulse, in world \[N·s\].
    pub impulse: Vector3<f64>,
    /// Cumulative moment about the world origin \[N·m·s\].
    pub moment: Vector3<f64>,
}

/// Impulses that a rigid body has taken from one soft body.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct AppliedTotals {
    /// Impulses taken.
    pub taken: ImpulseTotals,
    /// Impulses given, as of the last reading.
    pub seen: ImpulseTotals,
    /// Time over which it takes the rest \[s\].
    pub left: f64,
}

/// State that a rigid body publishes for soft ones in contact, and the impulses that it has taken from them.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, Component)]
#[component(name = "rigid_contacts", check = Self::ranges)]
#[serde(default, deny_unknown_fields)]
pub struct RigidContacts {
    /// Its mass properties.
    pub inertia: Inertia,
    /// Length of the steps in which it takes impulses \[s\].
    pub step: f64,
    /// Time of its last step; its pose and velocity refer to it.
    pub time: SimTime,
    /// Its acceleration by everything else, of the centre of mass \[m/s²\] and angular \[rad/s²\], in world: persistent
    /// forces, without impacts.
    pub pull: [Vector3<f64>; 2],
    /// The total of the last step, impacts included.
    pub last_pull: [Vector3<f64>; 2],
    /// Impulses taken, by giver.
    pub taken: Vec<AppliedTotals>,
}

impl ImpulseTotals {
    /// The entry of a body; a new one if there is none.
    pub(crate) fn of(all: &mut Vec<Self>, body: Entity) -> &mut Self {
        let at = all.iter().position(|sums| sums.body == Some(body)).unwrap_or_else(|| {
            all.push(Self { body: Some(body), ..Self::default() });
            all.len() - 1
        });
        &mut all[at]
    }

    /// Adds an impulse at a point in world.
    pub(crate) fn add(&mut self, impulse: &Vector3<f64>, at_in_world: &Point3<f64>) {
        self.impulse += impulse;
        self.moment += at_in_world.coords.cross(impulse);
    }

    fn less(&self, other: &Self) -> [Vector3<f64>; 2] {
        [self.impulse - other.impulse, self.moment - other.moment]
    }
}

impl RigidContacts {
    /// Whether soft bodies answer its contacts.
    pub(crate) fn gives_way(&self) -> bool {
        self.inertia.mass_inverse > 0.0
    }

    /// Updates the acceleration by everything else from a step, linear and angular; returns whether it changed.
    pub(crate) fn update_acceleration(&mut self, pull: [Vector3<f64>; 2]) -> bool {
        let before = std::mem::replace(&mut self.last_pull, pull);
        // A persistent acceleration occurs in two consecutive steps.
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

    /// Takes outstanding impulses over `time` \[s\]: as a force \[N\], and its torque about the world origin \[N·m\].
    /// `None` if nothing has changed.
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
                // A nanosecond: periods are whole nanoseconds.
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

    fn ranges(&self) -> Result<(), ComponentError> {
        let inverse = self.inertia.mass_inverse;
        ComponentError::range("inertia.mass_inverse", inverse, 0.0..=f64::MAX, "0 or more, in 1/kg")?;
        ComponentError::range("step", self.step, 0.0..=f64::MAX, "0 or more, in s")
    }
}

/// Velocity of a rigid body's centre of mass \[m/s\], and its angular velocity \[rad/s\], in world.
pub(crate) fn motion(inertia: &Inertia, pose: &Isometry3<f64>, of_origin: &Velocity) -> [Vector3<f64>; 2] {
    let lever = pose.rotation * inertia.centre_in_body.coords;
    [of_origin.linear + of_origin.angular.cross(&lever), of_origin.angular]
}

impl Inertia {
    /// Inverse inertia tensor, in world axes \[1/(kg·m²)\].
    pub(crate) fn inverse_in_world(&self, pose: &Isometry3<f64>) -> Matrix3<f64> {
        let turn = pose.rotation.to_rotation_matrix();
        turn.matrix() * self.inertia_inverse_in_body * turn.matrix().transpose()
    }

    /// Change of a body's linear and angular velocity by an impulse and its moment about the world origin.
    pub(crate) fn change(&self, pose: &Isometry3<f64>, given: [Vector3<f64>; 2]) -> [Vector3<f64>; 2] {
        let [impulse, moment] = given;
        let centre = (pose * self.centre_in_body).coords;
        [impulse * self.mass_inverse, self.inverse_in_world(pose) * (moment - centre.cross(&impulse))]
    }
}

/// A rigid body under contact.
pub(crate) struct RigidProxy {
    /// `world_from_body`, extrapolated to now.
    pub(crate) pose: Isometry3<f64>,
    centre: Point3<f64>,
    velocity: Vector3<f64>,
    spin: Vector3<f64>,
    mass_inverse: f64,
    /// Inverse inertia tensor in world axes \[1/(kg·m²)\].
    inertia_inverse: Matrix3<f64>,
}

impl RigidProxy {
    /// A body whose controller takes impulses, for a step of `period` seconds that ends `now`. Its state is
    /// extrapolated since its last report, with the impulses that it has not taken yet.
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
        let all = others.chain(own.iter().map(|given| (given.giver, &given.rigid_totals)));
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
        // Half of the change, because it accumulated gradually.
        let gone = (linear + (told.pull[0] * since + faster) * 0.5) * since;
        let turned = (spin + (told.pull[1] * since + more_spin) * 0.5) * since;
        let centre = pose * inertia.centre_in_body;
        let turn = Translation3::from(centre.coords + gone)
            * UnitQuaternion::from_scaled_axis(turned)
            * Translation3::from(-centre.coords);
        let there = turn * pose;
        let rigid = Self {
            pose: there,
            centre: there * inertia.centre_in_body,
            velocity: linear + told.pull[0] * (since + period) + faster,
            spin: spin + told.pull[1] * (since + period) + more_spin,
            mass_inverse: inertia.mass_inverse,
            inertia_inverse: inertia.inverse_in_world(&there),
        };
        Some(rigid)
    }

    /// Velocity of its origin.
    pub fn of_origin(&self) -> Velocity {
        let linear = self.speed(&self.pose.translation.vector.into());
        Velocity { linear, angular: self.spin }
    }

    /// Mobility of a point along a direction, and at most across it \[1/kg\].
    pub fn yields(&self, at: &Point3<f64>, normal: &Vector3<f64>) -> [f64; 2] {
        let lever = (at - self.centre).cross_matrix();
        let feels = Matrix3::identity() * self.mass_inverse - lever * self.inertia_inverse * lever;
        [normal.dot(&(feels * normal)), tangential_mobility_max(&feels, normal)]
    }

    /// Velocity of a point \[m/s\].
    pub fn speed(&self, at: &Point3<f64>) -> Vector3<f64> {
        self.velocity + self.spin.cross(&(at - self.centre))
    }

    /// Applies an impulse at a point \[N·s\].
    pub fn push(&mut self, at: &Point3<f64>, impulse: &Vector3<f64>) {
        self.velocity += impulse * self.mass_inverse;
        self.spin += self.inertia_inverse * (at - self.centre).cross(impulse);
    }
}
