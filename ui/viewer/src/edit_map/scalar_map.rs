//! One number per texel, such as the temperature for an overlay.

use nalgebra::Vector2;

use super::vertex_painter::VertexPainter;
use super::{DirtyRect, MapSizeError};

/// A map of one channel: 0 for the lower end of a range, 255 for its upper end.
#[derive(Clone, Debug)]
pub struct ScalarMap {
    width: u32,
    height: u32,
    values: Vec<u8>,
    range: [f64; 2],
    vertex_painter: VertexPainter<1>,
}

impl ScalarMap {
    /// A map of values between `low` and `high`, in any unit, initially at the lower end. The ends of an empty range
    /// count as one apart.
    ///
    /// # Errors
    /// When there is no texel, or more than [`super::SIZE_MAX`] each way.
    pub fn new(width: u32, height: u32, low: f64, high: f64) -> Result<Self, MapSizeError> {
        MapSizeError::check(width, height)?;
        let values = vec![0; width as usize * height as usize];
        let high = if high > low { high } else { low + 1.0 };
        Ok(Self {
            width,
            height,
            values,
            range: [low, high],
            vertex_painter: VertexPainter::new(width, height),
        })
    }

    /// Width and height \[texels\].
    pub fn size(&self) -> [u32; 2] {
        [self.width, self.height]
    }

    /// The texels, row by row.
    pub fn values(&self) -> &[u8] {
        &self.values
    }

    /// The values of 0 and 255.
    pub fn range(&self) -> [f64; 2] {
        self.range
    }

    /// Takes a topology, as [`super::EditMap::set_surface`].
    pub fn set_surface(&mut self, triangles: &[[u32; 3]], uv: &[Vector2<f64>]) {
        self.vertex_painter.set_surface(triangles, uv);
        self.values.fill(0);
    }

    /// Paints one value per vertex; vertices without one are at the lower end. Returns the texels to be uploaded.
    pub fn paint(&mut self, per_vertex: &[f64]) -> Option<DirtyRect> {
        let [low, high] = self.range;
        let value = |vertex: usize| {
            let value = per_vertex.get(vertex).copied().unwrap_or(low);
            [((value - low) / (high - low)) as f32]
        };
        let values = &mut self.values;
        self.vertex_painter.paint(value, |texel, [value]| values[texel] = crate::texture::image8::byte(value))
    }
}
