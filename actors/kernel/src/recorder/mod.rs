//! The recorder: writes the commit log as an MCAP file; also reads and replays recordings.
//!
//! ```text
//! Model ─▶ sink ═ queue ═▶ handover { journal: kept commits and samples ─▶ block ─▶ chunk ─▶ write buffer } ─▶ disk
//!                          ▲ one life of the recorder after the other
//! ```
//! The recorder is a supervised controller. Data that must survive its restarts is kept in the handover as plain data.

mod block;
mod byte_counts;
mod bytes;
mod chunk_items;
mod chunk_list;
mod columns;
mod commit_sink;
mod container;
mod controller;
#[cfg(test)]
mod damage_tests;
mod format;
mod gate;
mod handover;
mod head;
mod journal;
mod json_channels;
mod kept_commits;
mod life_buffers;
mod mcap_records;
mod open_block;
mod options;
mod reader;
mod recover;
mod replay;
mod rounding;
mod sampler;
#[cfg(test)]
mod sampling_tests;
mod statistics;
#[cfg(test)]
mod supervised_tests;
#[cfg(test)]
pub(crate) mod tests;
mod write_buffer;

pub use chunk_items::{Item, Keyframe};
pub use controller::{RATE_HZ, Recorder};
pub use format::{Gap, Group, PROFILE, SCHEMA};
pub use options::{RecorderError, RecorderOptions, RecordingHead};
pub use reader::{Recording, RecordingEnd, RecordingError, RecordingMetadata};
pub use recover::Recovered;
pub use replay::Replay;
pub use statistics::{Bytes, ComponentBytes, RecordingStatistics};
