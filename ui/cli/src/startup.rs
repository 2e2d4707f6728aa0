//! What the program prepares before the first step and the first picture, on stderr, when that takes long: reading
//! meshes, computing inverses, opening a window.
//!
//! On a terminal a spinner shows the present stage. Elsewhere a stage is one plain line, once the start has taken two
//! seconds. A thread of its own prints, and ends with the start: a running session has no part in it.

use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressStyle};
use trocar_scene::{Snapshot, TetMesh, VertexPositions};

use crate::escape::printable;
use crate::output;

/// The first stage of whatever starts from a scenario.
pub const READING: &str = "reading the scenario and its meshes";
/// Delay of the spinner: a quick start shows none.
const SPINNER_AFTER: Duration = Duration::from_millis(300);
/// Redraw interval of the spinner.
const SPIN_EVERY: Duration = Duration::from_millis(100);
/// Silence after which a stage is printed where there is no terminal.
const LINE_AFTER: Duration = Duration::from_secs(2);
/// Stages that wait for the thread at most; a further one is left out.
const STAGES_MAX: usize = 16;
/// Soft bodies named in one line at most.
const BODIES_MAX: usize = 3;

/// Shows the stages of a start until it is dropped.
pub struct Startup {
    /// What is started, for people.
    name: String,
    stages: Option<SyncSender<String>>,
    thread: Option<JoinHandle<()>>,
}

impl Startup {
    /// The start of `name`, with its first stage; `silent` shows nothing.
    pub fn new(name: &str, stage: &str, silent: bool) -> Self {
        let name = printable(name);
        if silent {
            return Self { name, stages: None, thread: None };
        }
        let (stages, received) = sync_channel(STAGES_MAX);
        let first = line(&name, stage);
        let thread = std::thread::Builder::new().name("startup".into()).spawn(move || {
            if console::Term::stderr().is_term() {
                spin(&received, first);
            } else {
                announce(&received, first);
            }
        });
        // Without a thread the start goes on and shows nothing.
        Self { name, stages: Some(stages), thread: thread.ok() }
    }

    /// Another stage begins. Never blocks.
    pub fn stage(&self, stage: &str) {
        if let Some(stages) = &self.stages {
            let _ = stages.try_send(line(&self.name, stage));
        }
    }
}

impl Drop for Startup {
    fn drop(&mut self) {
        self.stages = None;
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// The stage between the first scene and the first step, with the soft bodies of the scene, whose preparation takes
/// longest: `the controllers and their first step; liver: 2400 nodes`.
pub fn first_step(scene: &Snapshot) -> String {
    let volumes = scene.iter::<TetMesh>().filter_map(|(entity, _)| {
        let nodes = scene.get::<VertexPositions>(entity)?.positions.len();
        Some(format!("{}: {nodes} nodes", printable(&scene.name(entity))))
    });
    let mut bodies: Vec<String> = volumes.take(BODIES_MAX + 1).collect();
    if bodies.len() > BODIES_MAX {
        bodies[BODIES_MAX] = "…".to_owned();
    }
    let separator = if bodies.is_empty() { "" } else { "; " };
    format!("the controllers and their first step{separator}{}", bodies.join(", "))
}

fn line(name: &str, stage: &str) -> String {
    format!("Preparing {name}: {stage} …")
}

fn spin(stages: &Receiver<String>, first: String) {
    let mut stage = first;
    let due = Instant::now() + SPINNER_AFTER;
    loop {
        match stages.recv_timeout(due.saturating_duration_since(Instant::now())) {
            Ok(next) => stage = next,
            Err(RecvTimeoutError::Timeout) => break,
            Err(RecvTimeoutError::Disconnected) => return,
        }
    }
    let bar = ProgressBar::new_spinner();
    let style = ProgressStyle::with_template("{spinner} {wide_msg} {elapsed}");
    bar.set_style(style.unwrap_or_else(|_| ProgressStyle::default_spinner()));
    bar.set_message(stage);
    bar.enable_steady_tick(SPIN_EVERY);
    while let Ok(next) = stages.recv() {
        bar.set_message(next);
    }
    bar.finish_and_clear();
}

/// Prints the lines of a start that are due.
fn announce(stages: &Receiver<String>, first: String) {
    let begun = Instant::now();
    let mut lines = Lines::new(first, LINE_AFTER);
    loop {
        let received = match lines.due() {
            Some(due) => stages.recv_timeout(due.saturating_sub(begun.elapsed())),
            None => stages.recv().map_err(|_| RecvTimeoutError::Disconnected),
        };
        match received {
            Ok(next) => lines.stage(next),
            Err(RecvTimeoutError::Timeout) => {
                if let Some(line) = lines.print(begun.elapsed()) {
                    output::tell(&line);
                }
            }
            Err(RecvTimeoutError::Disconnected) => return,
        }
    }
}

/// Which stages of a start are printed, and when: the present one after a silence, a later one after a silence of twice
/// the length, so that a long start is not a long list. No stage is printed twice. Times count from the start.
struct Lines {
    /// The present stage, unless it is printed.
    waiting: Option<String>,
    silence: Duration,
    due: Duration,
}

impl Lines {
    fn new(first: String, silence: Duration) -> Self {
        Self { waiting: Some(first), silence, due: silence }
    }

    /// Another stage begins.
    fn stage(&mut self, stage: String) {
        self.waiting = Some(stage);
    }

    /// When the present stage is to be printed; never if it has been.
    fn due(&self) -> Option<Duration> {
        self.waiting.as_ref().map(|_| self.due)
    }

    /// The line to print now, if one is due.
    fn print(&mut self, now: Duration) -> Option<String> {
        let line = self.waiting.take_if(|_| now >= self.due)?;
        self.silence *= 2;
        self.due = now + self.silence;
        Some(line)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Lines of a start whose stages come at these times [ms], with a first silence of 100 ms.
    fn lines(stages: &[(u64, &str)], end: u64) -> Vec<String> {
        let mut lines = Lines::new("first".to_owned(), Duration::from_millis(100));
        let mut printed = Vec::new();
        let mut now = Duration::ZERO;
        for (at, stage) in stages.iter().map(|(at, stage)| (*at, Some(*stage))).chain([(end, None)]) {
            let until = Duration::from_millis(at);
            while let Some(due) = lines.due().filter(|due| *due <= until) {
                now = now.max(due);
                printed.extend(lines.print(now));
            }
            now = until;
            if let Some(stage) = stage {
                lines.stage(stage.to_owned());
            }
        }
        printed
    }

    #[test]
    fn a_slow_start_names_its_stages_once_each_and_a_quick_one_prints_nothing() {
        assert_eq!(lines(&[], 99), [] as [&str; 0]);
        assert_eq!(lines(&[], 10_000), ["first"]);
        assert_eq!(lines(&[(99, "second")], 1_000), ["second"], "what is over is not worth a line");
        assert_eq!(lines(&[(150, "second")], 299), ["first"]);
        assert_eq!(lines(&[(150, "second")], 300), ["first", "second"]);
        assert_eq!(lines(&[(150, "second"), (200, "third")], 1_000), ["first", "third"]);
        assert_eq!(
            lines(&[(500, "second")], 501),
            ["first", "second"],
            "a stage after the silence is printed at once"
        );
        assert_eq!(line("liver", "the window"), "Preparing liver: the window …");
    }
}
