//! The hands link in virtual time: a peer of the session, stepped every millisecond over wires.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};

use trocar_kernel::spec::Peer;
use trocar_scene::SimTime;

use super::wire::{End, Wire};
use crate::hands_link::HandsLink;

/// The wires of an end; clones share them. A station has one, a host one for each station. In virtual time one thread
/// steps everything, so its lock is never waited for.
#[derive(Clone, Default)]
pub struct Wires(Arc<Mutex<Vec<Wire>>>);

impl Wires {
    /// Adds a wire, and returns its number.
    pub fn add(&self, wire: Wire) -> usize {
        let mut wires = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        wires.push(wire);
        wires.len() - 1
    }

    /// The wires, in the order in which they were added.
    pub fn all(&self) -> Vec<Wire> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }
}

/// The wires of a station to other stations, with its end of each; clones share them.
#[derive(Clone, Default)]
pub struct PairWires(Arc<Mutex<Vec<(Wire, End)>>>);

/// The address of the first of them: far above those of hosts.
const FIRST_PAIR: usize = 1 << 16;

impl PairWires {
    /// Adds a wire, and returns the address of its datagrams.
    pub fn add(&self, wire: Wire, end: End) -> usize {
        let mut wires = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        wires.push((wire, end));
        FIRST_PAIR + wires.len() - 1
    }

    fn all(&self) -> Vec<(Wire, End)> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }
}

/// A hands link over wires; its addresses are their numbers.
pub struct HandsPeer {
    pairs: PairWires,
    name: String,
    link: Box<dyn HandsLink<usize>>,
    wires: Wires,
    end: End,
}

impl HandsPeer {
    /// The link at this end of the wires.
    pub fn new(name: &str, link: Box<dyn HandsLink<usize>>, wires: Wires, end: End) -> Self {
        Self { pairs: PairWires::default(), name: name.to_owned(), link, wires, end }
    }

    /// The same with wires to other stations.
    #[must_use]
    pub fn with_pairs(self, pairs: PairWires) -> Self {
        Self { pairs, ..self }
    }
}

impl Peer for HandsPeer {
    fn name(&self) -> &str {
        &self.name
    }

    fn period_ns(&self) -> u64 {
        SimTime::from_millis(1).as_nanos()
    }

    fn step(&mut self, now: SimTime) {
        self.step_at(now, now);
    }
}

impl HandsPeer {
    /// One step of a session whose clock shows `now`, when time on the wires is `wire_now`: it goes on while a session stands
    /// still.
    pub fn step_at(&mut self, now: SimTime, wire_now: SimTime) {
        let hosts = self.wires.all().into_iter().map(|wire| (wire, self.end)).enumerate();
        let pairs = self.pairs.all().into_iter().enumerate().map(|(at, wire)| (FIRST_PAIR + at, wire));
        let wires: BTreeMap<usize, (Wire, End)> = hosts.chain(pairs).collect();
        let mut send = |to: usize, bytes: &[u8]| {
            let wire = wires.get(&to);
            if let Some((wire, end)) = wire {
                wire.send_datagram(*end, wire_now, bytes);
            }
            wire.is_some()
        };
        for (address, (wire, end)) in &wires {
            while let Some(mut bytes) = wire.receive_datagram(*end, wire_now) {
                self.link.receive(now, *address, &mut bytes, &mut send);
            }
        }
        self.link.tick(now, &mut send);
    }
}
