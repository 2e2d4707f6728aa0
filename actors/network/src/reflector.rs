//! The packet reflector: returns or forwards each datagram as a bad network would have carried it.
//!
//! The experiment that this project reproduces sent the master's packets to a reflector in another city, which returned
//! them. Here the city is data: delays, measured or made, losses, bursts, and the other [`Impairments`].

use trocar_kernel::faults::{LinkCounts, LinkFaults, Message};
use trocar_scene::SimTime;

use crate::impairments::Impairments;

/// Longest datagram that is reflected.
pub const REFLECTED_MAX: usize = 2_048;

/// A datagram under way, with whom it goes to.
#[derive(Clone, Debug, PartialEq)]
pub struct Parcel<A> {
    /// To whom.
    pub to: A,
    /// What.
    pub bytes: Vec<u8>,
}

/// Bytes that a datagram takes on the wire besides its own: headers of IPv4 and UDP.
const HEADERS: usize = 28;

impl<A: Clone> Message for Parcel<A> {
    fn bytes(&self) -> usize {
        self.bytes.len() + HEADERS
    }
    fn duplicate(&self) -> Option<Self> {
        Some(self.clone())
    }
    fn through(mut self, noise: &mut dyn FnMut(&mut [u8])) -> Option<Self> {
        // Corrupted datagrams arrive: whoever receives them has a checksum of its own.
        noise(&mut self.bytes);
        Some(self)
    }
}

/// One direction of a path, with the datagrams under way.
#[derive(Clone)]
pub struct Reflector<A> {
    link: LinkFaults<Parcel<A>>,
    received: u64,
    sent: u64,
    refused: u64,
}

impl<A: Clone> Reflector<A> {
    /// A path; the same seed gives the same luck.
    pub fn new(path: &Impairments, seed: u64) -> Self {
        Self { link: path.link(seed), received: 0, sent: 0, refused: 0 }
    }

    /// A datagram for `to` came at `now`, which must not decrease. One that is too long is refused.
    pub fn receive(&mut self, bytes: &[u8], to: A, now: SimTime) {
        if bytes.len() > REFLECTED_MAX {
            self.refused += 1;
            return;
        }
        self.received += 1;
        self.link.send(now, Parcel { to, bytes: bytes.to_vec() });
    }

    /// The next datagram that is due by `now`; call it until there is none.
    pub fn due(&mut self, now: SimTime) -> Option<Parcel<A>> {
        let parcel = self.link.due(now)?;
        self.sent += 1;
        Some(parcel)
    }

    /// When the next one is due.
    pub fn next_due(&self) -> Option<SimTime> {
        self.link.next_due()
    }

    /// Datagrams received, sent, and refused for their length.
    pub fn counts(&self) -> (u64, u64, u64) {
        (self.received, self.sent, self.refused)
    }

    /// What the path did to them.
    pub fn path(&self) -> &LinkCounts {
        self.link.counts()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::impairments::DelayTrace;

    #[test]
    fn a_reflected_datagram_returns_to_its_sender_after_the_traces_delay() {
        let trace = DelayTrace::parse("0,0.070\n1,0.080\n").expect("a trace");
        let mut reflector = Reflector::new(&Impairments { trace, ..Impairments::default() }, 1);
        let mut round_trips = Vec::new();
        for ms in 0..3_000 {
            let now = SimTime::from_millis(ms);
            if ms < 2_000 {
                reflector.receive(&ms.to_le_bytes(), "master", now);
            }
            while let Some(Parcel { to, bytes }) = reflector.due(now) {
                assert_eq!(to, "master");
                round_trips.push(ms - u64::from_le_bytes(bytes.try_into().expect("eight bytes")));
            }
        }
        assert_eq!(round_trips.len(), 2_000);
        let mean = round_trips.iter().sum::<u64>() as f64 / 2_000.0;
        assert!((mean - 75.0).abs() < 0.5, "{mean}");
        assert_eq!(reflector.counts(), (2_000, 2_000, 0));
    }

    #[test]
    fn what_is_corrupted_arrives_changed_and_what_is_too_long_is_refused() {
        let path = Impairments { corrupt: 1.0, ..Impairments::default() };
        let mut reflector = Reflector::new(&path, 3);
        reflector.receive(&[0; 100], (), SimTime::ZERO);
        let parcel = reflector.due(SimTime::ZERO).expect("it arrives");
        assert!(parcel.bytes.len() == 100 && parcel.bytes.iter().any(|byte| *byte != 0));
        reflector.receive(&[0; REFLECTED_MAX + 1], (), SimTime::ZERO);
        assert_eq!((reflector.due(SimTime::ZERO), reflector.counts()), (None, (1, 1, 1)));
    }
}
