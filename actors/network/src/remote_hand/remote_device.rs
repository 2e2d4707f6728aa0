//! Remote hand: a haptic device that is moved by its local device until a station takes it, and by the station then.
//!
//! Below the same driver as any other device. A hand that nobody has ever taken is its local device, bit for bit. At each
//! change of owner the shown pose stays where it is (a [`Clutch`] takes up the difference in position and rotation), the
//! buttons must be released before they count, jaws that hold something wait for the new fingers, and the force fades out
//! at one end and in at the other over [`DoorLimits::handover_secs`]. A virtual local device is put where the hand is
//! shown instead, so that its intents keep their meaning; for a physical one they pass the clutch backwards.
//!
//! `read` and `write` allocate nothing, lock nothing and do not block, if the local device does not.

use nalgebra::Isometry3;
use triple_buffer::{Input, Output, triple_buffer};
use trocar_devices::{Capabilities, DeviceError, DeviceState, HandIntent, HapticDevice, Pedals, Wrench};
use trocar_scene::SimTime;

use super::clutch::Clutch;
use super::door::{Door, Standing};
use super::grip::{GripMatch, PedalGate};
use super::limits::{DoorLimits, LimitError};
use super::motion::STEP_MAX_SECS;
use super::station_end::{HandAnswer, HandControl, Owner, Post, Presence, StationEnd};

/// Time between two attempts to open a local device that was unplugged while a station has the hand \[ns\].
const REOPEN_PERIOD_NS: u64 = 100_000_000;

/// How the local device's motion is shown after the hand came back to it.
#[derive(Clone, Copy, Debug)]
struct Regained {
    /// `None` until the device's first reading.
    clutch: Option<Clutch>,
    grip: GripMatch,
    gate: PedalGate,
}

/// The local device.
struct Local {
    device: Box<dyn HapticDevice>,
    /// Whether it can be put where the hand is shown.
    is_virtual: bool,
    open: bool,
    retry_at_ns: u64,
    /// `None` while it is shown as it is.
    regained: Option<Regained>,
}

/// A hand whose device may be at another station.
pub struct RemoteHand {
    capabilities: Capabilities,
    local: Option<Local>,
    door: Door,
    control: HandControl,
    posts: Output<Option<Post>>,
    answers: Input<HandAnswer>,
    answer: HandAnswer,
    open: bool,
    owner: Owner,
    // The newest state that was shown; `None` before the first.
    shown: Option<DeviceState>,
    read_at_ns: Option<u64>,
    // Shares of the wrench for the local device's motors and the station's.
    local_share: f64,
    station_share: f64,
    // How old the newest sample of the station was when it was brought here.
    lag_ns: u64,
}

impl RemoteHand {
    /// A hand that stands on a local device until a station takes it.
    ///
    /// # Errors
    /// [`LimitError`] when a limit is out of range or the device's workspace is no box.
    pub fn over(
        hand: u8,
        limits: DoorLimits,
        local: Box<dyn HapticDevice>,
    ) -> Result<(Self, StationEnd), LimitError> {
        let capabilities = local.capabilities().clone();
        let is_virtual = local.fork().is_some();
        let local = Local { device: local, is_virtual, open: false, retry_at_ns: 0, regained: None };
        Self::build(Door::new(hand, limits, &capabilities)?, capabilities, Some(local))
    }

    /// A hand without a local device, whose station has a device with these capabilities.
    ///
    /// # Errors
    /// [`LimitError`] when a limit is out of range or the workspace is no box.
    pub fn alone(
        hand: u8,
        limits: DoorLimits,
        capabilities: Capabilities,
    ) -> Result<(Self, StationEnd), LimitError> {
        Self::build(Door::new(hand, limits, &capabilities)?, capabilities, None)
    }

    fn build(
        door: Door,
        capabilities: Capabilities,
        local: Option<Local>,
    ) -> Result<(Self, StationEnd), LimitError> {
        let control = HandControl::default();
        let (post_input, posts) = triple_buffer(&None);
        let answer = HandAnswer::unknown();
        let (answers, answer_output) = triple_buffer(&answer);
        let end = StationEnd { posts: post_input, answers: answer_output, control: control.clone() };
        let hand = Self {
            capabilities,
            local_share: if local.is_some() { 1.0 } else { 0.0 },
            local,
            door,
            control,
            posts,
            answers,
            answer,
            open: false,
            owner: Owner::NOBODY,
            shown: None,
            read_at_ns: None,
            station_share: 0.0,
            lag_ns: 0,
        };
        Ok((hand, end))
    }

    /// Says which station has the hand.
    pub fn control(&self) -> &HandControl {
        &self.control
    }

    /// Who moves the hand, as of the latest reading.
    pub fn presence(&self) -> Presence {
        match (self.owner.station(), self.door.standing()) {
            (Some(station), Standing::Waiting) => Presence::Waiting(station),
            (Some(station), Standing::Live) => Presence::Live(station),
            (Some(station), Standing::Silent) => Presence::Silent(station),
            (Some(station), Standing::Unplugged) => Presence::Unplugged(station),
            (None, _) if self.local.is_some() => Presence::Local,
            (None, _) => Presence::Nobody,
        }
    }

    /// Follows a change of owner.
    fn follow_owner(&mut self, now_ns: u64) {
        let owner = self.control.owner();
        if owner == self.owner {
            return;
        }
        let had_station = self.owner.station().is_some();
        self.owner = owner;
        if owner.station().is_some() {
            self.station_share = 0.0;
            self.door.open(SimTime(now_ns), self.shown.as_ref());
        } else if let (Some(local), Some(shown), true) = (&mut self.local, &self.shown, had_station) {
            local.regain(now_ns, shown, self.control.holding());
        }
    }

    /// Brings the station's newest sample to the door, and gives the hand up if the station is lost.
    fn serve_station(&mut self, now_ns: u64, station: u16) -> DeviceState {
        let now = SimTime(now_ns);
        self.door.set_holding(self.control.holding());
        self.door.set_mirroring(self.control.mirroring());
        if self.posts.update()
            && let Some(post) = *self.posts.output_buffer()
        {
            if post.station == station {
                // The door counts what it refuses.
                let _ = self.door.admit(now, post.arrival, &post.sample);
                self.lag_ns = u64::from(post.sample.age_us) * 1_000;
            } else {
                self.answer.refused_station += 1;
            }
        }
        self.door.step(now)
    }

    fn station_is_lost(&self, now_ns: u64) -> bool {
        let age_secs = self.door.age(SimTime(now_ns)).as_secs_f64();
        self.owner.station().is_some() && self.local.is_some() && age_secs >= self.door.limits().lost_secs
    }

    /// Moves the motors' shares of the force to whoever moves the hand.
    fn fade(&mut self, step_secs: f64) {
        let live = self.owner.station().is_some() && self.door.standing() == Standing::Live;
        let local = self.owner.station().is_none() && self.local.is_some();
        let handover_secs = self.door.limits().handover_secs;
        let most = if handover_secs > 0.0 { step_secs / handover_secs } else { 1.0 };
        let towards =
            |share: f64, to: bool| if to { (share + most).min(1.0) } else { (share - most).max(0.0) };
        self.local_share = towards(self.local_share, local);
        self.station_share = towards(self.station_share, live);
    }

    fn publish(&mut self, now_ns: u64) {
        self.answer.at = SimTime(now_ns);
        self.answer.presence = self.presence();
        self.answer.state = self.shown.unwrap_or_else(DeviceState::unknown);
        self.answer.door = *self.door.statistics();
        self.answers.write(self.answer);
    }
}

impl Local {
    /// Follows a hand that comes back from a station.
    fn regain(&mut self, now_ns: u64, shown: &DeviceState, holding: bool) {
        if self.is_virtual {
            let intent = HandIntent::at(shown.pose_in_device, shown.gripper);
            self.device.resume(now_ns, &DeviceState { connected: true, ..*shown }, &intent);
        }
        let mut grip = GripMatch::following(shown.gripper);
        if holding {
            grip.unmatch();
        }
        self.regained = Some(Regained { clutch: None, grip, gate: PedalGate::default() });
    }

    fn open(&mut self, now_ns: u64) -> Result<(), DeviceError> {
        let opened = self.device.open(now_ns);
        self.open = opened.is_ok();
        self.retry_at_ns = now_ns.saturating_add(REOPEN_PERIOD_NS);
        opened
    }

    fn read(&mut self, now_ns: u64) -> Result<DeviceState, DeviceError> {
        let reading = self.device.read(now_ns);
        if reading == Err(DeviceError::Disconnected) {
            self.open = false;
        }
        reading
    }

    /// Keeps the device going while a station has the hand; returns its pedals. The rest of its state is of no use now, and
    /// its faults are of no consequence.
    fn idle(&mut self, now_ns: u64) -> u32 {
        if self.open {
            let state = self.read(now_ns).ok().filter(|state| state.connected);
            return state.map_or(0, |state| state.buttons & Pedals::MASK);
        }
        if now_ns >= self.retry_at_ns {
            let _ = self.open(now_ns);
        }
        0
    }

    /// The device's state as it is shown: offset since the hand came back from a station.
    fn shown(
        &mut self,
        state: DeviceState,
        before: Option<&DeviceState>,
        step_secs: f64,
        limits: &DoorLimits,
    ) -> DeviceState {
        let Some(regained) = &mut self.regained else { return state };
        if !state.is_valid() {
            // The driver refuses it.
            return state;
        }
        let clutch = *regained.clutch.get_or_insert_with(|| {
            let shown = before.map_or(state.pose_in_device, |before| before.pose_in_device);
            Clutch::between(&state.pose_in_device, &shown)
        });
        regained.grip.step(state.gripper, limits.gripper_speed * step_secs, limits.grip_match);
        DeviceState {
            pose_in_device: clutch.shown(&state.pose_in_device),
            gripper: regained.grip.angle(),
            buttons: regained.gate.pass(state.buttons),
            ..state
        }
    }

    /// The intent in the device's own frame, of one for the hand as it is shown.
    fn intent(&self, intent: &HandIntent) -> HandIntent {
        let clutch = self.regained.and_then(|regained| regained.clutch);
        let hand = |shown: &Isometry3<f64>| clutch.map_or(*shown, |clutch| clutch.hand(shown));
        HandIntent { pose_in_device: hand(&intent.pose_in_device), ..*intent }
    }
}

impl HapticDevice for RemoteHand {
    fn capabilities(&self) -> &Capabilities {
        &self.capabilities
    }

    fn open(&mut self, now_ns: u64) -> Result<(), DeviceError> {
        self.open = true;
        match &mut self.local {
            // A station's hand is there without it.
            Some(local) => match local.open(now_ns) {
                Err(_) if self.control.station().is_some() => Ok(()),
                opened => opened,
            },
            None => Ok(()),
        }
    }

    fn read(&mut self, now_ns: u64) -> Result<DeviceState, DeviceError> {
        if !self.open {
            return Err(DeviceError::NotOpen);
        }
        let elapsed_ns = self.read_at_ns.map_or(0, |before| now_ns.saturating_sub(before));
        let step_secs = (elapsed_ns as f64 * 1e-9).min(STEP_MAX_SECS);
        self.read_at_ns = Some(now_ns);
        self.follow_owner(now_ns);
        if self.station_is_lost(now_ns) {
            self.control.lose(self.owner);
            self.answer.lost += 1;
            self.follow_owner(now_ns);
        }
        self.fade(step_secs);
        let reading = match (self.owner.station(), &mut self.local) {
            (Some(station), local) => {
                let pedals = local.as_mut().map_or(0, |local| local.idle(now_ns));
                self.control.set_local_pedals(pedals);
                let mut state = self.serve_station(now_ns, station);
                if self.control.mirroring() {
                    // At a station the pedals are those of its own person, who takes a hand back by them.
                    state.buttons |= pedals;
                }
                Ok(state)
            }
            (None, Some(local)) => {
                let reading = local.read(now_ns);
                let pedals = reading.as_ref().ok().filter(|state| state.connected);
                self.control.set_local_pedals(pedals.map_or(0, |state| state.buttons));
                reading.map(|state| local.shown(state, self.shown.as_ref(), step_secs, self.door.limits()))
            }
            (None, None) => Ok(self.shown.as_ref().map_or_else(DeviceState::unknown, DeviceState::unplugged)),
        };
        match reading {
            // A hand without a place yet is no place to hold.
            Ok(state) if state.is_valid() && (state.connected || self.shown.is_some()) => {
                self.shown = Some(state);
            }
            Err(DeviceError::Disconnected) => self.shown = self.shown.map(|shown| shown.unplugged()),
            _ => {}
        }
        self.publish(now_ns);
        reading
    }

    fn lag_ns(&self) -> u64 {
        if self.owner.station().is_some() { self.lag_ns } else { 0 }
    }

    fn write(&mut self, now_ns: u64, wrench: &Wrench) -> Result<(), DeviceError> {
        if !self.open {
            return Err(DeviceError::NotOpen);
        }
        let wrench = if wrench.is_finite() { *wrench } else { Wrench::ZERO };
        self.answer.wrench = wrench * self.station_share;
        self.answer.local_wrench = wrench * self.local_share;
        self.publish(now_ns);
        let Some(local) = &mut self.local else { return Ok(()) };
        if !local.open {
            return if self.owner.station().is_some() { Ok(()) } else { Err(DeviceError::Disconnected) };
        }
        let written = local.device.write(now_ns, &(wrench * self.local_share));
        if written == Err(DeviceError::Disconnected) {
            local.open = false;
        }
        if self.owner.station().is_some() { Ok(()) } else { written }
    }

    fn set_intent(&mut self, now_ns: u64, intent: &HandIntent) {
        if let Some(local) = &mut self.local {
            let intent = local.intent(intent);
            local.device.set_intent(now_ns, &intent);
        }
    }

    fn close(&mut self) {
        self.open = false;
        (self.answer.wrench, self.answer.local_wrench) = (Wrench::ZERO, Wrench::ZERO);
        self.answers.write(self.answer);
        if let Some(local) = &mut self.local {
            local.open = false;
            local.device.close();
        }
    }

    /// A branch has no stations: a hand that was taken comes back to the local device in it.
    fn fork(&self) -> Option<Box<dyn HapticDevice>> {
        let local = match &self.local {
            Some(local) => Some(Local { device: local.device.fork()?, ..*local }),
            None => None,
        };
        let (fork, _) = Self::build(self.door.clone(), self.capabilities.clone(), local).ok()?;
        Some(Box::new(Self {
            open: self.open,
            owner: self.owner,
            shown: self.shown,
            read_at_ns: self.read_at_ns,
            local_share: self.local_share,
            station_share: self.station_share,
            answer: self.answer,
            ..fork
        }))
    }

    fn resume(&mut self, now_ns: u64, state: &DeviceState, intent: &HandIntent) {
        if !state.is_valid() || !intent.is_valid() {
            return;
        }
        self.shown = Some(*state);
        self.read_at_ns = Some(now_ns);
        if let Some(local) = &mut self.local {
            local.regained = None;
            local.device.resume(now_ns, state, intent);
        }
    }
}
