//! Playback of a recording under control of a window: speed, seek, loop.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::Receiver;
use std::time::{Duration, Instant};

use trocar_kernel::recorder::{Recording, RecordingError, Replay};
use trocar_scene::{Registry, SimTime};
use trocar_viewer::window::subject::{Abilities, Mark, Note, PlayState, Request};

use super::link::{SessionLink, ViewerPresence};

/// Interval between two displayed scenes.
const FRAME: Duration = Duration::from_millis(16);
/// Interval at which requests are checked while playback is paused.
const REST: Duration = Duration::from_millis(50);
/// Session time of a single step.
const STEP: SimTime = SimTime::from_millis(10);
/// A seek further ahead than this begins at a keyframe instead of playing all commits in between.
const LEAP: SimTime = SimTime::from_millis(1_500);

/// The results of checking a recording while it is shown.
pub struct Findings {
    /// Marks of the timeline.
    pub marks: Vec<Mark>,
    /// The note for people.
    pub note: Note,
}

/// Plays a recording until all windows are closed, or `stop` is set.
///
/// # Errors
/// When it cannot be played at all; later errors are shown as notes.
pub fn play(
    mut link: SessionLink,
    recording: &Recording,
    registry: &Arc<Registry>,
    findings: &Receiver<Findings>,
    stop: &AtomicBool,
) -> Result<(), RecordingError> {
    let mut player = Player::new(recording, registry)?;
    let length = recording.duration();
    link.tell(|state| {
        state.length = Some(length);
        state.abilities =
            Abilities { pause: true, step: true, speed: true, reset: true, seek: true, tune: false };
    });
    link.show(player.replay.snapshot());
    let mut last = Instant::now();
    while link.shared().presence() == ViewerPresence::There && !stop.load(Ordering::Relaxed) {
        let runs = link.state().play_state == PlayState::Running;
        let mut requested = link.wait(if runs { FRAME.saturating_sub(last.elapsed()) } else { REST });
        while let Some(request) = requested {
            player.handle(&mut link, request, length);
            requested = link.requested();
        }
        if let Ok(found) = findings.try_recv() {
            link.tell(|state| state.marks = found.marks);
            link.note(found.note.text, found.note.bad);
        }
        let passed = last.elapsed();
        if runs && passed < FRAME {
            continue;
        }
        last = Instant::now();
        let ends =
            link.state().play_state == PlayState::Running && player.pass(&link, passed.min(5 * REST), length);
        match player.follow() {
            Ok(changed) => {
                if changed {
                    link.show(player.replay.snapshot());
                }
                // The last scene is shown before the end is announced.
                if ends {
                    link.tell(|state| state.play_state = PlayState::Over);
                }
            }
            Err(error) => {
                link.note(error.to_string(), true);
                link.tell(|state| state.play_state = PlayState::Over);
                player.give_up();
            }
        }
    }
    Ok(())
}

struct Player<'a> {
    recording: &'a Recording,
    registry: &'a Arc<Registry>,
    replay: Replay<'a>,
    /// The displayed time.
    time: SimTime,
    shown: SimTime,
}

impl<'a> Player<'a> {
    fn new(recording: &'a Recording, registry: &'a Arc<Registry>) -> Result<Self, RecordingError> {
        let replay = Replay::new(recording, registry)?;
        let time = replay.time();
        Ok(Self { recording, registry, replay, time, shown: time })
    }

    fn handle(&mut self, link: &mut SessionLink, request: Request, length: SimTime) {
        match request {
            Request::Pause => link.tell(|state| state.play_state = PlayState::Paused),
            Request::Resume => {
                if link.state().play_state == PlayState::Over {
                    self.time = SimTime::ZERO;
                }
                link.tell(|state| state.play_state = PlayState::Running);
            }
            Request::Step { back } => {
                self.time = if back { SimTime(self.time.0.saturating_sub(STEP.0)) } else { self.time + STEP };
                self.time = self.time.min(length);
                link.tell(|state| state.play_state = PlayState::Paused);
            }
            Request::Speed(speed) if (0.01..=100.0).contains(&speed) => {
                link.tell(|state| state.speed = speed);
            }
            Request::Reset => self.time = SimTime::ZERO,
            Request::Seek(time) => {
                self.time = time.min(length);
                if link.state().play_state == PlayState::Over {
                    link.tell(|state| state.play_state = PlayState::Paused);
                }
            }
            Request::Loop(looped) => link.tell(|state| state.looped = looped),
            Request::Speed(_) | Request::Tune(_) => {}
        }
    }

    /// Advances the time; returns whether it reached the end.
    fn pass(&mut self, link: &SessionLink, passed: Duration, length: SimTime) -> bool {
        let span = passed.as_secs_f64() * link.state().speed;
        self.time += SimTime::from_secs_f64(span);
        if self.time < length {
            return false;
        }
        let again = link.state().looped && length > SimTime::ZERO;
        self.time = if again { SimTime::ZERO } else { length };
        !again
    }

    /// Moves the scene to the displayed time; returns whether the scene changed.
    fn follow(&mut self) -> Result<bool, RecordingError> {
        if self.time == self.shown {
            return Ok(false);
        }
        // Commits that were published together are played together: the scene may be slightly ahead, which needs no
        // seek back.
        if self.time < self.shown || self.time > self.replay.time() + LEAP {
            self.replay = Replay::seek(self.recording, self.registry, self.time)?;
        }
        self.replay.advance_to(self.time)?;
        self.shown = self.time;
        Ok(true)
    }

    /// Playback cannot continue here; elsewhere it may.
    fn give_up(&mut self) {
        self.shown = self.time;
    }
}

#[cfg(test)]
mod tests {
    use super::super::link::{WindowLink, link};
    use super::*;
    use std::panic::AssertUnwindSafe;
    use std::sync::mpsc::sync_channel;
    use trocar::app::App;
    use trocar::run::{RunOptions, run};
    use trocar_viewer::window::Subject;

    /// Plays a one-second recording in the background and returns the result of `look`.
    fn shown<T>(look: impl FnOnce(&mut WindowLink, &std::sync::mpsc::SyncSender<Findings>) -> T) -> T {
        let folder = tempfile::tempdir().expect("a folder");
        let file = folder.path().join("try.mcap");
        let app = App::new();
        let scenario = app.scenario("peg-transfer").expect("a scenario");
        let options = RunOptions {
            lockstep: true,
            seconds: Some(1.0),
            record: Some(file.clone()),
            ..RunOptions::default()
        };
        run(&app, &scenario, &options, &mut |_| {}).expect("it runs");
        let recording = Recording::open(&file).expect("a recording");
        let first = scenario.spawn(app.registry()).expect("a scene").snapshot().into();
        let (link, mut window_link) = link("try".into(), None, first);
        let (found, findings) = sync_channel(1);
        let shared = window_link.shared().clone();
        std::thread::scope(|scope| {
            let (recording, registry) = (&recording, app.registry());
            let player =
                scope.spawn(move || play(link, recording, registry, &findings, &AtomicBool::new(false)));
            // Also when an assertion fails: the player runs as long as it has viewers.
            let outcome = std::panic::catch_unwind(AssertUnwindSafe(|| look(&mut window_link, &found)));
            shared.set_presence(ViewerPresence::Left);
            let outcome = outcome.unwrap_or_else(|panic| std::panic::resume_unwind(panic));
            player.join().expect("no panic").expect("it plays");
            outcome
        })
    }

    /// Waits without limit until the displayed state is as expected.
    fn until(window_link: &mut WindowLink, what: &str, is: impl Fn(&mut WindowLink) -> bool) {
        let begun = Instant::now();
        while !is(window_link) {
            assert!(begun.elapsed() < Duration::from_secs(60), "{what}");
            std::thread::sleep(Duration::from_millis(5));
        }
    }

    #[test]
    fn it_is_led_to_any_time_and_back_and_shows_the_same_there() {
        shown(|window_link, _| {
            let pose = |window_link: &mut WindowLink| {
                format!("{:?}", window_link.scene().iter::<trocar_scene::Pose>().collect::<Vec<_>>())
            };
            window_link.request(Request::Pause);
            until(window_link, "it pauses", |window_link| {
                window_link.state().play_state == PlayState::Paused
            });
            let mut seen = Vec::new();
            for millis in [700, 200, 700, 200] {
                let time = SimTime::from_millis(millis);
                window_link.request(Request::Seek(time));
                let near = |now: SimTime| now.0.abs_diff(time.0) < SimTime::from_millis(50).0;
                until(window_link, &format!("it is led to {millis} ms"), |window_link| {
                    near(window_link.now())
                });
                seen.push(pose(window_link));
            }
            assert_eq!((&seen[0], &seen[1]), (&seen[2], &seen[3]));
            assert_ne!(seen[0], seen[1]);
            let before = window_link.now();
            window_link.request(Request::Step { back: true });
            until(window_link, "a step back", |window_link| window_link.now() < before);
        });
    }

    #[test]
    fn it_ends_and_goes_on_from_the_beginning_or_over_and_over() {
        shown(|window_link, _| {
            window_link.request(Request::Speed(16.0));
            until(window_link, "it ends", |window_link| window_link.state().play_state == PlayState::Over);
            assert_eq!(window_link.state().length, Some(window_link.now()));
            window_link.request(Request::Loop(true));
            window_link.request(Request::Resume);
            until(window_link, "it begins anew", |window_link| window_link.now() < SimTime::from_millis(500));
            until(window_link, "it goes on", |window_link| window_link.now() > SimTime::from_millis(500));
            until(window_link, "and begins anew again", |window_link| {
                window_link.now() < SimTime::from_millis(500)
            });
            assert_eq!(window_link.state().play_state, PlayState::Running);
        });
    }

    #[test]
    fn what_is_found_out_about_it_stands_on_its_timeline() {
        shown(|window_link, found| {
            let mark = Mark { time: SimTime::from_millis(300), what: "a gap".into(), bad: true };
            let note = Note { text: "it has a gap".into(), bad: true };
            found.send(Findings { marks: vec![mark.clone()], note: note.clone() }).expect("it listens");
            until(window_link, "it is told", |window_link| !window_link.state().notes.is_empty());
            let state = window_link.state();
            assert_eq!((&state.marks, &state.notes[0].1), (&vec![mark], &note));
        });
    }
}
