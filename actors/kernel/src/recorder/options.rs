//! Options of a recording: its metadata and how it is written.

use std::collections::BTreeMap;
use std::path::PathBuf;

use serde_json::Value;
use thiserror::Error;
use trocar_scene::SimTime;

/// Metadata at the head of a recording.
#[derive(Clone, Debug, Default)]
pub struct RecordingHead {
    /// Name of the scenario.
    pub scenario: String,
    /// Its text, as it was run.
    pub scenario_text: String,
    /// The session's seed.
    pub seed: u64,
    /// This station's number.
    pub station: u16,
    /// Session time at the start, which is the time of the first keyframe.
    pub begin: SimTime,
    /// How it was run: `live` or `lockstep`.
    pub mode: String,
    /// Capabilities of each device by name.
    pub devices: BTreeMap<String, Value>,
    /// Further metadata for readers.
    pub extra: BTreeMap<String, String>,
}

/// How a recording is written.
#[derive(Clone, Copy, Debug)]
pub struct RecorderOptions {
    /// Keeps every commit to the last bit, also of sampled components.
    pub exact: bool,
    /// Time that one message of commits spans.
    pub block_period: SimTime,
    /// Time from one keyframe to the next.
    pub keyframe_period: SimTime,
    /// Time from one set of poses on `/tf` to the next.
    pub tf_period: SimTime,
    /// Longest time that data stays in memory only.
    pub flush_period: SimTime,
    /// Most bytes that may wait for the disk; more becomes a gap.
    pub backlog_max: usize,
    /// Most publications that may wait for the recorder's thread; more becomes a gap.
    pub queue_max: usize,
}

impl RecorderOptions {
    /// Every commit is kept to the last bit.
    pub fn exact() -> Self {
        Self { exact: true, ..Self::default() }
    }
}

impl Default for RecorderOptions {
    fn default() -> Self {
        Self {
            exact: false,
            block_period: SimTime::from_millis(100),
            keyframe_period: SimTime::from_millis(10_000),
            tf_period: SimTime(33_333_333),
            flush_period: SimTime::from_millis(500),
            backlog_max: 64 << 20,
            queue_max: 4_096,
        }
    }
}

/// A recording that cannot begin.
#[derive(Debug, Error)]
pub enum RecorderError {
    /// The file cannot be created.
    #[error("recording '{}': {source}", file.display())]
    Create {
        /// The file.
        file: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// The head cannot be written.
    #[error("recording '{}': {message}", file.display())]
    Head {
        /// The file.
        file: PathBuf,
        /// Why.
        message: String,
    },
}
