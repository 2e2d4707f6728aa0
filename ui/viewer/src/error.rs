//! Errors of rendering.

use trocar_scene::output_file::OutputError;

/// Why there is no picture.
#[derive(Debug, thiserror::Error)]
pub enum ViewError {
    /// No graphics adapter that can draw.
    #[error(
        "no graphics adapter was found ({0}): install a Vulkan driver, or Mesa's software one \
         (on Debian: mesa-vulkan-drivers); the simulation itself needs none"
    )]
    NoAdapter(String),
    /// The adapter lacks a required feature.
    #[error("the graphics adapter '{adapter}' cannot be used: {reason}")]
    Refused {
        /// Its name.
        adapter: String,
        /// Its reason.
        reason: String,
    },
    /// The device is gone: driver reset, adapter removed.
    #[error("the graphics device is lost: {0}")]
    DeviceLost(String),
    /// A picture of zero or too many pixels.
    #[error(
        "a picture of {width} × {height} pixels cannot be drawn here; the largest of its shape is {} × {}",
        largest[0], largest[1]
    )]
    Size {
        /// Requested width.
        width: u32,
        /// Requested height.
        height: u32,
        /// Width and height of the largest picture of the same shape.
        largest: [u32; 2],
    },
    /// No such camera.
    #[error("there is no camera called '{name}'; there are: {known}")]
    NoCamera {
        /// The name that was asked for.
        name: String,
        /// Cameras of the scene.
        known: String,
    },
    /// A file could not be written or read.
    #[error("{file}: {reason}")]
    File {
        /// Which one.
        file: String,
        /// Why.
        reason: String,
    },
}

impl From<OutputError> for ViewError {
    fn from(error: OutputError) -> Self {
        Self::File { file: error.file.display().to_string(), reason: error.reason.to_string() }
    }
}
