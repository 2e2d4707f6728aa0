//! Reflected link: sends masters' poses to a packet reflector, and takes what comes back for their slaves.
//!
//! The paper's experiment had one workstation at both ends of the path: its packets went to a reflector in another city and
//! came back, so that master and slave were a whole round trip apart. So here both ends are one machine: one clock, and a
//! key that never leaves the process. A packet is a sealed datagram of kind hands ([`datagram`](crate::datagram)), one for
//! each sample of the masters' devices. With force feedback it also has what both ends of a hand's coupling tell each other
//! ([`CoupledEnds`]), so that a force makes a round trip of its own before a hand feels it.

use ring::rand::{SecureRandom, SystemRandom};
use triple_buffer::{Input, Output, triple_buffer};
use trocar_devices::Wrench;
use trocar_scene::SimTime;

use super::coupled_ends::{COUPLED_BYTES, CoupledEnds};
use super::delay_histogram::DelayHistogram;
use super::exchange::{Arrival, LinkReport, LinkedHand};
use crate::datagram::{
    DATAGRAM_MAX, HANDS_MAX, Hands, Keys, Kind, Opener, PAYLOAD_MAX, ReceiveKey, SealError, Sealer, SendKey,
    Side, encode_hands, hands_bytes,
};
use crate::hand_sample::HandSample;
use crate::hands_link::HandsLink;
use crate::impairments::DelayTrace;

/// Number of the connection in the datagrams.
const CONNECTION: u32 = 1;
/// Bins of round trips: up to two seconds.
const ROUND_TRIPS: (SimTime, usize) = (SimTime::from_micros(500), 4_000);
/// Bins of deviations from the trace: up to 50 ms.
const ERRORS: (SimTime, usize) = (SimTime::from_micros(10), 5_000);
/// Time between two reports.
const REPORT_EVERY: SimTime = SimTime::from_millis(20);
/// A round trip that nobody waits for: what claims more is damaged.
const ROUND_TRIP_MAX: SimTime = SimTime::from_millis(120_000);

/// Both ends of a reflected path.
pub struct ReflectedLink<A> {
    reflector: A,
    /// Number of the key.
    phase: u32,
    sealer: Sealer,
    opener: Opener,
    arrived: Hands,
    hands: Vec<LinkedHand>,
    samples: Vec<HandSample>,
    /// Both ends of each hand's coupling, in the same order.
    coupled: Vec<CoupledEnds>,
    /// Whether any hand has a coupling.
    feeds_back: bool,
    arrived_coupled: Vec<CoupledEnds>,
    /// When each hand's newest sample was measured.
    sampled: Vec<Option<SimTime>>,
    newest: u64,
    trace: Option<DelayTrace>,
    /// When the first packet was sent that arrived: there the reflector's trace began.
    begun: Option<SimTime>,
    round_trips: DelayHistogram,
    errors: DelayHistogram,
    report: LinkReport,
    report_due: SimTime,
    reports: Input<LinkReport>,
}

/// The newest report of a link.
pub struct WatchedLink(Output<LinkReport>);

impl WatchedLink {
    /// The newest report.
    pub fn report(&mut self) -> LinkReport {
        *self.0.read()
    }
}

/// Why there is no link.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum LinkError {
    /// Too many hands for a datagram.
    #[error("{0} hands are too many for one packet; {HANDS_MAX} fit")]
    TooManyHands(usize),
    /// The system gives no random numbers for a key.
    #[error("the system has no random numbers for a key")]
    NoRandomness,
}

impl<A: Copy + PartialEq> ReflectedLink<A> {
    /// A link of these hands over the reflector at this address. With its trace the deviation of each packet is measured.
    ///
    /// # Errors
    /// [`LinkError`].
    pub fn new(
        reflector: A,
        hands: Vec<LinkedHand>,
        trace: Option<DelayTrace>,
    ) -> Result<(Self, WatchedLink), LinkError> {
        if hands.len() > HANDS_MAX {
            return Err(LinkError::TooManyHands(hands.len()));
        }
        let (send, receive) = keys(0)?;
        let (reports, watched) = triple_buffer(&LinkReport::default());
        let samples = hands.iter().map(|hand| HandSample::unknown(hand.hand)).collect();
        let link = Self {
            reflector,
            phase: 0,
            sealer: Sealer::new(send),
            // What is under way when a copy of the link takes a key of its own is to arrive.
            opener: Opener::new(receive, ROUND_TRIP_MAX),
            arrived: Hands::default(),
            sampled: vec![None; hands.len()],
            coupled: vec![CoupledEnds::default(); hands.len()],
            feeds_back: false,
            arrived_coupled: Vec::with_capacity(hands.len()),
            samples,
            hands,
            newest: 0,
            trace: trace.filter(|trace| !trace.delays.is_empty() && trace.every > SimTime::ZERO),
            begun: None,
            round_trips: DelayHistogram::new(ROUND_TRIPS.0, ROUND_TRIPS.1),
            errors: DelayHistogram::new(ERRORS.0, ERRORS.1),
            report: LinkReport::default(),
            report_due: SimTime::ZERO,
            reports,
        };
        Ok((link, WatchedLink(watched)))
    }

    /// The delay that the trace has for a packet sent at this time.
    fn expected(&self, sent_at: SimTime) -> Option<SimTime> {
        let trace = self.trace.as_ref()?;
        let step = sent_at.since(self.begun?).as_nanos() / trace.every.as_nanos();
        trace.delays.get((step % trace.delays.len() as u64) as usize).copied()
    }

    /// A copy in the same state, for a copy of its session: the same packets are under way to it, and it goes on to send
    /// under a key of its own. `hands` are those of the copied devices, in the same order.
    ///
    /// # Errors
    /// [`LinkError`].
    pub fn fork(&self, mut hands: Vec<LinkedHand>) -> Result<(Self, WatchedLink), LinkError> {
        let phase = self.phase.wrapping_add(1);
        let (send, receive) = keys(phase)?;
        let mut opener = self.opener.copied();
        // Of the same connection, and of the next phase: it is taken.
        opener.rekey(SimTime::ZERO, receive).map_err(|_| LinkError::NoRandomness)?;
        for (copy, hand) in hands.iter_mut().zip(&self.hands) {
            copy.tell(hand.arrived);
        }
        let (reports, watched) = triple_buffer(&self.report);
        let link = Self {
            reflector: self.reflector,
            phase,
            sealer: Sealer::going_on(send, self.sealer.next_sequence()),
            opener,
            arrived: Hands::default(),
            hands,
            samples: self.samples.clone(),
            coupled: self.coupled.clone(),
            feeds_back: self.feeds_back,
            arrived_coupled: Vec::with_capacity(self.samples.len()),
            sampled: self.sampled.clone(),
            newest: self.newest,
            trace: self.trace.clone(),
            begun: self.begun,
            round_trips: self.round_trips.clone(),
            errors: self.errors.clone(),
            report: self.report,
            report_due: self.report_due,
            reports,
        };
        Ok((link, WatchedLink(watched)))
    }

    /// Seals the samples, and the couplings if there are any.
    fn seal(&mut self, now: SimTime, out: &mut [u8; DATAGRAM_MAX]) -> Result<usize, SealError> {
        if !self.feeds_back {
            return self.sealer.seal_hands(now, None, &self.samples, out);
        }
        let mut payload = [0; PAYLOAD_MAX];
        let mut length = encode_hands(None, &self.samples, &mut payload)?;
        for ends in &self.coupled {
            let place = payload
                .get_mut(length..length + COUPLED_BYTES)
                .ok_or(SealError::TooLong(length + COUPLED_BYTES))?;
            place.copy_from_slice(&ends.encode());
            length += COUPLED_BYTES;
        }
        // No more hands than fit have been encoded.
        self.sealer.seal(Kind::CoupledHands, self.samples.len() as u8, now, &payload[..length], out)
    }

    fn measure(&mut self, now: SimTime, sent_at: SimTime) {
        let round_trip = now.since(sent_at);
        self.begun.get_or_insert(sent_at);
        self.report.newest = round_trip;
        self.round_trips.record(round_trip);
        if let Some(expected) = self.expected(sent_at) {
            self.errors.record(round_trip.since(expected).max(expected.since(round_trip)));
        }
    }

    fn tell(&mut self, now: SimTime) {
        if now < self.report_due {
            return;
        }
        self.report_due = now + REPORT_EVERY;
        let trips = &self.round_trips;
        let known = trips.mean().zip(trips.range()).zip(trips.quantile(0.99));
        self.report.round_trips = known.map(|((mean, (min, max)), p99)| [mean, min, p99, max]);
        self.report.delay_errors =
            self.errors.quantile(0.99).zip(self.errors.range()).map(|(p99, (_, max))| [p99, max]);
        self.report.refused = self.opener.counts().refused();
        self.reports.write(self.report);
    }
}

/// A key for both ends of a path, since one machine is both, that never leaves the process.
fn keys(phase: u32) -> Result<(SendKey, ReceiveKey), LinkError> {
    let mut secret = [0; 32];
    SystemRandom::new().fill(&mut secret).map_err(|_| LinkError::NoRandomness)?;
    let derive = |label: &[u8], context: &[u8], out: &mut [u8]| {
        blake3::Hasher::new_keyed(&secret).update(label).update(context).finalize_xof().fill(out);
        Ok::<(), LinkError>(())
    };
    let client = Keys::from_exporter(CONNECTION, phase, derive)?;
    let server = Keys::from_exporter(CONNECTION, phase, derive)?;
    let (send, _) = client.split(Side::Client);
    let (_, receive) = server.split(Side::Server);
    Ok((send, receive))
}

impl<A: Copy + PartialEq + Send + 'static> HandsLink<A> for ReflectedLink<A> {
    fn receive(&mut self, now: SimTime, from: A, datagram: &mut [u8], _: &mut dyn FnMut(A, &[u8]) -> bool) {
        if from != self.reflector {
            // Whoever that is, nothing of it is looked at.
            return;
        }
        // The opener counts what it refuses.
        let Ok((header, payload)) = self.opener.open(now, datagram) else { return };
        // The opener has compared the payload's kind with how many hands it may have.
        let (hands, ends) = payload.split_at(payload.len().min(hands_bytes(header.hands.into())));
        let coupled = if header.kind == Kind::CoupledHands { header.hands } else { 0 };
        if self.arrived.decode(header.hands, hands).is_err()
            || CoupledEnds::decode_all(coupled, ends, &mut self.arrived_coupled).is_err()
            || now.since(header.sent_at) > ROUND_TRIP_MAX
        {
            return;
        }
        self.report.received += 1;
        self.measure(now, header.sent_at);
        if header.sequence <= self.newest {
            self.report.late += 1;
            return;
        }
        self.newest = header.sequence;
        for (index, sample) in self.arrived.samples().iter().enumerate() {
            let Some(hand) = self.hands.iter_mut().find(|hand| hand.hand == sample.hand) else { continue };
            let age = SimTime::from_micros(u64::from(sample.age_us));
            hand.tell(Some(Arrival {
                sampled_at: SimTime(header.sent_at.as_nanos().saturating_sub(age.as_nanos())),
                sent_at: header.sent_at,
                arrived_at: now,
                sample: *sample,
                coupled: self.arrived_coupled.get(index).copied(),
            }));
        }
    }

    fn tick(&mut self, now: SimTime, send: &mut dyn FnMut(A, &[u8]) -> bool) {
        let mut is_new = false;
        let places = self.samples.iter_mut().zip(&mut self.coupled).zip(&mut self.sampled);
        for (hand, ((sample, coupled), sampled)) in self.hands.iter_mut().zip(places) {
            if let Some(newest) = *hand.masters.read()
                && *sampled != Some(newest.sampled_at)
            {
                is_new = true;
                *sampled = Some(newest.sampled_at);
                sample.state = newest.state;
                sample.wrench = Wrench::ZERO;
                if let Some(ends) = newest.coupled {
                    (*coupled, self.feeds_back) = (ends, true);
                }
            }
            if let Some(sampled) = *sampled {
                let age_us = (now.since(sampled).as_nanos() + 500) / 1_000;
                sample.age_us = u32::try_from(age_us).unwrap_or(u32::MAX);
            }
        }
        if is_new && self.sampled.iter().all(Option::is_some) {
            let mut out = [0; DATAGRAM_MAX];
            // Samples are checked before they come here, and their number fits; a key wears out after millennia.
            if let Ok(length) = self.seal(now, &mut out)
                && send(self.reflector, &out[..length])
            {
                self.report.sent += 1;
            }
        }
        self.tell(now);
    }

    fn is_idle(&self) -> bool {
        false
    }
}

#[cfg(test)]
#[path = "reflected_link_tests.rs"]
mod tests;
