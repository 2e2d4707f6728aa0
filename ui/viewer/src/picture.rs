//! Pictures in memory.

use std::path::Path;

use trocar_scene::Entity;
use trocar_scene::output_file::{self, Replace};

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

    /// Whether a picture can have this name: one that ends in `.png`, or has no ending, as FIFOs and devices do.
    ///
    /// # Errors
    /// [`ViewError::File`] with what is valid.
    pub fn check_name(file: &Path) -> Result<(), ViewError> {
        match file.extension().and_then(|ending| ending.to_str()) {
            Some(ending) if !ending.eq_ignore_ascii_case("png") => {
                let reason = format!("'.{ending}' is no picture that can be written; valid is .png");
                Err(ViewError::File { file: file.display().to_string(), reason })
            }
            _ => Ok(()),
        }
    }

    /// Writes a PNG file, completely or not at all, in the place of an earlier one.
    ///
    /// # Errors
    /// [`ViewError::File`].
    pub fn save(&self, file: &Path) -> Result<(), ViewError> {
        Self::check_name(file)?;
        Ok(output_file::write(file, &self.png()?, Replace::Writable)?)
    }

    /// The picture as a PNG file.
    ///
    /// # Errors
    /// [`ViewError::File`] for a picture without pixels.
    pub fn png(&self) -> Result<Vec<u8>, ViewError> {
        let failed = |reason: &dyn std::fmt::Display| ViewError::File {
            file: "the picture".to_owned(),
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
        Ok(bytes)
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
