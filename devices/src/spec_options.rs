//! The keys of device specifications, with what they mean: for help, for messages, and for the reader of the text.

/// One `key=value` of a device.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct DeviceOption {
    /// The key.
    pub key: &'static str,
    /// What it can be.
    pub values: &'static str,
    /// What it does, with the value that holds without it.
    pub about: &'static str,
}

const fn option(key: &'static str, values: &'static str, about: &'static str) -> DeviceOption {
    DeviceOption { key, values, about }
}

/// Of a virtual hand, and of a recording on which force acts.
pub const HAND_OPTIONS: [DeviceOption; 26] = [
    option("impedance", "on|off", "whether an arm holds the handle; on"),
    option("mass", "0.01 to 10 kg", "apparent mass of the device; 0.045"),
    option("damping", "0 to 1000 N·s/m", "viscous damping of the device; 0.2"),
    option("friction", "0 to 20 N", "Coulomb friction of the device; 0.26"),
    option("arm_mass", "0 to 20 kg", "mass of the arm that moves with the handle; 0.15"),
    option("arm_damping", "0 to 1000 N·s/m", "damping of the arm; 10"),
    option("arm_stiffness", "0 to 20000 N/m", "stiffness of the arm; 500"),
    option("push_x", "-20 to 20 N", "constant force of the human along x of the device; 0"),
    option("push_y", "-20 to 20 N", "the same along y; 0"),
    option("push_z", "-20 to 20 N", "the same along z; 0"),
    option("x", "-10 to 10 m", "where the handle is at the start, in the device's frame; 0"),
    option("y", "-10 to 10 m", "the same along y; 0"),
    option("z", "-10 to 10 m", "the same along z; 0"),
    option("workspace", "WIDTHxHEIGHTxDEPTH in m", "box in which the handle moves; 0.16x0.12x0.07"),
    option("stops", "on|off", "whether stops hold the handle in the workspace; on"),
    option("stop_stiffness", "0 to 5000 N/m", "stiffness of the stops; 1000"),
    option("stop_damping", "0 to 20 N·s/m", "damping of the stops; 5"),
    option("orientation_hz", "0.1 to 50 Hz", "natural frequency with which the orientation follows; 6"),
    option("finger_lag", "0 to 10 s", "time constant of the fingers at the gripper; 0.03"),
    option("finger_speed", "0 to 100 rad/s", "greatest speed of the gripper; 6"),
    option("gripper_max", "0 to 3.2 rad", "greatest angle of the gripper; 1.2"),
    option("quantise", "on|off", "whether positions have the resolution of a Phantom Omni, 55 µm; off"),
    option("velocity_cutoff", "1 to 100000 Hz", "cut-off of the filter of measured velocities; 100"),
    option("max_force", "0 to 100 N", "greatest force of the motors; 3.3"),
    option("max_torque", "0 to 10 N·m", "greatest torque of the motors, with six outputs; 0.1"),
    option("outputs", "3|6", "degrees of freedom that the motors drive; 3"),
];

/// Of a recording as CSV; with `force=on` those of the virtual hand, too.
pub const REPLAY_OPTIONS: [DeviceOption; 3] = [
    option(
        "force",
        "on|off",
        "whether force deflects the hand; then the virtual hand's options are valid, too; off",
    ),
    option(
        "start",
        "zero|file|TIME",
        "the session starts with the first row (zero), at zero of the file's clock (file), or at a time of that clock, \
         such as 1700000000.5 or 2026-11-27T14:05:00Z; zero",
    ),
    option(
        "time",
        "s|ms|us|ns",
        "unit of the times; without it that of the column's name (t_ms), or the one in which the first is a Unix time, \
         or s",
    ),
];

/// Of JIGSAWS kinematics; with `force=on` those of the virtual hand, too.
pub const JIGSAWS_OPTIONS: [DeviceOption; 11] = [
    option(
        "force",
        "on|off",
        "whether force deflects the hand; then the virtual hand's options are valid, too; off",
    ),
    option("side", "left|right", "which hand; left"),
    option(
        "source",
        "master|slave",
        "the manipulator moved by the surgeon, or the one in the patient; master",
    ),
    option("scale", "0.001 to 1000", "scale of lengths; 1"),
    option("centre", "on|off", "whether the middle of the motion is moved to the origin; on"),
    option("at_x", "-10 to 10 m", "shift along x of the device; 0"),
    option("at_y", "-10 to 10 m", "shift along y; 0"),
    option("at_z", "-10 to 10 m", "shift along z; 0"),
    option("roll", "-7 to 7 rad", "turn about x of the device; 0"),
    option("pitch", "-7 to 7 rad", "turn about y; 0"),
    option("yaw", "-7 to 7 rad", "turn about z; 0"),
];

/// The keys of a kind of device: its own, and those of the virtual hand on which force acts.
#[must_use]
pub fn options(kind: &str) -> &'static [DeviceOption] {
    match kind {
        "virtual" => &HAND_OPTIONS,
        "replay" => &REPLAY_OPTIONS,
        "jigsaws" => &JIGSAWS_OPTIONS,
        _ => &[],
    }
}
