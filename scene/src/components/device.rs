//! Haptic devices and hands: their state and their commands.

use nalgebra::Vector3;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::components::graph::{Pose, Velocity};
use crate::entity::Entity;
use crate::time::SimTime;
use crate::{Component, ComponentError, RecordPolicy};

/// Left or right.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Side {
    /// The trainee's left hand.
    Left,
    /// The trainee's right hand.
    Right,
}

impl Side {
    /// The other one.
    pub fn other(self) -> Self {
        match self {
            Side::Left => Side::Right,
            Side::Right => Side::Left,
        }
    }
    /// `"left"` or `"right"`.
    pub fn as_str(self) -> &'static str {
        match self {
            Side::Left => "left",
            Side::Right => "right",
        }
    }
}

/// A hand: a device registered to the world, and the instrument that it moves.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Component)]
#[component(name = "hand", check = Self::validate, schema)]
#[serde(deny_unknown_fields)]
pub struct Hand {
    /// Which hand it is.
    pub side: Side,
    /// The instrument it moves.
    #[schemars(with = "String")]
    pub instrument: Entity,
    /// `world_from_device`: where the device's origin lies.
    #[serde(default)]
    pub world_from_device: Pose,
    /// Metres in the world per metre at the device.
    #[serde(default = "one")]
    pub scale: f64,
}
fn one() -> f64 {
    1.0
}

impl Hand {
    fn validate(&self) -> Result<(), ComponentError> {
        super::graph::check_rotation(&self.world_from_device.rotation)?;
        ComponentError::range("scale", self.scale, 0.01..=100.0, "0.01 to 100")
    }
}

/// Capabilities of a device; copied into the scene when it is opened.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema, Component)]
#[component(name = "device_info", schema)]
#[serde(default, deny_unknown_fields)]
pub struct DeviceInfo {
    /// Product.
    pub model: String,
    /// Full extent of the workspace about the device's origin \[m\].
    pub workspace: [f64; 3],
    /// Largest force \[N\].
    pub max_force: f64,
    /// Largest torque \[N·m\].
    pub max_torque: f64,
    /// Largest stable stiffness \[N/m\].
    pub max_stiffness: f64,
    /// Mass that the hand feels when no force is rendered \[kg\].
    pub apparent_mass: f64,
    /// Sensed degrees of freedom.
    pub input_dofs: u8,
    /// Actuated degrees of freedom.
    pub output_dofs: u8,
}

impl DeviceInfo {
    /// Whether strangers may move the device: what it says of itself ends with this word in brackets.
    pub fn is_unprotected(&self) -> bool {
        self.model.ends_with("(unprotected)")
    }
}

/// The latest state of a haptic device, as its driver measured it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema, Component)]
#[component(name = "device_state", check = Self::validate, schema)]
#[serde(default, deny_unknown_fields)]
pub struct DeviceState {
    /// `device_from_handle`.
    pub handle_in_device: Pose,
    /// Its velocity, in the device's axes.
    pub velocity_in_device: Velocity,
    /// Opening of the gripper \[rad\].
    pub gripper: f64,
    /// One bit per button of the handle, 0 to 15; above are pedals, if the device has any (16), for the instrument's own
    /// current (17) and for coagulation (18).
    pub buttons: u32,
    /// Whether the device is connected.
    pub connected: bool,
    /// Force rendered by the driver, in the device's axes \[N\].
    #[schemars(with = "[f64; 3]")]
    pub applied_force: Vector3<f64>,
    /// When it was measured.
    pub sampled_at: SimTime,
}

impl DeviceState {
    fn validate(&self) -> Result<(), ComponentError> {
        super::graph::check_rotation(&self.handle_in_device.rotation)
    }
}

/// The wrench commanded by haptics, in the device's axes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema, Component)]
#[component(name = "device_force", record = RecordPolicy::sampled(100.0, 0.0001), schema)]
#[serde(default, deny_unknown_fields)]
pub struct DeviceForce {
    /// Force \[N\].
    #[schemars(with = "[f64; 3]")]
    pub force: Vector3<f64>,
    /// Torque \[N·m\].
    #[schemars(with = "[f64; 3]")]
    pub torque: Vector3<f64>,
    /// Time of the command.
    pub at: SimTime,
}

/// Target of a virtual trainee's hand, in the device's frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema, Component)]
#[component(name = "hand_target", check = Self::validate, schema)]
#[serde(default, deny_unknown_fields)]
pub struct HandTarget {
    /// Target of `device_from_handle`.
    pub handle_in_device: Pose,
    /// Target opening of the gripper \[rad\].
    pub gripper: f64,
}

impl HandTarget {
    fn validate(&self) -> Result<(), ComponentError> {
        super::graph::check_rotation(&self.handle_in_device.rotation)
    }
}

/// What a virtual trainee presses at its hand: buttons of the handle, and pedals. A hand that has it in the scenario has
/// pedals, and they alone switch its instrument: what is pressed goes the way of the hand's motion, over a network too.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema, Component)]
#[component(name = "press_target", schema)]
#[serde(default, deny_unknown_fields)]
pub struct PressTarget {
    /// Buttons of the handle: bit `n` is set while button `n` is pressed, 0 to 15.
    pub buttons: u16,
    /// The pedal for the instrument's own current.
    pub energy: bool,
    /// The pedal for coagulation; it goes before the other.
    pub coagulate: bool,
}

/// Restart state and status of a haptics controller.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema, Component)]
#[component(name = "haptic_status", record = RecordPolicy::sampled(10.0, 1e-7), schema)]
#[serde(default, deny_unknown_fields)]
pub struct HapticStatus {
    /// Energy that the driver observed at the device's port since the start \[J\]; passive while not negative.
    pub energy: f64,
    /// Minimum of `energy` so far \[J\].
    pub energy_min: f64,
    /// Energy withheld from the hand by passivity \[J\].
    pub dissipated: f64,
    /// Damping equivalent to the force withheld now \[N·s/m\].
    pub injected_damping: f64,
    /// Power withheld now \[W\].
    pub damping_power: f64,
    /// Rendered stiffness \[N/m\]; 0 out of contact and while the hand hardly moves.
    pub felt_stiffness: f64,
    /// Largest commanded force so far \[N\].
    pub force_max: f64,
    /// Ticks without a fresh device sample.
    pub stale_samples: u64,
}
