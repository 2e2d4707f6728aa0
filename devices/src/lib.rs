//! Device drivers: haptic and input devices, real, virtual and replayed.
//!
//! This crate does not depend on scene, physics or kernel. It offers
//!
//! - [`HapticDevice`], the interface of a device driver (with an annotated template for a new one);
//! - [`DriverCore`], the safety layer below every actor: clamp, slew limit, damping, watchdog, epoch fence, ramp-in,
//!   passivity, unplugging; a sans-IO state machine with the time passed in as nanoseconds;
//! - [`DriverThread`], which steps a core in real time on its own OS thread;
//! - the link between a driver and its controller: [`DeviceSlot`], [`DeviceLink`], [`Fence`],
//!   [`DeviceMonitor`], [`DeviceFaults`];
//! - [`VirtualHand`] and [`ReplayHand`], devices without hardware, and the readers of recorded hands;
//! - [`gamepad`]: the state of gamepads, and the reader of this machine's pads;
//! - [`DeviceSpec`], the text that names a device on a command line or in a scenario.
//!
//! Conventions: SI units; time in nanoseconds since the start of the session (`*_ns: u64`), given by the
//! caller; forces in newtons along the axes of the device's frame, acting on the hand at the handle's origin.
//! Only [`DriverThread`] and the reader of gamepads read a clock; only `sched` and `gamepad/evdev` hold unsafe code.

mod clock;
mod device;
mod driver_core;
mod driver_thread;
mod energy_observer;
mod faults;
mod force_guard;
pub mod gamepad;
mod gripper;
mod hand_config;
mod hand_csv;
mod jigsaws;
mod lane_gate;
mod link;
mod oscillator;
mod passivity;
mod pedals;
mod reader;
mod replay_hand;
mod sched;
mod spec;
pub mod spec_options;
mod sync;
mod trajectory;
mod virtual_hand;

pub use clock::TimeUnit;
pub use device::{Capabilities, DeviceError, DeviceState, Dofs, HandIntent, HapticDevice, Workspace, Wrench};
pub use driver_core::{DriverConfig, DriverCore, DriverResume};
pub use driver_thread::{DriverThread, DriverThreadConfig, DriverThreadError, Scheduling, SessionTime};
pub use faults::DeviceFaults;
pub use force_guard::{DECAY_END_NS, DECAY_START_NS, ForceGuard, GuardConfig};
pub use gripper::FingerFollower;
pub use hand_config::{ArmImpedance, HandConfigError, VirtualHandConfig};
pub use hand_csv::{read_hand_csv, read_hand_csv_from};
pub use jigsaws::{JigsawsSelection, JigsawsSide, JigsawsSource, read_jigsaws, read_jigsaws_from};
pub use link::{
    DeviceCommand, DeviceLink, DeviceMonitor, DeviceSample, DeviceSlot, DriverEnd, DriverStatistics, Fence,
    LANES, LinkError, link, pair,
};
pub use oscillator::Oscillator;
pub use passivity::{PassivityConfig, PassivityController, PortEnergy};
pub use pedals::{HAS_PEDALS, PEDAL_COAGULATE, PEDAL_ENERGY, Pedals};
pub use reader::{MAX_FILE_BYTES, MAX_ROWS, ReadError, RowProblem, StartTime};
pub use replay_hand::ReplayHand;
pub use spec::{BuildError, DeviceSpec, SpecError};
pub use trajectory::{Registration, Trajectory, TrajectoryError, TrajectoryPoint};
pub use virtual_hand::VirtualHand;
