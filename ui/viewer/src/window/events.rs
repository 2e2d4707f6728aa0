//! The event loop: opens windows, forwards their events, and serves the player's input.
//!
//! It runs on the first thread, as the system requires, draws nothing and waits for no window, so that hand input has
//! its own rate however long a frame takes.

use std::sync::Arc;
use std::time::{Duration, Instant};

use winit::application::ApplicationHandler;
use winit::dpi::LogicalSize;
use winit::error::EventLoopError;
use winit::event::{
    DeviceEvent, DeviceId, ElementState, Modifiers, MouseButton, MouseScrollDelta, WindowEvent,
};
use winit::event_loop::{ActiveEventLoop, ControlFlow, EventLoop, EventLoopProxy};
use winit::keyboard::{KeyCode, PhysicalKey};
use winit::window::{CursorGrabMode, Window, WindowId};

use super::health::ViewerHealth;
use super::keys;
use super::lifecycle::{self, ViewerFault, WindowHandle, WindowMessage, WindowSettings};
use super::subject::{Player, Subject};
use super::view_state::{Choice, Look, StereoLayout};
use crate::layout::Stereo;
use crate::overlay::Overlays;
use crate::quality::Quality;

/// Interval at which a player's input is written into the session.
const HAND_PERIOD: Duration = Duration::from_millis(8);
/// Most open windows.
const WINDOWS_MAX: usize = 16;

/// Messages to the event loop from windows, and from the program that opened them.
pub enum LoopMessage {
    /// Opens another window with these settings.
    Open(Vec<Box<dyn Subject>>, Choice),
    /// A window's actor has ended, with the reason if it was not asked to.
    Closed(WindowId, Option<String>),
    /// The player takes control of the instruments in this window.
    TakeHands(WindowId),
    /// The player's control of the instruments ends: the session is over.
    GiveBackHands,
    /// Injects a fault into every window's viewer.
    ViewerFault(ViewerFault),
    /// Closes all windows.
    Quit,
}

/// Initial options of windows.
pub struct Options {
    /// The subjects: one, or several beside each other.
    pub subjects: Vec<Box<dyn Subject>>,
    /// The receiver of a player's input.
    pub player: Option<Box<dyn Player>>,
    /// Whether the player controls the instruments from the start.
    pub hands: bool,
    /// Quality; `None`: chosen by the pacer.
    pub quality: Option<Quality>,
    /// Stereo layout.
    pub eyes: StereoLayout,
    /// Distance and convergence of the eyes.
    pub stereo: Stereo,
    /// The overlays.
    pub overlays: Overlays,
    /// Cameras by name, each in its own tile; empty: the first one.
    pub cameras: Vec<String>,
    /// Width and height of the window, in logical points.
    pub size: [f64; 2],
}

/// The windows of a program. Only one instance can exist, on the program's first thread.
pub struct Windows {
    event_loop: EventLoop<LoopMessage>,
    health: Arc<ViewerHealth>,
}

impl Windows {
    /// Connects to the display.
    ///
    /// # Errors
    /// When no display is usable, in words.
    pub fn connect() -> Result<Self, String> {
        super::display::survive_its_loss();
        let event_loop = EventLoop::with_user_event().build().map_err(|error| match error {
            EventLoopError::Os(error) => format!("the display cannot be used: {error}"),
            error => error.to_string(),
        })?;
        Ok(Self { event_loop, health: Arc::default() })
    }

    /// A sender of messages to the event loop.
    pub fn proxy(&self) -> EventLoopProxy<LoopMessage> {
        self.event_loop.create_proxy()
    }

    /// Health of the windows.
    pub fn health(&self) -> Arc<ViewerHealth> {
        self.health.clone()
    }

    /// Shows subjects until the last window is closed.
    ///
    /// # Errors
    /// Why nothing can be shown, in words: no adapter, or a lost display.
    pub fn show(self, options: Options) -> Result<(), String> {
        let proxy = self.event_loop.create_proxy();
        let look = match <[String; 1]>::try_from(options.cameras) {
            Ok([camera]) => Some(Look::Camera(camera)),
            Err(cameras) => (!cameras.is_empty()).then_some(Look::Cameras(cameras)),
        };
        let player_help = options.player.as_ref().map_or_else(Vec::new, |player| player.help());
        let mut house = WindowLoop {
            proxy,
            opening: Some((
                options.subjects,
                Choice {
                    look,
                    eyes: options.eyes,
                    stereo: options.stereo,
                    quality: options.quality,
                    overlays: options.overlays,
                },
            )),
            size: options.size,
            player: options.player,
            player_help,
            wants_hands: options.hands,
            windows: Vec::new(),
            hands: None,
            modifiers: Modifiers::default(),
            focused: false,
            last: Instant::now(),
            failed: None,
            health: self.health,
        };
        let ran = self.event_loop.run_app(&mut house);
        house.windows.drain(..).for_each(WindowHandle::close);
        match (ran, house.failed) {
            (_, Some(why)) => Err(why),
            (Err(error), None) => Err(error.to_string()),
            (Ok(()), None) => Ok(()),
        }
    }
}

struct WindowLoop {
    proxy: EventLoopProxy<LoopMessage>,
    opening: Option<(Vec<Box<dyn Subject>>, Choice)>,
    size: [f64; 2],
    player: Option<Box<dyn Player>>,
    player_help: Vec<(String, String)>,
    wants_hands: bool,
    windows: Vec<WindowHandle>,
    /// The window in which the player controls the instruments.
    hands: Option<WindowId>,
    modifiers: Modifiers,
    focused: bool,
    last: Instant,
    failed: Option<String>,
    health: Arc<ViewerHealth>,
}

impl WindowLoop {
    fn find(&self, id: WindowId) -> Option<&WindowHandle> {
        self.windows.iter().find(|window| lifecycle::id(window) == id)
    }

    fn open(&mut self, event_loop: &ActiveEventLoop, subjects: Vec<Box<dyn Subject>>, choice: Choice) {
        if self.windows.len() >= WINDOWS_MAX {
            tracing::warn!("there are {WINDOWS_MAX} windows already");
            return;
        }
        let title = subjects.iter().map(|subject| subject.title()).collect::<Vec<_>>().join(" | ");
        let attributes = Window::default_attributes()
            .with_title(format!("{title} – Trocar"))
            .with_inner_size(LogicalSize::new(self.size[0], self.size[1]))
            .with_min_inner_size(LogicalSize::new(200.0, 150.0));
        let opening = WindowSettings {
            subjects,
            choice,
            hands: self.player.is_some(),
            player_help: self.player_help.clone(),
            health: self.health.clone(),
        };
        let opened = event_loop.create_window(attributes).map_err(|error| error.to_string());
        let started = opened.and_then(|window| {
            lifecycle::start(Arc::new(window), opening, self.proxy.clone()).map_err(|error| error.to_string())
        });
        match started {
            Ok(address) => self.windows.push(address),
            Err(why) if self.windows.is_empty() => {
                self.failed = Some(format!("no window: {why}"));
                event_loop.exit();
            }
            Err(why) => tracing::warn!("no other window: {why}"),
        }
    }

    fn take_hands(&mut self, id: WindowId) {
        let (Some(address), true) = (self.find(id), self.player.is_some()) else { return };
        let window = &address.window;
        // Some systems can lock the pointer, others can only confine it; where neither works, its motion is followed.
        let grabbed = window
            .set_cursor_grab(CursorGrabMode::Locked)
            .or_else(|_| window.set_cursor_grab(CursorGrabMode::Confined));
        if let Err(error) = grabbed {
            tracing::debug!("the pointer is not held: {error}");
        }
        window.set_cursor_visible(false);
        address.send(WindowMessage::Hands(true));
        self.hands = Some(id);
        self.last = Instant::now();
    }

    fn give_back_hands(&mut self) {
        if let Some(player) = &mut self.player {
            player.release_all();
        }
        let Some(id) = self.hands.take() else { return };
        if let Some(address) = self.find(id) {
            // A grab that cannot be released now is released when the window closes.
            let _ = address.window.set_cursor_grab(CursorGrabMode::None);
            address.window.set_cursor_visible(true);
            address.send(WindowMessage::Hands(false));
        }
    }

    /// Whether an event belongs to the player's input alone.
    fn hand_event(&mut self, event: &WindowEvent) -> bool {
        let Some(player) = &mut self.player else { return false };
        match event {
            WindowEvent::KeyboardInput { event, .. } => {
                let PhysicalKey::Code(code) = event.physical_key else { return true };
                if code == KeyCode::Escape {
                    self.give_back_hands();
                    return true;
                }
                let down = event.state == ElementState::Pressed;
                if down && keys::is_reserved(code, &self.modifiers) {
                    return false;
                }
                if !event.repeat {
                    player.press(&format!("{code:?}"), down);
                }
                // A key pressed before the player took control may be released after.
                down
            }
            WindowEvent::MouseInput { state, button, .. } => {
                let name = match button {
                    MouseButton::Left => "MouseLeft",
                    MouseButton::Right => "MouseRight",
                    MouseButton::Middle => "MouseMiddle",
                    MouseButton::Back => "MouseBack",
                    MouseButton::Forward => "MouseForward",
                    MouseButton::Other(_) => return true,
                };
                player.press(name, *state == ElementState::Pressed);
                true
            }
            WindowEvent::MouseWheel { delta, .. } => {
                player.wheel(match delta {
                    MouseScrollDelta::LineDelta(_, notches) => f64::from(*notches),
                    MouseScrollDelta::PixelDelta(pixels) => pixels.y / 50.0,
                });
                true
            }
            WindowEvent::CursorMoved { .. } => true,
            // A new window reports a loss of focus before it gets the focus.
            WindowEvent::Focused(false) if self.focused => {
                self.give_back_hands();
                false
            }
            WindowEvent::CloseRequested => {
                self.give_back_hands();
                false
            }
            _ => false,
        }
    }

    /// Writes the player's input into the session, at its own rate.
    fn serve_hands(&mut self) {
        let now = Instant::now();
        if now.duration_since(self.last) < HAND_PERIOD {
            return;
        }
        let passed = now.duration_since(self.last).as_secs_f64();
        self.last = now;
        let taken = self.hands.or_else(|| self.windows.first().map(lifecycle::id));
        let view = taken.and_then(|id| self.find(id)).and_then(|address| address.view.load_full());
        if let Some(player) = &mut self.player {
            player.pass(passed, view.map(|view| *view));
        }
    }
}

impl ApplicationHandler<LoopMessage> for WindowLoop {
    fn resumed(&mut self, event_loop: &ActiveEventLoop) {
        if let Some((subjects, choice)) = self.opening.take() {
            self.open(event_loop, subjects, choice);
            if std::mem::take(&mut self.wants_hands)
                && let Some(first) = self.windows.first().map(lifecycle::id)
            {
                self.take_hands(first);
            }
        }
    }

    fn user_event(&mut self, event_loop: &ActiveEventLoop, told: LoopMessage) {
        match told {
            LoopMessage::Open(subjects, choice) => self.open(event_loop, subjects, choice),
            LoopMessage::Closed(id, why) => {
                if self.hands == Some(id) {
                    self.give_back_hands();
                }
                if let Some(at) = self.windows.iter().position(|window| lifecycle::id(window) == id) {
                    self.windows.remove(at).close();
                }
                if let Some(why) = why {
                    tracing::warn!("a window was given up: {why}");
                    if self.windows.is_empty() {
                        self.failed = Some(why);
                    }
                }
                if self.windows.is_empty() {
                    event_loop.exit();
                }
            }
            LoopMessage::TakeHands(id) => self.take_hands(id),
            LoopMessage::GiveBackHands => self.give_back_hands(),
            LoopMessage::ViewerFault(trouble) => {
                self.windows.iter().for_each(|window| window.send(WindowMessage::ViewerFault(trouble)));
            }
            LoopMessage::Quit => event_loop.exit(),
        }
    }

    fn window_event(&mut self, _: &ActiveEventLoop, id: WindowId, event: WindowEvent) {
        if let WindowEvent::ModifiersChanged(modifiers) = &event {
            self.modifiers = *modifiers;
        }
        if self.hands == Some(id) && self.hand_event(&event) {
            return;
        }
        if let WindowEvent::Focused(focused) = event {
            self.focused = focused;
        }
        let Some(address) = self.find(id) else { return };
        match event {
            WindowEvent::CloseRequested => address.send(WindowMessage::Close),
            event => address.send(WindowMessage::Event(event)),
        }
    }

    fn device_event(&mut self, _: &ActiveEventLoop, _: DeviceId, event: DeviceEvent) {
        let (DeviceEvent::MouseMotion { delta: (right, down) }, Some(id)) = (event, self.hands) else {
            return;
        };
        let height =
            self.find(id).map_or(1.0, |address| f64::from(address.window.inner_size().height.max(1)));
        if let Some(player) = &mut self.player {
            player.pointer(right / height, down / height);
        }
    }

    fn about_to_wait(&mut self, event_loop: &ActiveEventLoop) {
        if self.player.is_none() {
            event_loop.set_control_flow(ControlFlow::Wait);
            return;
        }
        self.serve_hands();
        event_loop.set_control_flow(ControlFlow::WaitUntil(self.last + HAND_PERIOD));
    }
}
