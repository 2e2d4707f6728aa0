//! Images of eight bits per channel, and their mip chains.

use std::sync::LazyLock;

/// An image, row by row from its upper edge.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Image8 {
    /// Texels in a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// `width × height` texels of four channels.
    pub pixels: Vec<[u8; 4]>,
}

/// The meaning of an image's channels, which decides how texels are averaged.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MapKind {
    /// sRGB colour with linear opacity: averaged in linear light, weighted by opacity.
    Color,
    /// A unit vector in RGB (0 to 255 for −1 to 1) and a linear value in A: vectors are added and normalised.
    Normal,
    /// Four linear values.
    Linear,
}

/// Linear light of each sRGB value (IEC 61966-2-1).
static LINEAR_OF_SRGB: LazyLock<[f32; 256]> = LazyLock::new(|| {
    std::array::from_fn(|value| {
        let encoded = value as f64 / 255.0;
        let linear = if encoded <= 0.04045 { encoded / 12.92 } else { ((encoded + 0.055) / 1.055).powf(2.4) };
        linear as f32
    })
});

/// Linear light of an sRGB value.
pub fn linear_of_srgb(value: u8) -> f32 {
    LINEAR_OF_SRGB[value as usize]
}

/// The sRGB value of a linear light, rounded to the nearest.
pub fn srgb_of_linear(linear: f32) -> u8 {
    let lights = &*LINEAR_OF_SRGB;
    let above = lights.partition_point(|light| *light < linear).min(255);
    let below = above.saturating_sub(1);
    if linear - lights[below] < lights[above] - linear { below as u8 } else { above as u8 }
}

/// A fraction as a byte, rounded and clamped.
pub fn byte(fraction: f32) -> u8 {
    (fraction * 255.0 + 0.5) as u8
}

/// A unit vector in three bytes, 128 for 0.
pub fn encode_normal(normal: [f32; 3]) -> [u8; 3] {
    normal.map(|x| (x * 127.0 + 128.5) as u8)
}

/// The vector of three bytes, not normalised; 128 counts as 0, so that a flat texel is exactly flat.
pub fn decode_normal([x, y, z, _]: [u8; 4]) -> [f32; 3] {
    [x, y, z].map(|byte| ((f32::from(byte) - 128.0) / 127.0).max(-1.0))
}

impl Image8 {
    /// An image of one colour.
    pub fn filled(width: u32, height: u32, pixel: [u8; 4]) -> Self {
        Self { width, height, pixels: vec![pixel; width as usize * height as usize] }
    }

    /// The texel in a column and a row, if there is one.
    pub fn get(&self, x: u32, y: u32) -> Option<[u8; 4]> {
        if x >= self.width {
            return None;
        }
        self.pixels.get(y as usize * self.width as usize + x as usize).copied()
    }

    /// The texels as bytes, four each.
    pub fn bytes(&self) -> &[u8] {
        self.pixels.as_flattened()
    }

    /// The image followed by its mip levels, each half the size (rounded down), down to a single texel.
    pub fn mips(self, kind: MapKind) -> Vec<Image8> {
        let mut chain = vec![self];
        while let Some(last) = chain.last().filter(|last| last.width > 1 || last.height > 1) {
            let smaller = last.half(kind);
            chain.push(smaller);
        }
        chain
    }

    /// An image of half the size, rounded down, at least one texel. Each texel averages exactly the area that it
    /// covers: two texels each way, three where the size is odd (Guthe, Heckbert 2005).
    pub fn half(&self, kind: MapKind) -> Image8 {
        if self.width == 0 || self.height == 0 {
            return self.clone();
        }
        let (width, height) = ((self.width / 2).max(1), (self.height / 2).max(1));
        let mut pixels = Vec::with_capacity(width as usize * height as usize);
        for y in 0..height {
            let (first_row, row_weights) = taps(self.height, height, y);
            for x in 0..width {
                let (first_column, column_weights) = taps(self.width, width, x);
                let mut sum = [0.0f32; 4];
                let mut plain = [0.0f32; 3];
                for (j, row_weight) in row_weights.into_iter().enumerate().filter(|(_, weight)| *weight > 0.0)
                {
                    let start = (first_row + j) * self.width as usize + first_column;
                    for (i, column_weight) in column_weights.into_iter().enumerate() {
                        if column_weight > 0.0 {
                            accumulate(
                                kind,
                                self.pixels[start + i],
                                row_weight * column_weight,
                                &mut sum,
                                &mut plain,
                            );
                        }
                    }
                }
                pixels.push(resolve(kind, sum, plain));
            }
        }
        Image8 { width, height, pixels }
    }
}

/// The first texel, and the weights of up to three, of a row of `from` that texel `index` of a row of `to` covers.
fn taps(from: u32, to: u32, index: u32) -> (usize, [f32; 3]) {
    if from == to {
        return (index as usize, [1.0, 0.0, 0.0]);
    }
    let scale = f64::from(from) / f64::from(to);
    let (start, end) = (f64::from(index) * scale, f64::from(index + 1) * scale);
    let first = 2 * index;
    let covered = |texel: u32| (end.min(f64::from(texel) + 1.0) - start.max(f64::from(texel))).max(0.0);
    let weight = |k: u32| if first + k < from { (covered(first + k) / scale) as f32 } else { 0.0 };
    (first as usize, [weight(0), weight(1), weight(2)])
}

fn accumulate(kind: MapKind, pixel: [u8; 4], weight: f32, sum: &mut [f32; 4], plain: &mut [f32; 3]) {
    let alpha = f32::from(pixel[3]) / 255.0;
    let values = match kind {
        MapKind::Color => {
            let light = [pixel[0], pixel[1], pixel[2]].map(linear_of_srgb);
            (0..3).for_each(|c| plain[c] += weight * light[c]);
            light.map(|c| c * alpha)
        }
        MapKind::Normal => decode_normal(pixel),
        MapKind::Linear => [pixel[0], pixel[1], pixel[2]].map(|c| f32::from(c) / 255.0),
    };
    (0..3).for_each(|c| sum[c] += weight * values[c]);
    sum[3] += weight * alpha;
}

fn resolve(kind: MapKind, sum: [f32; 4], plain: [f32; 3]) -> [u8; 4] {
    let [r, g, b, alpha] = sum;
    let rgb = match kind {
        // Where all is transparent, the colour is still the mean: magnified edges must not turn black.
        MapKind::Color if alpha > 0.0 => [r / alpha, g / alpha, b / alpha].map(srgb_of_linear),
        MapKind::Color => plain.map(srgb_of_linear),
        MapKind::Normal => {
            let length = (r * r + g * g + b * b).sqrt();
            let unit = if length > 1e-6 { [r / length, g / length, b / length] } else { [0.0, 0.0, 1.0] };
            encode_normal(unit)
        }
        MapKind::Linear => [r, g, b].map(byte),
    };
    [rgb[0], rgb[1], rgb[2], byte(alpha)]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_srgb_value_survives_linear_light() {
        for value in 0..=255u8 {
            assert_eq!(srgb_of_linear(linear_of_srgb(value)), value);
        }
        assert_eq!(
            [srgb_of_linear(-1.0), srgb_of_linear(0.0), srgb_of_linear(1.0), srgb_of_linear(9.0)],
            [0, 0, 255, 255]
        );
        assert_eq!(srgb_of_linear(0.5), 188);
    }

    #[test]
    fn black_and_white_average_to_half_the_light() {
        let mut checker = Image8::filled(2, 2, [0, 0, 0, 255]);
        checker.pixels[0] = [255; 4];
        checker.pixels[3] = [255; 4];
        assert_eq!(checker.clone().mips(MapKind::Color)[1].pixels, [[188, 188, 188, 255]]);
        assert_eq!(checker.mips(MapKind::Linear)[1].pixels, [[128, 128, 128, 255]]);
    }

    #[test]
    fn a_transparent_texel_does_not_tint_its_neighbours() {
        let image = Image8 { width: 2, height: 1, pixels: vec![[255, 0, 0, 255], [0, 255, 0, 0]] };
        assert_eq!(image.half(MapKind::Color).pixels, [[255, 0, 0, 128]]);
        let clear = Image8 { width: 2, height: 1, pixels: vec![[255, 0, 0, 0], [255, 0, 0, 0]] };
        assert_eq!(clear.half(MapKind::Color).pixels, [[255, 0, 0, 0]]);
    }

    #[test]
    fn chains_end_in_one_texel_whatever_the_size_and_keep_the_mean() {
        for (width, height) in [(1, 1), (8, 8), (7, 5), (1, 9), (33, 2), (640, 3)] {
            let mut image = Image8::filled(width, height, [0; 4]);
            for (index, pixel) in image.pixels.iter_mut().enumerate() {
                *pixel = [(index * 37 % 256) as u8, (index % 256) as u8, 90, 255];
            }
            let mean = |image: &Image8, c: usize| {
                image.pixels.iter().map(|p| f64::from(p[c])).sum::<f64>() / image.pixels.len() as f64
            };
            let chain = image.mips(MapKind::Linear);
            assert_eq!(chain.len(), 1 + width.max(height).ilog2() as usize);
            for pair in chain.windows(2) {
                assert_eq!(pair[1].width, (pair[0].width / 2).max(1));
                assert_eq!(pair[1].height, (pair[0].height / 2).max(1));
                assert_eq!(pair[1].pixels.len(), (pair[1].width * pair[1].height) as usize);
                for c in 0..4 {
                    assert!(
                        (mean(&pair[0], c) - mean(&pair[1], c)).abs() < 0.6,
                        "{width}×{height}, channel {c}"
                    );
                }
            }
        }
        assert_eq!(Image8::default().mips(MapKind::Color).len(), 1);
    }

    #[test]
    fn averaged_normals_are_unit_vectors_and_flat_stays_flat() {
        let flat = Image8::filled(4, 4, [128, 128, 255, 77]);
        assert!(
            flat.mips(MapKind::Normal)
                .iter()
                .all(|level| level.pixels.iter().all(|p| *p == [128, 128, 255, 77]))
        );
        let slope = |x: f32| {
            let [r, g, b] = encode_normal([x, 0.0, (1.0 - x * x).sqrt()]);
            [r, g, b, 0]
        };
        let image = Image8 { width: 2, height: 1, pixels: vec![slope(0.8), slope(-0.2)] };
        let [x, y, z] = decode_normal(image.half(MapKind::Normal).pixels[0]);
        assert!(((x * x + y * y + z * z).sqrt() - 1.0).abs() < 0.01);
        assert!(x > 0.3 && x < 0.42 && y.abs() < 0.01);
        let opposed = Image8 { width: 2, height: 1, pixels: vec![slope(1.0), slope(-1.0)] };
        let [_, _, z] = decode_normal(opposed.half(MapKind::Normal).pixels[0]);
        assert!(z > 0.99);
    }
}
