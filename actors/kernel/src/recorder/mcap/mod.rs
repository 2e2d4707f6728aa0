//! The container of a recording: records and chunks of MCAP, written and found again.

pub(super) mod bytes;
pub(super) mod chunk_list;
pub(super) mod container;
pub(super) mod records;
