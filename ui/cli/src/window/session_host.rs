//! Runs a session with windows: their requests are carried out between two looks at the scene.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use trocar::network::NETWORK;
use trocar::play;
use trocar::run::{Progress, RunOptions};
use trocar::session::Session;
use trocar_kernel::spec::VIEWER;
use trocar_scene::{Access, EntitySet, MentorInput, PersonInput, SimTime, Snapshot};
use trocar_viewer::window::subject::{Abilities, PlayState, Request, SubjectState, Tune, Tuning, Verdict};

use super::actors::actors;
use super::faults::Viewers;
use super::link::{PlayerGuest, SessionLink, ViewerPresence};
use super::mentor::MentorWriter;
use crate::escape::printable;
use crate::tune::TuningService;
use crate::tune::protocol::Request as TuneRequest;

/// Interval at which windows receive the actors' rates and health.
const TELL_EVERY: Duration = Duration::from_millis(250);
/// Longest wait for a request before the session checks whether it shall go on.
const LOOK_EVERY: Duration = Duration::from_millis(20);
/// Doubts about a scenario that a window shows at most.
const DOUBTS_MAX: usize = 3;
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
pub struct SessionHost {
    link: SessionLink,
    /// Whether a person moves the hands.
    plays: bool,
    viewers: Arc<Viewers>,
    /// Set by a signal.
    stop: Arc<AtomicBool>,
    begun: bool,
    /// In virtual time: wall-clock time and session time at which the current speed was set.
    pace: Option<(Instant, SimTime)>,
    paused: bool,
    /// Whether the windows show that the host of the session has paused it.
    paused_by_host: bool,
    again: bool,
    told: Option<Instant>,
    /// Sessions that are over.
    sessions: u64,
}

impl SessionHost {
    /// For a session that has not begun yet; `viewers` receives faults aimed at the windows.
    pub fn new(link: SessionLink, plays: bool, viewers: Arc<Viewers>) -> Self {
        Self {
            link,
            plays,
            viewers,
            stop: Arc::default(),
            begun: false,
            pace: None,
            paused: false,
            paused_by_host: false,
            again: false,
            told: None,
            sessions: 0,
        }
    }

    /// Before a session starts: registers the windows as fault targets, and lets them end the session.
    pub fn prepare(&mut self, options: &mut RunOptions) {
        options.fault_targets.0.push((VIEWER.to_owned(), self.viewers.clone()));
        let stop = options.stop.clone();
        (self.stop, self.begun, self.paused, self.again, self.told) = (stop, false, false, false, None);
        self.paused_by_host = false;
    }

    /// Whether the first picture is still to come.
    pub fn awaits_picture(&self) -> bool {
        self.link.shared().presence() == ViewerPresence::There && !self.viewers.have_shown()
    }

    /// Shows the last scene of the ended session.
    pub fn ended(&mut self, last: Arc<Snapshot>) {
        self.link.show(last);
        self.link.read_from(None);
        self.link.offer_mentor(None);
    }

    /// Serves the windows; called between two looks at the scene.
    pub fn update(&mut self, progress: &mut Progress<'_>, tuning_service: &mut TuningService<'_>) {
        if !self.begun {
            self.begun = true;
            self.begin(progress.session, tuning_service);
        }
        if self.pace.is_some() {
            self.link.show(progress.session.snapshot());
        }
        while let Some(request) = self.link.requested() {
            self.handle(progress.session, tuning_service, request);
        }
        self.follow_host(progress.session);
        self.tell(progress.session);
        self.keep_pace(progress.session, tuning_service);
        while self.paused && !self.shall_end() {
            if self.link.shared().presence() == ViewerPresence::Cut {
                // Without a window nothing could resume it.
                self.resume(progress.session);
                break;
            }
            tuning_service.serve(progress.session);
            if let Some(request) = self.link.wait(LOOK_EVERY) {
                self.handle(progress.session, tuning_service, request);
            }
        }
        progress.end = self.shall_end();
    }

    fn shall_end(&self) -> bool {
        let left = self.link.shared().presence() == ViewerPresence::Left;
        self.again || left || self.stop.load(Ordering::Relaxed)
    }

    fn begin(&mut self, session: &mut Session, tuning_service: &mut TuningService<'_>) {
        let reader = session.reader();
        self.pace = reader.is_none().then(|| (Instant::now(), session.now()));
        let speed = self.pace.is_some();
        self.link.read_from(reader);
        let abilities = Abilities { pause: true, step: true, speed, reset: true, seek: false, tune: true };
        self.link.tell(|state| {
            (state.play_state, state.abilities, state.verdict) = (PlayState::Running, abilities, None);
        });
        self.tell_tuning(session, tuning_service);
        self.offer_mentor(session);
        if self.plays
            && let Err(why) = self.offer_player(session)
        {
            self.link.note(format!("nobody can play: {why}"), true);
        }
    }

    /// A person who plays takes part in the session as a guest, which writes only the input for the hands.
    fn offer_player(&mut self, session: &mut Session) -> Result<(), String> {
        let person = play::person(&session.snapshot()).ok_or("the scenario has no hands")?;
        let access = Access::new().writes::<PersonInput>(EntitySet::Of(vec![person]));
        let guest = session.guest("viewer", &access).map_err(|error| error.to_string())?;
        self.link.offer_player_guest(PlayerGuest { guest, person });
        Ok(())
    }

    /// In a session that others share, persons at windows show one another things.
    fn offer_mentor(&mut self, session: &mut Session) {
        let is_shared = session.accesses().iter().any(|(name, ..)| name == NETWORK);
        self.link.offer_mentor(None);
        if !is_shared {
            return;
        }
        let access = Access::new().writes::<MentorInput>(EntitySet::Own);
        match session.guest("mentor", &access) {
            Ok(guest) => self.link.offer_mentor(Some(MentorWriter::new(guest))),
            Err(error) => self.link.note(format!("nothing can be shown to the others: {error}"), true),
        }
    }

    /// In virtual time: waits until the wall clock has caught up.
    fn keep_pace(&mut self, session: &mut Session, tuning_service: &mut TuningService<'_>) {
        while let Some((since, from)) = self.pace.filter(|_| !self.paused && !self.shall_end()) {
            let passed = session.now().since(from).as_secs_f64() / self.link.state().speed;
            let ahead = passed - since.elapsed().as_secs_f64();
            if ahead < -0.25 {
                // The machine is too slow for this speed: run as fast as possible, and do not catch up later.
                self.pace = Some((Instant::now(), session.now()));
                return;
            }
            if ahead <= 1e-3 {
                return;
            }
            if let Some(request) = self.link.wait(Duration::from_secs_f64(ahead).min(LOOK_EVERY)) {
                self.handle(session, tuning_service, request);
            }
        }
    }

    /// Shows that the host of the session has paused it; only that can let it go on.
    fn follow_host(&mut self, session: &Session) {
        let by_host = session.is_paused_by_host();
        if std::mem::replace(&mut self.paused_by_host, by_host) == by_host || self.paused {
            return;
        }
        let (play_state, text) = match by_host {
            true => (PlayState::Paused, "the host has paused the session"),
            false => (PlayState::Running, "the session goes on"),
        };
        self.link.tell(|state| state.play_state = play_state);
        self.link.note(text.to_owned(), false);
    }

    fn resume(&mut self, session: &mut Session) {
        session.resume();
        self.paused = false;
        self.pace = self.pace.map(|_| (Instant::now(), session.now()));
        self.link.tell(|state| state.play_state = PlayState::Running);
    }

    fn pause(&mut self, session: &mut Session) {
        session.pause();
        self.paused = true;
        self.link.tell(|state| state.play_state = PlayState::Paused);
    }

    fn handle(&mut self, session: &mut Session, tuning_service: &mut TuningService<'_>, request: Request) {
        match request {
            Request::Resume if self.paused_by_host && !self.paused => {
                self.link.note("the host has paused the session, and lets it go on".to_owned(), true);
            }
            Request::Pause if !self.paused => self.pause(session),
            Request::Resume if self.paused => self.resume(session),
            Request::Step { back: false } if self.paused => {
                let until = session.now() + STEP;
                session.resume();
                session.run_until(until);
                session.pause();
                if self.pace.is_some() {
                    self.link.show(session.snapshot());
                }
            }
            Request::Speed(speed) if self.pace.is_some() && (0.01..=100.0).contains(&speed) => {
                self.pace = Some((Instant::now(), session.now()));
                self.link.tell(|state| state.speed = speed);
            }
            Request::Reset => self.again = true,
            Request::Tune(tune) => self.tune(session, tuning_service, tune),
            // Windows do not offer requests that are impossible now.
            _ => {}
        }
    }

    fn tune(&mut self, session: &mut Session, tuning_service: &mut TuningService<'_>, tune: Tune) {
        let request = match tune {
            Tune::Set(values) => TuneRequest::Set { values },
            Tune::Use(set) => TuneRequest::Use { set },
            Tune::Keep(set) => TuneRequest::Keep { set },
            Tune::Save(file) => TuneRequest::Save { file },
        };
        let reply = tuning_service.ask(session, &request);
        if let Some(error) = reply.error {
            self.link.note(error, true);
        }
        if let Some(file) = reply.file {
            self.link.note(format!("saved to {}", file.display()), false);
        }
        for left_out in reply.left_out {
            self.link.note(left_out, true);
        }
        self.tell_tuning(session, tuning_service);
    }

    fn tell_tuning(&mut self, session: &mut Session, tuning_service: &mut TuningService<'_>) {
        let reply = tuning_service.ask(session, &TuneRequest::Status {});
        let changed = reply
            .fields
            .into_iter()
            .map(|row| (row.field, row.before.unwrap_or_default(), row.value))
            .collect();
        let tuning = Tuning { changed, sets: reply.sets, in_use: reply.in_use };
        if self.link.state().tuning != tuning {
            self.link.tell(|state| state.tuning = tuning);
        }
    }

    fn tell(&mut self, session: &Session) {
        if self.told.is_some_and(|told| told.elapsed() < TELL_EVERY) {
            return;
        }
        self.told = Some(Instant::now());
        let actors = actors(session);
        self.link.tell(|state| state.actors = actors);
    }

    /// Shows what is doubtful in the scenario's meshes and values.
    pub fn doubt(&mut self, doubts: &[String]) {
        for doubt in doubts.iter().take(DOUBTS_MAX) {
            self.link.note(printable(doubt), true);
        }
        if doubts.len() > DOUBTS_MAX {
            self.link.note(format!("{} more doubts are on the terminal", doubts.len() - DOUBTS_MAX), true);
        }
    }

    /// After the session: shows its last scene and its result until the user restarts it or closes the window.
    pub fn wait(&mut self, verdict: Verdict) -> Next {
        if self.again {
            return Next::Again;
        }
        self.sessions += 1;
        let number = self.sessions;
        self.link.tell(|state: &mut SubjectState| {
            state.verdict = Some((number, verdict));
            state.play_state = PlayState::Over;
            state.abilities = Abilities { reset: true, ..Abilities::default() };
        });
        loop {
            if self.link.shared().presence() != ViewerPresence::There || self.stop.load(Ordering::Relaxed) {
                return Next::End;
            }
            match self.link.wait(5 * LOOK_EVERY) {
                Some(Request::Reset) => return Next::Again,
                _ => continue,
            }
        }
    }
}
