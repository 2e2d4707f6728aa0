//! Reading of recordings, also of cut and damaged ones.

pub(super) mod chunk_items;
#[cfg(test)]
mod damage_tests;
mod error;
pub(super) mod metadata;
mod recording;
mod recover;
mod replay;
mod statistics;

pub use chunk_items::{Item, Keyframe};
pub use error::RecordingError;
pub use metadata::{RecordingEnd, RecordingMetadata};
pub use recording::Recording;
pub use recover::Recovered;
pub use replay::Replay;
pub use statistics::{Bytes, ComponentBytes, RecordingStatistics};
