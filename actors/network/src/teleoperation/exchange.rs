//! What the device of a reflected hand, its link and its actor tell each other: the newest of each, without waiting.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use nalgebra::{Isometry3, Vector3};
use triple_buffer::{Input, Output, triple_buffer};
use trocar_devices::{DeviceState, Pedals};
use trocar_scene::{SimTime, SlaveState, TeleoperationEnd};

use super::coupled_ends::CoupledEnds;
use super::force_feedback::FeedbackReport;
use crate::hand_sample::HandSample;

/// What the master's device measured.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MasterSample {
    /// When.
    pub sampled_at: SimTime,
    /// What.
    pub state: DeviceState,
    /// Both ends of its coupling, if forces are fed back.
    pub coupled: Option<CoupledEnds>,
}

/// A sample of the master that has come over the path.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Arrival {
    /// When it was measured, to the microsecond.
    pub sampled_at: SimTime,
    /// When its packet was sent.
    pub sent_at: SimTime,
    /// When it arrived.
    pub arrived_at: SimTime,
    /// What it says.
    pub sample: HandSample,
    /// What both ends of its coupling said, if forces are fed back.
    pub coupled: Option<CoupledEnds>,
}

/// What the device tells of its slave.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SlaveReport {
    /// When.
    pub at: SimTime,
    /// What of it is here.
    pub end: TeleoperationEnd,
    /// The master then.
    pub master_in_device: Isometry3<f64>,
    /// The slave then; none before it has a place.
    pub slave_in_device: Option<Isometry3<f64>>,
    /// What the slave does.
    pub state: SlaveState,
    /// Time stamp of the pose that it applies.
    pub applied: Option<SimTime>,
    /// Distances of the slave from the master's pose whose time stamp is applied: how many, the sum of their squares
    /// \[m²\], and the largest \[m\].
    pub errors: (u64, f64, f64),
    /// Steps in which a limit held the slave back.
    pub limited: u64,
    /// The pedals of the current, as they count at the slave.
    pub pedals: Pedals,
    /// Force at the slave, along the device's axes \[N\].
    pub force_in_device: Vector3<f64>,
    /// Emergency stops so far.
    pub stops: u64,
    /// Silences so far.
    pub silences: u64,
    /// Time with the current on \[s\].
    pub energised_secs: f64,
    /// What the master's hand feels, if forces are fed back.
    pub feedback: Option<FeedbackReport>,
    /// What is known of the path, where it is not that of a reflected link.
    pub link: Option<LinkReport>,
}

/// What the link tells of the path.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LinkReport {
    /// Packets that were sent.
    pub sent: u64,
    /// Packets that came back, each once.
    pub received: u64,
    /// Packets that a newer one had overtaken.
    pub late: u64,
    /// Packets that were refused: damaged, forged, or come twice.
    pub refused: u64,
    /// Round trip of the newest packet.
    pub newest: SimTime,
    /// Mean, shortest, of 99 %, and longest round trip \[s\].
    pub round_trips: Option<[f64; 4]>,
    /// Deviation from the trace's delay, of 99 % of the packets and of the worst \[s\]; none if the trace is unknown.
    pub delay_errors: Option<[f64; 2]>,
}

/// What is asked of a slave from outside. Clones share it.
#[derive(Clone, Debug, Default)]
pub struct SlaveControl(Arc<AtomicBool>);

impl SlaveControl {
    /// Emergency stop, or its end.
    pub fn set_stop(&self, stop: bool) {
        self.0.store(stop, Ordering::Release);
    }

    /// Whether the slave is to stand.
    pub fn is_stopped(&self) -> bool {
        self.0.load(Ordering::Acquire)
    }
}

/// The device's end.
pub(super) struct DeviceEnd {
    pub masters: Input<Option<MasterSample>>,
    pub arrivals: Output<Option<Arrival>>,
    pub told: ToldHand,
}

/// What a device tells its actor, and is told by it.
pub(super) struct ToldHand {
    pub reports: Input<Option<SlaveReport>>,
    pub control: SlaveControl,
}

/// The two ends between a device and its actor.
pub(super) fn watched() -> (ToldHand, WatchedHand) {
    let (reports_in, reports) = triple_buffer(&None);
    let control = SlaveControl::default();
    (ToldHand { reports: reports_in, control: control.clone() }, WatchedHand { reports, control })
}

/// The link's end of a hand.
pub struct LinkedHand {
    pub(super) hand: u8,
    pub(super) masters: Output<Option<MasterSample>>,
    arrivals: Input<Option<Arrival>>,
    /// What was told last.
    pub(super) arrived: Option<Arrival>,
}

impl LinkedHand {
    /// Tells the device of what has come.
    pub(super) fn tell(&mut self, arrival: Option<Arrival>) {
        self.arrived = arrival;
        self.arrivals.write(arrival);
    }
}

/// The actor's end of a hand.
pub struct WatchedHand {
    pub(super) reports: Output<Option<SlaveReport>>,
    pub(super) control: SlaveControl,
}

/// The three ends of hand number `hand`.
pub(super) fn exchange(hand: u8) -> (DeviceEnd, LinkedHand, WatchedHand) {
    let (masters_in, masters) = triple_buffer(&None);
    let (arrivals_in, arrivals) = triple_buffer(&None);
    let (told, watched) = watched();
    let device = DeviceEnd { masters: masters_in, arrivals, told };
    (device, LinkedHand { hand, masters, arrivals: arrivals_in, arrived: None }, watched)
}
