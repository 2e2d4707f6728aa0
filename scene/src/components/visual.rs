//! Visual components: materials with four maps, lights, cameras.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::entity::Entity;
use crate::{Component, ComponentError};

/// A texture: a file below the scenario's folder, or a procedural one.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Texture {
    /// A picture file, relative to the scenario.
    File(String),
    /// A procedural pattern by name.
    Procedural(String),
}

/// Surface appearance: a base colour and up to four maps combined per fragment.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Component)]
#[component(name = "visual_material", check = Self::ranges, schema)]
#[serde(default, deny_unknown_fields)]
pub struct VisualMaterial {
    /// Linear RGB with opacity, in \[0, 1\].
    pub base_color: [f64; 4],
    /// Perceptual roughness in \[0, 1\].
    pub roughness: f64,
    /// Metalness in \[0, 1\].
    pub metalness: f64,
    /// Wetness of the surface in \[0, 1\], for specular highlights of a liquid film.
    pub wetness: f64,
    /// How often the maps repeat over the unit square of texture coordinates; the edit map never does.
    pub tiling: [f64; 2],
    /// Depth of the normal map's relief \[m\]; 0 leaves the surface flat.
    pub relief: f64,
    /// A WGSL file below the scenario's folder whose function `surface` modifies the shading.
    pub shader: Option<String>,
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
            wetness: 0.0,
            tiling: [1.0, 1.0],
            relief: 0.0,
            shader: None,
            color_map: None,
            normal_map: None,
            edit_map: None,
            free_map: None,
        }
    }
}

impl VisualMaterial {
    fn ranges(&self) -> Result<(), ComponentError> {
        let share = |field, value| ComponentError::range(field, value, 0.0..=1.0, "0 to 1");
        self.base_color.iter().try_for_each(|part| share("base_color", *part))?;
        share("roughness", self.roughness)?;
        share("metalness", self.metalness)?;
        share("wetness", self.wetness)?;
        let repeat = |value: f64| ComponentError::range("tiling", value, 1e-3..=1e4, "1e-3 to 1e4");
        self.tiling.iter().try_for_each(|repeats| repeat(*repeats))?;
        ComponentError::range("relief", self.relief, 0.0..=0.05, "0 to 0.05 m")
    }
}

/// A light at the entity's pose, shining along its +z axis.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Component)]
#[component(name = "light", schema)]
#[serde(default, deny_unknown_fields)]
pub struct Light {
    /// Linear RGB in \[0, 1\].
    pub color: [f64; 3],
    /// Luminous intensity \[cd\].
    pub intensity: f64,
    /// Half angle of the cone \[rad\]; π for a point light.
    pub cone_angle: f64,
    /// Whether it casts shadows; only a cone of less than a right angle can.
    pub shadows: bool,
}
impl Default for Light {
    fn default() -> Self {
        Self { color: [1.0; 3], intensity: 1.0, cone_angle: std::f64::consts::PI, shadows: true }
    }
}

/// A camera at the entity's pose, looking along its +z axis, image down along +y.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Component)]
#[component(name = "camera", schema)]
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

/// The optics of a laparoscope, on the entity of its [`Camera`]: the scope's axis is the entity's +z.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema, Component)]
#[component(name = "optics", check = Self::ranges, schema)]
#[serde(default, deny_unknown_fields)]
pub struct Optics {
    /// Angle between the scope's axis and the line of sight \[rad\]: 0, 30° or 45° are common.
    pub tilt: f64,
    /// Rotation of the scope about its axis \[rad\]; the tilted line of sight rotates with it, the image does not.
    pub turn: f64,
    /// Barrel distortion: radial displacement at the picture's corner as a share of its half diagonal.
    pub distortion: f64,
    /// Vignetting at the image's corner in \[0, 1\].
    pub vignette: f64,
}

impl Optics {
    fn ranges(&self) -> Result<(), ComponentError> {
        ComponentError::range("tilt", self.tilt, 0.0..=2.1, "0 to 2.1 rad")?;
        ComponentError::range("distortion", self.distortion, 0.0..=0.5, "0 to 0.5")?;
        ComponentError::range("vignette", self.vignette, 0.0..=1.0, "0 to 1")
    }
}

/// Makes a [`Camera`] a head-coupled display: for a viewer with a tracked head, the screen shows the scene behind it
/// like a window pane ("fish tank virtual reality": Ware, Arthur, Booth 1993).
///
/// The camera's entity is the centre of the screen: z into the screen, x to its right, y down. The pose of
/// [`Self::head`] is the head's, so that its writer (a tracker, a controller, a scenario) moves the eye. The camera's
/// near and far apply; its field of view and [`Optics`] do not.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Component)]
#[component(name = "head_tracked", check = Self::ranges, schema)]
#[serde(deny_unknown_fields)]
pub struct HeadTracked {
    /// Entity with the pose of the head: between the eyes, x to the right eye, y down, z straight ahead. Best below the
    /// camera's entity ([`Parent`](crate::Parent)), so that it is given in the frame of the screen.
    #[schemars(with = "String")]
    pub head: Entity,
    /// Width and height of the screen \[m\].
    pub screen: [f64; 2],
    /// Interocular distance \[m\].
    #[serde(default = "interocular")]
    pub interocular: f64,
    /// Metres in the scene per metre in front of the screen; scales screen, head and eyes.
    #[serde(default = "life_size")]
    pub scale: f64,
}
/// Mean interpupillary distance of adults (Dodgson, "Variation and extrema of human interpupillary distance", 2004)
/// \[m\].
fn interocular() -> f64 {
    0.063
}
fn life_size() -> f64 {
    1.0
}

impl HeadTracked {
    fn ranges(&self) -> Result<(), ComponentError> {
        let side = |value: f64| ComponentError::range("screen", value, 1e-3..=100.0, "0.001 to 100 m");
        self.screen.iter().try_for_each(|length| side(*length))?;
        ComponentError::range("interocular", self.interocular, 0.0..=0.2, "0 to 0.2 m")?;
        ComponentError::range("scale", self.scale, 1e-3..=1e3, "0.001 to 1000")
    }
}
