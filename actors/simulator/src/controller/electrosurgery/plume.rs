//! The smoke that a body gives off, as who heats it tells it.

use nalgebra::Point3;
use serde::{Deserialize, Serialize};
use trocar_scene::Component;

/// What a body gives off, as a total: whoever looks late misses nothing.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Plume {
    /// Smoke since the beginning \[kg\].
    pub emitted: f64,
    /// Where the last of it rose, in the frame of the body \[m\].
    pub place: Point3<f64>,
}
impl Component for Plume {
    const NAME: &'static str = "plume";
}
