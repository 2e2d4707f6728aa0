//! Pictures in memory.

use std::path::Path;

use trocar_scene::Entity;

use crate::error::ViewError;

/// A colour picture.
#[derive(Clone, Debug, PartialEq)]
pub struct Picture {
    /// Pixels per row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Red, green, blue (sRGB) and opacity, row by row from the top.
    pub color: Vec<[u8; 4]>,
}

/// Depths and entities of a view.
#[derive(Clone, Debug, PartialEq)]
pub struct Probe {
    /// Pixels per row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Depth along the line of sight \[m\], row by row from the top; infinite for the background.
    pub depth: Vec<f32>,
    /// Per pixel: the index of the entity in `entities` plus one; 0 for the background.
    pub numbers: Vec<u32>,
    /// The entities of the numbers.
    pub entities: Vec<Entity>,
}

impl Picture {
    /// The colour of a pixel; `None` outside.
    pub fn at(&self, x: u32, y: u32) -> Option<[u8; 4]> {
        let inside = x < self.width && y < self.height;
        inside.then(|| self.color[(y * self.width + x) as usize])
    }

    /// Writes a PNG file, completely or not at all.
    ///
    /// # Errors
    /// [`ViewError::File`].
    pub fn save(&self, file: &Path) -> Result<(), ViewError> {
        let failed = |reason: &dyn std::fmt::Display| ViewError::File {
            file: file.display().to_string(),
            reason: reason.to_string(),
        };
        let mut bytes = Vec::new();
        let mut encoder = png::Encoder::new(&mut bytes, self.width, self.height);
        encoder.set_color(png::ColorType::Rgba);
        encoder.set_depth(png::BitDepth::Eight);
        encoder.set_source_srgb(png::SrgbRenderingIntent::Perceptual);
        let mut writer = encoder.write_header().map_err(|error| failed(&error))?;
        writer.write_image_data(self.color.as_flattened()).map_err(|error| failed(&error))?;
        writer.finish().map_err(|error| failed(&error))?;
        let name = file.file_name().ok_or_else(|| failed(&"it has no name"))?;
        let mut partial = name.to_owned();
        partial.push(".part");
        let partial = file.with_file_name(partial);
        std::fs::write(&partial, &bytes).map_err(|error| failed(&error))?;
        std::fs::rename(&partial, file).map_err(|error| failed(&error))
    }
}

impl Probe {
    /// The entity at a pixel.
    pub fn entity(&self, x: u32, y: u32) -> Option<Entity> {
        let inside = x < self.width && y < self.height;
        let number = inside.then(|| self.numbers[(y * self.width + x) as usize])?;
        self.entities.get(number.checked_sub(1)? as usize).copied()
    }
}
