//! Runs a session with windows: their requests are carried out between two looks at the scene.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use trocar::play;
use trocar::run::{Progress, RunOptions};
use trocar::session::Session;
use trocar_kernel::spec::{FaultSink, VIEWER};
use trocar_scene::{Access, EntitySet, PersonInput, SimTime, Snapshot};
use trocar_viewer::window::subject::{Abilities, Ask, Course, Standing, Tune, Tuning};

use super::actors::actors;
use super::link::{Audience, Link, Seat};
use crate::tune::Desk;
use crate::tune::protocol::Request;

/// Interval at which windows receive the actors' rates and health.
const TELL_EVERY: Duration = Duration::from_millis(250);
/// Longest wait for a request before the session checks whether it shall go on.
const LOOK_EVERY: Duration = Duration::from_millis(20);
/// Session time of a single step.
const STEP: SimTime = SimTime::from_millis(10);

/// What to do after a session.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Next {
    /// Run it again.
    Again,
    /// End.
    End,
}

/// Connects a session and its windows.
pub struct Attendant {
    link: Link,
    /// Whether a person moves the hands.
    plays: bool,
    viewers: Arc<dyn FaultSink>,
    /// Set by a signal.
    stop: Arc<AtomicBool>,
    begun: bool,
    /// In virtual time: wall-clock time and session time at which the current speed was set.
    pace: Option<(Instant, SimTime)>,
    paused: bool,
    again: bool,
    told: Option<Instant>,
}

impl Attendant {
    /// For a session that has not begun yet; `viewers` receives faults aimed at the windows.
    pub fn new(link: Link, plays: bool, viewers: Arc<dyn FaultSink>) -> Self {
        Self {
            link,
            plays,
            viewers,
            stop: Arc::default(),
            begun: false,
            pace: None,
            paused: false,
            again: false,
            told: None,
        }
    }

    /// Before a session starts: registers the windows as fault targets, and lets them end the session.
    pub fn prepare(&mut self, options: &mut RunOptions) {
        options.fault_targets.0.push((VIEWER.to_owned(), self.viewers.clone()));
        let stop = options.stop.clone();
        (self.stop, self.begun, self.paused, self.again, self.told) = (stop, false, false, false, None);
    }

    /// Shows the last scene of the ended session.
    pub fn ended(&mut self, last: Arc<Snapshot>) {
        self.link.show(last);
        self.link.read_from(None);
    }

    /// Serves the windows; called between two looks at the scene.
    pub fn attend(&mut self, progress: &mut Progress<'_>, desk: &mut Desk<'_>) {
        if !self.begun {
            self.begun = true;
            self.begin(progress.session, desk);
        }
        if self.pace.is_some() {
            self.link.show(progress.session.snapshot());
        }
        while let Some(ask) = self.link.asked() {
            self.serve(progress.session, desk, ask);
        }
        self.tell(progress.session);
        self.keep_pace(progress.session, desk);
        while self.paused && !self.shall_end() {
            if self.link.shared().audience() == Audience::Cut {
                // Without a window nothing could resume it.
                self.resume(progress.session);
                break;
            }
            desk.serve(progress.session);
            if let Some(ask) = self.link.wait(LOOK_EVERY) {
                self.serve(progress.session, desk, ask);
            }
        }
        progress.end = self.shall_end();
    }

    fn shall_end(&self) -> bool {
        let left = self.link.shared().audience() == Audience::Left;
        self.again || left || self.stop.load(Ordering::Relaxed)
    }

    fn begin(&mut self, session: &mut Session, desk: &mut Desk<'_>) {
        let reader = session.reader();
        self.pace = reader.is_none().then(|| (Instant::now(), session.now()));
        let speed = self.pace.is_some();
        self.link.read_from(reader);
        let abilities = Abilities { pause: true, step: true, speed, reset: true, seek: false, tune: true };
        self.link.tell(|standing| {
            (standing.course, standing.abilities) = (Course::Running, abilities);
        });
        self.tell_tuning(session, desk);
        if self.plays
            && let Err(why) = self.offer_seat(session)
        {
            self.link.note(format!("nobody can play: {why}"), true);
        }
    }

    /// A person who plays takes part in the session as a guest, which writes only the input for the hands.
    fn offer_seat(&mut self, session: &mut Session) -> Result<(), String> {
        let person = play::person(&session.snapshot()).ok_or("the scenario has no hands")?;
        let access = Access::new().writes::<PersonInput>(EntitySet::Of(vec![person]));
        let guest = session.guest("viewer", &access).map_err(|error| error.to_string())?;
        self.link.offer(Seat { guest, person });
        Ok(())
    }

    /// In virtual time: waits until the wall clock has caught up.
    fn keep_pace(&mut self, session: &mut Session, desk: &mut Desk<'_>) {
        while let Some((since, from)) = self.pace.filter(|_| !self.paused && !self.shall_end()) {
            let passed = session.now().since(from).as_secs_f64() / self.link.standing().speed;
            let ahead = passed - since.elapsed().as_secs_f64();
            if ahead < -0.25 {
                // The machine is too slow for this speed: run as fast as possible, and do not catch up later.
                self.pace = Some((Instant::now(), session.now()));
                return;
            }
            if ahead <= 1e-3 {
                return;
            }
            if let Some(ask) = self.link.wait(Duration::from_secs_f64(ahead).min(LOOK_EVERY)) {
                self.serve(session, desk, ask);
            }
        }
    }

    fn resume(&mut self, session: &mut Session) {
        session.resume();
        self.paused = false;
        self.pace = self.pace.map(|_| (Instant::now(), session.now()));
        self.link.tell(|standing| standing.course = Course::Running);
    }

    fn pause(&mut self, session: &mut Session) {
        session.pause();
        self.paused = true;
        self.link.tell(|standing| standing.course = Course::Paused);
    }

    fn serve(&mut self, session: &mut Session, desk: &mut Desk<'_>, ask: Ask) {
        match ask {
            Ask::Pause if !self.paused => self.pause(session),
            Ask::Resume if self.paused => self.resume(session),
            Ask::Step { back: false } if self.paused => {
                let until = session.now() + STEP;
                session.resume();
                session.run_until(until);
                session.pause();
                if self.pace.is_some() {
                    self.link.show(session.snapshot());
                }
            }
            Ask::Speed(speed) if self.pace.is_some() && (0.01..=100.0).contains(&speed) => {
                self.pace = Some((Instant::now(), session.now()));
                self.link.tell(|standing| standing.speed = speed);
            }
            Ask::Reset => self.again = true,
            Ask::Tune(tune) => self.tune(session, desk, tune),
            // Windows do not offer requests that are impossible now.
            _ => {}
        }
    }

    fn tune(&mut self, session: &mut Session, desk: &mut Desk<'_>, tune: Tune) {
        let request = match tune {
            Tune::Set(values) => Request::Set { values },
            Tune::Use(set) => Request::Use { set },
            Tune::Keep(set) => Request::Keep { set },
            Tune::Save(file) => Request::Save { file },
        };
        let reply = desk.ask(session, &request);
        if let Some(error) = reply.error {
            self.link.note(error, true);
        }
        if let Some(file) = reply.file {
            self.link.note(format!("saved to {}", file.display()), false);
        }
        for left_out in reply.left_out {
            self.link.note(left_out, true);
        }
        self.tell_tuning(session, desk);
    }

    fn tell_tuning(&mut self, session: &mut Session, desk: &mut Desk<'_>) {
        let reply = desk.ask(session, &Request::Status {});
        let changed = reply
            .fields
            .into_iter()
            .map(|row| (row.field, row.before.unwrap_or_default(), row.value))
            .collect();
        let tuning = Tuning { changed, sets: reply.sets, in_use: reply.in_use };
        if self.link.standing().tuning != tuning {
            self.link.tell(|standing| standing.tuning = tuning);
        }
    }

    fn tell(&mut self, session: &Session) {
        if self.told.is_some_and(|told| told.elapsed() < TELL_EVERY) {
            return;
        }
        self.told = Some(Instant::now());
        let actors = actors(session);
        self.link.tell(|standing| standing.actors = actors);
    }

    /// After the session: shows its last scene until the user restarts it or closes the window.
    pub fn wait(&mut self, verdict: String, bad: bool) -> Next {
        if self.again {
            return Next::Again;
        }
        self.link.note(verdict, bad);
        self.link.tell(|standing: &mut Standing| {
            standing.course = Course::Over;
            standing.abilities = Abilities { reset: true, ..Abilities::default() };
        });
        loop {
            if self.link.shared().audience() != Audience::There || self.stop.load(Ordering::Relaxed) {
                return Next::End;
            }
            match self.link.wait(5 * LOOK_EVERY) {
                Some(Ask::Reset) => return Next::Again,
                _ => continue,
            }
        }
    }
}
