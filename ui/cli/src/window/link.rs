//! The link between a session and its windows; neither end ever blocks the other.

use std::sync::atomic::{AtomicU8, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use arc_swap::{ArcSwap, ArcSwapOption};
use trocar::session::SceneReader;
use trocar_kernel::live::Guest;
use trocar_scene::{Entity, MentorDeed, SimTime, Snapshot, SurfacePlace};
use trocar_viewer::window::display;
use trocar_viewer::window::subject::{Note, Request, Subject, SubjectState};

use super::mentor::MentorWriter;

/// Most queued requests to the session.
const REQUESTS_MAX: usize = 256;
/// Most notes kept for a window that is not open yet.
const NOTES_MAX: usize = 8;

/// Writes the input of a person who plays: offered by the session, taken by the event loop.
pub struct PlayerGuest {
    /// The guest that writes the input.
    pub guest: Guest,
    /// The entity that takes it.
    pub person: Entity,
}

/// Whether a session has viewers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ViewerPresence {
    /// At least one window is open.
    There,
    /// The last window was closed by the user.
    Left,
    /// The display is lost. The session goes on without pictures.
    Cut,
}

/// State shared by the session and its windows.
pub struct Shared {
    title: String,
    folder: Option<std::path::PathBuf>,
    /// In real time: a reader of the latest scene.
    reader: ArcSwapOption<SceneReader>,
    /// Otherwise: the scene that was shown last.
    shown: ArcSwap<Snapshot>,
    state: ArcSwap<SubjectState>,
    player_guest: Mutex<Option<PlayerGuest>>,
    mentor: Mutex<Option<MentorWriter>>,
    presence: AtomicU8,
}

impl Shared {
    /// Takes the player's guest of a new session; each can be taken once.
    pub fn take_player_guest(&self) -> Option<PlayerGuest> {
        self.player_guest.lock().unwrap_or_else(PoisonError::into_inner).take()
    }

    /// The latest scene.
    pub fn scene(&self) -> Arc<Snapshot> {
        match self.reader.load().as_deref() {
            Some(reader) => reader.scene(),
            None => self.shown.load_full(),
        }
    }

    /// Whether there are viewers.
    pub fn presence(&self) -> ViewerPresence {
        match self.presence.load(Ordering::Acquire) {
            _ if display::is_gone() => ViewerPresence::Cut,
            0 => ViewerPresence::There,
            1 => ViewerPresence::Left,
            _ => ViewerPresence::Cut,
        }
    }

    /// Sets whether there are viewers.
    pub fn set_presence(&self, presence: ViewerPresence) {
        self.presence.store(presence as u8, Ordering::Release);
    }
}

/// The session's end of the link.
pub struct SessionLink {
    shared: Arc<Shared>,
    requests: Receiver<Request>,
    state: SubjectState,
    notes: u64,
}

/// A window's end of the link.
pub struct WindowLink {
    shared: Arc<Shared>,
    requests: SyncSender<Request>,
}

/// Both ends, with the first scene.
pub fn link(
    title: String,
    folder: Option<std::path::PathBuf>,
    first: Arc<Snapshot>,
) -> (SessionLink, WindowLink) {
    let (sender, requests) = sync_channel(REQUESTS_MAX);
    let shared = Arc::new(Shared {
        title,
        folder,
        reader: ArcSwapOption::empty(),
        shown: ArcSwap::new(first),
        state: ArcSwap::default(),
        player_guest: Mutex::default(),
        mentor: Mutex::default(),
        presence: AtomicU8::new(ViewerPresence::There as u8),
    });
    let window_link = WindowLink { shared: shared.clone(), requests: sender };
    (
        SessionLink {
            shared,
            requests,
            state: SubjectState { speed: 1.0, ..SubjectState::default() },
            notes: 0,
        },
        window_link,
    )
}

impl SessionLink {
    /// The state shared with the windows.
    pub fn shared(&self) -> &Arc<Shared> {
        &self.shared
    }

    /// The next request, if there is one.
    pub fn requested(&self) -> Option<Request> {
        self.requests.try_recv().ok()
    }

    /// The next request, or `None` after that time.
    pub fn wait(&self, limit: Duration) -> Option<Request> {
        self.requests.recv_timeout(limit).ok()
    }

    /// Sets the reader of the scene.
    pub fn read_from(&self, reader: Option<SceneReader>) {
        self.shared.reader.store(reader.map(Arc::new));
    }

    /// Shows a scene.
    pub fn show(&self, scene: Arc<Snapshot>) {
        self.shared.shown.store(scene);
    }

    /// Offers a guest to the person who plays.
    pub fn offer_player_guest(&self, player_guest: PlayerGuest) {
        *self.shared.player_guest.lock().unwrap_or_else(PoisonError::into_inner) = Some(player_guest);
    }

    /// Lets the persons at the windows show the others something, in the session that has begun; `None`: nobody shares it.
    pub fn offer_mentor(&self, writer: Option<MentorWriter>) {
        *self.shared.mentor.lock().unwrap_or_else(PoisonError::into_inner) = writer;
    }

    /// Changes the session's state as the windows show it.
    pub fn tell(&mut self, change: impl FnOnce(&mut SubjectState)) {
        change(&mut self.state);
        self.shared.state.store(Arc::new(self.state.clone()));
    }

    /// The session's state as the windows show it.
    pub fn state(&self) -> &SubjectState {
        &self.state
    }

    /// Shows a note to people.
    pub fn note(&mut self, text: impl Into<String>, bad: bool) {
        self.notes += 1;
        let note = (self.notes, Note { text: text.into(), bad });
        self.tell(|state| {
            state.notes.push(note);
            let surplus = state.notes.len().saturating_sub(NOTES_MAX);
            state.notes.drain(..surplus);
        });
    }
}

impl WindowLink {
    /// The state shared with the session.
    pub fn shared(&self) -> &Arc<Shared> {
        &self.shared
    }
}

impl Subject for WindowLink {
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

    fn state(&mut self) -> Arc<SubjectState> {
        self.shared.state.load_full()
    }

    fn request(&mut self, request: Request) {
        // A full queue means that the session is far behind: the request is dropped.
        let _ = self.requests.try_send(request);
    }

    fn is_shared(&self) -> bool {
        self.shared.mentor.lock().unwrap_or_else(PoisonError::into_inner).is_some()
    }

    fn show(&mut self, pointer: Option<Option<SurfacePlace>>, deeds: &mut Vec<MentorDeed>) {
        let mut mentor = self.shared.mentor.lock().unwrap_or_else(PoisonError::into_inner);
        match mentor.as_mut() {
            Some(writer) => writer.show(pointer, deeds),
            None => deeds.clear(),
        }
    }

    fn another(&mut self) -> Result<Box<dyn Subject>, String> {
        Ok(Box::new(Self { shared: self.shared.clone(), requests: self.requests.clone() }))
    }
}
