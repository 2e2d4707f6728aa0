//! The lifecycle of a window's actor: its thread, its mailbox, and restarts after failures.

use std::any::Any;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, TrySendError, sync_channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use arc_swap::ArcSwapOption;
use trocar_scene::PersonView;
use winit::event::{Modifiers, WindowEvent};
use winit::event_loop::EventLoopProxy;
use winit::window::{Window, WindowId};

use super::events::LoopMessage;
use super::health::{ViewerHealth, WindowHealth};
use super::mentor::Pen;
use super::panel::{Hands, Panels};
use super::screen::{End, KeptState, Screen};
use super::subject::Subject;
use super::surface::WindowSurface;
use super::view_state::{Choice, SubjectView};
use crate::error::ViewError;

/// Mailbox capacity of a window that is drawing.
const MESSAGES_MAX: usize = 1024;
/// A window is given up after so many failures within [`FAILURES_WITHIN`].
const FAILURES_MAX: usize = 3;
const FAILURES_WITHIN: Duration = Duration::from_secs(20);

/// A message from the event loop to a window.
pub(super) enum WindowMessage {
    /// A window event.
    Event(WindowEvent),
    /// The player has taken control of the instruments, or released it.
    Hands(bool),
    /// An injected fault.
    ViewerFault(ViewerFault),
    /// Close the window.
    Close,
}

/// Faults that can be injected into a viewer, to test its recovery.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ViewerFault {
    /// It panics.
    Panic,
    /// Its device is lost.
    DeviceLost,
}

/// The event loop's handle to a window.
pub(super) struct WindowHandle {
    messages: SyncSender<WindowMessage>,
    overflowed: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
    /// The point of view from which it shows the scene.
    pub(super) view: Arc<ArcSwapOption<PersonView>>,
    pub(super) window: Arc<Window>,
}

impl WindowHandle {
    /// Never blocks: a message to a full mailbox is dropped, and the window is told so.
    pub(super) fn send(&self, message: WindowMessage) {
        if let Err(TrySendError::Full(_)) = self.messages.try_send(message) {
            self.overflowed.store(true, Ordering::Relaxed);
        }
    }

    /// Closes the window and joins its thread, so that nothing draws on a closed window.
    pub(super) fn close(mut self) {
        let _ = self.messages.send(WindowMessage::Close);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// Initial settings of a window.
pub(super) struct WindowSettings {
    pub(super) subjects: Vec<Box<dyn Subject>>,
    pub(super) choice: Choice,
    /// Whether there is a receiver of the player's input.
    pub(super) hands: bool,
    pub(super) player_help: Vec<(String, String)>,
    pub(super) health: Arc<ViewerHealth>,
}

/// Starts the actor of a window.
///
/// # Errors
/// When the system cannot start a thread.
pub(super) fn start(
    window: Arc<Window>,
    opening: WindowSettings,
    proxy: EventLoopProxy<LoopMessage>,
) -> std::io::Result<WindowHandle> {
    let (messages, inbox) = sync_channel(MESSAGES_MAX);
    let (overflowed, view) = (Arc::<AtomicBool>::default(), Arc::<ArcSwapOption<PersonView>>::default());
    let (shared, seen, shown) = (overflowed.clone(), view.clone(), window.clone());
    let thread = std::thread::Builder::new().name("viewer".into()).spawn(move || {
        let id = shown.id();
        let told = proxy.clone();
        let actor = WindowActor { window: shown, inbox, overflowed: shared, view: seen, proxy };
        let end = match catch_unwind(AssertUnwindSafe(|| actor.run(opening))) {
            Ok(end) => end.err().map(|error| error.to_string()),
            Err(panic) => Some(said(&*panic)),
        };
        // If the event loop has ended already, the message is not needed.
        let _ = told.send_event(LoopMessage::Closed(id, end));
    })?;
    Ok(WindowHandle { messages, overflowed, thread: Some(thread), view, window })
}

/// State that a window keeps across restarts of its actor.
pub(super) struct WindowActor {
    pub(super) window: Arc<Window>,
    pub(super) inbox: Receiver<WindowMessage>,
    pub(super) overflowed: Arc<AtomicBool>,
    pub(super) view: Arc<ArcSwapOption<PersonView>>,
    pub(super) proxy: EventLoopProxy<LoopMessage>,
}

impl WindowActor {
    fn run(self, opening: WindowSettings) -> Result<(), ViewError> {
        let (mut gpu, mut painter) = WindowSurface::new(&self.window)?;
        let subjects = opening.subjects.into_iter();
        let mut kept = KeptState {
            panels: Panels::new(opening.player_help),
            subject_views: subjects.map(|subject| SubjectView::new(&gpu, subject, &opening.choice)).collect(),
            hands: Hands { there: opening.hands, taken: false },
            pen: Pen::default(),
            window_health: WindowHealth::new(opening.health),
            modifiers: Modifiers::default(),
            picture_wanted: false,
            greeted: false,
            hands_at_rest: false,
        };
        let mut failures: Vec<Instant> = Vec::new();
        loop {
            let end =
                catch_unwind(AssertUnwindSafe(|| Screen::new(&self, &gpu, &mut painter, &mut kept).run()));
            let why = match end {
                Ok(End::Closed) => {
                    kept.window_health.recovered();
                    return Ok(());
                }
                Ok(End::Failed(why)) => why,
                Err(panic) => said(&*panic),
            };
            kept.window_health.failed();
            failures.retain(|at| at.elapsed() < FAILURES_WITHIN);
            failures.push(Instant::now());
            if failures.len() > FAILURES_MAX {
                return Err(ViewError::DeviceLost(why));
            }
            tracing::warn!("the viewer is started again: {why}");
            kept.panels.note(format!("the viewer was started again: {why}"), true);
            // The old surface must be dropped before its window gets a new one.
            drop(painter);
            (gpu, painter) = WindowSurface::new(&self.window)?;
            kept.subject_views.iter_mut().for_each(|subject_view| subject_view.rebuild(&gpu));
        }
    }
}

/// The message of a panic.
fn said(panic: &(dyn Any + Send)) -> String {
    let text = panic.downcast_ref::<String>().map(String::as_str).or(panic.downcast_ref::<&str>().copied());
    format!("it panicked: {}", text.unwrap_or("without a word"))
}

/// The id of a window.
pub(super) fn id(address: &WindowHandle) -> WindowId {
    address.window.id()
}
