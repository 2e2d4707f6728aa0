//! What a viewer needs: materials with four maps, lights, cameras.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// An image: a file below the scenario's folder, or one that is computed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Texture {
    /// A picture file, relative to the scenario.
    File(String),
    /// A procedural pattern by name.
    Procedural(String),
}

/// Surface appearance: a base colour and up to four maps combined per fragment.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct VisualMaterial {
    /// Linear RGB with opacity, in \[0, 1\].
    pub base_color: [f64; 4],
    /// Perceptual roughness in \[0, 1\].
    pub roughness: f64,
    /// Metalness in \[0, 1\].
    pub metalness: f64,
    /// Colour map.
    pub color_map: Option<Texture>,
    /// Normal (bump or relief) map.
    pub normal_map: Option<Texture>,
    /// Edit map: burns, cuts and blood painted while the scene changes.
    pub edit_map: Option<Texture>,
    /// Free for the application.
    pub free_map: Option<Texture>,
}
impl Default for VisualMaterial {
    fn default() -> Self {
        Self {
            base_color: [0.8, 0.8, 0.8, 1.0],
            roughness: 0.5,
            metalness: 0.0,
            color_map: None,
            normal_map: None,
            edit_map: None,
            free_map: None,
        }
    }
}
super::component!(VisualMaterial, "visual_material");

/// A light at the entity's pose, shining along its +z axis.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Light {
    /// Linear RGB in \[0, 1\].
    pub color: [f64; 3],
    /// Luminous intensity \[cd\].
    pub intensity: f64,
    /// Half angle of the cone \[rad\]; π for a point light.
    pub cone_angle: f64,
}
impl Default for Light {
    fn default() -> Self {
        Self { color: [1.0; 3], intensity: 1.0, cone_angle: std::f64::consts::PI }
    }
}
super::component!(Light, "light");

/// A camera at the entity's pose, looking along its +z axis, image down along +y.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Camera {
    /// Vertical field of view \[rad\].
    pub field_of_view: f64,
    /// Nearest visible depth \[m\].
    pub near: f64,
    /// Farthest visible depth \[m\].
    pub far: f64,
    /// Width divided by height.
    pub aspect: f64,
}
impl Default for Camera {
    fn default() -> Self {
        Self { field_of_view: 1.05, near: 0.005, far: 1.0, aspect: 4.0 / 3.0 }
    }
}
super::component!(Camera, "camera");
