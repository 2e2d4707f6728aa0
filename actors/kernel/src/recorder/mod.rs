//! The recorder: the log of commits as an MCAP file, and what can be done with one afterwards.

mod bytes;
mod format;
mod reader;
mod replay;
mod side;
mod sink;
mod spool;
#[cfg(test)]
mod tests;
mod writer;

pub use format::{Gap, Group, PROFILE, SCHEMA};
pub use reader::{Item, Keyframe, Recording, RecordingEnd, RecordingError, RecordingMetadata};
pub use replay::Replay;
pub use sink::Recorder;
pub use writer::{RecorderError, RecorderOptions, RecordingHead};
