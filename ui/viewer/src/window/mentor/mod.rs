//! Telementoring at a window: what a person does with mouse and keys becomes deeds, which the subject passes on.

mod pen;
mod requests;

pub(super) use pen::{COLOURS, LabelEntry, Pen};
pub(super) use requests::{askable, requested};
