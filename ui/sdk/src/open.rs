//! Opening a session in one line, and letting time pass in it.

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
    /// There is no such scenario, or it is wrong.
    #[error(transparent)]
    App(#[from] AppError),
    /// The session could not start.
    #[error(transparent)]
    Run(#[from] RunError),
    /// A controller to be left out that the scenario does not have.
    #[error("without '{name}': the scenario has no such controller; there are: {known}")]
    UnknownController {
        /// What was asked for.
        name: String,
        /// What there is.
        known: String,
    },
}

/// What a session is opened with; [`Session::builder`] makes one.
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
    /// With the components and controllers of this program; without, those that come with Trocar.
    pub fn app(mut self, app: &'a App) -> Self {
        self.app = Some(app);
        self
    }
    /// Seeds everything random; 1 otherwise.
    pub fn seed(mut self, seed: u64) -> Self {
        self.options.seed = seed;
        self
    }
    /// Ends after so much time of the session \[s\], also before the exercise is over.
    pub fn seconds(mut self, seconds: f64) -> Self {
        self.options.seconds = Some(seconds);
        self
    }
    /// Another device for a hand than the scenario's: `hand("left", "virtual:mass=0.05")`.
    pub fn hand(mut self, name: &str, device: &str) -> Self {
        self.options.hands.push((name.to_owned(), device.to_owned()));
        self
    }
    /// What shall go wrong.
    pub fn faults(mut self, plan: FaultPlan) -> Self {
        self.options.faults = Some(plan);
        self
    }
    /// Records into this file, until the end or the first [`Session::reset`]; a branch is not recorded.
    pub fn record(mut self, file: impl Into<PathBuf>) -> Self {
        self.options.record = Some(file.into());
        self
    }
    /// Skill of the virtual trainee instead of the scenario's.
    pub fn skill(mut self, skill: &str) -> Self {
        self.options.skill = Some(skill.to_owned());
        self
    }
    /// The trainee is left-handed.
    pub fn left_handed(mut self) -> Self {
        self.options.left_handed = true;
        self
    }
    /// A person moves the hands, in the place of the virtual trainee: see [`crate::play`].
    pub fn play(mut self) -> Self {
        self.options.play = true;
        self
    }
    /// Leaves a controller of the scenario out, to do its work through [`Session::apply`].
    pub fn without(mut self, controller: &str) -> Self {
        self.without.push(controller.to_owned());
        self
    }

    /// Opens a session of a scenario, by its name or file, in virtual time.
    ///
    /// # Errors
    /// [`OpenError`] says what is wrong and what there is.
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

    /// Opens a session of a scenario that was read, and perhaps changed, before.
    ///
    /// # Errors
    /// [`OpenError`] says what is wrong and what there is.
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
    /// Opens a session of a scenario, by its name or file, in virtual time, with everything as the scenario says.
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
    /// [`OpenError`] says what is wrong and what there is.
    pub fn open(name_or_file: &str) -> Result<Self, OpenError> {
        Self::builder().open(name_or_file)
    }

    /// What a session is to be opened with, beginning with everything as the scenario says.
    pub fn builder<'a>() -> SessionBuilder<'a> {
        SessionBuilder::default()
    }

    /// Lets `dt` pass: computes in virtual time, waits in real time. Whether the session goes on: `false` once its
    /// exercise is over, its time is up, or its supervisor gave up.
    pub fn step(&mut self, dt: SimTime) -> bool {
        self.run_until(self.now() + dt)
    }

    /// How the exercise stands; without one there is nothing left undone.
    pub fn task(&self) -> TaskSummary {
        match &self.running {
            Running::Lockstep(session) => run::task_summary(session.view()),
            Running::Live(session, _) => run::task_summary(&session.snapshot()),
        }
    }

    /// The state hash over everything that was ever written; of a session in real time only its end has one.
    pub fn hash(&self) -> Option<StateHash> {
        match &self.running {
            Running::Lockstep(session) => Some(session.hash()),
            Running::Live(..) => None,
        }
    }
}
