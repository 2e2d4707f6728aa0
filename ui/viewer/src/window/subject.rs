//! What a window shows, and whom it asks: a running session, a recording, or whatever else has snapshots.

use std::path::PathBuf;
use std::sync::Arc;

use serde_json::Value;
use trocar_scene::{PersonView, SimTime, Snapshot};

/// What a window looks at. Nothing here waits for anybody: a window that is slow, or gone, is nobody's concern.
pub trait Subject: Send {
    /// What stands in the title of the window.
    fn title(&self) -> String;

    /// The scenario's folder, below which files of textures and shaders are.
    fn folder(&self) -> Option<PathBuf> {
        None
    }

    /// The latest scene.
    fn scene(&mut self) -> Arc<Snapshot>;

    /// Time of the session, which goes on between two scenes.
    fn now(&mut self) -> SimTime;

    /// How things stand; renewed some ten times per second.
    fn standing(&mut self) -> Arc<Standing>;

    /// Asks for something; what became of it is seen in the scene and in [`Standing`].
    fn ask(&mut self, ask: Ask);

    /// The same for one more window.
    ///
    /// # Errors
    /// Why there can be no more, in words.
    fn another(&mut self) -> Result<Box<dyn Subject>, String>;
}

/// Whom a window tells what a person does who has taken the instruments in hand.
pub trait Player {
    /// A key or button, by the name that the W3C gives its place (`KeyW`, `MouseLeft`); `false` when it means nothing.
    fn press(&mut self, control: &str, down: bool) -> bool;

    /// The pointer went to the right and down \[heights of the picture\].
    fn pointer(&mut self, right: f64, down: f64);

    /// The wheel turned \[notches, away from the person positive\].
    fn wheel(&mut self, notches: f64);

    /// Nothing is held down any more.
    fn release_all(&mut self);

    /// `secs` have passed; what came of it is written into the session. The person looks through `view`.
    fn pass(&mut self, secs: f64, view: Option<PersonView>);

    /// What each control does, for people: controls, and what they do.
    fn help(&self) -> Vec<(String, String)>;
}

/// What a window asks of its subject.
#[derive(Clone, Debug, PartialEq)]
pub enum Ask {
    /// Time shall stand still.
    Pause,
    /// Time shall go on.
    Resume,
    /// A little time shall pass, while it stands still: forwards, or backwards in a recording.
    Step {
        /// Backwards.
        back: bool,
    },
    /// How fast time shall pass; 1: as on the wall.
    Speed(f64),
    /// From the beginning.
    Reset,
    /// To a time of a recording.
    Seek(SimTime),
    /// Whether a recording begins anew at its end.
    Loop(bool),
    /// A change of values.
    Tune(Tune),
}

/// A change of values while the session runs.
#[derive(Clone, Debug, PartialEq)]
pub enum Tune {
    /// Fields, by name (ENTITY.COMPONENT.FIELD), and their values.
    Set(Vec<(String, Value)>),
    /// A set of values is used.
    Use(String),
    /// What is tuned now is kept as a set.
    Keep(String),
    /// What is tuned is written into the scenario, or into a new file.
    Save(Option<PathBuf>),
}

/// Whether time passes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Course {
    /// It does.
    #[default]
    Running,
    /// It stands still.
    Paused,
    /// The session has ended, or the recording is at its end.
    Over,
}

/// What can be asked for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Abilities {
    /// Time can stand still and go on.
    pub pause: bool,
    /// And pass in steps.
    pub step: bool,
    /// Time can pass faster or slower than on the wall.
    pub speed: bool,
    /// It can begin anew.
    pub reset: bool,
    /// Any time can be looked at.
    pub seek: bool,
    /// Values can be changed.
    pub tune: bool,
}

/// How a subject stands.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Standing {
    /// Whether time passes.
    pub course: Course,
    /// How fast.
    pub speed: f64,
    /// What can be asked for.
    pub abilities: Abilities,
    /// Length of a recording.
    pub length: Option<SimTime>,
    /// Whether it begins anew at its end.
    pub looped: bool,
    /// What happened when in a recording, for its timeline.
    pub marks: Vec<Mark>,
    /// The actors as their supervisors have them: each supervisor stands above its own.
    pub actors: Vec<Actor>,
    /// What is tuned.
    pub tuning: Tuning,
    /// The last things that were said, oldest first, with the number of each: bounded.
    pub notes: Vec<(u64, Note)>,
}

/// Something that happened.
#[derive(Clone, Debug, PartialEq)]
pub struct Mark {
    /// When.
    pub time: SimTime,
    /// What, in a few words.
    pub what: String,
    /// Whether it is a fault or an error.
    pub bad: bool,
}

/// Something to tell a person.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Note {
    /// What.
    pub text: String,
    /// Whether it is an error.
    pub bad: bool,
}

/// How one actor keeps its rate, and how it is.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Actor {
    /// Its name.
    pub name: String,
    /// How many supervisors stand above it.
    pub depth: usize,
    /// Of a supervisor: what it does when one of its own fails, in a few words.
    pub supervises: Option<String>,
    /// What its supervisor says: `healthy`, `late`, `restarting`, …
    pub health: String,
    /// Ticks per second that it should make, and that it made; none for one that has no rate.
    pub hz: Option<[f64; 2]>,
    /// Share of its ticks that started in time, 0 to 1.
    pub on_time: f64,
    /// How late ticks start: median and 99th percentile \[µs\].
    pub late_us: [f64; 2],
    /// How long steps take: median and 99th percentile \[µs\].
    pub step_us: [f64; 2],
    /// Ticks that never ran.
    pub missed: u64,
    /// How often it was started again.
    pub restarts: u64,
}

/// Values that are not as in the scenario.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Tuning {
    /// Fields, what they were, and what they are.
    pub changed: Vec<(String, Value, Value)>,
    /// Names of the sets.
    pub sets: Vec<String>,
    /// The one in use; none when single fields were set since.
    pub in_use: Option<String>,
}
