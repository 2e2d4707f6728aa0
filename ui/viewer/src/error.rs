//! Errors of rendering.

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
    #[error("a picture of {width} × {height} pixels cannot be drawn: each side takes 1 to {max}")]
    Size {
        /// Requested width.
        width: u32,
        /// Requested height.
        height: u32,
        /// Largest side.
        max: u32,
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
