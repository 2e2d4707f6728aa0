//! A rigid body as the soft bodies that bear it see it: its state at the beginning of a step, extrapolated since its
//! controller's last report, and its motion on from there.

use nalgebra::{Isometry3, Matrix3, Point3, Translation3, UnitQuaternion, Vector3};
use trocar_scene::{Entity, Frozen, SimTime, Snapshot, Velocity};

use super::STEP_MAX;
use super::rigid_response::RigidInStep;
use crate::rigid_world::{Inertia, tangential_mobility_max};
use crate::soft_body::contact::rigid::motion;
use crate::soft_body::contact::{ImpulseTotals, RigidContacts, SoftContacts};

/// A rigid body under contact.
#[derive(Clone, Debug)]
pub(crate) struct RigidProxy {
    /// `world_from_body`, extrapolated to the beginning of a step.
    pub(crate) pose: Isometry3<f64>,
    inertia: Inertia,
    centre: Point3<f64>,
    /// Velocity of the centre of mass \[m/s\] and angular velocity \[rad/s\], in world.
    velocity: Vector3<f64>,
    spin: Vector3<f64>,
    /// Acceleration by everything else, linear and angular.
    pull: [Vector3<f64>; 2],
    mass_inverse: f64,
    /// Inverse inertia tensor in world axes \[1/(kg·m²)\].
    inertia_inverse: Matrix3<f64>,
    /// Length of the steps in which its controller moves it, and of its ticks \[s\].
    substep: f64,
    tick: f64,
    /// What its controller takes at once, if the partner follows it so exactly.
    batch: Option<Batch>,
}

/// A span whose impulses a rigid body's controller takes together, spread evenly over its own steps: where the body is at
/// the end does not depend on when they were given.
#[derive(Clone, Copy, Debug)]
struct Batch {
    /// Length of the span, and how much of it has passed \[s\].
    length: f64,
    passed: f64,
    /// Changes of velocity that count from its end on.
    pending: [Vector3<f64>; 2],
}

impl RigidProxy {
    /// A body whose controller reported this of it, at the beginning of a step of `period` seconds that ends `now`. Its
    /// state is extrapolated since the report, with the impulses that it has not taken yet; `own` are those given by
    /// bodies whose rows of the scene are older. `in_batches`: followed as its controller moves it, to the step.
    pub fn of<'a>(
        scene: &'a Snapshot,
        entity: Entity,
        (now, period): (SimTime, f64),
        told: &RigidContacts,
        own: impl Iterator<Item = (Entity, &'a [ImpulseTotals])> + Clone,
        in_batches: bool,
    ) -> Option<Self> {
        if !told.gives_way() || scene.get::<Frozen>(entity).is_some() {
            return None;
        }
        let pose = scene.world_pose(entity);
        let is_own = |giver: Entity| own.clone().any(|(own, _)| own == giver);
        let others = scene.iter::<SoftContacts>().filter(|(giver, _)| !is_own(*giver));
        let others = others.map(|(giver, contacts)| (giver, &contacts.given_whole[..]));
        let all = others.chain(own.clone());
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
        let there = moved(&pose, &(pose * inertia.centre_in_body), &gone, &turned);
        let mut rigid = Self {
            pose: there,
            inertia: *inertia,
            centre: there * inertia.centre_in_body,
            velocity: linear + told.pull[0] * since + faster,
            spin: spin + told.pull[1] * since + more_spin,
            pull: told.pull,
            mass_inverse: inertia.mass_inverse,
            inertia_inverse: inertia.inverse_in_world(&there),
            substep: told.substep,
            tick: told.step,
            batch: None,
        };
        if in_batches {
            rigid.batch = Some(Batch::of(told));
            (rigid.pose, rigid.velocity, rigid.spin) = (pose, linear, spin);
            rigid.centre = pose * inertia.centre_in_body;
            rigid.advance(since, [Vector3::zeros(); 2]);
            rigid.batched(0.0, [faster, more_spin]);
        }
        Some(rigid)
    }

    /// Distance that a body goes until the end of a batch per change of velocity in it \[s\], in steps of `step` seconds.
    pub fn lever(&self, step: f64) -> f64 {
        let span = self.batch.map_or(step, |batch| batch.length.max(step));
        0.5 * (span + self.substep.min(span))
    }

    /// Moves it by `secs` seconds of a batch, with these changes of velocity.
    fn batched(&mut self, secs: f64, faster: [Vector3<f64>; 2]) {
        let Some(mut batch) = self.batch else { return };
        let lever = self.lever(secs);
        let gone = self.velocity * secs + faster[0] * lever;
        let turned = self.spin * secs + faster[1] * lever;
        self.pose = moved(&self.pose, &self.centre, &gone, &turned);
        self.centre = self.pose * self.inertia.centre_in_body;
        self.inertia_inverse = self.inertia.inverse_in_world(&self.pose);
        batch.passed += secs;
        (0..2).for_each(|k| batch.pending[k] += faster[k]);
        // A nanosecond: periods are whole nanoseconds.
        if batch.passed > batch.length - 1e-9 {
            let [faster, more_spin] = std::mem::take(&mut batch.pending);
            self.velocity += faster;
            self.spin += more_spin;
            batch.passed = 0.0;
        }
        self.batch = Some(batch);
    }

    /// With its velocity at the end of a step of `period` seconds, by everything else.
    pub fn pulled(mut self, period: f64) -> Self {
        self.velocity += self.pull[0] * period;
        self.spin += self.pull[1] * period;
        self
    }

    /// Advances by `secs` seconds with everything else that accelerates it, and an impulse and its moment about the
    /// centre of mass, spread over that time.
    pub fn advance(&mut self, secs: f64, given: [Vector3<f64>; 2]) {
        let [faster, more_spin] = self.inertia.change(&self.pose, given);
        let (faster, more_spin) = (faster + self.pull[0] * secs, more_spin + self.pull[1] * secs);
        if self.batch.is_some() {
            return self.batched(secs, [faster, more_spin]);
        }
        // Its controller moves it on by the velocity at the end of each of its own steps.
        let share = 0.5 + 0.5 * (self.substep / secs).min(1.0);
        let gone = (self.velocity + faster * share) * secs;
        let turned = (self.spin + more_spin * share) * secs;
        self.pose = moved(&self.pose, &self.centre, &gone, &turned);
        self.centre = self.pose * self.inertia.centre_in_body;
        self.velocity += faster;
        self.spin += more_spin;
        self.inertia_inverse = self.inertia.inverse_in_world(&self.pose);
    }

    /// As a soft body with this rotation sees it in a step, with another force \[N\] and torque about the centre of mass
    /// \[N·m\] on it, in world.
    pub fn in_step(
        &self,
        world_from_body: &UnitQuaternion<f64>,
        [force, torque]: [Vector3<f64>; 2],
    ) -> RigidInStep {
        let turn = world_from_body.inverse().to_rotation_matrix();
        let inertia = self.inertia_inverse.try_inverse().unwrap_or_else(Matrix3::zeros);
        let pull = [self.pull[0] + force * self.mass_inverse, self.pull[1] + self.inertia_inverse * torque];
        RigidInStep {
            mass: self.mass_inverse.recip(),
            inertia: turn.matrix() * inertia * turn.matrix().transpose(),
            velocity: [turn * self.velocity, turn * self.spin],
            pull: pull.map(|of| turn * of),
            own_step: self.tick,
            is_led: false,
        }
    }

    /// Length of its controller's ticks \[s\].
    pub fn own_step(&self) -> f64 {
        self.tick
    }

    /// Its mass properties.
    pub fn inertia(&self) -> &Inertia {
        &self.inertia
    }

    /// Its pose after `secs` seconds at its present velocity.
    pub fn pose_ahead(&self, secs: f64) -> Isometry3<f64> {
        moved(&self.pose, &self.centre, &(self.velocity * secs), &(self.spin * secs))
    }

    /// Velocity of its origin.
    pub fn of_origin(&self) -> Velocity {
        let linear = self.speed(&self.pose.translation.vector.into());
        Velocity { linear, angular: self.spin }
    }

    /// Its centre of mass, in world \[m\].
    pub fn centre(&self) -> &Point3<f64> {
        &self.centre
    }

    /// Acceleration by everything else, of its centre of mass \[m/s²\].
    pub fn pull(&self) -> &Vector3<f64> {
        &self.pull[0]
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
}

impl Batch {
    fn of(told: &RigidContacts) -> Self {
        let parts = (told.step / STEP_MAX - 1e-9).ceil().max(1.0);
        Self { length: told.step / parts, passed: 0.0, pending: [Vector3::zeros(); 2] }
    }
}

/// A pose shifted by `gone` \[m\], and turned by `turned` \[rad\] about a point, all in world.
fn moved(
    pose: &Isometry3<f64>,
    about: &Point3<f64>,
    gone: &Vector3<f64>,
    turned: &Vector3<f64>,
) -> Isometry3<f64> {
    Translation3::from(about.coords + gone)
        * UnitQuaternion::from_scaled_axis(*turned)
        * Translation3::from(-about.coords)
        * pose
}
