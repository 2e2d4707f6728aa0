//! Virtual hand: a device without hardware, simulating the handle and the human arm that holds it.
//!
//! The handle of apparent mass `m_d` is gripped rigidly by an arm of impedance (`m_a`, `b_a`, `k_a`) that pulls it
//! towards the human's target point (equilibrium-point model of posture: Flash, "The control of hand equilibrium
//! trajectories in multi-joint arm movements", 1987):
//!
//! ```text
//! (m_d + m_a) ẍ + (b_d + b_a) ẋ + k_a (x − x_aim) = F_motors + F_push + F_friction + F_stops
//! ```
//!
//! The linear part is integrated exactly per sub-step of at most 0.25 ms under a held force ([`Oscillator`]), so that
//! it is stable for every stiffness; Coulomb friction is semi-implicit (the force, bounded by the friction cone, that
//! brings the velocity at the end of the sub-step closest to zero), so that a hand at rest sticks without creeping; the
//! soft stops at the workspace's walls are explicit. The orientation follows the target as a critically damped
//! second-order system (semi-implicit Euler), the gripper as a first-order one. Uses only additions, multiplications
//! and square roots: bit-identical on every machine.

use nalgebra::{Isometry3, Quaternion, UnitQuaternion, Vector3};

use crate::device::{Capabilities, DeviceError, DeviceState, Dofs, HandIntent, HapticDevice, Wrench};
use crate::hand_config::{HandConfigError, VirtualHandConfig};
use crate::oscillator::{Oscillator, Transition};

/// Longest sub-step \[ns\].
const SUBSTEP_MAX_NS: u64 = 250_000;
/// Longest time simulated after a pause in stepping \[ns\]; earlier time is skipped.
const CATCH_UP_MAX_NS: u64 = 100_000_000;
/// Rotational inertia of the handle [kg·m²]: a stylus of 45 g and 15 cm about its middle.
const HANDLE_INERTIA: f64 = 8.4e-5;

/// A handle held by a human arm, moved by the target and by force.
#[derive(Clone, Debug)]
pub struct VirtualHand {
    config: VirtualHandConfig,
    capabilities: Capabilities,
    oscillator: Oscillator,
    transition: Transition,
    // Length of the sub-step for which `transition` holds [s].
    transition_secs: f64,
    open: bool,
    now_ns: Option<u64>,
    wrench: Wrench,
    aim: HandIntent,
    position: Vector3<f64>,
    velocity: Vector3<f64>,
    orientation: UnitQuaternion<f64>,
    angular_velocity: Vector3<f64>,
    gripper: f64,
    measured: DeviceState,
}

impl VirtualHand {
    /// A hand at rest at its start pose, which is also its target.
    ///
    /// # Errors
    /// Names a parameter that is out of range.
    pub fn new(config: VirtualHandConfig) -> Result<Self, HandConfigError> {
        config.check()?;
        let oscillator = config.oscillator();
        let start = config.start_in_device;
        let measured = DeviceState { pose_in_device: start, connected: true, ..DeviceState::unknown() };
        let mut hand = Self {
            capabilities: config.capabilities(),
            oscillator,
            transition: oscillator.transition(SUBSTEP_MAX_NS as f64 * 1e-9),
            transition_secs: SUBSTEP_MAX_NS as f64 * 1e-9,
            open: false,
            now_ns: None,
            wrench: Wrench::ZERO,
            aim: HandIntent::at(start, 0.0),
            position: start.translation.vector,
            velocity: Vector3::zeros(),
            orientation: start.rotation,
            angular_velocity: Vector3::zeros(),
            gripper: 0.0,
            measured,
            config,
        };
        hand.measured.pose_in_device = hand.measured_pose();
        Ok(hand)
    }

    /// The parameters of this hand.
    pub fn config(&self) -> &VirtualHandConfig {
        &self.config
    }

    /// Sets whether the arm holds the handle.
    pub fn set_impedance(&mut self, impedance: bool) {
        self.config.impedance = impedance;
        self.oscillator = self.config.oscillator();
        self.transition = self.oscillator.transition(self.transition_secs);
    }

    /// Sets the human's constant force \[N\], in the device's frame. A non-finite one counts as zero.
    pub fn set_push(&mut self, push: Vector3<f64>) {
        self.config.push = if crate::device::is_finite(&push) { push } else { Vector3::zeros() };
    }

    /// Places the hand at rest at a target; for the start of a replay.
    pub(crate) fn place(&mut self, at: &HandIntent) {
        self.aim = *at;
        self.position = at.pose_in_device.translation.vector;
        self.orientation = at.pose_in_device.rotation;
        self.velocity = Vector3::zeros();
        self.angular_velocity = Vector3::zeros();
        self.gripper = at.gripper.max(0.0).min(self.config.fingers.angle_max);
        self.measured = DeviceState {
            pose_in_device: self.measured_pose(),
            gripper: self.gripper,
            connected: true,
            ..DeviceState::unknown()
        };
    }

    fn advance(&mut self, elapsed_ns: u64) {
        let elapsed_ns = elapsed_ns.min(CATCH_UP_MAX_NS);
        let substeps = elapsed_ns.div_ceil(SUBSTEP_MAX_NS);
        if substeps == 0 {
            return;
        }
        let step_secs = elapsed_ns as f64 * 1e-9 / substeps as f64;
        if step_secs != self.transition_secs {
            self.transition = self.oscillator.transition(step_secs);
            self.transition_secs = step_secs;
        }
        for _ in 0..substeps {
            self.translate();
            self.rotate(step_secs);
            self.gripper = self.config.fingers.step(self.gripper, self.aim.gripper, step_secs);
        }
    }

    fn translate(&mut self) {
        let aim = self.aim.pose_in_device.translation.vector;
        let mass = self.oscillator.mass;
        let force = self.wrench.force + self.config.push + self.stop_force();
        let offset = self.position - aim;
        let [_, _, gain] = self.transition.velocity;
        let mut unhindered = Vector3::zeros();
        for axis in 0..3 {
            unhindered[axis] = self.transition.apply(offset[axis], self.velocity[axis], force[axis] / mass).1;
        }
        // The friction that would stop the hand within this sub-step, limited to the friction cone.
        let stopping = -unhindered * (mass / gain);
        let needed = stopping.norm();
        let friction =
            if needed > self.config.friction { stopping * (self.config.friction / needed) } else { stopping };
        let acceleration = (force + friction) / mass;
        for axis in 0..3 {
            let (moved, velocity) =
                self.transition.apply(offset[axis], self.velocity[axis], acceleration[axis]);
            self.position[axis] = aim[axis] + moved;
            self.velocity[axis] = velocity;
        }
    }

    fn stop_force(&self) -> Vector3<f64> {
        if !self.config.stops {
            return Vector3::zeros();
        }
        let excess = self.config.workspace.excess(&self.position);
        excess.zip_map(&self.velocity, |depth, speed| {
            if depth == 0.0 {
                return 0.0;
            }
            // A stop pushes back and never pulls, however fast the hand leaves it.
            let push = -self.config.stop_stiffness * depth - self.config.stop_damping * speed;
            if depth > 0.0 { push.min(0.0) } else { push.max(0.0) }
        })
    }

    fn rotate(&mut self, step_secs: f64) {
        // Half the error's axis-angle vector for small angles; largest at half a turn, so it always turns back.
        let error = self.aim.pose_in_device.rotation.into_inner() * self.orientation.into_inner().conjugate();
        let shorter = if error.w < 0.0 { -2.0 } else { 2.0 };
        let towards = error.imag() * shorter;
        let rate = 2.0 * std::f64::consts::PI * self.config.orientation_hz;
        let torque = if self.config.output_dofs == Dofs::Six { self.wrench.torque } else { Vector3::zeros() };
        let acceleration = towards * (rate * rate) + torque / HANDLE_INERTIA;
        self.angular_velocity =
            (self.angular_velocity + acceleration * step_secs) / (1.0 + 2.0 * rate * step_secs);
        let half_turn = Quaternion::from_imag(self.angular_velocity * (0.5 * step_secs));
        let orientation = self.orientation.into_inner();
        self.orientation = UnitQuaternion::new_normalize(orientation + half_turn * orientation);
    }

    fn measured_pose(&self) -> Isometry3<f64> {
        let resolution = self.config.resolution;
        let position = if resolution > 0.0 {
            self.position.map(|x| (x / resolution).round() * resolution)
        } else {
            self.position
        };
        Isometry3::from_parts(position.into(), self.orientation)
    }

    /// Measures as a device does: quantised positions, differentiated and filtered (first-order low pass by the
    /// backward Euler rule).
    fn measure(&mut self, elapsed_ns: u64) {
        let pose = self.measured_pose();
        let elapsed = elapsed_ns as f64 * 1e-9;
        let lag = 1.0 / (2.0 * std::f64::consts::PI * self.config.velocity_cutoff_hz);
        let share = elapsed / (lag + elapsed);
        let before = self.measured;
        let differentiated = (pose.translation.vector - before.pose_in_device.translation.vector) / elapsed;
        self.measured = DeviceState {
            pose_in_device: pose,
            linear_velocity: before.linear_velocity + share * (differentiated - before.linear_velocity),
            angular_velocity: before.angular_velocity
                + share * (self.angular_velocity - before.angular_velocity),
            gripper: self.gripper,
            buttons: self.aim.buttons,
            connected: true,
        };
    }
}

impl HapticDevice for VirtualHand {
    fn capabilities(&self) -> &Capabilities {
        &self.capabilities
    }

    fn open(&mut self, now_ns: u64) -> Result<(), DeviceError> {
        self.open = true;
        self.wrench = Wrench::ZERO;
        self.now_ns.get_or_insert(now_ns);
        Ok(())
    }

    fn read(&mut self, now_ns: u64) -> Result<DeviceState, DeviceError> {
        if !self.open {
            return Err(DeviceError::NotOpen);
        }
        let elapsed_ns = self.now_ns.map_or(0, |before| now_ns.saturating_sub(before));
        if elapsed_ns > 0 {
            self.now_ns = Some(now_ns);
            self.advance(elapsed_ns);
            self.measure(elapsed_ns);
        }
        Ok(self.measured)
    }

    fn write(&mut self, _now_ns: u64, wrench: &Wrench) -> Result<(), DeviceError> {
        if !self.open {
            return Err(DeviceError::NotOpen);
        }
        self.wrench = if wrench.is_finite() { *wrench } else { Wrench::ZERO };
        Ok(())
    }

    fn set_intent(&mut self, _now_ns: u64, intent: &HandIntent) {
        if intent.is_valid() {
            self.aim = *intent;
        }
    }

    fn close(&mut self) {
        self.open = false;
        self.wrench = Wrench::ZERO;
    }

    fn fork(&self) -> Option<Box<dyn HapticDevice>> {
        Some(Box::new(self.clone()))
    }

    fn resume(&mut self, now_ns: u64, state: &DeviceState, intent: &HandIntent) {
        if !state.is_valid() || !intent.is_valid() {
            return;
        }
        self.place(&HandIntent::at(state.pose_in_device, state.gripper));
        self.aim = *intent;
        self.velocity = state.linear_velocity;
        self.angular_velocity = state.angular_velocity;
        self.measured = DeviceState { connected: true, ..*state };
        self.now_ns = Some(now_ns);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_figure_out_of_range_is_named_with_its_range() {
        let config = VirtualHandConfig { device_mass: f64::NAN, ..VirtualHandConfig::default() };
        let error = VirtualHand::new(config).unwrap_err();
        assert_eq!(error.to_string(), "mass = NaN is out of range (0.01 to 10 kg)");
        let mut config = VirtualHandConfig::default();
        config.arm.stiffness = -1.0;
        assert_eq!(config.check().unwrap_err().field, "arm_stiffness");
    }

    #[test]
    fn a_closed_hand_gives_no_reading_and_takes_no_force() {
        let mut hand = VirtualHand::new(VirtualHandConfig::default()).unwrap();
        assert_eq!(hand.read(0), Err(DeviceError::NotOpen));
        assert_eq!(hand.write(0, &Wrench::ZERO), Err(DeviceError::NotOpen));
        hand.open(0).unwrap();
        assert!(hand.read(0).unwrap().connected);
    }
}
