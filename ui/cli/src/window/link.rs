//! What lies between a session and the windows onto it: neither waits for the other.

use std::sync::atomic::{AtomicU8, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use arc_swap::{ArcSwap, ArcSwapOption};
use trocar::session::SceneReader;
use trocar_kernel::live::Guest;
use trocar_scene::{Entity, SimTime, Snapshot};
use trocar_viewer::window::display;
use trocar_viewer::window::subject::{Ask, Note, Standing, Subject};

/// Wishes that may wait for the session.
const ASKS_MAX: usize = 256;
/// Notes that are kept for a window that was not there when they were made.
const NOTES_MAX: usize = 8;

/// Where a person who plays sits: written by the session, taken by the event loop.
pub struct Seat {
    /// Through whom it writes.
    pub guest: Guest,
    /// Where.
    pub person: Entity,
}

/// Who looks at a session.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Audience {
    /// Somebody does.
    There,
    /// The last window was closed: nobody wants to see more.
    Left,
    /// Nothing can be shown any more. The session goes on without pictures.
    Cut,
}

/// What the session and its windows share.
pub struct Shared {
    title: String,
    folder: Option<std::path::PathBuf>,
    /// In real time: where the latest scene always is.
    reader: ArcSwapOption<SceneReader>,
    /// Otherwise: the latest that was shown.
    shown: ArcSwap<Snapshot>,
    standing: ArcSwap<Standing>,
    seat: Mutex<Option<Seat>>,
    audience: AtomicU8,
}

impl Shared {
    /// The seat of a new session, once.
    pub fn take_seat(&self) -> Option<Seat> {
        self.seat.lock().unwrap_or_else(PoisonError::into_inner).take()
    }

    /// The latest scene.
    pub fn scene(&self) -> Arc<Snapshot> {
        match self.reader.load().as_deref() {
            Some(reader) => reader.scene(),
            None => self.shown.load_full(),
        }
    }

    /// Who looks.
    pub fn audience(&self) -> Audience {
        match self.audience.load(Ordering::Acquire) {
            _ if display::is_gone() => Audience::Cut,
            0 => Audience::There,
            1 => Audience::Left,
            _ => Audience::Cut,
        }
    }

    /// Who looks from now on.
    pub fn set_audience(&self, audience: Audience) {
        self.audience.store(audience as u8, Ordering::Release);
    }
}

/// The session's end.
pub struct Link {
    shared: Arc<Shared>,
    asks: Receiver<Ask>,
    standing: Standing,
    notes: u64,
}

/// The windows' end: one per window.
pub struct Looker {
    shared: Arc<Shared>,
    asks: SyncSender<Ask>,
}

/// Both ends, with the scene to begin with.
pub fn link(title: String, folder: Option<std::path::PathBuf>, first: Arc<Snapshot>) -> (Link, Looker) {
    let (sender, asks) = sync_channel(ASKS_MAX);
    let shared = Arc::new(Shared {
        title,
        folder,
        reader: ArcSwapOption::empty(),
        shown: ArcSwap::new(first),
        standing: ArcSwap::default(),
        seat: Mutex::default(),
        audience: AtomicU8::new(Audience::There as u8),
    });
    let looker = Looker { shared: shared.clone(), asks: sender };
    (Link { shared, asks, standing: Standing { speed: 1.0, ..Standing::default() }, notes: 0 }, looker)
}

impl Link {
    /// What it shares with the windows.
    pub fn shared(&self) -> &Arc<Shared> {
        &self.shared
    }

    /// The next wish, if there is one.
    pub fn asked(&self) -> Option<Ask> {
        self.asks.try_recv().ok()
    }

    /// The next wish, or none within that time.
    pub fn wait(&self, limit: Duration) -> Option<Ask> {
        self.asks.recv_timeout(limit).ok()
    }

    /// From now on scenes are read there.
    pub fn read_from(&self, reader: Option<SceneReader>) {
        self.shared.reader.store(reader.map(Arc::new));
    }

    /// Shows a scene.
    pub fn show(&self, scene: Arc<Snapshot>) {
        self.shared.shown.store(scene);
    }

    /// Offers a seat to whoever plays.
    pub fn offer(&self, seat: Seat) {
        *self.shared.seat.lock().unwrap_or_else(PoisonError::into_inner) = Some(seat);
    }

    /// Changes how things stand, for all to see.
    pub fn tell(&mut self, change: impl FnOnce(&mut Standing)) {
        change(&mut self.standing);
        self.shared.standing.store(Arc::new(self.standing.clone()));
    }

    /// How things stand.
    pub fn standing(&self) -> &Standing {
        &self.standing
    }

    /// Tells people something.
    pub fn note(&mut self, text: impl Into<String>, bad: bool) {
        self.notes += 1;
        let note = (self.notes, Note { text: text.into(), bad });
        self.tell(|standing| {
            standing.notes.push(note);
            let surplus = standing.notes.len().saturating_sub(NOTES_MAX);
            standing.notes.drain(..surplus);
        });
    }
}

impl Looker {
    /// What it shares with the session.
    pub fn shared(&self) -> &Arc<Shared> {
        &self.shared
    }
}

impl Subject for Looker {
    fn title(&self) -> String {
        self.shared.title.clone()
    }

    fn folder(&self) -> Option<std::path::PathBuf> {
        self.shared.folder.clone()
    }

    fn scene(&mut self) -> Arc<Snapshot> {
        self.shared.scene()
    }

    fn now(&mut self) -> SimTime {
        self.shared.scene().time()
    }

    fn standing(&mut self) -> Arc<Standing> {
        self.shared.standing.load_full()
    }

    fn ask(&mut self, ask: Ask) {
        // A session that is so far behind has been asked enough.
        let _ = self.asks.try_send(ask);
    }

    fn another(&mut self) -> Result<Box<dyn Subject>, String> {
        Ok(Box::new(Self { shared: self.shared.clone(), asks: self.asks.clone() }))
    }
}
