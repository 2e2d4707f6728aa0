//! The recorder: writes the commit log as an MCAP file; also reads and replays recordings.
//!
//! ```text
//! Model ─▶ sink ═ queue ═▶ handover { journal: kept commits and samples ─▶ block ─▶ chunk ─▶ write buffer } ─▶ disk
//!                          ▲ one life of the recorder after the other
//! ```
//! The recorder is a supervised controller. Data that must survive its restarts is kept in the handover as plain data.

mod block;
mod block_message;
mod byte_counts;
mod columns;
mod commit_sink;
mod controller;
mod format;
mod gate;
mod handover;
mod head;
mod journal;
mod kept_commits;
mod life_buffers;
mod mcap;
mod open_block;
mod options;
mod reading;
mod rounding;
mod sampler;
#[cfg(test)]
mod sampling_tests;
#[cfg(test)]
mod supervised_tests;
#[cfg(test)]
pub(crate) mod tests;
mod tool_channels;
mod write_buffer;

pub use block::rows_of_body;
pub use controller::{RATE_HZ, Recorder};
pub use format::{Gap, Group, PROFILE, SCHEMA};
pub use options::{RecorderError, RecorderOptions, RecordingHead};
pub use reading::{
    Bytes, ComponentBytes, Item, Keyframe, Recording, RecordingEnd, RecordingError, RecordingMetadata,
    RecordingStatistics, Recovered, Replay,
};
