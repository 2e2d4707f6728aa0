//! Reading of recordings, also of cut and damaged ones.

pub(super) mod chunk_items;
#[cfg(test)]
mod damage_tests;
pub(super) mod recording;
mod recover;
mod replay;
mod statistics;

pub use chunk_items::{Item, Keyframe};
pub use recording::{Recording, RecordingEnd, RecordingError, RecordingMetadata};
pub use recover::Recovered;
pub use replay::Replay;
pub use statistics::{Bytes, ComponentBytes, RecordingStatistics};
