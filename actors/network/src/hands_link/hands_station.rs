//! The hands link of a station: its own hands go to the host, and the host's answers come back.

use trocar_devices::{HAS_PEDALS, Pedals};
use trocar_scene::SimTime;

use super::HandsLink;
use super::connection::Connection;
use super::exchange::{self, Ways};
use super::order::{HandNumbers, HandsNews, HandsOrder, LinkEnd};
use super::playout::{Played, Playout};
use crate::control::STATIONS_MAX;
use crate::datagram::{DATAGRAM_MAX, HANDS_MAX, Header};
use crate::hand_sample::{CLUTCHES, HandSample};
use crate::remote_hand::{PedalGate, Presence, StationEnd};

/// Orders that are taken at one tick.
const ORDERS_AT_ONCE: usize = 64;
/// The number by which the host counts as the station that moves a hand here, when it is taken over from elsewhere.
pub const HOST: u16 = 0;

/// How long the host's place must be shown before the own device goes on from there: some steps of its driver.
const PLACED_FOR: SimTime = SimTime::from_millis(20);
/// Longest time for a hand to come to where the host has it; then its own device goes on from where it is.
const PLACING_MAX: SimTime = SimTime::from_millis(2_000);
/// Pedals that nobody speaks of for so long count as released.
const PEDALS_HELD: SimTime = SimTime::from_millis(100);
/// What counts as being there \[m\], [rad].
const PLACE_TOLERANCE: (f64, f64) = (1e-5, 1e-4);

/// A hand whose device is here, or that is shown here while another station serves it.
///
/// Its instrument is at the host. Whenever the host takes the hand's motion up anew (it joins, it comes back after a
/// silence, it was handed over), the device's link first brings the hand as it is shown here to where the host has it, and
/// holds it there until the host has taken it up; only then its own device goes on, from there. So both ends show the hand
/// at the same place, however long the first samples are on their way.
pub struct StationHand {
    number: u8,
    end: StationEnd,
    /// Whether it is to be brought to the host's place, and since when that has been known.
    is_placing: bool,
    placing_since: Option<SimTime>,
    /// Since when it has been there.
    there_since: Option<SimTime>,
    /// Since when it has been held there for the host to take it up.
    offered_since: Option<SimTime>,
    /// The host's count of clutches; `None` until the clutch of the present stretch is seen.
    clutch: Option<u8>,
    /// The count when the hand was offered.
    clutch_before: u8,
    /// How often the hand was offered, modulo [`CLUTCHES`].
    offers: u8,
    /// What the person at the station does with its pedals, and when that was said.
    pedals: (Pedals, SimTime),
    gate: PedalGate,
    /// When samples of another station's hand are played, if those come at all.
    playout: Option<Playout>,
}

impl StationHand {
    /// The hand of this number, by the link of its device.
    pub fn new(number: u8, end: StationEnd) -> Self {
        end.control().set_mirroring(true);
        end.control().take(HOST);
        Self {
            number,
            end,
            is_placing: false,
            placing_since: None,
            there_since: None,
            offered_since: None,
            clutch: None,
            clutch_before: 0,
            offers: 0,
            pedals: (Pedals::None, SimTime::ZERO),
            gate: PedalGate::default(),
            playout: None,
        }
    }

    /// Follows the hand, while another station serves it, this long after it was measured there.
    #[must_use]
    pub fn following(self, delay: SimTime) -> Self {
        Self { playout: Some(Playout::new(delay)), ..self }
    }

    /// The hand goes to where the host has it.
    fn place(&mut self) {
        self.end.control().take(HOST);
        (self.is_placing, self.placing_since, self.there_since) = (true, None, None);
        (self.offered_since, self.clutch) = (None, None);
        self.playout.iter_mut().for_each(Playout::clear);
    }

    /// Nobody here moves it any more.
    fn leave(&mut self) {
        self.end.control().take(HOST);
        (self.is_placing, self.placing_since, self.there_since) = (false, None, None);
        (self.offered_since, self.clutch) = (None, None);
    }

    /// The host tells where it has the hand.
    fn hear(&mut self, now: SimTime, sample: &HandSample) {
        if !self.is_placing {
            match self.clutch {
                Some(clutch) if clutch != sample.clutch => self.place(),
                None if sample.clutch != self.clutch_before => self.clutch = Some(sample.clutch),
                _ => {}
            }
            return;
        }
        let since = *self.placing_since.get_or_insert(now);
        if sample.state.connected {
            // The host may have been silent for so long that it has lost the hand.
            self.end.control().take_again(HOST);
            // The host's pedals are this person's own, as they came there.
            let mut place = *sample;
            place.state.buttons &= !Pedals::MASK;
            self.end.post(HOST, now, &place);
        }
        if let Some(offered) = self.offered_since {
            let is_taken_up = sample.clutch != self.clutch_before;
            if is_taken_up || now.since(offered) >= PLACING_MAX {
                self.clutch = is_taken_up.then_some(sample.clutch);
                (self.is_placing, self.offered_since) = (false, None);
                self.end.control().give_back();
            }
            return;
        }
        let answer = self.end.answer();
        let (far, turned) = PLACE_TOLERANCE;
        let (shown, there) = (&answer.state.pose_in_device, &sample.state.pose_in_device);
        let is_there = answer.presence == Presence::Live(HOST)
            && (shown.translation.vector - there.translation.vector).norm() <= far
            && shown.rotation.angle_to(&there.rotation) <= turned;
        self.there_since = if is_there { self.there_since.or(Some(now)) } else { None };
        let is_placed = self.there_since.is_some_and(|there| now.since(there) >= PLACED_FOR);
        if is_placed || now.since(since) >= PLACING_MAX {
            self.clutch_before = sample.clutch;
            (self.placing_since, self.there_since) = (None, None);
            self.offered_since = Some(now);
            self.offers = (self.offers + 1) % CLUTCHES;
        }
    }

    /// Shows the hand of another station, if the host sends it.
    fn play(&mut self, now: SimTime) {
        if let Some(Played { arrived_at, sample }) =
            self.playout.as_mut().and_then(|playout| playout.play(now))
        {
            self.end.control().take_again(HOST);
            self.end.post(HOST, arrived_at, &sample);
        }
    }

    /// The person does this with the pedals. After a time in which nobody has spoken of them, a pedal counts once it has been
    /// released.
    fn press(&mut self, now: SimTime, pedals: Pedals) {
        if now.since(self.pedals.1) > PEDALS_HELD {
            self.gate.close();
        }
        let buttons = pedals.buttons();
        let passed = self.gate.pass(buttons & !HAS_PEDALS) | (buttons & HAS_PEDALS);
        self.pedals = (Pedals::of(passed), now);
    }

    /// The pedals as they count now, as bits of the buttons.
    fn pedals(&self, now: SimTime) -> u32 {
        match self.pedals {
            (Pedals::None, _) => Pedals::None,
            (pedals, at) if now.since(at) <= PEDALS_HELD => pedals,
            _ => Pedals::Released,
        }
        .buttons()
    }

    /// Whether the host is to follow it: its own device moves it, or it is held for the host to take it up.
    fn is_sent(&self) -> bool {
        self.offered_since.is_some() || (!self.is_placing && self.end.control().station().is_none())
    }
}

/// A connection to another station.
struct PairLink<A> {
    station: u16,
    connection: Box<Connection<A>>,
    to: Option<A>,
    serves: HandNumbers,
    is_worn: bool,
}

/// The connection of a station to its host, and those to other stations. Does not allocate after it was made, but for what its
/// orders own.
pub struct HandsStation<A> {
    pairs: Vec<PairLink<A>>,
    hands: Vec<StationHand>,
    serves: HandNumbers,
    host: Option<A>,
    connection: Option<Box<Connection<A>>>,
    is_worn: bool,
    controller: LinkEnd<A>,
    samples: Vec<HandSample>,
    out: [u8; DATAGRAM_MAX],
    refused: u64,
}

impl<A: Copy + PartialEq> HandsStation<A> {
    /// A station with these hands.
    pub fn new(hands: Vec<StationHand>, controller: LinkEnd<A>) -> Self {
        Self {
            pairs: Vec::with_capacity(STATIONS_MAX),
            hands,
            serves: HandNumbers::default(),
            host: None,
            connection: None,
            is_worn: false,
            controller,
            samples: Vec::with_capacity(HANDS_MAX),
            out: [0; DATAGRAM_MAX],
            refused: 0,
        }
    }

    /// Datagrams that were refused.
    pub fn refused(&self) -> u64 {
        self.refused
    }

    /// The connection, if there is one.
    pub fn connection(&self) -> Option<&Connection<A>> {
        self.connection.as_deref()
    }

    fn obey(&mut self, order: HandsOrder<A>, now: SimTime, send: &mut dyn FnMut(A, &[u8]) -> bool) {
        match order {
            HandsOrder::Open { mut connection, peer, .. } => {
                self.host = peer.or(self.host);
                if let Some(before) = &self.connection {
                    *connection.way_mut() = before.way().again();
                }
                self.close();
                self.is_worn = false;
                // The hands that it serves are told anew, and placed anew.
                self.serves = HandNumbers::default();
                self.connection = Some(connection);
            }
            HandsOrder::Serve { connection, hands } => {
                let followed =
                    self.hands.iter().filter(|hand| hand.playout.is_some()).map(|hand| hand.number);
                let others = followed.filter(|number| !hands.as_slice().contains(number));
                let expected = HandNumbers::new(hands.as_slice().iter().copied().chain(others));
                if self.open(connection).is_some_and(|open| open.expect_hands(expected.as_slice()).is_ok()) {
                    self.serve(hands);
                }
            }
            HandsOrder::Press { hand, pedals } => {
                if let Some(hand) = self.hands.iter_mut().find(|known| known.number == hand) {
                    hand.press(now, pedals);
                }
            }
            HandsOrder::Place => {
                let serves = self.serves;
                let is_served = |hand: &&mut StationHand| serves.as_slice().contains(&hand.number);
                self.hands.iter_mut().filter(is_served).for_each(StationHand::place);
            }
            HandsOrder::Send { connection, parcel } => {
                let Self { host, connection: open, controller, out, .. } = self;
                if let Some(open) = open.as_deref_mut().filter(|open| open.id() == connection) {
                    exchange::send_parcel(open, *host, &parcel, now, Ways { controller, send, out });
                }
            }
            HandsOrder::Carried { connection, mut datagram } => {
                if self.open(connection).is_some() {
                    self.take(now, None, datagram.bytes_mut(), send);
                }
            }
            HandsOrder::Heard { connection, is_heard } => {
                if let Some(open) = self.open(connection) {
                    open.heard(is_heard);
                }
            }
            HandsOrder::RekeyOpener { connection, key } => {
                // A key that does not fit leaves the present one in use; the host asks for another phase.
                let _ = self.open(connection).map(|open| open.rekey_opener(now, key));
            }
            HandsOrder::RekeySealer { connection, key } => {
                if self.open(connection).is_some_and(|open| open.rekey_sealer(key).is_ok()) {
                    self.is_worn = false;
                }
            }
            HandsOrder::Close { connection } => {
                if self.open(connection).is_some() {
                    self.close();
                }
            }
            HandsOrder::CloseAll => {
                self.close();
                while let Some(pair) = self.pairs.pop() {
                    self.controller.tell(HandsNews::Closed(pair.connection));
                }
            }
            HandsOrder::OpenPair { station, connection, peer } => {
                self.close_pair(station);
                if self.pairs.len() < STATIONS_MAX {
                    let serves = HandNumbers::default();
                    self.pairs.push(PairLink { station, connection, to: peer, serves, is_worn: false });
                } else {
                    self.controller.tell(HandsNews::Closed(connection));
                }
            }
            HandsOrder::ServePair { station, hands } => {
                if let Some(pair) = self.pairs.iter_mut().find(|pair| pair.station == station)
                    && pair.connection.expect_hands(hands.as_slice()).is_ok()
                {
                    pair.serves = hands;
                }
            }
            HandsOrder::ClosePair { station } => self.close_pair(station),
            // Nobody diagnoses the path to a station.
            HandsOrder::Echo(echo) => {
                self.controller.tell(HandsNews::EchoEnded(echo));
            }
        }
    }

    fn close_pair(&mut self, station: u16) {
        if let Some(at) = self.pairs.iter().position(|pair| pair.station == station) {
            let pair = self.pairs.swap_remove(at);
            self.controller.tell(HandsNews::Closed(pair.connection));
        }
    }

    /// Takes a datagram of another station: the hands that it serves, as the host says.
    fn take_of_pair(
        &mut self,
        at: usize,
        now: SimTime,
        from: A,
        datagram: &mut [u8],
        send: &mut dyn FnMut(A, &[u8]) -> bool,
    ) {
        let Self { pairs, hands, serves, controller, out, .. } = self;
        let PairLink { connection, serves: theirs, .. } = &mut pairs[at];
        match exchange::take(connection, now, Some(from), datagram, Ways { controller, send, out }) {
            Ok(true) => {
                let own = serves.as_slice();
                for sample in connection.samples() {
                    let is_theirs = theirs.as_slice().contains(&sample.hand) && !own.contains(&sample.hand);
                    if is_theirs
                        && let Some(hand) = hands.iter_mut().find(|hand| hand.number == sample.hand)
                        && let Some(playout) = &mut hand.playout
                    {
                        playout.push(now, connection.measured_at(sample.hand, now), sample);
                    }
                }
            }
            Ok(false) => {}
            Err(_) => self.refused += 1,
        }
    }

    /// The connection, if it is the one of this number.
    fn open(&mut self, id: u32) -> Option<&mut Connection<A>> {
        self.connection.as_deref_mut().filter(|connection| connection.id() == id)
    }

    /// Takes a datagram, which came from an address or was carried.
    fn take(
        &mut self,
        now: SimTime,
        from: Option<A>,
        datagram: &mut [u8],
        send: &mut dyn FnMut(A, &[u8]) -> bool,
    ) {
        let Self { hands, connection: Some(connection), controller, out, serves, .. } = self else {
            self.refused += 1;
            return;
        };
        match exchange::take(connection, now, from, datagram, Ways { controller, send, out }) {
            Ok(true) => {
                for sample in connection.samples() {
                    let Some(hand) = hands.iter_mut().find(|hand| hand.number == sample.hand) else {
                        continue;
                    };
                    if serves.as_slice().contains(&sample.hand) {
                        hand.hear(now, sample);
                    } else if let Some(playout) = &mut hand.playout {
                        playout.push(now, connection.measured_at(sample.hand, now), sample);
                    }
                }
            }
            Ok(false) => {}
            Err(_) => self.refused += 1,
        }
    }

    fn serve(&mut self, hands: HandNumbers) {
        for hand in &mut self.hands {
            let served = |numbers: &HandNumbers| numbers.as_slice().contains(&hand.number);
            match (served(&self.serves), served(&hands)) {
                (false, true) => hand.place(),
                (true, false) => hand.leave(),
                _ => {}
            }
        }
        self.serves = hands;
    }

    fn close(&mut self) {
        if let Some(connection) = self.connection.take() {
            self.controller.tell(HandsNews::Closed(connection));
        }
    }
}

impl<A: Copy + PartialEq + Send + 'static> HandsLink<A> for HandsStation<A> {
    fn receive(
        &mut self,
        now: SimTime,
        from: A,
        datagram: &mut [u8],
        send: &mut dyn FnMut(A, &[u8]) -> bool,
    ) {
        let id = Header::decode(datagram).ok().map(|header| header.connection);
        match self.pairs.iter().position(|pair| Some(pair.connection.id()) == id) {
            Some(at) => self.take_of_pair(at, now, from, datagram, send),
            None => self.take(now, Some(from), datagram, send),
        }
    }

    fn tick(&mut self, now: SimTime, send: &mut dyn FnMut(A, &[u8]) -> bool) {
        for _ in 0..ORDERS_AT_ONCE {
            let Ok(order) = self.controller.orders.pop() else { break };
            self.obey(order, now, send);
        }
        let Self {
            hands,
            serves,
            host,
            connection: Some(connection),
            pairs,
            is_worn,
            controller,
            samples,
            out,
            ..
        } = self
        else {
            return;
        };
        let others = hands.iter_mut().filter(|hand| !serves.as_slice().contains(&hand.number));
        others.for_each(|hand| hand.play(now));
        samples.clear();
        for number in serves.as_slice() {
            // The age of the host's answer is counted for the figures of the link.
            let _ = connection.read(*number, now);
            let own = hands.iter_mut().find(|hand| hand.number == *number && hand.is_sent());
            if let Some(hand) = own {
                samples.push(shown(hand, now));
            }
        }
        exchange::send_due(connection, *host, samples, is_worn, now, Ways { controller, send, out });
        for PairLink { connection, to, is_worn, .. } in pairs.iter_mut() {
            let to = connection.address().or(*to);
            exchange::send_due(connection, to, samples, is_worn, now, Ways { controller, send, out });
        }
    }

    fn is_idle(&self) -> bool {
        self.connection.is_none()
    }
}

/// A hand as its device shows it, as a sample.
fn shown(hand: &mut StationHand, now: SimTime) -> HandSample {
    let pedals = hand.pedals(now);
    let answer = hand.end.answer();
    let age = now.since(answer.at).as_nanos() / 1_000;
    let mut state = answer.state;
    state.buttons |= pedals;
    HandSample {
        hand: hand.number,
        state,
        wrench: answer.local_wrench,
        grabbed: None,
        age_us: u32::try_from(age).unwrap_or(u32::MAX),
        clutch: hand.offers,
    }
}
