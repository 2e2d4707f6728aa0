//! The two ends of a remote hand that are not its driver's: the link's, which brings samples and fetches wrenches, and
//! the session's, which says which station has the hand.
//!
//! Wait-free in both directions (triple buffers, as between a driver and its controller); the owner is one atomic
//! number.

use std::fmt;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, AtomicU64, Ordering};

use triple_buffer::{Input, Output};
use trocar_devices::{DeviceState, Pedals, Wrench};
use trocar_scene::SimTime;

use super::door::{Arrival, DoorStatistics};
use crate::hand_sample::HandSample;

/// Who moves the hand at present.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Presence {
    /// The local device.
    Local,
    /// Nobody, and there is no local device: the hand is held and shown as unplugged.
    Nobody,
    /// A station that has taken it, and has not sent anything yet: the hand is held.
    Waiting(u16),
    /// A station.
    Live(u16),
    /// A station that has fallen silent: the hand is held and still connected.
    Silent(u16),
    /// A station whose device is unplugged: the hand is held and shown as unplugged.
    Unplugged(u16),
}

/// What the hand answers the station.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HandAnswer {
    /// When (session time).
    pub at: SimTime,
    /// Who moves the hand.
    pub presence: Presence,
    /// The wrench for the station's motors, in the device's frame: faded in after the station took the hand or
    /// returned, and faded out after it fell silent.
    pub wrench: Wrench,
    /// The wrench for the local device's motors, in the device's frame; zero while a station has the hand.
    pub local_wrench: Wrench,
    /// The hand as it is shown here, behind door and clutch.
    pub state: DeviceState,
    /// Counters of the door.
    pub door: DoorStatistics,
    /// Samples of stations that do not have the hand.
    pub refused_station: u64,
    /// Times at which a local device took over because the station was silent for too long.
    pub lost: u64,
}

impl HandAnswer {
    pub(super) fn unknown() -> Self {
        Self {
            at: SimTime::ZERO,
            presence: Presence::Nobody,
            wrench: Wrench::ZERO,
            local_wrench: Wrench::ZERO,
            state: DeviceState::unknown(),
            door: DoorStatistics::default(),
            refused_station: 0,
            lost: 0,
        }
    }
}

/// A sample as the link brings it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Post {
    pub station: u16,
    pub arrival: Arrival,
    pub sample: HandSample,
}

/// Who has the hand: (number of the change << 32) | (station + 1), where a station of 0 means nobody. The number makes
/// two takes by one station different.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Owner(u64);

impl Owner {
    pub const NOBODY: Self = Self(0);

    pub fn station(self) -> Option<u16> {
        u16::try_from((self.0 & 0xffff_ffff).checked_sub(1)?).ok()
    }

    fn number(self) -> u64 {
        self.0 >> 32
    }

    fn next(self, station: Option<u16>) -> Self {
        let number = (self.0 >> 32).wrapping_add(1) & 0xffff_ffff;
        Self((number << 32) | station.map_or(0, |station| u64::from(station) + 1))
    }
}

#[derive(Debug, Default)]
struct Shared {
    owner: AtomicU64,
    /// Whom the hand was taken from for silence, as an [`Owner`] with the number of that change; 0 if from nobody.
    lost: AtomicU64,
    holding: AtomicBool,
    mirroring: AtomicBool,
    /// Pedals of the local device, as bits of its buttons.
    local_pedals: AtomicU32,
}

/// Says which station has a hand; clones share it. No method blocks.
#[derive(Clone, Debug, Default)]
pub struct HandControl {
    shared: Arc<Shared>,
}

impl HandControl {
    /// Gives the hand to a station, from the hand's next step on; whoever had it before loses it. Nothing moves by
    /// this: the hand is held until the station's first sample, and from then on follows the station's motion.
    pub fn take(&self, station: u16) {
        self.change(|_| Some(Some(station)));
    }

    /// Takes the hand from whatever station has it: the local device takes over, or nobody.
    pub fn give_back(&self) {
        self.shared.lost.store(0, Ordering::Release);
        self.change(|owner| owner.station().map(|_| None));
    }

    /// Takes the hand from this station, if it has it: for a station that left or died.
    pub fn give_back_from(&self, station: u16) {
        // Whoever left does not come back out of a silence.
        if Owner(self.shared.lost.load(Ordering::Acquire)).station() == Some(station) {
            self.shared.lost.store(0, Ordering::Release);
        }
        self.change(|owner| (owner.station() == Some(station)).then_some(None));
    }

    /// Gives the hand back to a station that it was taken from because it was silent for too long; nothing happens if
    /// anybody else has decided meanwhile.
    pub fn take_again(&self, station: u16) {
        let (owner, lost) = (self.owner(), Owner(self.shared.lost.load(Ordering::Acquire)));
        if owner.station().is_none() && lost.station() == Some(station) && lost.number() == owner.number() {
            let next = owner.next(Some(station)).0;
            let _ = self.shared.owner.compare_exchange(owner.0, next, Ordering::AcqRel, Ordering::Acquire);
        }
    }

    /// The station that has the hand.
    pub fn station(&self) -> Option<u16> {
        self.owner().station()
    }

    /// Says whether the instrument holds something: the jaws then wait, at the next change of owner or return from
    /// silence, until the new fingers have closed to them.
    pub fn set_holding(&self, holding: bool) {
        self.shared.holding.store(holding, Ordering::Release);
    }

    /// Says whether the hand goes to the place that its station names, rather than follow its motion from where it is:
    /// for a station's own hand, which the host shows where it is.
    pub fn set_mirroring(&self, mirroring: bool) {
        self.shared.mirroring.store(mirroring, Ordering::Release);
    }

    /// What the pedals of the local device say, also while a station has the hand: by them its person takes the hand back.
    pub fn local_pedals(&self) -> Pedals {
        Pedals::of(self.shared.local_pedals.load(Ordering::Acquire))
    }

    pub(super) fn set_local_pedals(&self, buttons: u32) {
        self.shared.local_pedals.store(buttons & Pedals::MASK, Ordering::Release);
    }

    pub(super) fn mirroring(&self) -> bool {
        self.shared.mirroring.load(Ordering::Acquire)
    }

    pub(super) fn holding(&self) -> bool {
        self.shared.holding.load(Ordering::Acquire)
    }

    pub(super) fn owner(&self) -> Owner {
        Owner(self.shared.owner.load(Ordering::Acquire))
    }

    /// Takes the hand from a station that was lost, unless somebody else has taken it meanwhile.
    pub(super) fn lose(&self, owner: Owner) {
        let next = owner.next(None);
        let order = (Ordering::AcqRel, Ordering::Acquire);
        // A failure means that somebody else has decided, which is as good.
        if self.shared.owner.compare_exchange(owner.0, next.0, order.0, order.1).is_ok() {
            let lost = next.0 | (owner.0 & 0xffff_ffff);
            self.shared.lost.store(lost, Ordering::Release);
        }
    }

    fn change(&self, to: impl Fn(Owner) -> Option<Option<u16>>) {
        let next = |owner| to(Owner(owner)).map(|station| Owner(owner).next(station).0);
        // Refused by `to`: the hand stays where it is.
        let _ = self.shared.owner.fetch_update(Ordering::AcqRel, Ordering::Acquire, next);
    }
}

/// The link's end of a remote hand. No method allocates, locks or blocks.
pub struct StationEnd {
    pub(super) posts: Input<Option<Post>>,
    pub(super) answers: Output<HandAnswer>,
    pub(super) control: HandControl,
}

impl fmt::Debug for StationEnd {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("StationEnd").field("station", &self.control.station()).finish_non_exhaustive()
    }
}

impl StationEnd {
    /// Brings the newest sample of a station, with the time of its arrival. Samples of a station that does not have the
    /// hand are counted by the hand and have no effect.
    pub fn post(&mut self, station: u16, arrival: impl Into<Arrival>, sample: &HandSample) {
        self.posts.write(Some(Post { station, arrival: arrival.into(), sample: *sample }));
    }

    /// The newest answer of the hand.
    pub fn answer(&mut self) -> &HandAnswer {
        self.answers.read()
    }

    /// Says which station has the hand.
    pub fn control(&self) -> &HandControl {
        &self.control
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_takes_by_one_station_are_two_changes() {
        let control = HandControl::default();
        assert_eq!((control.owner(), control.station()), (Owner::NOBODY, None));
        control.take(0);
        let first = control.owner();
        control.give_back();
        control.take(0);
        assert_eq!(control.station(), Some(0));
        assert_ne!(control.owner(), first);
        control.take(u16::MAX);
        assert_eq!(control.station(), Some(u16::MAX));
    }

    #[test]
    fn a_hand_that_was_lost_in_a_silence_returns_to_its_station_unless_somebody_has_decided() {
        let control = HandControl::default();
        control.take_again(3);
        assert_eq!(control.station(), None, "it never had it");
        let lose = || {
            control.take(3);
            control.lose(control.owner());
            assert_eq!(control.station(), None);
        };
        lose();
        control.take_again(4);
        assert_eq!(control.station(), None, "another's");
        control.take_again(3);
        assert_eq!(control.station(), Some(3));
        lose();
        control.take(5);
        control.give_back_from(5);
        control.take_again(3);
        assert_eq!(control.station(), None, "it was another's meanwhile");
        lose();
        control.give_back();
        control.take_again(3);
        assert_eq!(control.station(), None, "it was given back");
        lose();
        control.give_back_from(3);
        control.take_again(3);
        assert_eq!(control.station(), None, "the station left");
    }

    #[test]
    fn a_station_that_leaves_takes_no_hand_from_another() {
        let control = HandControl::default();
        control.take(3);
        let lost = control.owner();
        control.give_back_from(4);
        assert_eq!(control.station(), Some(3));
        control.take(5);
        control.lose(lost);
        assert_eq!(control.station(), Some(5));
        control.give_back_from(5);
        assert_eq!(control.station(), None);
        let nobody = control.owner();
        control.give_back();
        assert_eq!(control.owner(), nobody, "nothing to give back");
    }
}
