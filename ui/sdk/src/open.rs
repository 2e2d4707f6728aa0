//! Opens a session in one line, and steps it.

use std::path::PathBuf;

use thiserror::Error;
use trocar_kernel::StateHash;
use trocar_kernel::faults::FaultPlan;
use trocar_scene::SimTime;
use trocar_scene::scenario::Scenario;

use crate::app::{App, AppError};
use crate::run::{self, RunError, RunOptions};
use crate::session::{Running, Session};
use crate::summary::TaskSummary;

/// Why a session could not be opened.
#[derive(Debug, Error)]
pub enum OpenError {
    /// The scenario does not exist or is invalid.
    #[error(transparent)]
    App(#[from] AppError),
    /// The session could not start.
    #[error(transparent)]
    Run(#[from] RunError),
    /// The scenario has no controller of the name to be left out.
    #[error("without '{name}': the scenario has no such controller; there are: {known}")]
    UnknownController {
        /// The name that was asked for.
        name: String,
        /// The valid names.
        known: String,
    },
}

/// Options of a session to open; [`Session::builder`] makes one.
///
/// ```
/// use trocar::prelude::*;
///
/// // The exercise without its virtual trainee: the hands are ours.
/// let mut session = Session::builder().seed(7).without("autopilot").open("peg-transfer")?;
/// let hand = session.snapshot().find("hand.right").expect("the scenario has it");
/// let there = HandTarget { handle_in_device: Pose::at(0.01, 0.0, 0.0), gripper: 0.3 };
/// session.apply(|out| out.put(hand, there))?;
/// session.step(SimTime::from_millis(500));
/// assert!(!session.task().completed);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Default)]
#[must_use]
pub struct SessionBuilder<'a> {
    app: Option<&'a App>,
    options: RunOptions,
    without: Vec<String>,
}

impl<'a> SessionBuilder<'a> {
    /// Uses the components and controllers of this program instead of the built-in ones.
    pub fn app(mut self, app: &'a App) -> Self {
        self.app = Some(app);
        self
    }
    /// Sets the seed of all randomness; the default is 1.
    pub fn seed(mut self, seed: u64) -> Self {
        self.options.seed = seed;
        self
    }
    /// Starts at this session time instead of zero, as a station that joins another one does.
    pub fn begin(mut self, begin: SimTime) -> Self {
        self.options.begin = begin;
        self
    }
    /// Ends this long after the start \[s\], even before the exercise is over.
    pub fn seconds(mut self, seconds: f64) -> Self {
        self.options.seconds = Some(seconds);
        self
    }
    /// Replaces the scenario's device for a hand: `hand("left", "virtual:mass=0.05")`.
    pub fn hand(mut self, name: &str, device: &str) -> Self {
        self.options.hands.push((name.to_owned(), device.to_owned()));
        self
    }
    /// Sets the fault plan.
    pub fn faults(mut self, plan: FaultPlan) -> Self {
        self.options.faults = Some(plan);
        self
    }
    /// Records into this file, until the end or the first [`Session::reset`]; a branch is not recorded.
    pub fn record(mut self, file: impl Into<PathBuf>) -> Self {
        self.options.record = Some(file.into());
        self
    }
    /// Sets the skill of the virtual trainee instead of the scenario's.
    pub fn skill(mut self, skill: &str) -> Self {
        self.options.skill = Some(skill.to_owned());
        self
    }
    /// The trainee is left-handed.
    pub fn left_handed(mut self) -> Self {
        self.options.left_handed = true;
        self
    }
    /// Lets a person move the hands instead of the virtual trainee: see [`crate::play`].
    pub fn play(mut self) -> Self {
        self.options.play = true;
        self
    }
    /// Leaves a controller of the scenario out; the program does its work through [`Session::apply`].
    pub fn without(mut self, controller: &str) -> Self {
        self.without.push(controller.to_owned());
        self
    }

    /// Opens a session of a scenario, by its name or file, in virtual time.
    ///
    /// # Errors
    /// [`OpenError`] says what is wrong and what is valid.
    pub fn open(self, name_or_file: &str) -> Result<Session, OpenError> {
        let standard;
        let app = match self.app {
            Some(app) => app,
            None => {
                standard = App::new();
                &standard
            }
        };
        let scenario = app.scenario(name_or_file)?;
        Self { app: None, ..self }.open_in(app, scenario)
    }

    /// Opens a session of a scenario that is loaded already, perhaps with changes.
    ///
    /// # Errors
    /// [`OpenError`] says what is wrong and what is valid.
    pub fn open_scenario(self, scenario: &Scenario) -> Result<Session, OpenError> {
        match self.app {
            Some(app) => self.open_in(app, scenario.clone()),
            None => self.open_in(&App::new(), scenario.clone()),
        }
    }

    fn open_in(self, app: &App, mut scenario: Scenario) -> Result<Session, OpenError> {
        for name in self.without {
            let Some(at) = scenario.controllers.iter().position(|entry| entry.name == name) else {
                let known = scenario.controllers.iter().map(|entry| entry.name.as_str());
                return Err(OpenError::UnknownController {
                    name,
                    known: known.collect::<Vec<_>>().join(", "),
                });
            };
            scenario.controllers.remove(at);
        }
        let options = RunOptions { lockstep: true, ..self.options };
        Ok(run::start(app, &scenario, &options)?)
    }
}

impl Session {
    /// Opens a session of a scenario, by its name or file, in virtual time, with the scenario's own settings.
    ///
    /// ```
    /// use trocar::prelude::*;
    ///
    /// let mut session = Session::open("peg-transfer")?;
    /// while session.step(SimTime::from_millis(10)) && session.now() < SimTime::from_millis(2_000) {}
    /// assert_eq!(session.task().errors.len(), 0);
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    ///
    /// # Errors
    /// [`OpenError`] says what is wrong and what is valid.
    pub fn open(name_or_file: &str) -> Result<Self, OpenError> {
        Self::builder().open(name_or_file)
    }

    /// A builder that begins with the scenario's own settings.
    pub fn builder<'a>() -> SessionBuilder<'a> {
        SessionBuilder::default()
    }

    /// Advances the session by `dt`: computes in virtual time, waits in real time. Returns whether the session goes on:
    /// `false` once its exercise is over, its time is up, or its supervisor gave up.
    pub fn step(&mut self, dt: SimTime) -> bool {
        self.run_until(self.now() + dt)
    }

    /// The state of the exercise; a scenario without one counts as completed.
    pub fn task(&self) -> TaskSummary {
        match &self.running {
            Running::Lockstep(session) => run::task_summary(session.view()),
            Running::Live(session, _) => run::task_summary(&session.snapshot()),
        }
    }

    /// The state hash over all commits. A session in real time has one only at its end.
    pub fn hash(&self) -> Option<StateHash> {
        match &self.running {
            Running::Lockstep(session) => Some(session.hash()),
            Running::Live(..) => None,
        }
    }
}
