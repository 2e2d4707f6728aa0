//! Options of a run.

mod resume;

use std::net::SocketAddr;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use trocar_kernel::faults::FaultPlan;
use trocar_kernel::recorder::RecorderOptions;
use trocar_kernel::spec::FaultSink;
use trocar_scene::SimTime;

use crate::network::Network;

pub use resume::{ResumeError, Resumed};

/// Further targets for faults, by name, that belong to the program.
#[derive(Clone, Default)]
pub struct FaultTargets(pub Vec<(String, Arc<dyn FaultSink>)>);

impl std::fmt::Debug for FaultTargets {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_list().entries(self.0.iter().map(|(name, _)| name)).finish()
    }
}

/// Options of a run.
#[derive(Clone, Debug)]
pub struct RunOptions {
    /// Run in virtual time on one thread instead of real time.
    pub lockstep: bool,
    /// Session time at the start, for a station that joins a host: see
    /// [`SessionSpec::begin`](trocar_kernel::spec::SessionSpec::begin).
    pub begin: SimTime,
    /// Where an earlier session has stopped, if this one goes on there: it begins in that scene, at that time.
    pub resume: Option<Resumed>,
    /// End this long after the start \[s\]; `None`: when the exercise is over.
    pub seconds: Option<f64>,
    /// Seed of all randomness.
    pub seed: u64,
    /// Devices instead of the scenario's: (hand, spec).
    pub hands: Vec<(String, String)>,
    /// The fault plan.
    pub faults: Option<FaultPlan>,
    /// Further targets for faults: parts of the program outside the session.
    pub fault_targets: FaultTargets,
    /// File to record to. One that is there is emptied: a program that must not lose it claims the place first, with
    /// [`trocar_scene::output_file::Claim`].
    pub record: Option<PathBuf>,
    /// Options of the recorder.
    pub recorder: RecorderOptions,
    /// Skill of the virtual trainee instead of the scenario's.
    pub skill: Option<String>,
    /// The trainee is left-handed.
    pub left_handed: bool,
    /// A person moves the hands instead of the virtual trainee: see [`crate::play`].
    pub play: bool,
    /// Whether others share the session over a network, and how.
    pub network: Network,
    /// The packet reflector that hands of the scenario go through live, in place of one that the session starts.
    pub reflector: Option<SocketAddr>,
    /// Hands that lead a robot elsewhere, as at a surgeon's console: (hand, robot), such as `itp:127.0.0.1:36000`. The
    /// session is then that console alone: it has these hands, and none of the physics.
    pub consoles: Vec<(String, String)>,
    /// Set from outside to end the run early.
    pub stop: Arc<AtomicBool>,
}

impl Default for RunOptions {
    fn default() -> Self {
        Self {
            lockstep: false,
            begin: SimTime::ZERO,
            resume: None,
            seconds: None,
            seed: 1,
            hands: Vec::new(),
            faults: None,
            fault_targets: FaultTargets::default(),
            record: None,
            recorder: RecorderOptions::default(),
            skill: None,
            left_handed: false,
            play: false,
            network: Network::None,
            reflector: None,
            consoles: Vec::new(),
            stop: Arc::default(),
        }
    }
}

impl RunOptions {
    /// Session time at the start.
    pub fn begin(&self) -> SimTime {
        self.resume.as_ref().map_or(self.begin, Resumed::time)
    }
}
