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
                announce(&received, first, LINE_AFTER, &mut |line| eprintln!("{line}"));
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

/// Prints the present stage after `after`, and a later one each time that nothing was printed for twice as long as
/// before, so that a long start is not a long list. No stage is printed twice.
fn announce(stages: &Receiver<String>, first: String, mut after: Duration, print: &mut dyn FnMut(&str)) {
    let mut waiting = Some(first);
    let mut due = Instant::now() + after;
    loop {
        let received = match &waiting {
            Some(_) => stages.recv_timeout(due.saturating_duration_since(Instant::now())),
            None => stages.recv().map_err(|_| RecvTimeoutError::Disconnected),
        };
        match received {
            Ok(next) => waiting = Some(next),
            Err(RecvTimeoutError::Timeout) => {
                if let Some(stage) = waiting.take() {
                    print(&stage);
                }
                after *= 2;
                due = Instant::now() + after;
            }
            Err(RecvTimeoutError::Disconnected) => return,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Lines of a start whose stages come at these times [ms], announced after 100 ms.
    fn lines(stages: &[(u64, &str)], end: u64) -> Vec<String> {
        let (sender, received) = sync_channel(STAGES_MAX);
        let mut printed = Vec::new();
        std::thread::scope(|scope| {
            scope.spawn(move || {
                let begun = Instant::now();
                let wait = |ms| {
                    let at = begun + Duration::from_millis(ms);
                    std::thread::sleep(at.saturating_duration_since(Instant::now()));
                };
                for (at, stage) in stages {
                    wait(*at);
                    let _ = sender.try_send((*stage).to_owned());
                }
                wait(end);
            });
            announce(&received, "first".to_owned(), Duration::from_millis(100), &mut |line| {
                printed.push(line.to_owned());
            });
        });
        printed
    }

    #[test]
    fn a_slow_start_names_its_stages_once_each_and_a_quick_one_prints_nothing() {
        assert_eq!(lines(&[], 1), [] as [&str; 0]);
        assert_eq!(lines(&[], 1_000), ["first"]);
        assert_eq!(lines(&[(1, "second")], 1_000), ["second"], "what is over is not worth a line");
        assert_eq!(lines(&[(500, "second")], 1_500), ["first", "second"]);
        assert_eq!(line("liver", "the window"), "Preparing liver: the window …");
    }
}
