//! Parameters of a virtual hand: device, arm and fingers.
//!
//! The device's defaults are from the Phantom Omni's data sheet: 6 inputs, 3 outputs, 3.3 N, 160 × 120 × 70 mm, 0.055
//! mm, 45 g apparent mass at the tip, 0.26 N of friction, stiffness 1.26, 2.31 and 1.02 N/mm along x, y and z; its
//! viscous damping is not published and is assumed. The arm is within the range of measured grips: 0.1–0.2 kg, 3–10
//! N·s/m, 100–500 N/m in order of magnitude (Hajian and Howe, "Identification of the mechanical impedance at the human
//! finger tip", 1997; Kuchenbecker, Park and Niemeyer, "Characterizing the human wrist for improved haptic
//! interaction", 2003; Fu and Çavuşoğlu, "Human-arm-and-hand- dynamic model with variability analyses for a
//! stylus-based haptic interface", 2012).

use nalgebra::{Isometry3, Vector3};
use thiserror::Error;

use crate::device::{Capabilities, Dofs, Workspace};
use crate::gripper::FingerFollower;
use crate::oscillator::Oscillator;

/// Mechanical impedance of a human's arm at the grip.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ArmImpedance {
    /// Mass that moves with the handle \[kg\].
    pub mass: f64,
    /// Viscous damping [N·s/m].
    pub damping: f64,
    /// Stiffness towards the target point [N/m].
    pub stiffness: f64,
}

/// Parameters of a [`crate::VirtualHand`]; the default is a Phantom Omni in a firm grip.
#[derive(Clone, Debug, PartialEq)]
pub struct VirtualHandConfig {
    /// Apparent mass of the device at the handle \[kg\].
    pub device_mass: f64,
    /// Viscous damping of the device [N·s/m].
    pub device_damping: f64,
    /// Coulomb friction of the device \[N\].
    pub friction: f64,
    /// The arm that holds the handle.
    pub arm: ArmImpedance,
    /// Whether the arm holds the handle. If not, translation has the device's mass, damping and friction only; the
    /// orientation and the gripper still follow the target.
    pub impedance: bool,
    /// Constant force of the human, in the device's frame \[N\].
    pub push: Vector3<f64>,
    /// Where the handle is at the start, in the device's frame.
    pub start_in_device: Isometry3<f64>,
    /// Box in which the handle can move.
    pub workspace: Workspace,
    /// Whether stops hold the handle in the workspace.
    pub stops: bool,
    /// Stiffness of the stops [N/m].
    pub stop_stiffness: f64,
    /// Damping of the stops [N·s/m].
    pub stop_damping: f64,
    /// Natural frequency with which the orientation follows the target \[Hz\].
    pub orientation_hz: f64,
    /// The fingers at the gripper.
    pub fingers: FingerFollower,
    /// Resolution of the position that is measured \[m\]; 0 for none.
    pub resolution: f64,
    /// Cut-off of the filter of measured velocities \[Hz\].
    pub velocity_cutoff_hz: f64,
    /// Greatest force of the motors \[N\].
    pub max_force: f64,
    /// Greatest torque of the motors [N·m]; matters with six outputs.
    pub max_torque: f64,
    /// Degrees of freedom driven by the motors.
    pub output_dofs: Dofs,
}

impl Default for VirtualHandConfig {
    fn default() -> Self {
        Self {
            device_mass: 0.045,
            device_damping: 0.2,
            friction: 0.26,
            arm: ArmImpedance { mass: 0.15, damping: 10.0, stiffness: 500.0 },
            impedance: true,
            push: Vector3::zeros(),
            start_in_device: Isometry3::identity(),
            workspace: Workspace::centred(Vector3::new(0.160, 0.120, 0.070)),
            stops: true,
            stop_stiffness: 1_000.0,
            stop_damping: 5.0,
            orientation_hz: 6.0,
            fingers: FingerFollower { time_constant: 0.03, speed_max: 6.0, angle_max: 1.2 },
            resolution: 0.0,
            velocity_cutoff_hz: 100.0,
            max_force: 3.3,
            max_torque: 0.1,
            output_dofs: Dofs::Three,
        }
    }
}

/// A parameter of a virtual hand that is out of range.
#[derive(Clone, Debug, Error, PartialEq)]
#[error("{field} = {value} is out of range ({min} to {max} {unit})")]
pub struct HandConfigError {
    /// The parameter.
    pub field: &'static str,
    /// What it was set to.
    pub value: f64,
    /// Smallest valid value.
    pub min: f64,
    /// Greatest valid value.
    pub max: f64,
    /// Unit of the parameter.
    pub unit: &'static str,
}

impl VirtualHandConfig {
    /// The resolution of the Phantom Omni \[m\].
    pub const OMNI_RESOLUTION: f64 = 55e-6;

    /// Checks that every parameter is in the range for which the integration is known to be stable.
    ///
    /// # Errors
    /// Names the first parameter out of range, and its range.
    pub fn check(&self) -> Result<(), HandConfigError> {
        let size = self.workspace.size();
        let start = self.start_in_device.translation.vector;
        let figures = [
            ("mass", self.device_mass, 0.01, 10.0, "kg"),
            ("damping", self.device_damping, 0.0, 1e3, "N·s/m"),
            ("friction", self.friction, 0.0, 20.0, "N"),
            ("arm_mass", self.arm.mass, 0.0, 20.0, "kg"),
            ("arm_damping", self.arm.damping, 0.0, 1e3, "N·s/m"),
            ("arm_stiffness", self.arm.stiffness, 0.0, 2e4, "N/m"),
            ("push_x", self.push.x, -20.0, 20.0, "N"),
            ("push_y", self.push.y, -20.0, 20.0, "N"),
            ("push_z", self.push.z, -20.0, 20.0, "N"),
            ("x", start.x, -10.0, 10.0, "m"),
            ("y", start.y, -10.0, 10.0, "m"),
            ("z", start.z, -10.0, 10.0, "m"),
            ("workspace width", size.x, 1e-3, 10.0, "m"),
            ("workspace height", size.y, 1e-3, 10.0, "m"),
            ("workspace depth", size.z, 1e-3, 10.0, "m"),
            ("stop_stiffness", self.stop_stiffness, 0.0, 5e3, "N/m"),
            ("stop_damping", self.stop_damping, 0.0, 20.0, "N·s/m"),
            ("orientation_hz", self.orientation_hz, 0.1, 50.0, "Hz"),
            ("finger_lag", self.fingers.time_constant, 0.0, 10.0, "s"),
            ("finger_speed", self.fingers.speed_max, 0.0, 100.0, "rad/s"),
            ("gripper_max", self.fingers.angle_max, 0.0, 3.2, "rad"),
            ("resolution", self.resolution, 0.0, 0.01, "m"),
            ("velocity_cutoff", self.velocity_cutoff_hz, 1.0, 1e5, "Hz"),
            ("max_force", self.max_force, 0.0, 100.0, "N"),
            ("max_torque", self.max_torque, 0.0, 10.0, "N·m"),
        ];
        for (field, value, min, max, unit) in figures {
            // NaN fails every range check.
            if !(min..=max).contains(&value) {
                return Err(HandConfigError { field, value, min, max, unit });
            }
        }
        Ok(())
    }

    /// Capabilities of a device with these parameters.
    pub fn capabilities(&self) -> Capabilities {
        Capabilities {
            name: "virtual hand (Phantom Omni)".to_owned(),
            workspace: self.workspace,
            max_force_newtons: self.max_force,
            max_torque: if self.output_dofs == Dofs::Six { self.max_torque } else { 0.0 },
            max_stiffness: 1_020.0,
            input_dofs: Dofs::Six,
            output_dofs: self.output_dofs,
            apparent_mass: self.device_mass,
        }
    }

    pub(crate) fn oscillator(&self) -> Oscillator {
        if self.impedance {
            Oscillator {
                mass: self.device_mass + self.arm.mass,
                damping: self.device_damping + self.arm.damping,
                stiffness: self.arm.stiffness,
            }
        } else {
            Oscillator { mass: self.device_mass, damping: self.device_damping, stiffness: 0.0 }
        }
    }
}
