//! How much work goes into a frame.

/// What is drawn with how much care.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Quality {
    /// Colour, normal, edit and free maps.
    pub maps: bool,
    /// Physically based lighting with a wet coat and surroundings that reflect; else one plain highlight.
    pub wet: bool,
    /// Shadows of the lights that throw some.
    pub shadows: bool,
    /// Soft edges of shadows, and no seams between the levels of maps.
    pub fine: bool,
    /// Samples per pixel: 1 or 4.
    pub samples: u32,
}

impl Quality {
    /// One light with a plain highlight, base colours only: for machines without a graphics card.
    pub const PLAIN: Self = Self { maps: false, wet: false, shadows: false, fine: false, samples: 1 };
    /// Everything, one sample per pixel: what a rasteriser in software can do several times a second.
    pub const FULL: Self = Self { maps: true, wet: true, shadows: true, fine: false, samples: 1 };
    /// Everything, with smooth edges of all kinds: for pictures, and where there is a graphics card.
    pub const FINE: Self = Self { maps: true, wet: true, shadows: true, fine: true, samples: 4 };
}

impl Default for Quality {
    fn default() -> Self {
        Self::FULL
    }
}
