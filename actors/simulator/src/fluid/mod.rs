//! Fluids: blood and irrigation by SPH, smoke, bleeding vessels, and the effect of blood loss on vital signs.
//!
//! | Concept | File |
//! |---|---|
//! | Liquid: incompressible SPH | `liquid.rs`, `sph.rs`, `viscosity.rs`, `neighbour_lists.rs`, `neighbour_clusters.rs`, `neighbour_search.rs`, `pressure.rs`, `kernel.rs`, `cell_grid.rs` |
//! | Smoke puffs | `smoke.rs` |
//! | Bleeding vessels | `bleeding.rs` |
//! | Clamping and cutting of vessels | `clamp.rs`, `vessel_cut.rs` |
//! | Outflow of a hole as particles | `emitter.rs` |
//! | Surfaces as walls of a liquid | `boundary_samples.rs`, `mirror_walls.rs` |
//! | Vital signs | `vital_signs.rs` |

pub mod bleeding;
pub mod boundary_samples;
pub(crate) mod cell_grid;
pub mod clamp;
mod config;
pub(crate) mod emitter;
mod error;
mod kernel;
mod liquid;
mod mirror_walls;
pub(crate) mod neighbour_clusters;
pub(crate) mod neighbour_lists;
pub(crate) mod neighbour_search;
mod pressure;
pub mod smoke;
mod sph;
pub mod vessel_cut;
mod viscosity;
pub mod vital_signs;

use nalgebra::Vector3;

pub use config::{Ends, FluidConfig, FluidReport, FluidState};
pub use emitter::{Emitter, Hole};
pub use error::{FluidError, FluidStepError};
pub use liquid::Fluid;

/// Two unit vectors perpendicular to a unit direction and to each other.
fn across(direction: &Vector3<f64>) -> [Vector3<f64>; 2] {
    let helper = if direction.x.abs() < 0.7 { Vector3::x() } else { Vector3::y() };
    let first = direction.cross(&helper).normalize();
    [first, direction.cross(&first)]
}
