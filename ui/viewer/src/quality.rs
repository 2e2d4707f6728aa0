//! Rendering quality.

/// The rendering features of a quality.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Quality {
    /// Colour, normal, edit and free maps.
    pub maps: bool,
    /// Physically based lighting with a wet coat and environment reflections; otherwise one plain highlight.
    pub wet: bool,
    /// Shadows.
    pub shadows: bool,
    /// Soft shadow edges, and interpolation between mip levels.
    pub fine: bool,
    /// Samples per pixel: 1 or 4.
    pub samples: u32,
}

impl Quality {
    /// One light with a plain highlight, base colours only: for machines without a graphics card.
    pub const PLAIN: Self = Self { maps: false, wet: false, shadows: false, fine: false, samples: 1 };
    /// All features, one sample per pixel: several frames a second with a software rasteriser.
    pub const FULL: Self = Self { maps: true, wet: true, shadows: true, fine: false, samples: 1 };
    /// All features, with antialiasing: for pictures, and with a graphics card.
    pub const FINE: Self = Self { maps: true, wet: true, shadows: true, fine: true, samples: 4 };
}

impl Default for Quality {
    fn default() -> Self {
        Self::FULL
    }
}
