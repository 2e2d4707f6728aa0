//! Tele-surgery: a master's poses go over a path, and a slave within limits of its own follows them.
//!
//! A *reflected hand* repeats the experiment of the paper: its device is the master, the instrument in the scene is the
//! slave, and every pose makes the round trip to a packet reflector before it moves anything.
//!
//! ```text
//! master's device ─▶ ReflectedHand ─▶ ReflectedLink ─▶ packet reflector ─┐
//! instrument ◀─ haptics ◀─ driver ◀─ [ Slave ] ◀─ ReflectedLink ◀────────┘
//! ```
//!
//! [`ReflectedHand`] is a device like any other, below its driver; [`ReflectedLink`] is a [`HandsLink`] with the drivers of
//! all of them, over sockets or in virtual time; [`TeleoperationController`] is the actor that shows and measures. [`Slave`] is
//! the robot: speed, workspace, force, pedal, emergency stop, scaling and clutch. [`ForceFeedback`] lets the master's hand feel
//! what the slave touches, by the [compensation](crate::compensation) that the scenario names. [`internet_path`] makes a trace of round
//! trips. [`ItpHand`] is a hand that a console of another make moves, [`ItpMaster`] one that moves a robot of another make.
//!
//! [`HandsLink`]: crate::hands_link::HandsLink

mod controller;
mod coupled_ends;
mod delay_histogram;
mod exchange;
mod force_feedback;
mod force_limit;
pub mod internet_path;
mod itp_hand;
mod itp_master;
mod pose_history;
mod reflected_hand;
mod reflected_link;
mod slave;
mod tracking;
mod tremor_filter;

pub use controller::{PATH_FIGURES, TeleoperationController, TeleoperationWatch};
pub use coupled_ends::{COUPLED_BYTES, CoupledEnds, CoupledError};
pub use delay_histogram::DelayHistogram;
pub use exchange::{Arrival, LinkReport, LinkedHand, MasterSample, SlaveControl, SlaveReport, WatchedHand};
pub use force_feedback::{FeedbackReport, ForceFeedback};
pub use force_limit::{ForceLimit, GIVES_WAY_MAX, MOBILITY};
pub use itp_hand::ItpHand;
pub use itp_master::ItpMaster;
pub use pose_history::PoseHistory;
pub use reflected_hand::ReflectedHand;
pub use reflected_link::{LinkError, ReflectedLink, WatchedLink};
pub use slave::{Slave, SlaveConfig, SlaveError};
pub use tracking::{CONTACT_FORCE, LAGS, LOOK_EVERY, Look, TrackingMeter};
pub use tremor_filter::{CUTOFF_HZ, TremorFilter};
