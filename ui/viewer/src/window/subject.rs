//! The subject of a window: a running session, a recording, or any other source of snapshots.

use std::path::PathBuf;
use std::sync::Arc;

use serde_json::Value;
use trocar_scene::{MentorDeed, PersonView, SimTime, Snapshot, SurfacePlace};

/// The data source of a window. No method blocks: a slow or closed window does not affect the subject.
pub trait Subject: Send {
    /// Title of the window.
    fn title(&self) -> String;

    /// The scenario's folder, below which files of textures and shaders are.
    fn folder(&self) -> Option<PathBuf> {
        None
    }

    /// The latest scene.
    fn scene(&mut self) -> Arc<Snapshot>;

    /// Session time, which advances between two scenes.
    fn now(&mut self) -> SimTime;

    /// The subject's state; updated about ten times per second.
    fn state(&mut self) -> Arc<SubjectState>;

    /// Sends a request; its result appears in the scene and in [`SubjectState`].
    fn request(&mut self, request: Request);

    /// Whether there are others to whom the person at the window can show something: the scene of such a session has a
    /// [`MentorAnswer`](trocar_scene::MentorAnswer).
    fn is_shared(&self) -> bool {
        false
    }

    /// Passes on what the person at the window shows the others: where it points, if that has changed, and what it does,
    /// in order. Deeds that are taken are removed from `deeds`. Called often while it is shared.
    fn show(&mut self, _pointer: Option<Option<SurfacePlace>>, _deeds: &mut Vec<MentorDeed>) {}

    /// A subject of the same source for another window.
    ///
    /// # Errors
    /// Why there can be no further one, in words.
    fn another(&mut self) -> Result<Box<dyn Subject>, String>;
}

/// Receives the input of the player who controls the instruments.
pub trait Player {
    /// A key or button, by the W3C code of its position (`KeyW`, `MouseLeft`); `false` when it has no function.
    fn press(&mut self, control: &str, down: bool) -> bool;

    /// The pointer moved to the right and down \[heights of the picture\].
    fn pointer(&mut self, right: f64, down: f64);

    /// The wheel turned \[notches, away from the person positive\].
    fn wheel(&mut self, notches: f64);

    /// Releases all keys and buttons.
    fn release_all(&mut self);

    /// `secs` have passed; writes the input into the session. The player looks through `view`.
    fn pass(&mut self, secs: f64, view: Option<PersonView>);

    /// The controls and their functions, for the help.
    fn help(&self) -> Vec<(String, String)>;
}

/// A window's request to its subject.
#[derive(Clone, Debug, PartialEq)]
pub enum Request {
    /// Pause.
    Pause,
    /// Resume.
    Resume,
    /// A single step while paused: forwards, or backwards in a recording.
    Step {
        /// Backwards.
        back: bool,
    },
    /// Speed relative to real time; 1: real time.
    Speed(f64),
    /// Reset.
    Reset,
    /// Seek to a time of a recording.
    Seek(SimTime),
    /// Whether a recording loops.
    Loop(bool),
    /// A change of values.
    Tune(Tune),
}

/// A change of tuned values while the session runs.
#[derive(Clone, Debug, PartialEq)]
pub enum Tune {
    /// Fields, by name (ENTITY.COMPONENT.FIELD), and their values.
    Set(Vec<(String, Value)>),
    /// Use a set of values.
    Use(String),
    /// Store the tuned values as a set.
    Keep(String),
    /// Write the tuned values into the scenario, or into a new file.
    Save(Option<PathBuf>),
}

/// Whether time advances.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum PlayState {
    /// It advances.
    #[default]
    Running,
    /// It is paused.
    Paused,
    /// The session has ended, or the recording is at its end.
    Over,
}

/// The supported requests.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Abilities {
    /// Pause and resume.
    pub pause: bool,
    /// Single steps.
    pub step: bool,
    /// Other speeds than real time.
    pub speed: bool,
    /// Reset.
    pub reset: bool,
    /// Seek.
    pub seek: bool,
    /// Tuning.
    pub tune: bool,
}

/// The state of a subject.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SubjectState {
    /// Whether time advances.
    pub play_state: PlayState,
    /// Speed relative to real time.
    pub speed: f64,
    /// The supported requests.
    pub abilities: Abilities,
    /// Length of a recording.
    pub length: Option<SimTime>,
    /// Whether it loops.
    pub looped: bool,
    /// Events of a recording, for its timeline.
    pub marks: Vec<Mark>,
    /// The actors in the order of the supervisor tree: each supervisor before its children.
    pub actors: Vec<Actor>,
    /// The tuned values.
    pub tuning: Tuning,
    /// The last notes, oldest first, each with its number: bounded.
    pub notes: Vec<(u64, Note)>,
    /// The result of a session that is over, with the session's number.
    pub verdict: Option<(u64, Verdict)>,
}

/// The result of a session, for people.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Verdict {
    /// In a word or two: `completed`.
    pub title: String,
    /// Score, errors and their reasons, a line each.
    pub lines: Vec<String>,
    /// Whether it failed.
    pub bad: bool,
}

/// An event on the timeline.
#[derive(Clone, Debug, PartialEq)]
pub struct Mark {
    /// Its time.
    pub time: SimTime,
    /// Its description.
    pub what: String,
    /// Whether it is a fault or an error.
    pub bad: bool,
}

/// A note for people.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Note {
    /// Its text.
    pub text: String,
    /// Whether it is an error.
    pub bad: bool,
}

/// Rate and health of one actor.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Actor {
    /// Its name.
    pub name: String,
    /// Number of supervisors above it.
    pub depth: usize,
    /// A supervisor's strategy when a child fails, in a few words.
    pub supervises: Option<String>,
    /// Its health by its supervisor: `healthy`, `late`, `restarting`, …
    pub health: String,
    /// Target and achieved ticks per second; `None` for an actor without a rate.
    pub hz: Option<[f64; 2]>,
    /// Share of its ticks that started on time, 0 to 1.
    pub on_time: f64,
    /// Lateness of ticks: median and 99th percentile \[µs\].
    pub late_us: [f64; 2],
    /// Step time: median and 99th percentile \[µs\].
    pub step_us: [f64; 2],
    /// Missed ticks.
    pub missed: u64,
    /// Number of restarts.
    pub restarts: u64,
}

/// Values that differ from the scenario.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Tuning {
    /// Fields with their original and present values.
    pub changed: Vec<(String, Value, Value)>,
    /// Names of the sets.
    pub sets: Vec<String>,
    /// The set in use; `None` after single fields were set.
    pub in_use: Option<String>,
}
