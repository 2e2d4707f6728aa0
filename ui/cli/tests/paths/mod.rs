//! Paths between a station and its host: what is looked at, and what leads around a router.

mod doctor;
mod relay;
