//! The actor behind one window: takes events, draws when there is a change, and never blocks others.
//!
//! It has its own thread: however long a software rasteriser takes for a frame, the event loop, the other windows and
//! the session go on. It is restarted ([`super::lifecycle`]) after its device is lost or it has panicked.

mod mentoring;

use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::sync::mpsc::RecvTimeoutError;
use std::time::{Duration, Instant};

use trocar_scene::output_file::{self, Replace};
use winit::event::{ElementState, KeyEvent, Modifiers, WindowEvent};
use winit::keyboard::{KeyCode, PhysicalKey};
use winit::window::Fullscreen;

use super::canvas::Canvas;
use super::events::LoopMessage;
use super::health::WindowHealth;
use super::keys::{self, Action};
use super::lag::{self, LagWatch};
use super::lifecycle::{ViewerFault, WindowActor, WindowMessage};
use super::mentor::Pen;
use super::mouse::{Gesture, Mouse};
use super::panel::{self, Hands, Panels, WindowState, next_speed, request_all, toggle_play};
use super::subject::{PlayState, Request};
use super::surface::{FrameOutcome, WindowSurface};
use super::view_state::{Choice, QUALITIES, StereoLayout, SubjectView};
use crate::error::ViewError;
use crate::gpu::Gpu;
use crate::pacing::{LADDER, Pacer};
use crate::picture::Picture;
use crate::quality::Quality;

/// Shortest time between two frames, and between two checks for a new scene.
const FRAME: Duration = Duration::from_micros(16_667);
/// Share of time for drawing with a software rasteriser: the rest is for the simulation.
const SOFTWARE_LOAD: f64 = 0.6;

/// The end of a run of a window's actor.
pub(super) enum End {
    /// Closed on request.
    Closed,
    /// Failed, with the reason.
    Failed(String),
}

/// State that survives a restart of the actor: keys that are down, and a requested picture.
pub(super) struct KeptState {
    pub(super) panels: Panels,
    pub(super) subject_views: Vec<SubjectView>,
    pub(super) hands: Hands,
    pub(super) pen: Pen,
    pub(super) window_health: WindowHealth,
    pub(super) modifiers: Modifiers,
    pub(super) picture_wanted: bool,
    /// A frame has said that the first picture is being prepared.
    pub(super) greeted: bool,
    /// The session's end took the instruments out of the player's hands; the next session gives them back.
    pub(super) hands_at_rest: bool,
}

/// A run of a window's actor between two restarts.
pub(super) struct Screen<'a> {
    actor: &'a WindowActor,
    gpu: &'a Gpu,
    painter: &'a mut WindowSurface,
    kept: &'a mut KeptState,
    ui: egui::Context,
    input: egui_winit::State,
    canvas: Canvas,
    pacer: Pacer,
    mouse: Mouse,
    /// An input or message has arrived since the last frame.
    stale: bool,
    /// When the user interface wants to be redrawn by itself.
    wanted: Option<Instant>,
    /// The window is not visible.
    hidden: bool,
    closing: bool,
    frames: Vec<Instant>,
    /// Origin of the clock of `lag_watch`.
    since: Instant,
    lag_watch: LagWatch,
    told: Vec<(PlayState, f64, Option<u64>)>,
    /// Where the mouse was when it was last looked what is under it.
    looked_at: Option<egui::Pos2>,
    /// The instruments were laid down for the pen.
    laid_down: bool,
    /// Refusals that were told.
    heard_refusals: Option<u64>,
}

impl<'a> Screen<'a> {
    pub(super) fn new(
        actor: &'a WindowActor,
        gpu: &'a Gpu,
        painter: &'a mut WindowSurface,
        kept: &'a mut KeptState,
    ) -> Self {
        let ui = egui::Context::default();
        ui.set_theme(egui::Theme::Dark);
        ui.set_fonts(panel::fonts());
        let largest = gpu.device.limits().max_texture_dimension_2d as usize;
        let window = &actor.window;
        let input = egui_winit::State::new(
            ui.clone(),
            egui::ViewportId::ROOT,
            window,
            Some(window.scale_factor() as f32),
            None,
            Some(largest),
        );
        let frames_per_second = 1.0 / FRAME.as_secs_f64();
        // Without a graphics card the first picture is a cheap one: it comes in time on a busy machine too.
        let pacer = match gpu.is_software() {
            true => Pacer::new(frames_per_second, SOFTWARE_LOAD).begin_with(Quality::PLAIN),
            false => Pacer::new(frames_per_second, 1.0),
        };
        Self {
            actor,
            gpu,
            painter,
            kept,
            ui,
            input,
            canvas: Canvas::default(),
            pacer: pacer.at_best(Quality::FULL),
            mouse: Mouse::default(),
            stale: true,
            wanted: None,
            hidden: false,
            closing: false,
            frames: Vec::new(),
            since: Instant::now(),
            lag_watch: LagWatch::default(),
            told: Vec::new(),
            looked_at: None,
            laid_down: false,
            heard_refusals: None,
        }
    }

    pub(super) fn run(mut self) -> End {
        let mut next = Instant::now();
        loop {
            match self.actor.inbox.recv_timeout(next.saturating_duration_since(Instant::now())) {
                Ok(message) => self.receive(message),
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => return End::Closed,
            }
            while let Ok(message) = self.actor.inbox.try_recv() {
                self.receive(message);
            }
            if self.actor.overflowed.swap(false, Ordering::Relaxed) {
                // A key released without focus must not stay down.
                self.kept.modifiers = Modifiers::default();
                self.stale = true;
            }
            if self.closing {
                return End::Closed;
            }
            let now = Instant::now();
            if now < next {
                continue;
            }
            next = now + FRAME;
            let newer = self
                .kept
                .subject_views
                .iter_mut()
                .fold(false, |newer, subject_view| subject_view.follow() | newer);
            self.pass_pen_on();
            let requested = self.wanted.is_some_and(|wanted| wanted <= now) | self.heard_something();
            if self.hidden || !(newer || requested || self.stale) {
                continue;
            }
            match self.frame() {
                Ok(FrameOutcome::Yes) => {
                    self.kept.window_health.recovered();
                    // Waits until it is drawn, to measure the frame time.
                    if let Err(error) = self.gpu.device.poll(wgpu::PollType::wait_indefinitely()) {
                        return End::Failed(error.to_string());
                    }
                    let took = now.elapsed().as_secs_f64();
                    self.pacer.drawn(took);
                    let moves = self.moves();
                    self.lag_watch.shown(self.since.elapsed().as_secs_f64(), took, moves);
                    next = Instant::now() + Duration::from_secs_f64(self.pacer.rest(took).clamp(0.0, 1.0));
                }
                Ok(FrameOutcome::NotNow | FrameOutcome::Again) => self.stale = true,
                Err(error) => return End::Failed(error.to_string()),
            }
        }
    }

    /// Whether a subject's time passes.
    fn moves(&mut self) -> bool {
        let runs =
            |subject_view: &mut SubjectView| subject_view.subject.state().play_state == PlayState::Running;
        self.kept.subject_views.iter_mut().any(runs)
    }

    /// How far the pictures lag, and why. While a lower quality is left to try, that is tried first.
    fn lag(&self) -> Option<[String; 2]> {
        let lag = self.lag_watch.lag()?;
        let is_fixed = self.kept.subject_views.iter().any(|subject_view| subject_view.quality.is_some());
        let is_lowest = self.pacer.pace() == LADDER[LADDER.len() - 1];
        (is_fixed || is_lowest)
            .then(|| [lag.to_string(), lag::reason(self.gpu.is_software(), lag::load(), is_fixed)])
    }

    /// When a session is over, its player needs the window's keys and the pointer; when the next one begins, the
    /// instruments.
    fn rest_hands(&mut self) {
        let moves = self.moves();
        let over =
            |subject_view: &mut SubjectView| subject_view.subject.state().play_state == PlayState::Over;
        if self.kept.hands.taken && self.kept.subject_views.iter_mut().all(over) {
            self.kept.hands_at_rest = true;
            self.tell(LoopMessage::GiveBackHands);
        } else if moves && std::mem::take(&mut self.kept.hands_at_rest) {
            self.tell(LoopMessage::TakeHands(self.actor.window.id()));
        }
    }

    /// Whether a subject has new data for the panels.
    fn heard_something(&mut self) -> bool {
        let said = |subject_view: &mut SubjectView| {
            let state = subject_view.subject.state();
            (state.play_state, state.speed, state.notes.last().map(|(number, _)| *number))
        };
        let told: Vec<_> = self.kept.subject_views.iter_mut().map(said).collect();
        let changed = told != self.told;
        self.told = told;
        if changed {
            self.rest_hands();
        }
        changed
    }

    fn receive(&mut self, message: WindowMessage) {
        match message {
            WindowMessage::Close => self.closing = true,
            WindowMessage::ViewerFault(ViewerFault::Panic) => panic!("a fault that was injected"),
            WindowMessage::ViewerFault(ViewerFault::DeviceLost) => {
                self.gpu.device.destroy();
                self.stale = true;
            }
            WindowMessage::Hands(taken) => {
                self.kept.hands.taken = taken;
                if taken {
                    self.laid_down = false;
                    self.take_pen(false);
                }
                self.stale = true;
            }
            WindowMessage::Event(event) => self.event(&event),
        }
    }

    fn event(&mut self, event: &WindowEvent) {
        match event {
            WindowEvent::Resized(size) => {
                self.hidden = size.width == 0 || size.height == 0;
                self.painter.resize(self.gpu, [size.width, size.height]);
                self.stale = true;
            }
            WindowEvent::Occluded(hidden) => {
                self.hidden = *hidden;
                self.stale = true;
            }
            WindowEvent::RedrawRequested => self.stale = true,
            WindowEvent::ModifiersChanged(modifiers) => self.kept.modifiers = *modifiers,
            WindowEvent::KeyboardInput { event, .. } if self.key(event) => return,
            _ => {}
        }
        let (canvas, ui) = (&self.canvas, &self.ui);
        let over = |place: egui::Pos2| {
            let points = place / ui.pixels_per_point();
            let covered = ui.layer_id_at(points).is_some_and(|layer| layer.order != egui::Order::Background);
            canvas.at(place).filter(|_| !covered).map(|(index, _)| index)
        };
        let under = over(match event {
            WindowEvent::CursorMoved { position, .. } => {
                egui::Pos2::new(position.x as f32, position.y as f32)
            }
            _ => self.mouse.place(),
        });
        let is_press = matches!(event, WindowEvent::MouseInput { state: ElementState::Pressed, .. });
        // A press of the pen is no gesture of the camera; of everything else both hear.
        let is_pens = is_press && self.lead_pen(event, under);
        if !is_pens && let Some(gesture) = self.mouse.follow(event, Instant::now(), |_| under) {
            self.lead(gesture);
        }
        if !is_press {
            self.lead_pen(event, under);
        }
        self.stale |= self.input.on_window_event(&self.actor.window, event).repaint;
    }

    /// Moves the camera by a gesture.
    fn lead(&mut self, gesture: Gesture) {
        self.stale = true;
        let height = |index: usize| self.canvas.height(index);
        let led = match gesture {
            Gesture::Turn(index, moved) => {
                let moved = moved / height(index) as f32;
                self.kept.subject_views[index].free().turn(f64::from(moved.x), f64::from(moved.y));
                index
            }
            Gesture::Shift(index, moved) => {
                let moved = moved / height(index) as f32;
                self.kept.subject_views[index].free().shift(f64::from(moved.x), f64::from(moved.y));
                index
            }
            Gesture::Zoom(index, notches) => {
                self.kept.subject_views[index].free().zoom(notches);
                index
            }
            Gesture::Select(index, place) => {
                let Some((_, at)) = self.canvas.at(place) else { return };
                match self.kept.subject_views[index].pick(self.gpu, at) {
                    Ok(found) => self.kept.subject_views[index].selected = found,
                    // The next frame will fail as well, and report it.
                    Err(error) => tracing::debug!("nothing is selected: {error}"),
                }
                return;
            }
        };
        // Compared recordings share one point of view.
        let look = self.kept.subject_views[led].look.clone();
        self.kept.subject_views.iter_mut().for_each(|subject_view| subject_view.look = look.clone());
    }

    /// Whether the window has handled a key.
    fn key(&mut self, event: &KeyEvent) -> bool {
        let PhysicalKey::Code(code) = event.physical_key else { return false };
        let types = self.ui.text_edit_focused() || self.kept.pen.label.is_some();
        if types && (code == KeyCode::Escape || !keys::is_reserved(code, &self.kept.modifiers)) {
            return false;
        }
        let Some(action) = keys::action(code, &self.kept.modifiers) else { return false };
        if types && matches!(action, Action::Mentor(_)) {
            // The line has keys of the same names.
            return false;
        }
        let again = matches!(action, Action::Step | Action::StepBack);
        if event.state == ElementState::Pressed && (again || !event.repeat) {
            self.act(action);
        }
        true
    }

    fn act(&mut self, action: Action) {
        self.stale = true;
        let cycle = |at: Option<usize>, count: usize| at.map_or(0, |at| (at + 1) % count);
        match action {
            Action::Help => self.kept.panels.help = !self.kept.panels.help,
            Action::LeftPanel => self.kept.panels.left = !self.kept.panels.left,
            Action::RightPanel => self.kept.panels.right = !self.kept.panels.right,
            Action::Actors => self.kept.panels.actors = !self.kept.panels.actors,
            Action::FullScreen => {
                let window = &self.actor.window;
                let full = window.fullscreen().is_none().then_some(Fullscreen::Borderless(None));
                window.set_fullscreen(full);
            }
            Action::Layout => {
                for subject_view in self.kept.subject_views.iter_mut() {
                    let at = StereoLayout::ALL.iter().position(|(eyes, _)| *eyes == subject_view.eyes);
                    subject_view.eyes = StereoLayout::ALL[cycle(at, StereoLayout::ALL.len())].0;
                }
            }
            Action::Quality => {
                for subject_view in self.kept.subject_views.iter_mut() {
                    let at = QUALITIES.iter().position(|(quality, _)| *quality == subject_view.quality);
                    subject_view.quality = QUALITIES[cycle(at, QUALITIES.len())].0;
                }
            }
            Action::Hands if self.kept.hands.there => {
                self.tell(LoopMessage::TakeHands(self.actor.window.id()))
            }
            Action::Hands => {
                let text = "nobody plays in this session: start it with --play";
                self.kept.panels.note(text.to_owned(), true);
            }
            Action::Pause => toggle_play(&mut self.kept.subject_views),
            Action::Step => request_all(&mut self.kept.subject_views, &Request::Step { back: false }),
            Action::StepBack => request_all(&mut self.kept.subject_views, &Request::Step { back: true }),
            Action::Faster => self.speed(1),
            Action::Slower => self.speed(-1),
            Action::Reset => request_all(&mut self.kept.subject_views, &Request::Reset),
            Action::Loop => {
                let looped = self
                    .kept
                    .subject_views
                    .first_mut()
                    .is_some_and(|subject_view| subject_view.subject.state().looped);
                request_all(&mut self.kept.subject_views, &Request::Loop(!looped));
            }
            Action::CameraBefore => {
                self.kept.subject_views.iter_mut().for_each(|subject_view| subject_view.cycle_camera(-1))
            }
            Action::CameraNext => {
                self.kept.subject_views.iter_mut().for_each(|subject_view| subject_view.cycle_camera(1))
            }
            Action::FreeCamera => {
                for subject_view in self.kept.subject_views.iter_mut() {
                    subject_view.free();
                }
            }
            // Taken once all earlier input is drawn.
            Action::Screenshot => self.kept.picture_wanted = true,
            Action::NewWindow => self.new_window(),
            Action::Close => self.closing = true,
            Action::Quit => self.tell(LoopMessage::Quit),
            Action::Mentor(key) => self.mentor(key),
            Action::Show(overlay) => {
                for subject_view in self.kept.subject_views.iter_mut() {
                    subject_view.overlays.toggle(overlay);
                }
            }
        }
    }

    fn speed(&mut self, by: isize) {
        let Some(subject_view) = self.kept.subject_views.first_mut() else { return };
        let state = subject_view.subject.state();
        if state.abilities.speed {
            request_all(&mut self.kept.subject_views, &Request::Speed(next_speed(state.speed, by)));
        } else {
            let text = "in real time there is one speed only; --lockstep and recordings have others";
            self.kept.panels.note(text.to_owned(), true);
        }
    }

    fn screenshot(&mut self) {
        self.stale = true;
        for index in 0..self.kept.subject_views.len() {
            let subject_view = &self.kept.subject_views[index];
            let saved = subject_view.picture(self.gpu).and_then(|picture| match picture {
                Some(picture) => save_under_free_name(&picture, &subject_view.subject.title()),
                None => Ok("nothing yet".to_owned()),
            });
            match saved {
                Ok(file) => self.kept.panels.note(format!("picture {file}"), false),
                Err(error) => self.kept.panels.note(format!("no picture: {error}"), true),
            }
        }
    }

    fn new_window(&mut self) {
        let others: Result<Vec<_>, String> =
            self.kept.subject_views.iter_mut().map(|subject_view| subject_view.subject.another()).collect();
        match others {
            Ok(subjects) => {
                let choice =
                    self.kept.subject_views.first().map_or_else(Choice::default, SubjectView::choice);
                self.tell(LoopMessage::Open(subjects, choice));
            }
            Err(why) => self.kept.panels.note(format!("no other window: {why}"), true),
        }
    }

    fn tell(&self, told: LoopMessage) {
        // If the event loop has ended, the message is lost, and this window ends as well.
        let _ = self.actor.proxy.send_event(told);
    }

    fn frame(&mut self) -> Result<FrameOutcome, ViewError> {
        let now = Instant::now();
        self.frames.retain(|at| now.duration_since(*at) < Duration::from_secs(1));
        self.frames.push(now);
        (self.stale, self.wanted) = (false, None);
        let raw = self.input.take_egui_input(&self.actor.window);
        let (frames, pace) = (self.frames.len() as f64, self.pacer.pace());
        let state = WindowState { frames, lag: self.lag(), hands: self.kept.hands };
        let greets = !std::mem::replace(&mut self.kept.greeted, true);
        let mut actions = Vec::new();
        let mut outcome = Ok(());
        let ui = self.ui.clone();
        let output = ui.run_ui(raw, |ui| {
            let wishes = self.kept.panels.show(ui, &mut self.kept.subject_views, &mut self.kept.pen, &state);
            actions.extend(wishes.0);
            egui::CentralPanel::no_frame().show(ui, |ui| {
                if greets {
                    // The first picture may take seconds: its pipelines are compiled.
                    ui.centered_and_justified(|ui| ui.label("preparing the first picture …"));
                    return;
                }
                outcome = self.canvas.show(ui, self.gpu, self.painter, &mut self.kept.subject_views, pace);
            });
            self.kept.panels.show_notes(ui);
        });
        outcome?;
        if self.kept.panels.actors {
            // Rates change even while the scene does not.
            ui.request_repaint_after(Duration::from_millis(500));
        }
        if let Some(subject_view) = self.kept.subject_views.first() {
            self.actor.view.store(Some(Arc::new(subject_view.person_view())));
        }
        self.input.handle_platform_output(&self.actor.window, output.platform_output);
        if let Some(root) = output.viewport_output.get(&egui::ViewportId::ROOT) {
            self.wanted = now.checked_add(root.repaint_delay);
        }
        let shapes = ui.tessellate(output.shapes, output.pixels_per_point);
        let shown = self.painter.show(
            self.gpu,
            &self.actor.window,
            &shapes,
            output.textures_delta,
            output.pixels_per_point,
        )?;
        // After the greeting the picture itself is due.
        self.stale |= greets;
        if !greets && std::mem::take(&mut self.kept.picture_wanted) {
            self.screenshot();
        }
        actions.into_iter().for_each(|action| self.act(action));
        Ok(shown)
    }
}

/// Pictures of one title in one folder at most.
const PICTURES_MAX: u32 = 10_000;

/// Writes a picture under an unused name in the working folder, and returns that name.
fn save_under_free_name(picture: &Picture, title: &str) -> Result<String, ViewError> {
    let safe = |c: char| if c.is_alphanumeric() || c == '-' || c == '_' { c } else { '-' };
    let stem: String = title.chars().take(60).map(safe).collect();
    let png = picture.png()?;
    let mut taken = None;
    for number in 1..PICTURES_MAX {
        let name = format!("{stem}-{number:04}.png");
        match output_file::write(name.as_ref(), &png, Replace::Never) {
            Ok(()) => return Ok(name),
            Err(error) if error.is_occupied() => taken = Some(error),
            Err(error) => return Err(error.into()),
        }
    }
    Err(taken.map_or_else(|| ViewError::File { file: stem, reason: "has no name".to_owned() }, Into::into))
}
