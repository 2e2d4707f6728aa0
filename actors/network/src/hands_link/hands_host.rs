//! The hands link of a host: the connections of all stations, and the hands that they serve.

use trocar_scene::SimTime;

use super::HandsLink;
use super::connection::Connection;
use super::exchange::{self, Ways};
use super::order::{HandNumbers, HandsNews, HandsOrder, LinkEnd};
use super::playout::{Played, Playout};
use crate::control::{DIAGNOSES_MAX, SESSION_HANDS_MAX, STATIONS_MAX};
use crate::datagram::{DATAGRAM_MAX, HANDS_MAX, Header};
use crate::diagnosis::EchoEnd;
use crate::hand_sample::{CLUTCHES, HandSample};
use crate::remote_hand::{Arrival, StationEnd};
use trocar_devices::Wrench;

/// After so long without a datagram a station was silent.
const SILENCE: SimTime = SimTime::from_millis(100);
/// Orders that are taken at one tick.
const ORDERS_AT_ONCE: usize = 64;

/// A hand of the session, as the link reaches it.
pub struct HostHand {
    /// Its number in datagrams.
    pub number: u8,
    /// Where its samples go and its answers come from.
    pub end: StationEnd,
    /// Among peers, when they are played; otherwise they are followed as they come.
    pub playout: Option<Playout>,
}

struct Link<A> {
    station: u16,
    connection: Box<Connection<A>>,
    serves: HandNumbers,
    is_worn: bool,
}

/// What came and had no connection.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct StrangerCounts {
    /// Datagrams without a header, or for no connection of this host.
    pub unknown: u64,
    /// Datagrams of a connection that were refused.
    pub refused: u64,
}

/// All connections of a host. Does not allocate after it was made, but for what its orders own.
pub struct HandsHost<A> {
    hands: Vec<HostHand>,
    links: Vec<Link<A>>,
    /// Of those who diagnose the path.
    #[expect(
        clippy::vec_box,
        reason = "a box goes back to the controller as it came: nothing is allocated here"
    )]
    echoes: Vec<Box<EchoEnd>>,
    controller: LinkEnd<A>,
    samples: Vec<HandSample>,
    /// Whether every station is sent the hands of all others.
    shares: bool,
    /// Then all hands as they are now.
    all: Vec<HandSample>,
    out: [u8; DATAGRAM_MAX],
    strangers: StrangerCounts,
}

impl<A: Copy + PartialEq> HandsHost<A> {
    /// A host of a session with these hands.
    pub fn new(hands: Vec<HostHand>, controller: LinkEnd<A>) -> Self {
        Self {
            hands,
            links: Vec::with_capacity(STATIONS_MAX),
            echoes: Vec::with_capacity(DIAGNOSES_MAX),
            controller,
            samples: Vec::with_capacity(HANDS_MAX),
            shares: false,
            all: Vec::with_capacity(SESSION_HANDS_MAX),
            out: [0; DATAGRAM_MAX],
            strangers: StrangerCounts::default(),
        }
    }

    /// Sends every station the hands of all others, too, as many as fit into a datagram.
    #[must_use]
    pub fn sharing(self) -> Self {
        Self { shares: true, ..self }
    }

    /// What came from strangers so far.
    pub fn strangers(&self) -> &StrangerCounts {
        &self.strangers
    }

    fn take_orders(&mut self, now: SimTime, send: &mut dyn FnMut(A, &[u8]) -> bool) {
        for _ in 0..ORDERS_AT_ONCE {
            let Ok(order) = self.controller.orders.pop() else { break };
            self.obey(order, now, send);
        }
    }

    fn obey(&mut self, order: HandsOrder<A>, now: SimTime, send: &mut dyn FnMut(A, &[u8]) -> bool) {
        match order {
            HandsOrder::Open { station, mut connection, peer: _ } => {
                let of_station = |link: &Link<A>| link.station == station;
                if let Some(at) = self.links.iter().position(of_station) {
                    *connection.way_mut() = self.links[at].connection.way().again();
                    self.close(at);
                }
                if self.links.len() < STATIONS_MAX {
                    let serves = HandNumbers::default();
                    self.links.push(Link { station, connection, serves, is_worn: false });
                } else {
                    self.controller.tell(HandsNews::Closed(connection));
                }
            }
            HandsOrder::Serve { connection, hands } => {
                if let Some(link) = self.link(connection)
                    && link.connection.expect_hands(hands.as_slice()).is_ok()
                {
                    link.serves = hands;
                }
            }
            // A host's own pedals are in its scene already.
            HandsOrder::Press { .. }
            | HandsOrder::Place
            | HandsOrder::ServePair { .. }
            | HandsOrder::ClosePair { .. } => {}
            // The host is connected to all stations.
            HandsOrder::OpenPair { connection, .. } => {
                self.controller.tell(HandsNews::Closed(connection));
            }
            HandsOrder::Send { connection, parcel } => {
                let Self { links, controller, out, .. } = self;
                let link = links.iter_mut().find(|link| link.connection.id() == connection);
                if let Some(Link { connection, .. }) = link {
                    let (to, ways) = (connection.address(), Ways { controller, send, out });
                    exchange::send_parcel(connection, to, &parcel, now, ways);
                }
            }
            HandsOrder::Carried { connection, mut datagram } => {
                if let Some(at) = self.links.iter().position(|link| link.connection.id() == connection) {
                    self.take(at, now, None, datagram.bytes_mut(), send);
                }
            }
            HandsOrder::Heard { connection, is_heard } => {
                if let Some(link) = self.link(connection) {
                    link.connection.heard(is_heard);
                }
            }
            HandsOrder::RekeyOpener { connection, key } => {
                // A key that does not fit leaves the present ones in use; the controller asks for another phase.
                let _ = self.link(connection).map(|link| link.connection.rekey_opener(now, key));
            }
            HandsOrder::RekeySealer { connection, key } => {
                if let Some(link) = self.link(connection)
                    && link.connection.rekey_sealer(key).is_ok()
                {
                    link.is_worn = false;
                }
            }
            HandsOrder::CloseAll => {
                while !self.links.is_empty() {
                    self.close(self.links.len() - 1);
                }
                while let Some(echo) = self.echoes.pop() {
                    self.controller.tell(HandsNews::EchoEnded(echo));
                }
            }
            HandsOrder::Close { connection } => {
                if let Some(at) = self.links.iter().position(|link| link.connection.id() == connection) {
                    self.close(at);
                } else if let Some(at) = self.echoes.iter().position(|echo| echo.id() == connection) {
                    let echo = self.echoes.swap_remove(at);
                    self.controller.tell(HandsNews::EchoEnded(echo));
                }
            }
            HandsOrder::Echo(echo) => {
                if self.echoes.len() < DIAGNOSES_MAX {
                    self.echoes.push(echo);
                } else {
                    self.controller.tell(HandsNews::EchoEnded(echo));
                }
            }
        }
    }

    fn link(&mut self, connection: u32) -> Option<&mut Link<A>> {
        self.links.iter_mut().find(|link| link.connection.id() == connection)
    }

    /// Takes a datagram of a link, which came from an address or was carried.
    fn take(
        &mut self,
        at: usize,
        now: SimTime,
        from: Option<A>,
        datagram: &mut [u8],
        send: &mut dyn FnMut(A, &[u8]) -> bool,
    ) {
        let Self { hands, links, controller, out, strangers, .. } = self;
        let Link { station, connection, serves, .. } = &mut links[at];
        let before = connection.heard_at();
        match exchange::take(connection, now, from, datagram, Ways { controller, send, out }) {
            Ok(true) => {
                // A hand that was lost in a silence is held from the first word of its station on, so that it stands still
                // while the station brings its own there. One that then does not come is lost again.
                let is_back = before.is_none_or(|before| now.since(before) >= SILENCE);
                let served = hands.iter().filter(|hand| serves.as_slice().contains(&hand.number));
                served.filter(|_| is_back).for_each(|hand| hand.end.control().take_again(*station));
                for sample in connection.samples() {
                    if serves.as_slice().contains(&sample.hand)
                        && let Some(hand) = hands.iter_mut().find(|hand| hand.number == sample.hand)
                    {
                        hand.end.control().take_again(*station);
                        let measured_at = connection.measured_at(sample.hand, now);
                        match &mut hand.playout {
                            Some(playout) => playout.push(now, measured_at, sample),
                            None => {
                                let arrival = Arrival { at: now, measured_at: Some(measured_at) };
                                hand.end.post(*station, arrival, sample);
                            }
                        }
                    }
                }
            }
            Ok(false) => {}
            Err(_) => strangers.refused += 1,
        }
    }

    /// Moves the hands that other peers serve as their samples' time comes.
    fn play(&mut self, now: SimTime) {
        for Link { station, serves, .. } in &self.links {
            let served = self.hands.iter_mut().filter(|hand| serves.as_slice().contains(&hand.number));
            for hand in served {
                if let Some(Played { arrived_at, sample }) =
                    hand.playout.as_mut().and_then(|playout| playout.play(now))
                {
                    hand.end.post(*station, arrived_at, &sample);
                }
            }
        }
    }

    /// Looks at all hands, each as its own station has measured it.
    fn look_at_all(&mut self, now: SimTime) {
        self.all.clear();
        if !self.shares {
            return;
        }
        for hand in &mut self.hands {
            let serving = self.links.iter().find(|link| link.serves.as_slice().contains(&hand.number));
            let sample = match serving {
                Some(Link { connection, .. }) => {
                    let Some(read) = connection.newest(hand.number, now) else { continue };
                    let age = read.age.unwrap_or(read.silence).as_nanos() / 1_000;
                    HandSample { age_us: u32::try_from(age).unwrap_or(u32::MAX), ..read.sample }
                }
                None => answer_of(hand, now),
            };
            // What it feels is computed where it is felt.
            self.all.push(HandSample { wrench: Wrench::ZERO, grabbed: None, clutch: 0, ..sample });
        }
    }

    fn close(&mut self, at: usize) {
        let link = self.links.swap_remove(at);
        self.controller.tell(HandsNews::Closed(link.connection));
    }
}

impl<A: Copy + PartialEq + Send + 'static> HandsLink<A> for HandsHost<A> {
    fn receive(
        &mut self,
        now: SimTime,
        from: A,
        datagram: &mut [u8],
        send: &mut dyn FnMut(A, &[u8]) -> bool,
    ) {
        let Ok(id) = Header::decode(datagram).map(|header| header.connection) else {
            self.strangers.unknown += 1;
            return;
        };
        if let Some(at) = self.links.iter().position(|link| link.connection.id() == id) {
            self.take(at, now, Some(from), datagram, send);
            return;
        }
        let Self { echoes, out, strangers, .. } = self;
        match echoes.iter_mut().find(|echo| echo.id() == id).map(|echo| echo.answer(now, datagram, out)) {
            Some(Some(length)) => drop(send(from, &out[..length])),
            Some(None) => strangers.refused += 1,
            None => strangers.unknown += 1,
        }
    }

    fn tick(&mut self, now: SimTime, send: &mut dyn FnMut(A, &[u8]) -> bool) {
        self.take_orders(now, send);
        self.play(now);
        self.look_at_all(now);
        let Self { hands, links, echoes, controller, samples, all, out, .. } = self;
        for echo in echoes.iter_mut() {
            if let Some(counts) = echo.news(now) {
                controller.tell(HandsNews::Echoed { connection: echo.id(), counts });
            }
        }
        for Link { connection, serves, is_worn, .. } in links.iter_mut() {
            samples.clear();
            for number in serves.as_slice() {
                // The age of what came is counted for the figures of the link.
                let _ = connection.read(*number, now);
                if let Some(hand) = hands.iter_mut().find(|hand| hand.number == *number) {
                    samples.push(answer_of(hand, now));
                }
            }
            let others = all.iter().filter(|sample| !serves.as_slice().contains(&sample.hand));
            samples.extend(others.take(HANDS_MAX.saturating_sub(serves.as_slice().len())));
            let to = connection.address();
            exchange::send_due(connection, to, samples, is_worn, now, Ways { controller, send, out });
        }
    }

    fn is_idle(&self) -> bool {
        self.links.is_empty()
    }
}

/// What a hand answers its station, as a sample.
fn answer_of(hand: &mut HostHand, now: SimTime) -> HandSample {
    let answer = hand.end.answer();
    let age = now.since(answer.at).as_nanos() / 1_000;
    HandSample {
        hand: hand.number,
        state: answer.state,
        wrench: answer.wrench,
        grabbed: None,
        age_us: u32::try_from(age).unwrap_or(u32::MAX),
        clutch: (answer.door.clutches % u64::from(CLUTCHES)) as u8,
    }
}

#[cfg(test)]
#[path = "hands_host_tests.rs"]
mod tests;
