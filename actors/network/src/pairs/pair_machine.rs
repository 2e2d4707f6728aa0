//! The machine of a station's pairs: it invites, lets in, dials, and gives the hands link its connections.

use std::collections::BTreeMap;

use trocar_scene::SimTime;

use super::invitation::{Invitation, TOKEN_BYTES, connection_of};
use crate::control::{STATIONS_MAX, StationInfo};
use crate::datagram::{Keys, Side};
use crate::hands_link::{Connection, ControllerEnd, HandNumbers, HandsOrder};
use crate::haptic::SenderConfig;
use crate::streams::{HostStreams, StationStream, StreamId, StreamState};

/// Longest time from a stream's opening to its token.
pub const OPENING_MAX: SimTime = SimTime::from_millis(5_000);
/// Time between two invitations of a station that does not come.
pub const INVITE_EVERY: SimTime = SimTime::from_millis(2_000);
/// Time between two attempts to dial a station.
pub const DIAL_EVERY: SimTime = SimTime::from_millis(3_000);
/// Most streams whose token has not come.
const OPENERS_MAX: usize = 8;
/// Number and token.
const HELLO_BYTES: usize = 2 + TOKEN_BYTES;
/// What lets in.
const WELCOME: u8 = 1;

/// How a driver lets others in, and dials them.
pub trait PairDoor<A>: Send + 'static {
    /// The streams of those who come.
    fn streams(&mut self) -> &mut dyn HostStreams;
    /// What others need to find the door; at most 2 KiB.
    fn place(&self) -> Vec<u8>;
    /// A token that nobody guesses; `None` when the system has no randomness.
    fn token(&self) -> Option<[u8; TOKEN_BYTES]>;
    /// A stream to another door.
    ///
    /// # Errors
    /// When there can be no door at that place.
    fn dial(&mut self, place: &[u8]) -> Result<Box<dyn StationStream<A>>, String>;
}

/// A stream of somebody who has come.
struct Guest {
    since: SimTime,
    received: Vec<u8>,
    /// Once the token was right.
    station: Option<u16>,
    /// Whether it has been told that it is in.
    is_told: bool,
}

/// A station that has invited this one.
struct Dialled<A> {
    invitation: Invitation,
    stream: Option<Box<dyn StationStream<A>>>,
    /// How much of the opening has gone.
    sent: usize,
    is_open: bool,
    dial_at: SimTime,
}

/// All pairs of a station.
pub struct PairMachine<A> {
    door: Box<dyn PairDoor<A>>,
    hands: ControllerEnd<A>,
    sender: SenderConfig,
    secret: u64,
    me: u16,
    /// Tokens that were given out, by the station that was invited, and when that was last.
    given: BTreeMap<u16, ([u8; TOKEN_BYTES], SimTime)>,
    guests: BTreeMap<StreamId, Guest>,
    dialled: BTreeMap<u16, Dialled<A>>,
    /// The hands of each station with which there is a pair.
    served: BTreeMap<u16, Vec<u8>>,
    opened: Vec<StreamId>,
}

impl<A: Copy + PartialEq + Send + 'static> PairMachine<A> {
    /// No pairs yet. `secret` is random.
    pub fn new(
        door: Box<dyn PairDoor<A>>,
        hands: ControllerEnd<A>,
        sender: SenderConfig,
        secret: u64,
    ) -> Self {
        Self {
            door,
            hands,
            sender,
            secret,
            me: 0,
            given: BTreeMap::new(),
            guests: BTreeMap::new(),
            dialled: BTreeMap::new(),
            served: BTreeMap::new(),
            opened: Vec::new(),
        }
    }

    /// The stations with which there is a pair.
    pub fn stations(&self) -> impl Iterator<Item = u16> + '_ {
        self.served.keys().copied()
    }

    /// Somebody has invited this station. What is no invitation has no effect.
    pub fn invited(&mut self, from: u16, invitation: &[u8], now: SimTime) {
        let Ok(invitation) = Invitation::read(invitation) else { return };
        if self.dialled.len() >= STATIONS_MAX && !self.dialled.contains_key(&from) {
            return;
        }
        if self.dialled.get(&from).is_some_and(|dialled| dialled.invitation == invitation) {
            return;
        }
        self.dialled.remove(&from);
        self.end(from);
        let dialled = Dialled { invitation, stream: None, sent: 0, is_open: false, dial_at: now };
        self.dialled.insert(from, dialled);
    }

    /// One step of station `me`, with who is in the session; returns invitations to be passed on.
    pub fn step(&mut self, now: SimTime, me: u16, stations: &[StationInfo]) -> Vec<(u16, Vec<u8>)> {
        self.me = me;
        self.forget_gone(stations);
        let invitations = self.invite(now, stations);
        self.let_in(now);
        self.dial(now);
        self.follow_roster(stations);
        invitations
    }

    fn forget_gone(&mut self, stations: &[StationInfo]) {
        let is_there = |number: &u16| stations.iter().any(|info| info.number == *number);
        self.given.retain(|station, _| is_there(station));
        let gone: Vec<u16> = self
            .dialled
            .keys()
            .chain(self.served.keys())
            .copied()
            .filter(|station| !is_there(station))
            .collect();
        for station in gone {
            self.dialled.remove(&station);
            self.end(station);
        }
    }

    fn invite(&mut self, now: SimTime, stations: &[StationInfo]) -> Vec<(u16, Vec<u8>)> {
        let may = stations.iter().any(|info| info.number == self.me && info.role.may_operate());
        let mut invitations = Vec::new();
        for info in stations.iter().filter(|info| may && info.is_here && info.number > self.me) {
            let given = self.given.get(&info.number).copied();
            let waits = given.is_some_and(|(_, at)| now.since(at) < INVITE_EVERY);
            if waits || self.served.contains_key(&info.number) {
                continue;
            }
            // An invitation may have come before the other station was ready for it.
            let Some(token) = given.map(|(token, _)| token).or_else(|| self.door.token()) else { continue };
            self.given.insert(info.number, (token, now));
            invitations.push((info.number, Invitation { token, door: self.door.place() }.to_bytes()));
        }
        invitations
    }

    /// Takes those who come, and looks at their tokens.
    fn let_in(&mut self, now: SimTime) {
        let streams = self.door.streams();
        streams.work(now, &mut self.opened);
        for stream in self.opened.drain(..) {
            let openers = self.guests.values().filter(|guest| guest.station.is_none()).count();
            if openers >= OPENERS_MAX {
                streams.close(stream);
                continue;
            }
            let guest = Guest { since: now, received: Vec::new(), station: None, is_told: false };
            self.guests.insert(stream, guest);
        }
        let (mut over, mut entered) = (Vec::new(), Vec::new());
        for (stream, guest) in &mut self.guests {
            let streams = self.door.streams();
            let received = streams.receive(*stream, now, HELLO_BYTES, &mut guest.received);
            let is_over = received.is_err()
                || guest.received.len() > HELLO_BYTES
                || (guest.station.is_none() && now.since(guest.since) >= OPENING_MAX);
            if is_over {
                over.push((*stream, guest.station));
                continue;
            }
            if guest.station.is_none() && guest.received.len() == HELLO_BYTES {
                match known(&self.given, &guest.received) {
                    Some((station, token)) => {
                        guest.station = Some(station);
                        entered.push((*stream, station, connection_of(&token)));
                    }
                    None => over.push((*stream, None)),
                }
            }
            if guest.station.is_some() && !guest.is_told {
                guest.is_told = streams.send(*stream, now, &[WELCOME]) == Ok(1);
            }
        }
        for (stream, station, id) in entered {
            let keys = self.door.streams().keys(stream, id, 0);
            if !self.open(station, id, keys, Side::Server, None) {
                over.push((stream, Some(station)));
            }
        }
        for (stream, station) in over {
            self.door.streams().close(stream);
            self.guests.remove(&stream);
            // A newer stream of the same station goes on.
            let has_other = self.guests.values().any(|guest| guest.station == station);
            if let Some(station) = station.filter(|_| !has_other) {
                self.end(station);
            }
        }
    }

    /// Goes on with the stations that are to be dialled.
    fn dial(&mut self, now: SimTime) {
        let (mut over, mut entered) = (Vec::new(), Vec::new());
        for (station, dialled) in &mut self.dialled {
            let Some(stream) = &mut dialled.stream else {
                if now >= dialled.dial_at {
                    dialled.dial_at = now + DIAL_EVERY;
                    (dialled.sent, dialled.is_open) = (0, false);
                    dialled.stream = self.door.dial(&dialled.invitation.door).ok().map(|mut stream| {
                        stream.connect(now);
                        stream
                    });
                }
                continue;
            };
            match stream.work(now) {
                StreamState::Open => {}
                StreamState::Connecting => continue,
                StreamState::None | StreamState::Closed(_) => {
                    over.push(*station);
                    continue;
                }
            }
            if dialled.sent < HELLO_BYTES {
                let hello = [&self.me.to_le_bytes()[..], &dialled.invitation.token].concat();
                match stream.send(now, &hello[dialled.sent..]) {
                    Ok(count) => dialled.sent += count,
                    Err(_) => over.push(*station),
                }
                continue;
            }
            let mut answer = Vec::new();
            if stream.receive(now, HELLO_BYTES, &mut answer).is_err() {
                over.push(*station);
            } else if answer.first() == Some(&WELCOME) && !dialled.is_open {
                dialled.is_open = true;
                let id = dialled.invitation.connection();
                entered.push((*station, id, stream.keys(id, 0), stream.peer()));
            }
        }
        for (station, id, keys, peer) in entered {
            if !self.open(station, id, keys, Side::Client, peer) {
                over.push(station);
            }
        }
        for station in over {
            if let Some(dialled) = self.dialled.get_mut(&station)
                && let Some(mut stream) = dialled.stream.take()
            {
                stream.close();
            }
            self.end(station);
        }
    }

    fn open(&mut self, station: u16, id: u32, keys: Option<Keys>, side: Side, peer: Option<A>) -> bool {
        let secret = self.secret ^ u64::from(id).wrapping_mul(0x9E37_79B9_7F4A_7C15);
        let made = keys.and_then(|keys| Connection::new(id, keys, side, &[], &self.sender, secret).ok());
        let Some(connection) = made.map(Box::new) else { return false };
        let is_open = self.hands.order(HandsOrder::OpenPair { station, connection, peer });
        if is_open {
            self.served.insert(station, Vec::new());
        }
        is_open
    }

    fn end(&mut self, station: u16) {
        if self.served.remove(&station).is_some() {
            self.hands.order(HandsOrder::ClosePair { station });
        }
    }

    /// Takes of each station the hands that it serves, as the host says.
    fn follow_roster(&mut self, stations: &[StationInfo]) {
        for (station, served) in &mut self.served {
            let Some(info) = stations.iter().find(|info| info.number == *station) else { continue };
            let hands = HandNumbers::new(info.hands.iter().copied());
            if info.hands != *served && self.hands.order(HandsOrder::ServePair { station: *station, hands }) {
                served.clone_from(&info.hands);
            }
        }
    }
}

/// The station whose number and token these are, compared in a time that tells nothing of the token.
fn known(
    given: &BTreeMap<u16, ([u8; TOKEN_BYTES], SimTime)>,
    hello: &[u8],
) -> Option<(u16, [u8; TOKEN_BYTES])> {
    let (number, shown) = hello.split_at_checked(2)?;
    let station = u16::from_le_bytes(number.try_into().ok()?);
    let (token, _) = given.get(&station)?;
    let differs = token.iter().zip(shown).fold(0, |differs, (a, b)| differs | (a ^ b));
    (differs == 0 && shown.len() == TOKEN_BYTES).then_some((station, *token))
}
