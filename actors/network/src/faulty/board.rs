//! Link board: which faults a session's links have, for whoever moves their datagrams and bytes.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError, TryLockError};

use trocar_kernel::spec::{FaultKind, FaultOrder, FaultSink, LINK, LINKS};
use trocar_scene::SimTime;

use crate::control::STATIONS_MAX;

/// A link is sound if something has arrived within this time.
pub const SOUND_FOR: SimTime = SimTime::from_millis(100);
/// Most orders: the beginnings and ends of all faults of a plan.
const ORDERS_MAX: usize = 4_096;
/// Before the name or number of a station.
const OF_STATION: &str = "link.";

/// A connection, as faults know it.
#[derive(Clone, Debug)]
struct Known {
    /// Its number in datagrams; `None` for the one of a station.
    connection: Option<u32>,
    station: u16,
    name: String,
    heard_at: Option<SimTime>,
    /// Whether a fault has cut it; what was under way may come all the same.
    is_cut: bool,
}

/// Orders with their numbers.
pub(super) type Orders<'a> = dyn Iterator<Item = (usize, &'a FaultOrder)> + 'a;

#[derive(Debug, Default)]
struct Inner {
    orders: Vec<FaultOrder>,
    known: Vec<Known>,
    now: SimTime,
}

/// The faults of a session's links. Orders come from the session's fault plan. Whoever moves datagrams never waits for it:
/// it looks when the version has changed and nobody else does.
#[derive(Debug, Default)]
pub struct LinkBoard {
    inner: Mutex<Inner>,
    version: AtomicU64,
    dies: AtomicBool,
}

impl LinkBoard {
    /// Of a host, which has links as stations come.
    pub fn host() -> Self {
        Self::default()
    }

    /// Of a station, which has one link.
    pub fn station() -> Self {
        let board = Self::default();
        let own = Known { connection: None, station: 0, name: String::new(), heard_at: None, is_cut: false };
        board.lock().known.push(own);
        board
    }

    fn lock(&self) -> MutexGuard<'_, Inner> {
        // Whoever panicked has left whole entries.
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn try_lock(&self) -> Option<MutexGuard<'_, Inner>> {
        match self.inner.try_lock() {
            Ok(inner) => Some(inner),
            Err(TryLockError::Poisoned(inner)) => Some(inner.into_inner()),
            Err(TryLockError::WouldBlock) => None,
        }
    }

    /// Changes with every order and every connection.
    pub(super) fn version(&self) -> u64 {
        self.version.load(Ordering::Acquire)
    }

    /// Whether the network is to die at work; once.
    pub(super) fn takes_its_life(&self) -> bool {
        self.dies.swap(false, Ordering::AcqRel)
    }

    /// A station was let in; an earlier connection of it is over.
    pub(super) fn admit(&self, connection: u32, station: u16, name: &str) {
        let mut inner = self.lock();
        inner.known.retain(|known| known.station != station);
        if inner.known.len() < STATIONS_MAX {
            let (name, connection) = (name.to_owned(), Some(connection));
            inner.known.push(Known { connection, station, name, heard_at: None, is_cut: false });
        }
        drop(inner);
        self.version.fetch_add(1, Ordering::Release);
    }

    /// A station's own link begins anew.
    pub(super) fn reconnect(&self) {
        for known in self.lock().known.iter_mut().filter(|known| known.connection.is_none()) {
            (known.heard_at, known.is_cut) = (None, false);
        }
    }

    /// Shows each connection with all its orders so far, numbered; false if somebody else looks at them.
    pub(super) fn look(&self, mut each: impl FnMut(Option<u32>, &mut Orders<'_>)) -> bool {
        let Some(inner) = self.try_lock() else { return false };
        for known in &inner.known {
            let orders = inner.orders.iter().enumerate();
            each(known.connection, &mut orders.filter(|(_, order)| concerns(&order.target, known)));
        }
        true
    }

    /// Something came over these connections; `None` is a station's own.
    pub(super) fn heard(&self, now: SimTime, connections: &mut Vec<Option<u32>>) {
        let Some(mut inner) = self.try_lock() else { return };
        inner.now = inner.now.max(now);
        for connection in connections.drain(..) {
            for known in inner.known.iter_mut().filter(|known| known.connection == connection) {
                known.heard_at = Some(now);
            }
        }
    }
}

fn concerns(target: &str, known: &Known) -> bool {
    let Some(wanted) = target.strip_prefix(OF_STATION) else {
        return target == LINK && known.connection.is_none();
    };
    wanted == known.name || wanted.parse() == Ok(known.station)
}

fn is_sound(known: &Known, now: SimTime) -> bool {
    !known.is_cut && known.heard_at.is_some_and(|at| now.since(at) <= SOUND_FOR)
}

impl FaultSink for LinkBoard {
    fn fault(&self, order: &FaultOrder) {
        if order.target == LINKS {
            if order.kind == FaultKind::Kill && order.begins {
                self.lock().known.iter_mut().for_each(|known| known.is_cut = true);
                self.dies.store(true, Ordering::Release);
            }
            return;
        }
        let mut inner = self.lock();
        if order.kind == FaultKind::Kill && order.begins {
            let struck = inner.known.iter_mut().filter(|known| concerns(&order.target, known));
            struck.for_each(|known| known.is_cut = true);
        }
        if inner.orders.len() < ORDERS_MAX {
            inner.orders.push(order.clone());
        }
        drop(inner);
        self.version.fetch_add(1, Ordering::Release);
    }

    /// Of all links together.
    fn is_sound(&self) -> Option<bool> {
        let inner = self.lock();
        (!inner.known.is_empty()).then(|| inner.known.iter().all(|known| is_sound(known, inner.now)))
    }

    fn is_target_sound(&self, target: &str) -> Option<bool> {
        let inner = self.lock();
        let known = inner.known.iter().find(|known| concerns(target, known))?;
        Some(is_sound(known, inner.now))
    }
}
