//! What flows: blood and irrigation as smoothed particles, smoke, a vessel that bleeds, and what the loss does to the
//! patient.
//!
//! | Concept | File |
//! |---|---|
//! | Liquid: divergence-free smoothed particles | `sph.rs`, `kernel.rs`, `neighbours.rs` |
//! | Smoke: puffs that rise and stray | `smoke.rs` |
//! | A vessel that bleeds | `bleeding.rs` |
//! | Pressure and heart rate | `vital_signs.rs` |

pub mod bleeding;
mod config;
mod error;
mod kernel;
mod neighbours;
pub mod smoke;
mod sph;
pub mod vital_signs;

use nalgebra::Vector3;

pub use config::{FluidConfig, FluidReport, FluidState};
pub use error::{FluidError, FluidStepError};
pub use sph::Fluid;

/// Two unit directions across a unit direction, and across each other.
fn across(direction: &Vector3<f64>) -> [Vector3<f64>; 2] {
    let helper = if direction.x.abs() < 0.7 { Vector3::x() } else { Vector3::y() };
    let first = direction.cross(&helper).normalize();
    [first, direction.cross(&first)]
}
