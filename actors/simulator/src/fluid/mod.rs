//! What flows: blood and irrigation as smoothed particles, smoke, a vessel that bleeds, and what the loss does to the
//! patient.
//!
//! | Concept | File |
//! |---|---|
//! | Liquid: smoothed particles that keep their volume | `sph.rs`, `rows.rs`, `links.rs`, `near.rs`, `pressure.rs`, `kernel.rs`, `neighbours.rs` |
//! | Smoke: puffs that rise and stray | `smoke.rs` |
//! | A vessel that bleeds | `bleeding.rs` |
//! | What jaws close of a vessel, what cuts it | `clamp.rs`, `sever.rs` |
//! | What comes out of a hole, as particles | `spout.rs` |
//! | Surfaces as walls of a liquid | `walls.rs` |
//! | Pressure and heart rate | `vital_signs.rs` |

pub mod bleeding;
pub mod clamp;
mod config;
mod error;
mod kernel;
mod links;
mod near;
mod neighbours;
mod pressure;
mod rows;
pub mod sever;
pub mod smoke;
mod sph;
mod spout;
pub mod vital_signs;
pub mod walls;

use nalgebra::Vector3;

pub use config::{FluidConfig, FluidReport, FluidState};
pub use error::{FluidError, FluidStepError};
pub use sph::Fluid;
pub use spout::{Hole, Spout};

/// Two unit directions across a unit direction, and across each other.
fn across(direction: &Vector3<f64>) -> [Vector3<f64>; 2] {
    let helper = if direction.x.abs() < 0.7 { Vector3::x() } else { Vector3::y() };
    let first = direction.cross(&helper).normalize();
    [first, direction.cross(&first)]
}
