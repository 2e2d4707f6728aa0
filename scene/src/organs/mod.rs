//! Procedural organs and soft bodies: implicit functions meshed with graded tetrahedra; sheets, tubes and threads as
//! grids.

mod catalogue;
mod grids;
mod implicit;
mod lattice;
mod stuffing;

use thiserror::Error;

use crate::readable::{number, quantity};

pub use catalogue::Organ;
pub use grids::{block, line, pipe, sheet, tube};
pub use implicit::{Implicit, Part};
pub use lattice::CELLS_MAX;
pub use stuffing::tetrahedra;

/// An organ that cannot be made.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum OrganError {
    /// It has no parts.
    #[error("it has no parts")]
    Empty,
    /// The lattice would be too large.
    #[error(
        "edges of {} make at least {} cells, and {} are allowed: make them longer",
        quantity(*edge, "m"),
        number(*cells),
        number(*most as f64)
    )]
    TooFine {
        /// Length of an edge \[m\].
        edge: f64,
        /// Cells that it makes.
        cells: f64,
        /// Most that are allowed.
        most: usize,
    },
    /// The lattice is too coarse: no element is left.
    #[error("nothing of it is left with edges of {}: make them shorter", quantity(*edge, "m"))]
    Lost {
        /// Length of an edge \[m\].
        edge: f64,
    },
    /// A number of cells or a length that is out of range.
    #[error("{field}: {value} is out of range ({valid})")]
    OutOfRange {
        /// Which.
        field: &'static str,
        /// Its value.
        value: f64,
        /// What would be valid.
        valid: &'static str,
    },
}
