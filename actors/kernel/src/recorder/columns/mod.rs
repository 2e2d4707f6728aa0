//! Columns: the coding by which rows take little room in a recording.
//!
//! ```text
//! rows of a component ─▶ leaves ─▶ whole numbers ─▶ − prediction ─▶ planes of bytes ─▶ (deflate)
//!                        trocar_scene::Leaves   grid     prediction          planes
//! ```
//! * A number with a fraction becomes a whole number where all of its column are multiples of one power of two, as
//!   rounded values are; otherwise its bits are taken, in the order of the numbers.
//! * It is predicted from the last two values of the same entity, as on a straight line; without such values, from the
//!   element before it in its own list.
//! * What is left is small. The lowest bytes of all numbers come first, then the next ones: most planes are zeros.
//!
//! No bit is lost. The values that predict others are a [`History`]; it begins anew with each chunk of a recording, so
//! that each chunk can be read without the ones before it.
//!
//! Similar codings: Lindstrom and Isenburg, "Fast and efficient compression of floating-point data", 2006; the shuffle
//! of HDF5 and Blosc.

mod decoder;
mod encoder;
mod grid;
mod history;
mod planes;
mod prediction;

pub(super) use decoder::RowDecoder;
pub(super) use encoder::RowEncoder;
pub(super) use history::History;
pub(super) use planes::Cursor;

/// Rows of up to this many leaves have a grid for each of their columns.
const COLUMNS_MAX: usize = 256;

#[cfg(test)]
mod tests;
