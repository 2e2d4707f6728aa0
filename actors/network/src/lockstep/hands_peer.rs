//! The hands link in virtual time: a peer of the session, stepped every millisecond over wires.

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

/// A hands link over wires; its addresses are their numbers.
pub struct HandsPeer {
    name: String,
    link: Box<dyn HandsLink<usize>>,
    wires: Wires,
    end: End,
}

impl HandsPeer {
    /// The link at this end of the wires.
    pub fn new(name: &str, link: Box<dyn HandsLink<usize>>, wires: Wires, end: End) -> Self {
        Self { name: name.to_owned(), link, wires, end }
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
        let (wires, end) = (self.wires.all(), self.end);
        let mut send = |to: usize, bytes: &[u8]| {
            let wire: Option<&Wire> = wires.get(to);
            if let Some(wire) = wire {
                wire.send_datagram(end, now, bytes);
            }
            wire.is_some()
        };
        for (number, wire) in wires.iter().enumerate() {
            while let Some(mut bytes) = wire.receive_datagram(end, now) {
                self.link.receive(now, number, &mut bytes, &mut send);
            }
        }
        self.link.tick(now, &mut send);
    }
}
