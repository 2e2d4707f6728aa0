//! Pairs of stations in virtual time: a wire for each, made when one dials another.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use trocar_scene::SimTime;

use super::hands_peer::{PairWires, Wires};
use super::wire::{End, Wire};
use super::wire_streams::{WireHostStreams, WireStationStream};
use crate::impairments::Impairments;
use crate::pairs::{PairDoor, TOKEN_BYTES};
use crate::streams::{HostStreams, StationStream};

/// How long a stream over a wire takes to open.
const HANDSHAKE: SimTime = SimTime::from_millis(2);

/// The doors of all stations of a session; clones share them.
#[derive(Clone)]
pub struct PairDoors(Arc<Mutex<Inner>>);

struct Inner {
    path: Impairments,
    seed: u64,
    /// Wires of those who have come to each door, and all pair wires of its station.
    doors: Vec<(Wires, PairWires)>,
    wires: u64,
    tokens: u64,
}

impl PairDoors {
    /// Stations whose paths to each other are like this one; the same seed gives the same luck.
    pub fn new(path: &Impairments, seed: u64) -> Self {
        let inner = Inner { path: path.clone(), seed, doors: Vec::new(), wires: 0, tokens: 0 };
        Self(Arc::new(Mutex::new(inner)))
    }

    fn lock(&self) -> MutexGuard<'_, Inner> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The door of another station, whose hands link has these wires.
    pub fn open(&self, own: PairWires) -> WirePairDoor {
        let comers = Wires::default();
        let mut inner = self.lock();
        inner.doors.push((comers.clone(), own.clone()));
        let number = inner.doors.len() - 1;
        WirePairDoor { doors: self.clone(), number, own, streams: WireHostStreams::new(comers) }
    }
}

/// The door of one station.
pub struct WirePairDoor {
    doors: PairDoors,
    number: usize,
    own: PairWires,
    streams: WireHostStreams,
}

impl PairDoor<usize> for WirePairDoor {
    fn streams(&mut self) -> &mut dyn HostStreams {
        &mut self.streams
    }

    fn place(&self) -> Vec<u8> {
        (self.number as u64).to_le_bytes().to_vec()
    }

    fn token(&self) -> Option<[u8; TOKEN_BYTES]> {
        let mut inner = self.doors.lock();
        inner.tokens += 1;
        let of = [inner.seed.to_le_bytes(), inner.tokens.to_le_bytes()].concat();
        Some(blake3::derive_key("trocar-network lock-step token of a pair", &of))
    }

    fn dial(&mut self, place: &[u8]) -> Result<Box<dyn StationStream<usize>>, String> {
        let mut inner = self.doors.lock();
        let number =
            place.try_into().map(u64::from_le_bytes).ok().and_then(|number| usize::try_from(number).ok());
        let (comers, theirs) =
            number.and_then(|number| inner.doors.get(number)).cloned().ok_or("there is no such door")?;
        inner.wires += 1;
        let wire = Wire::new(&inner.path, inner.seed.wrapping_add(2 * inner.wires));
        let number = comers.add(wire.clone());
        theirs.add(wire.clone(), End::Host);
        let peer = self.own.add(wire.clone(), End::Station);
        Ok(Box::new(WireStationStream::new(wire, number, HANDSHAKE).with_peer(peer)))
    }
}
