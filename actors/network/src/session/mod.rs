//! A session of several stations: the machines that join the parts of this crate, and the actors that carry them.
//!
//! | | at the host | at a station |
//! |---|---|---|
//! | machine, sans-IO | [`HostMachine`]: connections, tickets, roster, feeds | [`StationMachine`]: control channel, replica |
//! | actor, a controller of the scene | [`HostController`] | [`StationController`] |
//! | below the actors | [`HandsHost`](crate::hands_link::HandsHost) | [`HandsStation`](crate::hands_link::HandsStation) |
//!
//! A machine outlives its actor: a life that ends between two ticks leaves it in a [`MachineSlot`] for the next one, with
//! all its connections. A life that dies within a tick loses it, since nobody knows what state it is in; the stations come
//! back by their resume secrets.

mod admissions;
#[cfg(test)]
mod carried_tests;
mod carrier;
mod host_controller;
mod host_course;
mod host_machine;
mod host_members;
mod instrument_follower;
mod machine_slot;
#[cfg(test)]
mod machines_tests;
mod own_rows;
mod peer_repair;
mod station_controller;
mod station_machine;

pub use admissions::{Admissions, BookAdmissions, SteppedClock, UnixClock, examine, no_station};
pub use host_controller::HostController;
pub use host_course::HostCourse;
pub use host_machine::{HostMachine, HostSetup, Incident};
pub use host_members::{AcceptedNote, HostHandControl};
pub use instrument_follower::InstrumentFollower;
pub use machine_slot::{HeldMachine, MachineSlot};
pub use own_rows::own_rows;
pub use station_controller::StationController;
pub use station_machine::{StationError, StationMachine, StationNews, StationParts, StationSetup};
