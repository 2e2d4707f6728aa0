//! A hand whose device is at another station: the door that its samples pass, and the device that stands for it here.
//!
//! Haptics, physics and tasks see a [`RemoteHand`] as any other [`HapticDevice`](trocar_devices::HapticDevice), below
//! the same driver with the same guard. It stands on a local device (or on none), and a station may take it:
//!
//! ```text
//! link driver: datagrams ─▶ StationEnd ─▶ [ Door: checks, clutch, limits ] ─┐
//!                                         local device ─▶ [ clutch ] ───────┴▶ RemoteHand ─▶ DriverCore ─▶ haptics
//! link driver: datagrams ◀─ StationEnd ◀─ newest wrench, faded in and out ◀──── write
//! ```
//!
//! What a station sends is authenticated, and may be nonsense all the same. The [`Door`] refuses what is no number,
//! clamps the rest to [`DoorLimits`], counts both, and decides what silence means: the pedal is released, the jaws hold,
//! the motion stops. What comes unevenly is shown evenly ([`ConstantAge`]). Whoever takes a hand, gives it back or returns
//! to it does so through a [`Clutch`], so that nothing jumps.

mod clutch;
mod constant_age;
mod door;
#[cfg(test)]
mod door_tests;
mod grip;
mod limits;
mod motion;
mod remote_device;
#[cfg(test)]
mod remote_device_tests;
mod station_end;

pub use clutch::Clutch;
pub use constant_age::{ConstantAge, REACH_SECS};
pub use door::{Arrival, Door, DoorStatistics, Refusal, Standing};
pub use grip::{GripMatch, PedalGate};
pub use limits::{DoorLimits, LimitError};
pub use motion::{Caps, MotionLimiter, STEP_MAX_SECS, VELOCITY_CUTOFF_HZ};
pub use remote_device::RemoteHand;
pub use station_end::{HandAnswer, HandControl, Presence, StationEnd};
