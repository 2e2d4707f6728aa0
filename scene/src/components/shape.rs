//! Analytic shapes, for bodies without a mesh.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::{Component, ComponentError};

/// A shape in the entity's frame. Axes of revolution are the local z axis.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Component)]
#[component(name = "shape", check = Self::ranges, schema)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Shape {
    /// A box.
    Box {
        /// Half edge lengths \[m\].
        half_extents: [f64; 3],
    },
    /// A ball.
    Sphere {
        /// Radius \[m\].
        radius: f64,
    },
    /// A cylinder about z.
    Cylinder {
        /// Radius \[m\].
        radius: f64,
        /// Half of the length \[m\].
        half_height: f64,
    },
    /// A cylinder about z with hemispherical ends.
    Capsule {
        /// Radius \[m\].
        radius: f64,
        /// Half of the length without the ends \[m\].
        half_height: f64,
    },
    /// A ring about z.
    Torus {
        /// Radius of the centre line \[m\].
        ring_radius: f64,
        /// Radius of the tube \[m\].
        tube_radius: f64,
    },
    /// A board whose top face is z = 0 with upright pegs on it.
    PegBoard {
        /// Half edge lengths of the board in x and y \[m\].
        half_extents: [f64; 2],
        /// Thickness of the board, downwards from z = 0 \[m\].
        thickness: f64,
        /// Foot of each peg (x, y) on the top face \[m\].
        pegs: Vec<[f64; 2]>,
        /// Radius of a peg \[m\].
        peg_radius: f64,
        /// Height of a peg above the top face \[m\].
        peg_height: f64,
    },
}

impl Shape {
    fn ranges(&self) -> Result<(), ComponentError> {
        let positive = |field, value: f64| {
            ComponentError::range(field, value, f64::MIN_POSITIVE..=100.0, "above 0, at most 100 m")
        };
        match self {
            Shape::Box { half_extents } => {
                half_extents.iter().try_for_each(|half| positive("half_extents", *half))
            }
            Shape::Sphere { radius } => positive("radius", *radius),
            Shape::Cylinder { radius, half_height } | Shape::Capsule { radius, half_height } => {
                positive("radius", *radius)?;
                positive("half_height", *half_height)
            }
            Shape::Torus { ring_radius, tube_radius } => {
                positive("tube_radius", *tube_radius)?;
                ComponentError::range(
                    "ring_radius",
                    *ring_radius,
                    *tube_radius..=100.0,
                    "at least tube_radius",
                )
            }
            Shape::PegBoard { half_extents, thickness, pegs, peg_radius, peg_height } => {
                half_extents.iter().try_for_each(|half| positive("half_extents", *half))?;
                positive("thickness", *thickness)?;
                positive("peg_radius", *peg_radius)?;
                positive("peg_height", *peg_height)?;
                ComponentError::range(
                    "pegs (their number)",
                    pegs.len() as f64,
                    0.0..=1024.0,
                    "at most 1024",
                )?;
                pegs.iter().try_for_each(|[x, y]| {
                    ComponentError::range("pegs.x", x.abs(), ..=half_extents[0], "on the board")?;
                    ComponentError::range("pegs.y", y.abs(), ..=half_extents[1], "on the board")
                })
            }
        }
    }
}
