//! Going on where a recording ends: for a session whose program, or machine, died.
//!
//! A recording has whole scenes and what changed since, and one that was cut off is good for all but its last second. Its
//! last scene is where the new session begins, at the time that it had: every controller takes over from the scene, as
//! one that the supervisor has restarted does. What a recording samples (places, forces) is as exact as it says.

use std::fmt;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use thiserror::Error;
use trocar_kernel::recorder::{Recording, RecordingError};
use trocar_scene::scenario::Scenario;
use trocar_scene::{LineMesh, Registry, SimTime, Snapshot, TaskState};

/// Where an earlier session has stopped.
#[derive(Clone)]
pub struct Resumed {
    file: PathBuf,
    scenario: String,
    seed: u64,
    is_exact: bool,
    scene: Arc<Snapshot>,
}

impl fmt::Debug for Resumed {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Resumed")
            .field("file", &self.file)
            .field("time", &self.time())
            .finish_non_exhaustive()
    }
}

/// Why a recording is no place to go on from.
#[derive(Debug, Error)]
pub enum ResumeError {
    /// It cannot be read.
    #[error(transparent)]
    Recording(#[from] RecordingError),
    /// It is of something else.
    #[error("{file}: it is a recording of '{found}'; to go on from it, run '{found}'")]
    OtherScenario {
        /// The recording.
        file: String,
        /// Its scenario.
        found: String,
    },
    /// There is nothing left to do.
    #[error("{file}: the exercise was over at {secs:.1} s; 'trocar replay' shows it")]
    Over {
        /// The recording.
        file: String,
        /// When \[s\].
        secs: f64,
    },
}

impl Resumed {
    /// Reads where the recording ends.
    ///
    /// # Errors
    /// [`ResumeError`] when it cannot be read, or its exercise was over.
    pub fn read(registry: &Arc<Registry>, file: &Path) -> Result<Self, ResumeError> {
        let recording = Recording::open(file)?;
        recording.check_components(registry)?;
        let scene = recording.snapshot_at(registry, SimTime(u64::MAX))?;
        if scene.iter::<TaskState>().any(|(_, task)| task.over) {
            return Err(ResumeError::Over { file: name(file), secs: scene.time().as_secs_f64() });
        }
        let head = recording.metadata();
        Ok(Self {
            file: file.to_owned(),
            scenario: head.scenario.clone(),
            seed: head.seed,
            is_exact: !head.components.values().any(|component| component.contains("sampled")),
            scene: Arc::new(scene),
        })
    }

    /// Whether it is of this scenario.
    ///
    /// # Errors
    /// [`ResumeError::OtherScenario`].
    pub fn check(&self, scenario: &Scenario) -> Result<(), ResumeError> {
        if self.scenario == scenario.name {
            return Ok(());
        }
        Err(ResumeError::OtherScenario { file: name(&self.file), found: self.scenario.clone() })
    }

    /// The scene there.
    pub fn scene(&self) -> &Arc<Snapshot> {
        &self.scene
    }

    /// The session time there.
    pub fn time(&self) -> SimTime {
        self.scene.time()
    }

    /// Whether the recording is too coarse for what is in the scene: threads and needles bear no rounding.
    pub fn is_too_coarse(&self) -> bool {
        !self.is_exact && self.scene.iter::<LineMesh>().next().is_some()
    }

    /// The seed of the earlier session.
    pub fn seed(&self) -> u64 {
        self.seed
    }
}

fn name(file: &Path) -> String {
    file.display().to_string()
}
