//! The channel of hands: who sends when, what the other side holds, and how old it is.
//!
//! Per direction of a link, a [`HapticSender`] here and a [`HapticReceiver`] there, with the datagrams of
//! [`crate::datagram`] between. A station has one of each for a link; they share the receiver's
//! [`ClockSync`]. At a tick:
//!
//! 1. for each datagram that arrived: [`HapticReceiver::receive`], then [`HapticSender::echoed`] with its echo;
//! 2. [`HapticReceiver::read`] for each hand, and [`HapticReceiver::report`], which goes to the other station by
//!    any way; a report from there goes into [`HapticSender::report`];
//! 3. [`HapticSender::tick`]; if a datagram is to go, [`HapticSender::sent`] or [`HapticSender::blocked`] follows.
//!
//! Nothing here reads a clock or allocates while it runs, and nothing waits: what is late is counted, and the
//! newest wins.

#[cfg(test)]
mod channel_tests;
mod clock_sync;
#[cfg(test)]
mod cross_check_tests;
mod deadband;
#[cfg(test)]
mod hand_motion_testing;
mod link_meter;
mod link_quality;
mod link_report;
mod rate_ladder;
mod receiver;
mod receiver_belief;
mod sender;

pub use clock_sync::{ClockSync, SKEW_MAX, Transit};
pub use deadband::{Deadband, Deviation};
pub use link_meter::{LinkHistograms, LinkMeter, LinkPoint, POINT_EVERY};
pub use link_quality::{Figure, LinkQuality, LinkSummary, POINTS_MAX};
pub use link_report::{LinkReport, LossMeter, Order, REPORT_BYTES, REPORT_EVERY, ReportError};
pub use rate_ladder::{
    GROWING, GROWTH_US, LOSS_DOWN, LOSS_UP, QUIET_MAX, QUIET_MIN, Rate, RateChange, RateLadder, RateReason,
    SILENCE,
};
pub use receiver::{
    FADE_END, FADE_START, HandCounts, HapticReceiver, ReceiverCounts, ReceiverError, RemoteHandSample, fade,
};
pub use receiver_belief::{CANDIDATES, ReceiverBelief, WRONG_BANDS, WRONG_DISCRETE, Wrong};
pub use sender::{HEARTBEAT, HapticSender, Outgoing, SendReason, SenderConfig, SenderCounts};
