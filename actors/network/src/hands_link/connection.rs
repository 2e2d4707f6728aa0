//! Connection: one end of the datagrams between a host and a station.

use thiserror::Error;
use trocar_scene::SimTime;

use super::path::{CHALLENGE_BYTES, Path, PathNews};
use super::way::Way;
use crate::datagram::{
    DATAGRAM_MAX, Hands, Header, Keys, Kind, Opener, ReceiveKey, Refused, RekeyError, Sealer, SendKey, Side,
};
use crate::hand_sample::HandSample;
use crate::haptic::{
    ClockSync, HapticReceiver, HapticSender, LinkMeter, LinkPoint, LinkReport, Order, Rate, ReceiverError,
    RemoteHandSample, SenderConfig,
};

/// How long datagrams under the key before are still opened.
const KEY_GRACE: SimTime = SimTime::from_millis(2_000);

/// What an authentic datagram brought.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Arrived<'a> {
    /// New samples of hands, now in the connection.
    Hands,
    /// A payload of rows.
    Rows(&'a [u8]),
    /// A payload of acknowledgements of rows.
    RowAcks(&'a [u8]),
    /// A payload of sketches of the other side's bodies.
    Sketch(&'a [u8]),
    /// Something that the connection needs for itself, or that a newer datagram had overtaken.
    Other,
}

/// A datagram that is to go back to the address from which one came.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Reply {
    /// [`Kind::PathChallenge`] or [`Kind::PathResponse`].
    pub kind: Kind,
    /// Its payload.
    pub payload: [u8; CHALLENGE_BYTES],
}

/// Why a datagram had no effect.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum ConnectionError {
    /// It is not authentic, or comes again.
    #[error(transparent)]
    Refused(#[from] Refused),
    /// It is authentic, and its payload is not what it says.
    #[error("an authentic datagram of kind {0:?} with a payload that cannot be read")]
    Malformed(Kind),
}

/// What was authentic and had no effect.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ConnectionCounts {
    /// Payloads that could not be read.
    pub malformed: u64,
    /// Datagrams that a newer one had overtaken, of kinds of which only the newest counts.
    pub overtaken: u64,
}

/// One end of a connection. Does not allocate after it was made.
pub struct Connection<A> {
    id: u32,
    sealer: Sealer,
    opener: Opener,
    receiver: HapticReceiver,
    sender: HapticSender,
    meter: LinkMeter,
    path: Path<A>,
    way: Way,
    hands: Hands,
    heard_at: Option<SimTime>,
    counts: ConnectionCounts,
}

impl<A: Copy + PartialEq> Connection<A> {
    /// This side's end of a connection whose other side sends these hands. `secret` is random.
    ///
    /// # Errors
    /// [`ReceiverError`] when there are too many hands, or one comes twice.
    pub fn new(
        id: u32,
        keys: Keys,
        side: Side,
        hands: &[u8],
        config: &SenderConfig,
        secret: u64,
    ) -> Result<Self, ReceiverError> {
        let (send, receive) = keys.split(side);
        Ok(Self {
            id,
            sealer: Sealer::new(send),
            opener: Opener::new(receive, KEY_GRACE),
            receiver: HapticReceiver::new(hands)?,
            sender: HapticSender::new(config),
            meter: LinkMeter::default(),
            path: Path::new(secret),
            way: Way::new(side),
            hands: Hands::default(),
            heard_at: None,
            counts: ConnectionCounts::default(),
        })
    }

    /// Its number.
    pub fn id(&self) -> u32 {
        self.id
    }

    /// Whether strangers can neither read nor make its datagrams.
    pub fn is_protected(&self) -> bool {
        self.sealer.is_protected()
    }

    /// Knows the next phase's key from the other side.
    ///
    /// # Errors
    /// [`RekeyError`].
    pub fn rekey_opener(&mut self, now: SimTime, key: ReceiveKey) -> Result<(), RekeyError> {
        self.opener.rekey(now, key)
    }

    /// Sends under the next phase's key, which the other side knows.
    ///
    /// # Errors
    /// [`RekeyError`].
    pub fn rekey_sealer(&mut self, key: SendKey) -> Result<(), RekeyError> {
        self.sealer.rekey(key)
    }

    /// Whether the keys should be replaced.
    pub fn is_worn(&self) -> bool {
        self.sealer.is_worn() || self.opener.is_worn()
    }

    /// A datagram arrived from `from`. It is decrypted in place. A reply is to be [sealed](Self::seal) and to go to `from`.
    ///
    /// # Errors
    /// [`ConnectionError`]; nothing is to be answered.
    pub fn receive<'a>(
        &mut self,
        now: SimTime,
        from: A,
        datagram: &'a mut [u8],
    ) -> Result<(Arrived<'a>, Option<Reply>), ConnectionError> {
        self.take(now, Some(from), datagram)
    }

    /// A datagram arrived that the control channel carried. It is decrypted in place, and tells nothing of paths.
    ///
    /// # Errors
    /// [`ConnectionError`].
    pub fn receive_carried<'a>(
        &mut self,
        now: SimTime,
        datagram: &'a mut [u8],
    ) -> Result<Arrived<'a>, ConnectionError> {
        self.take(now, None, datagram).map(|(arrived, _)| arrived)
    }

    fn take<'a>(
        &mut self,
        now: SimTime,
        from: Option<A>,
        datagram: &'a mut [u8],
    ) -> Result<(Arrived<'a>, Option<Reply>), ConnectionError> {
        let bytes = datagram.len();
        let (header, payload) = self.opener.open(now, datagram)?;
        self.heard_at = Some(now);
        let mut reply = None;
        if let Some(from) = from {
            self.way.came(now);
            if let PathNews::Challenge(payload) = self.path.arrived(from, header.sequence, now) {
                reply = Some(Reply { kind: Kind::PathChallenge, payload });
            }
        }
        let arrived = if header.kind == Kind::Hands {
            self.take_hands(&header, payload, bytes, now)
        } else {
            self.receiver.receive_other(header.sequence, header.sent_at, now);
            self.meter.received(bytes, None);
            self.take_other(header.kind, from, payload, now, &mut reply)
        };
        self.counts.malformed += u64::from(arrived.is_err());
        Ok((arrived?, reply))
    }

    fn take_hands<'a>(
        &mut self,
        header: &Header,
        payload: &[u8],
        bytes: usize,
        now: SimTime,
    ) -> Result<Arrived<'a>, ConnectionError> {
        let Self { receiver, sender, meter, hands: read, .. } = self;
        let Header { sequence, sent_at, .. } = *header;
        if read.decode(header.hands, payload).is_err() {
            receiver.receive_other(sequence, sent_at, now);
            meter.received(bytes, None);
            return Err(ConnectionError::Malformed(Kind::Hands));
        }
        let order = receiver.receive(sequence, sent_at, read.echo(), read.samples(), now);
        let echo = read.echo().filter(|_| order == Order::Newest);
        if let Some(echo) = echo {
            sender.echoed(echo, receiver.clock(), now);
        }
        meter.received(bytes, echo.and_then(|_| receiver.clock().round_trip()));
        self.counts.overtaken += u64::from(order != Order::Newest);
        Ok(if order == Order::Newest { Arrived::Hands } else { Arrived::Other })
    }

    fn take_other<'a>(
        &mut self,
        kind: Kind,
        from: Option<A>,
        payload: &'a [u8],
        now: SimTime,
        reply: &mut Option<Reply>,
    ) -> Result<Arrived<'a>, ConnectionError> {
        let malformed = ConnectionError::Malformed(kind);
        match kind {
            Kind::Rows => return Ok(Arrived::Rows(payload)),
            Kind::RowAcks => return Ok(Arrived::RowAcks(payload)),
            Kind::Sketch => return Ok(Arrived::Sketch(payload)),
            Kind::PathChallenge => {
                let payload = payload.try_into().map_err(|_| malformed)?;
                *reply = Some(Reply { kind: Kind::PathResponse, payload });
            }
            Kind::PathResponse => {
                if let Some(from) = from {
                    self.path.answered(from, payload);
                }
            }
            Kind::Report => {
                let report = LinkReport::decode(payload).map_err(|_| malformed)?;
                // Tries that are lost say nothing of the rate.
                if !self.way.carries() {
                    self.sender.report(&report, self.receiver.clock(), now);
                }
            }
            // Echoes belong to a diagnosis, which has no hands, and couplings to a slave.
            Kind::Hands | Kind::Echo | Kind::CoupledHands => return Err(malformed),
        }
        Ok(Arrived::Other)
    }

    /// The other side sends these hands from now on.
    ///
    /// # Errors
    /// [`ReceiverError`]; then nothing has changed.
    pub fn expect_hands(&mut self, hands: &[u8]) -> Result<(), ReceiverError> {
        self.receiver.expect_hands(hands)
    }

    /// The newest samples that have come, in the order of the datagram.
    pub fn samples(&self) -> &[HandSample] {
        self.hands.samples()
    }

    /// Makes the datagram of hands that is due now with these samples, always in the same order; `None` if none is due.
    /// The caller then says whether it [was sent](Self::sent).
    pub fn tick(
        &mut self,
        samples: &[HandSample],
        now: SimTime,
        out: &mut [u8; DATAGRAM_MAX],
    ) -> Option<usize> {
        let outgoing = self.sender.tick(samples, self.receiver.clock(), now)?;
        let sealed = self.sealer.seal_hands(now, outgoing.echo, samples, out);
        match sealed {
            Ok(length) => Some(length),
            Err(_) => {
                self.sender.blocked();
                None
            }
        }
    }

    /// What became of the datagram of [`Self::tick`].
    pub fn sent(&mut self, samples: &[HandSample], bytes: usize, is_sent: bool, now: SimTime) {
        if is_sent {
            self.sender.sent(samples, now);
            self.meter.sent(bytes);
        } else {
            self.sender.blocked();
        }
    }

    /// Makes the datagram of hands that the control channel is to carry now, with these samples.
    pub fn carry(
        &mut self,
        samples: &[HandSample],
        now: SimTime,
        out: &mut [u8; DATAGRAM_MAX],
    ) -> Option<usize> {
        if !self.way.carry(now) {
            return None;
        }
        let length = self.seal_now(samples, now, out)?;
        self.sender.carried(samples, now);
        Some(length)
    }

    /// Makes the datagram of hands that is to be tried by itself now, although they are carried.
    pub fn try_again(
        &mut self,
        samples: &[HandSample],
        now: SimTime,
        out: &mut [u8; DATAGRAM_MAX],
    ) -> Option<usize> {
        if self.way.try_again(now) { self.seal_now(samples, now, out) } else { None }
    }

    fn seal_now(
        &mut self,
        samples: &[HandSample],
        now: SimTime,
        out: &mut [u8; DATAGRAM_MAX],
    ) -> Option<usize> {
        let echo = self.receiver.clock().echo(now);
        let length = self.sealer.seal_hands(now, echo, samples, out).ok()?;
        self.meter.sent(length);
        Some(length)
    }

    /// The way of its datagrams.
    pub fn way(&self) -> &Way {
        &self.way
    }

    /// The way of its datagrams, for what time and the control channel bring.
    pub fn way_mut(&mut self) -> &mut Way {
        &mut self.way
    }

    /// The other end says whether it hears this one's datagrams by themselves.
    pub fn heard(&mut self, is_heard: bool) {
        if self.way.heard(is_heard) {
            self.sender.restart();
        }
    }

    /// Makes the report that is due now for the other side's sender.
    pub fn report(&mut self, now: SimTime, out: &mut [u8; DATAGRAM_MAX]) -> Option<usize> {
        let report = self.receiver.report(now)?;
        self.seal(Kind::Report, &report.encode(), now, out)
    }

    /// Makes a datagram of another kind. `None` when the payload is too long, or the numbers are used up.
    pub fn seal(
        &mut self,
        kind: Kind,
        payload: &[u8],
        now: SimTime,
        out: &mut [u8; DATAGRAM_MAX],
    ) -> Option<usize> {
        let length = self.sealer.seal(kind, 0, now, payload, out).ok()?;
        self.meter.sent(length);
        Some(length)
    }

    /// The newest sample of a hand of the other side. It counts as shown.
    pub fn read(&mut self, hand: u8, now: SimTime) -> Option<RemoteHandSample> {
        let read = self.receiver.read(hand, now)?;
        if let Some(age) = read.age {
            self.meter.shown(age);
        }
        Some(read)
    }

    /// The newest sample of a hand of the other side, without its being shown by that.
    pub fn newest(&self, hand: u8, now: SimTime) -> Option<RemoteHandSample> {
        self.receiver.newest(hand, now)
    }

    /// When the newest sample of a hand was measured, by this side's clock; now, as long as the other clock is unknown.
    pub fn measured_at(&self, hand: u8, now: SimTime) -> SimTime {
        let age = self.newest(hand, now).and_then(|newest| newest.age).unwrap_or_default();
        SimTime(now.as_nanos().saturating_sub(age.as_nanos()))
    }

    /// Ends the second of the meter when it is over.
    pub fn point(&mut self, now: SimTime) -> Option<LinkPoint> {
        let point = self.meter.tick(&self.receiver.counts(), self.receiver.clock().jitter(), now)?;
        let is_carried = self.way.carries() || !self.way.hears();
        // What is lost where datagrams are blocked are tries; a stream loses nothing.
        let loss = if self.way.hears() { point.loss } else { 0.0 };
        Some(LinkPoint { is_carried, loss, ..point })
    }

    /// Where datagrams go; `None` before one has come.
    pub fn address(&self) -> Option<A> {
        self.path.address()
    }

    /// How long ago this was sent, by the estimate of the other clock.
    pub fn age(&self, sent_at: SimTime, now: SimTime) -> Option<SimTime> {
        self.receiver.clock().delay(sent_at, now)
    }

    /// When an authentic datagram came last.
    pub fn heard_at(&self) -> Option<SimTime> {
        self.heard_at
    }

    /// The other side's clock, and the path.
    pub fn clock(&self) -> &ClockSync {
        self.receiver.clock()
    }

    /// The rate at which hands are sent at most.
    pub fn rate(&self) -> Rate {
        self.sender.ladder().rate()
    }

    /// The meter.
    pub fn meter(&self) -> &LinkMeter {
        &self.meter
    }

    /// The receiver, for its counts.
    pub fn receiver(&self) -> &HapticReceiver {
        &self.receiver
    }

    /// The sender, for its counts.
    pub fn sender(&self) -> &HapticSender {
        &self.sender
    }

    /// The opener, for what it refused.
    pub fn opener(&self) -> &Opener {
        &self.opener
    }

    /// What was authentic and had no effect.
    pub fn counts(&self) -> &ConnectionCounts {
        &self.counts
    }
}
