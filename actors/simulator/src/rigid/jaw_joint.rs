//! Jaw joint: an additional degree of freedom of a body, driven with limited torque.
//!
//! Both blades rotate symmetrically, each by half of the opening, about a hinge through the body's centre of mass:
//! their drive then does not move the body, and the inertia of body and opening is diagonal. The drive is an implicit
//! spring and damper, stable for any stiffness.

use nalgebra::Vector3;

/// A jaw joint and its drive.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Joint {
    /// Inertia felt by the drive \[kg·m²\].
    pub inertia: f64,
    /// Opening \[rad\].
    pub angle: f64,
    /// Its rate \[rad/s\].
    pub rate: f64,
    /// Range of the opening \[rad\].
    pub range: [f64; 2],
    /// Target opening at the end of the step \[rad\], and its rate \[rad/s\].
    pub wanted: [f64; 2],
    /// Stiffness \[N·m/rad\] and damping \[N·m·s/rad\] of the drive.
    pub servo: [f64; 2],
    /// Torque limit of the drive \[N·m\].
    pub torque_max: f64,
    /// Impulse of the drive in the last step \[N·m·s\]; warm-starts the next one.
    pub drive_impulse: f64,
}

/// Velocity of a contact point per rate of an opening.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Arm {
    /// The joint.
    pub joint: u32,
    /// Velocity of the point for an opening of 1 rad/s, in world \[m\].
    pub arm: Vector3<f64>,
}

/// A joint during the solve.
#[derive(Clone, Copy, Debug)]
pub(super) struct Turning {
    pub rate: f64,
    /// Change of the rate per impulse of a contact \[1/(kg·m²)\]; of the jaws alone, and together with their drive.
    pub inverse: f64,
    pub inverse_alone: f64,
    /// Rate by which penetration is corrected; it is discarded after the step.
    pub undo: f64,
    /// Whether the drive is part of the inertia, because its limit is out of reach.
    is_within_limit: bool,
    drive: f64,
    stops: [f64; 2],
}

impl Turning {
    /// A joint at the beginning of a step of `dt`.
    ///
    /// The drive is many times as stiff as the jaws are heavy. Solved in turn with the contacts, it would push closed
    /// jaws through what they hold, and the contacts push them back, in hundreds of iterations. So where it would stay
    /// below its limit on blocked jaws, its spring and damper are added to the inertia that contacts feel, which solves
    /// it exactly. At its limit it is a constant torque.
    pub(super) fn begin(joint: &Joint, dt: f64) -> Self {
        let inverse_alone = 1.0 / joint.inertia;
        let [stiffness, damping] = joint.servo;
        let on_blocked_jaws = on_blocked_jaws(joint);
        let is_within_limit = on_blocked_jaws.abs() <= joint.torque_max;
        let drive = joint.drive_impulse;
        let (begin, inverse) = if is_within_limit {
            let inverse = 1.0 / (joint.inertia + dt * (stiffness * dt + damping));
            ((joint.inertia * joint.rate + dt * on_blocked_jaws) * inverse, inverse)
        } else {
            (joint.rate + drive * inverse_alone, inverse_alone)
        };
        Self { rate: begin, inverse, inverse_alone, undo: 0.0, is_within_limit, drive, stops: [0.0; 2] }
    }

    /// Sets a drive at its limit to its limit, as on blocked jaws.
    pub(super) fn saturate(&mut self, joint: &Joint, dt: f64) {
        if !self.is_within_limit {
            let limit = (joint.torque_max * dt).copysign(on_blocked_jaws(joint));
            self.rate += (limit - self.drive) * self.inverse;
            self.drive = limit;
        }
    }

    /// Solves drive and stops again, after contact impulses.
    pub(super) fn solve(&mut self, joint: &Joint, dt: f64) {
        if !self.is_within_limit {
            let free = self.rate - self.drive * self.inverse;
            let most = joint.torque_max * dt;
            let [stiffness, damping] = joint.servo;
            let soft = dt * (stiffness * dt + damping) * self.inverse;
            self.drive = (impulse_at(joint, free, dt) / (1.0 + soft)).clamp(-most, most);
            self.rate = free + self.drive * self.inverse;
        }
        for (end, sign) in [(0, 1.0), (1, -1.0)] {
            let least = sign * (joint.range[end] - joint.angle) / dt;
            let stop = (self.stops[end] + (least - sign * self.rate) / self.inverse).max(0.0);
            self.rate += sign * (stop - self.stops[end]) * self.inverse;
            self.stops[end] = stop;
        }
    }

    pub(super) fn end(&self, joint: &mut Joint, dt: f64) {
        joint.drive_impulse =
            if self.is_within_limit { impulse_at(joint, self.rate, dt) } else { self.drive };
        joint.rate = self.rate;
        joint.angle = (joint.angle + dt * (self.rate + self.undo)).clamp(joint.range[0], joint.range[1]);
    }
}

/// Torque of spring and damper on jaws that do not move.
fn on_blocked_jaws(joint: &Joint) -> f64 {
    let [stiffness, damping] = joint.servo;
    let [angle, rate] = joint.wanted;
    stiffness * (angle - joint.angle) + damping * rate
}

/// Impulse of spring and damper in a step of `dt` at the end of which the opening has this rate.
fn impulse_at(joint: &Joint, rate_at_end: f64, dt: f64) -> f64 {
    let [stiffness, damping] = joint.servo;
    let [angle, rate] = joint.wanted;
    dt * (stiffness * (angle - joint.angle - dt * rate_at_end) + damping * (rate - rate_at_end))
}
