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
    pub inverse: f64,
    drive: f64,
    stops: [f64; 2],
}

impl Turning {
    pub(super) fn begin(joint: &Joint) -> Self {
        let inverse = 1.0 / joint.inertia;
        let drive = joint.drive_impulse;
        Self { rate: joint.rate + drive * inverse, inverse, drive, stops: [0.0; 2] }
    }

    /// Solves drive and stops again, after contact impulses.
    pub(super) fn solve(&mut self, joint: &Joint, dt: f64) {
        let [stiffness, damping] = joint.servo;
        let [angle, rate] = joint.wanted;
        let free = self.rate - self.drive * self.inverse;
        let wanted = dt * (stiffness * (angle - joint.angle - dt * free) + damping * (rate - free));
        let most = joint.torque_max * dt;
        self.drive = (wanted / (1.0 + dt * (stiffness * dt + damping) * self.inverse)).clamp(-most, most);
        self.rate = free + self.drive * self.inverse;
        for (end, sign) in [(0, 1.0), (1, -1.0)] {
            let least = sign * (joint.range[end] - joint.angle) / dt;
            let stop = (self.stops[end] + (least - sign * self.rate) / self.inverse).max(0.0);
            self.rate += sign * (stop - self.stops[end]) * self.inverse;
            self.stops[end] = stop;
        }
    }

    pub(super) fn end(&self, joint: &mut Joint, dt: f64) {
        joint.rate = self.rate;
        joint.angle = (joint.angle + dt * self.rate).clamp(joint.range[0], joint.range[1]);
        joint.drive_impulse = self.drive;
    }
}
