//! The hands link of a station: its own hands go to the host, and the host's answers come back.

use trocar_scene::SimTime;

use super::connection::{Arrived, Connection, Reply};
use super::order::{HandNumbers, HandsNews, HandsOrder, HandsThread, Parcel};
use crate::datagram::{DATAGRAM_MAX, HANDS_MAX, Kind};
use crate::hand_sample::HandSample;
use crate::remote_hand::StationEnd;

/// Orders that are taken at one tick.
const ORDERS_AT_ONCE: usize = 64;
/// The number by which the host counts as the station that moves a hand here, when it is taken over from elsewhere.
pub const HOST: u16 = 0;

/// A hand whose device is here.
pub struct StationHand {
    /// Its number in datagrams.
    pub number: u8,
    /// The device's link: the state that it shows, and where the host's samples go while somebody else moves the hand.
    pub end: StationEnd,
}

/// The connection of a station. Does not allocate after it was made, but for what its orders own.
pub struct HandsStation<A> {
    hands: Vec<StationHand>,
    serves: HandNumbers,
    host: A,
    connection: Option<Box<Connection<A>>>,
    is_worn: bool,
    thread: HandsThread<A>,
    samples: Vec<HandSample>,
    out: [u8; DATAGRAM_MAX],
    refused: u64,
}

impl<A: Copy + PartialEq> HandsStation<A> {
    /// A station with these hands, whose host receives at `host`.
    pub fn new(hands: Vec<StationHand>, host: A, thread: HandsThread<A>) -> Self {
        Self {
            hands,
            serves: HandNumbers::default(),
            host,
            connection: None,
            is_worn: false,
            thread,
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

    /// Datagrams go there from now on: the control channel has found the host at another of its addresses.
    pub fn set_host(&mut self, host: A) {
        self.host = host;
    }

    /// A datagram came; replies go out by `send`, which says whether the system took them.
    pub fn receive(
        &mut self,
        now: SimTime,
        from: A,
        datagram: &mut [u8],
        send: &mut dyn FnMut(A, &[u8]) -> bool,
    ) {
        let Self { hands, connection: Some(connection), thread, out, serves, .. } = self else {
            self.refused += 1;
            return;
        };
        let id = connection.id();
        let reply = match connection.receive(now, from, datagram) {
            Ok((Arrived::Hands, reply)) => {
                for sample in connection.samples().iter().filter(|sample| sample.state.connected) {
                    // Only while another one moves the hand does its sample count; the hand itself sees to that.
                    let is_own = serves.as_slice().contains(&sample.hand);
                    if !is_own && let Some(hand) = hands.iter_mut().find(|hand| hand.number == sample.hand) {
                        hand.end.post(HOST, now, sample);
                    }
                }
                reply
            }
            Ok((Arrived::Rows(payload), reply)) => {
                tell(thread, id, Kind::Rows, payload);
                reply
            }
            Ok((Arrived::RowAcks(payload), reply)) => {
                tell(thread, id, Kind::RowAcks, payload);
                reply
            }
            Ok((Arrived::Other, reply)) => reply,
            Err(_) => {
                self.refused += 1;
                return;
            }
        };
        if let Some(Reply { kind, payload }) = reply
            && let Some(length) = connection.seal(kind, &payload, now, out)
        {
            send(from, &out[..length]);
        }
    }

    /// Sends what is due.
    pub fn tick(&mut self, now: SimTime, send: &mut dyn FnMut(A, &[u8]) -> bool) {
        for _ in 0..ORDERS_AT_ONCE {
            let Ok(order) = self.thread.orders.pop() else { break };
            self.obey(order, now, send);
        }
        let Self { hands, serves, host, connection: Some(connection), is_worn, thread, samples, out, .. } =
            self
        else {
            return;
        };
        samples.clear();
        for number in serves.as_slice() {
            // The age of the host's answer is counted for the figures of the link.
            let _ = connection.read(*number, now);
            if let Some(hand) = hands.iter_mut().find(|hand| hand.number == *number) {
                samples.push(shown(hand, now));
            }
        }
        let id = connection.id();
        if let Some(length) = connection.tick(samples, now, out) {
            let is_sent = send(*host, &out[..length]);
            connection.sent(samples, length, is_sent, now);
        }
        if let Some(length) = connection.report(now, out) {
            send(*host, &out[..length]);
        }
        if let Some(point) = connection.point(now) {
            thread.tell(HandsNews::Second { connection: id, point, rate: connection.rate() });
        }
        if connection.is_worn() && !*is_worn {
            *is_worn = thread.tell(HandsNews::Worn { connection: id });
        }
    }

    fn obey(&mut self, order: HandsOrder<A>, now: SimTime, send: &mut dyn FnMut(A, &[u8]) -> bool) {
        if let HandsOrder::Open { connection, .. } = order {
            self.close();
            self.is_worn = false;
            self.connection = Some(connection);
            return;
        }
        let id = match &order {
            HandsOrder::Serve { connection, .. }
            | HandsOrder::Send { connection, .. }
            | HandsOrder::RekeyOpener { connection, .. }
            | HandsOrder::RekeySealer { connection, .. }
            | HandsOrder::Close { connection } => *connection,
            HandsOrder::Open { connection, .. } => connection.id(),
        };
        let Some(connection) = self.connection.as_mut().filter(|connection| connection.id() == id) else {
            return;
        };
        match order {
            HandsOrder::Serve { hands, .. } => {
                if connection.expect_hands(hands.as_slice()).is_ok() {
                    self.serves = hands;
                }
            }
            HandsOrder::Send { parcel, .. } => {
                if let Some(length) =
                    connection.seal(parcel.kind(), parcel.payload(), now, &mut self.out)
                {
                    send(self.host, &self.out[..length]);
                }
            }
            HandsOrder::RekeyOpener { key, .. } => {
                // A key that does not fit leaves the present one in use; the host asks for another phase.
                let _ = connection.rekey_opener(now, key);
            }
            HandsOrder::RekeySealer { key, .. } => {
                self.is_worn &= connection.rekey_sealer(key).is_err();
            }
            HandsOrder::Close { .. } => self.close(),
            HandsOrder::Open { .. } => {}
        }
    }

    fn close(&mut self) {
        if let Some(connection) = self.connection.take() {
            self.thread.tell(HandsNews::Closed(connection));
        }
    }
}

fn tell<A>(thread: &mut HandsThread<A>, connection: u32, kind: Kind, payload: &[u8]) {
    if let Some(parcel) = Parcel::new(kind, payload) {
        thread.tell(HandsNews::Arrived { connection, parcel });
    }
}

/// A hand as its device shows it, as a sample.
fn shown(hand: &mut StationHand, now: SimTime) -> HandSample {
    let answer = hand.end.answer();
    let age = now.since(answer.at).as_nanos() / 1_000;
    HandSample {
        hand: hand.number,
        state: answer.state,
        wrench: answer.local_wrench,
        grabbed: None,
        age_us: u32::try_from(age).unwrap_or(u32::MAX),
    }
}
