//! The edit map: burns, blood and cuts, painted into an image in texture space as the Model's state changes.
//!
//! Burns and blood are a function of the state alone: each texel belongs to one triangle ([`Atlas`]) and interpolates
//! the values of its corners. So a triangle is repainted only when one of its vertices changed, no other texels change
//! with it, and a viewer that starts late shows the same. Cuts are the exception: they are detected by comparing
//! consecutive topologies, and stay.

mod atlas;
mod cuts;
pub mod damage;
mod scalar_map;
mod vertex_painter;

use nalgebra::Vector2;
use thiserror::Error;

pub use atlas::Atlas;
pub use cuts::CutFinder;
pub use scalar_map::ScalarMap;

use crate::texture::Image8;
use crate::texture::image8::byte;
use vertex_painter::VertexPainter;

/// Largest width and height of a map \[texels\].
pub const SIZE_MAX: u32 = 4096;
/// A texel where nothing has happened: no burn, no blood, no cut, full gloss.
pub const UNTOUCHED: [u8; 4] = [0, 0, 0, 255];
/// Default width of the line that marks the edge of a cut \[texels\].
pub const CUT_WIDTH: f32 = 2.5;

/// An invalid size of a map.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
#[error("a map of {width} × {height} texels is not possible; valid are 1 to {SIZE_MAX} each way")]
pub struct MapSizeError {
    /// The requested width \[texels\].
    pub width: u32,
    /// The requested height \[texels\].
    pub height: u32,
}

impl MapSizeError {
    fn check(width: u32, height: u32) -> Result<(), Self> {
        let valid = 1..=SIZE_MAX;
        if valid.contains(&width) && valid.contains(&height) { Ok(()) } else { Err(Self { width, height }) }
    }
}

/// Texels that changed, so that only they are uploaded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct DirtyRect {
    /// First column.
    pub x: u32,
    /// First row.
    pub y: u32,
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
}

impl DirtyRect {
    /// The bounding rectangle of two.
    pub fn union(a: Option<Self>, b: Option<Self>) -> Option<Self> {
        let (Some(a), Some(b)) = (a, b) else { return a.or(b) };
        let (x, y) = (a.x.min(b.x), a.y.min(b.y));
        let right = (a.x + a.width).max(b.x + b.width);
        let lower = (a.y + a.height).max(b.y + b.height);
        Some(Self { x, y, width: right - x, height: lower - y })
    }
}

/// The state of a surface's vertices. A vertex beyond the end of a list keeps what the map showed at its place when the
/// topology last changed, since a cut creates vertices before their state is known; without a list nothing has
/// happened.
#[derive(Clone, Copy, Debug, Default)]
pub struct SurfaceState<'a> {
    /// Arrhenius integral per vertex (`Burn::omega`).
    pub omega: Option<&'a [f64]>,
    /// Amount of blood on each vertex, in \[0, 1\].
    pub blood: Option<&'a [f64]>,
}

/// The edit map of one entity: R burn ([`damage::encoded`]), G blood, B cut, A remaining gloss.
#[derive(Clone, Debug)]
pub struct EditMap {
    image: Image8,
    /// The initial image, if not [`UNTOUCHED`].
    base: Option<Image8>,
    /// Damage, blood, gloss.
    vertex_painter: VertexPainter<3>,
    /// What the map showed at the vertices when the topology last changed.
    inherited: Vec<[f32; 3]>,
    cuts: CutFinder,
    cut_width: f32,
}

impl EditMap {
    /// A map of an intact surface.
    ///
    /// # Errors
    /// When there is no texel, or more than [`SIZE_MAX`] each way.
    pub fn new(width: u32, height: u32) -> Result<Self, MapSizeError> {
        MapSizeError::check(width, height)?;
        Ok(Self {
            image: Image8::filled(width, height, UNTOUCHED),
            base: None,
            vertex_painter: VertexPainter::new(width, height),
            inherited: Vec::new(),
            cuts: CutFinder::default(),
            cut_width: CUT_WIDTH,
        })
    }

    /// A map that starts from an image (a material's `edit_map`), to which painting adds.
    ///
    /// # Errors
    /// As [`EditMap::new`]; also when the image has fewer or more texels than its size says.
    pub fn with_base(base: Image8) -> Result<Self, MapSizeError> {
        let mut map = Self::new(base.width, base.height)?;
        if base.pixels.len() != map.image.pixels.len() {
            return Err(MapSizeError { width: base.width, height: base.height });
        }
        map.image.pixels.clone_from(&base.pixels);
        map.base = Some(base);
        Ok(map)
    }

    /// Sets the width of the line that marks a cut \[texels\], 0 for none.
    pub fn with_cut_width(mut self, width: f32) -> Self {
        self.cut_width = width.clamp(0.0, 64.0);
        self
    }

    /// The image.
    pub fn image(&self) -> &Image8 {
        &self.image
    }

    /// Texels inside more than one triangle (see [`Atlas::shared`]).
    pub fn shared(&self) -> usize {
        self.vertex_painter.atlas().shared()
    }

    /// Takes a topology: triangles, and the texture coordinate of each vertex. The next state repaints everything;
    /// edges that have become a border since the last topology are marked as cut.
    pub fn set_surface(&mut self, triangles: &[[u32; 3]], uv: &[Vector2<f64>]) {
        let inherited = uv.iter().map(|at| {
            let [damage, blood, _, gloss] = self.sample(*at);
            [damage, blood, gloss]
        });
        self.inherited = inherited.collect();
        self.vertex_painter.set_surface(triangles, uv);
        for (texel, pixel) in self.image.pixels.iter_mut().enumerate() {
            let base = self.base.as_ref().map_or(UNTOUCHED, |base| base.pixels[texel]);
            *pixel = [base[0], base[1], pixel[2], base[3]];
        }
        let width = self.cut_width;
        let mut cuts = std::mem::take(&mut self.cuts);
        for edge in cuts.update(triangles, uv) {
            // The next state uploads the whole map.
            self.mark_cut(edge, width);
        }
        self.cuts = cuts;
    }

    /// Paints a state; returns the texels to be uploaded, `None` when nothing changed.
    pub fn paint(&mut self, state: &SurfaceState) -> Option<DirtyRect> {
        let inherited = &self.inherited;
        let value = |vertex: usize| {
            let kept = inherited.get(vertex).copied().unwrap_or([0.0, 0.0, 1.0]);
            let (damage, gloss) = match state.omega.map(|omega| omega.get(vertex)) {
                None => (0.0, 1.0),
                Some(None) => (kept[0], kept[2]),
                Some(Some(omega)) => (damage::encoded(*omega), damage::gloss(*omega)),
            };
            let blood = match state.blood.map(|blood| blood.get(vertex)) {
                None => 0.0,
                Some(None) => kept[1],
                Some(Some(blood)) => *blood as f32,
            };
            [damage, blood, gloss]
        };
        let (image, base) = (&mut self.image, self.base.as_ref());
        self.vertex_painter.paint(value, |texel, [damage, blood, gloss]| {
            let below = base.map_or(UNTOUCHED, |base| base.pixels[texel]);
            let pixel = &mut image.pixels[texel];
            pixel[0] = below[0].max(byte(damage));
            pixel[1] = below[1].max(byte(blood));
            pixel[3] = below[3].min(byte(gloss));
        })
    }

    /// Marks a line in texture space as cut, `width` texels wide with a soft edge; returns the texels to be uploaded.
    pub fn mark_cut(&mut self, polyline: &[Vector2<f64>], width: f32) -> Option<DirtyRect> {
        if width.is_nan() || width <= 0.0 {
            return None;
        }
        let (columns, rows) = (self.image.width, self.image.height);
        let size = Vector2::new(f64::from(columns), f64::from(rows));
        let reach = f64::from(width.min(64.0)) / 2.0 + 0.5;
        let mut dirty = None;
        for pair in polyline.windows(2) {
            let [a, b] = [pair[0].component_mul(&size), pair[1].component_mul(&size)];
            let along = b - a;
            if !(a.norm().is_finite() && b.norm().is_finite() && along.norm_squared().is_finite()) {
                continue;
            }
            let range = |low: f64, high: f64, count: u32| {
                let first = (low - reach).max(0.0) as u32;
                first..((high + reach).max(0.0).ceil() as u32).min(count)
            };
            for y in range(a.y.min(b.y), a.y.max(b.y), rows) {
                let row = f64::from(y) + 0.5;
                let (from, to) = cuts::span_between(a, b, row - reach, row + reach);
                for x in range(from, to, columns) {
                    let center = Vector2::new(f64::from(x) + 0.5, row);
                    let length = along.norm_squared();
                    let share =
                        if length > 0.0 { ((center - a).dot(&along) / length).clamp(0.0, 1.0) } else { 0.0 };
                    let covered = (reach - (center - a - along * share).norm()).clamp(0.0, 1.0);
                    let value = byte(covered as f32);
                    let pixel = &mut self.image.pixels[y as usize * columns as usize + x as usize];
                    if value > pixel[2] {
                        pixel[2] = value;
                        dirty = DirtyRect::union(dirty, Some(DirtyRect { x, y, width: 1, height: 1 }));
                    }
                }
            }
        }
        dirty
    }

    /// A shader's sample at a texture coordinate (bilinear, clamped at the border), as fractions.
    pub fn sample(&self, uv: Vector2<f64>) -> [f32; 4] {
        let axis = |x: f64, count: u32| {
            // `max` first: it turns NaN into 0.
            let x = (x * f64::from(count) - 0.5).max(0.0).min(f64::from(count - 1));
            let first = x as u32;
            (first, (first + 1).min(count - 1), (x - f64::from(first)) as f32)
        };
        let (x0, x1, fx) = axis(uv.x, self.image.width);
        let (y0, y1, fy) = axis(uv.y, self.image.height);
        let texel = |x: u32, y: u32| {
            self.image.pixels[y as usize * self.image.width as usize + x as usize]
                .map(|c| f32::from(c) / 255.0)
        };
        let (a, b, c, d) = (texel(x0, y0), texel(x1, y0), texel(x0, y1), texel(x1, y1));
        std::array::from_fn(|k| {
            (a[k] * (1.0 - fx) + b[k] * fx) * (1.0 - fy) + (c[k] * (1.0 - fx) + d[k] * fx) * fy
        })
    }
}

#[cfg(test)]
mod tests;
