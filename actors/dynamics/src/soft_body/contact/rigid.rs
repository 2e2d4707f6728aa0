//! Contacts of soft bodies with rigid ones. The soft body computes the contact force for both, with the mass and
//! inertia that the rigid body's controller publishes; that controller takes the impulses and does not answer these
//! contacts itself.
//!
//! The exchanged quantities are the cumulative impulse and its cumulative moment about the rigid body's centre of mass.
//! The rigid body takes the difference to what it has taken before: momentum is conserved for any pair of rates, delays
//! and restarts. A moment about the world origin would turn a body that has moved on by the time that it takes the
//! impulse: a rolling ball would be spun up by its own weight. Impulses from a soft body with longer steps are spread over
//! such a step, not applied at once.

use nalgebra::{Isometry3, Matrix3, Vector3};
use serde::{Deserialize, Serialize};
use trocar_scene::kinematics::spatial::Wrench;
use trocar_scene::{Component, ComponentError, Entity, SimTime, Snapshot, Velocity};

use super::SoftContacts;
use crate::rigid_world::Inertia;

/// Cumulative impulse on a body that moves as a whole.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ImpulseTotals {
    /// The other body.
    pub body: Option<Entity>,
    /// Cumulative impulse, in world \[N·s\].
    pub impulse: Vector3<f64>,
    /// Cumulative moment about the body's centre of mass at the time of each impulse \[N·m·s\].
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
    /// Length of the steps in which it moves \[s\].
    pub substep: f64,
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

    /// Adds an impulse at a point with this arm from the centre of mass \[m\].
    pub(crate) fn add(&mut self, impulse: &Vector3<f64>, arm: &Vector3<f64>) {
        self.impulse += impulse;
        self.moment += arm.cross(impulse);
    }

    /// Impulse and moment beyond those of another sum.
    pub(crate) fn less(&self, other: &Self) -> [Vector3<f64>; 2] {
        [self.impulse - other.impulse, self.moment - other.moment]
    }
}

impl SoftContacts {
    /// Impulse \[N·s\] and moment \[N·m·s\] that a body has got in total in the first `time` seconds of the last step; at
    /// its end all that was `given`.
    fn given_after(&self, given: &ImpulseTotals, time: f64) -> (Vector3<f64>, Vector3<f64>) {
        let parts = self.course.len();
        let at = (time / self.step * parts as f64).clamp(0.0, parts as f64);
        let part = (at as usize).min(parts - 1);
        let before = |part: usize| match self.course.get(part) {
            Some(all) => all.iter().find(|of| of.body == given.body).copied().unwrap_or_default(),
            None => *given,
        };
        let (from, to, share) = (before(part), before(part + 1), at - part as f64);
        (from.impulse.lerp(&to.impulse, share), from.moment.lerp(&to.moment, share))
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

    /// Takes outstanding impulses over `time` \[s\]: as a force \[N\], and its torque about the centre of mass \[N·m\].
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
                if share < 1.0 && !contacts.course.is_empty() {
                    (taken.impulse, taken.moment) = contacts.given_after(given, contacts.step - *left);
                } else if share < 1.0 {
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
    pub fn inverse_in_world(&self, pose: &Isometry3<f64>) -> Matrix3<f64> {
        let turn = pose.rotation.to_rotation_matrix();
        turn.matrix() * self.inertia_inverse_in_body * turn.matrix().transpose()
    }

    /// Change of a body's linear and angular velocity by an impulse and its moment about the centre of mass.
    pub(crate) fn change(&self, pose: &Isometry3<f64>, given: [Vector3<f64>; 2]) -> [Vector3<f64>; 2] {
        let [impulse, moment] = given;
        [impulse * self.mass_inverse, self.inverse_in_world(pose) * moment]
    }
}
