//! Assembles a procedural texture from a painter's values per texel.

use trocar_scene::random::seed_of;

use super::image8::{Image8, byte};
use super::relief;

/// The maps of one texture. All have the same size and tile without a seam.
#[derive(Clone, Debug, PartialEq)]
pub struct MapSet {
    /// sRGB colour; A is opacity (linear).
    pub color: Image8,
    /// Unit normal in tangent space (128 is 0; +x to the right, +y to the picture's upper edge, as OpenGL and glTF
    /// have it); A is the height for relief mapping, 0 the deepest and 255 the highest.
    pub normal: Image8,
    /// R roughness, G wetness, B metalness, A openness to ambient light (ambient occlusion); linear.
    pub surface: Image8,
    /// Physical width of the tile \[m\].
    pub tile: f32,
    /// Height that separates 0 and 255 in the normal map's A \[m\].
    pub relief: f32,
}

/// A painter's values at one point.
#[derive(Clone, Copy, Debug)]
pub(super) struct Texel {
    /// sRGB.
    pub color: [f32; 3],
    /// Opacity, 0 to 1.
    pub alpha: f32,
    /// In \[0, 1\].
    pub height: f32,
    pub roughness: f32,
    pub wetness: f32,
    pub metalness: f32,
}

/// The size and seed of a texture.
#[derive(Clone, Copy, Debug)]
pub(super) struct Canvas {
    /// Width and height \[texels\].
    pub size: u32,
    /// Differs from texture to texture.
    pub seed: u64,
}

impl Canvas {
    /// A seed for the `index`-th lattice of a texture.
    pub fn seed(&self, index: u64) -> u64 {
        self.seed ^ index.wrapping_mul(0x2545_f491_4f6c_dd1d)
    }

    /// The texel at a point of the unit square.
    pub fn index(&self, u: f32, v: f32) -> usize {
        let coordinate = |x: f32| ((x * self.size as f32) as u32).min(self.size - 1) as usize;
        coordinate(v) * self.size as usize + coordinate(u)
    }
}

/// Computes a texture's values at a point of the unit square.
pub(super) type TexelPainter = Box<dyn Fn(f32, f32) -> Texel>;

/// The recipe of a texture.
pub(super) struct Recipe {
    pub name: &'static str,
    /// Width of the tile \[m\].
    pub tile: f32,
    /// Height of the relief \[m\].
    pub relief: f32,
    /// Smallest size at which its details are drawn; smaller ones are downsampled from it.
    pub drawn_min: u32,
    pub painter: fn(&Canvas) -> TexelPainter,
}

impl Recipe {
    pub fn make(&self, size: u32) -> MapSet {
        let paint = (self.painter)(&Canvas { size, seed: seed_of(self.name) });
        let texels = size as usize * size as usize;
        let mut color = Vec::with_capacity(texels);
        let mut surface = Vec::with_capacity(texels);
        let mut heights = Vec::with_capacity(texels);
        for row in 0..size {
            let v = (row as f32 + 0.5) / size as f32;
            for column in 0..size {
                let texel = paint((column as f32 + 0.5) / size as f32, v);
                let [r, g, b] = texel.color.map(byte);
                color.push([r, g, b, byte(texel.alpha)]);
                surface.push([byte(texel.roughness), byte(texel.wetness), byte(texel.metalness), 255]);
                heights.push(texel.height.clamp(0.0, 1.0));
            }
        }
        // Almost flat relief causes no occlusion, however its heights fill the range.
        let steepness = self.relief / self.tile;
        let open = relief::openness(&heights, size, (80.0 * steepness).min(2.5));
        surface.iter_mut().zip(open).for_each(|(texel, open)| texel[3] = byte(open));
        let normals = relief::normals(&heights, size, steepness);
        let normal =
            normals.iter().zip(&heights).map(|([x, y, z], height)| [*x, *y, *z, byte(*height)]).collect();
        let image = |pixels| Image8 { width: size, height: size, pixels };
        MapSet {
            color: image(color),
            normal: image(normal),
            surface: image(surface),
            tile: self.tile,
            relief: self.relief,
        }
    }
}
