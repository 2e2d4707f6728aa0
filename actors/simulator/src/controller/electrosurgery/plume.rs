//! Smoke emission of a body, as published by the electrosurgery controller.

use nalgebra::Point3;
use serde::{Deserialize, Serialize};
use trocar_scene::{Component, RecordPolicy};

/// Cumulative emission of a body: a late reader misses nothing.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, Component)]
#[component(name = "plume", record = RecordPolicy::sampled(10.0, 1e-6))]
pub struct Plume {
    /// Smoke since the beginning \[kg\].
    pub emitted: f64,
    /// Position of the latest emission, in the body's frame \[m\].
    pub place: Point3<f64>,
}
