//! Whether a person would take two pictures for the same one.
//!
//! Two measures, pixel by pixel, both in CIE L\*a\*b\* (1976), whose distances are about as large as they look:
//!
//! - *colour*: the distance of the colours after both pictures were blurred as the eye blurs what is fine (S-CIELAB: Zhang,
//!   Wandell, "A spatial extension of CIELAB for digital color-image reproduction", 1997). From 2.3 on a person sees one
//!   (Mahy, Van Eycken, Oosterlinck, 1994).
//! - *structure*: the structural similarity of the lightness around the pixel (SSIM: Wang, Bovik, Sheikh, Simoncelli,
//!   "Image quality assessment: from error visibility to structural similarity", 2004), which sees that a texture moved
//!   where its mean colour stays.
//!
//! Rasterisers round differently: a few pixels at edges go to the other side, levels of maps and powers differ by a step
//! of eight bits. The first is a small share of the picture, the second small everywhere; [`Limits`] leaves room for both
//! and for nothing else.

use trocar_viewer::Picture;

/// Radius of the blur, and of the window in which structure is compared \[pixels, standard deviation\].
const SIGMA: f64 = 1.5;
/// Stabilisers of SSIM: (0.01 × 100)² and (0.03 × 100)² for lightness from 0 to 100.
const STABLE: [f64; 2] = [1.0, 9.0];

/// How different pictures may be that count as the same.
#[derive(Clone, Copy, Debug)]
pub struct Limits {
    /// Distance of colours from which on a pixel is different.
    pub color: f64,
    /// Structural similarity below which a pixel is different.
    pub structure: f64,
    /// Share of the pixels that may be different.
    pub share: f64,
    /// Mean distance of colours over the picture.
    pub mean_color: f64,
    /// Mean structural similarity over the picture.
    pub mean_structure: f64,
}

impl Default for Limits {
    fn default() -> Self {
        Self { color: 2.3, structure: 0.9, share: 1e-3, mean_color: 0.5, mean_structure: 0.98 }
    }
}

/// What is different between two pictures of one size.
#[derive(Clone, Debug)]
pub struct Difference {
    width: u32,
    /// Distance of colours per pixel.
    pub color: Vec<f64>,
    /// Structural similarity per pixel, at most 1.
    pub structure: Vec<f64>,
}

impl Difference {
    /// Compares; `None` for pictures of different sizes.
    pub fn between(a: &Picture, b: &Picture) -> Option<Self> {
        if [a.width, a.height] != [b.width, b.height] || a.color.is_empty() {
            return None;
        }
        let blur = |plane: &[f64]| blurred(plane, a.width as usize);
        let (lab_a, lab_b) = (lab_planes(a), lab_planes(b));
        let means = [&lab_a, &lab_b].map(|planes| [0, 1, 2].map(|part| blur(&planes[part])));
        let distance = |pixel: usize| {
            let squares = (0..3).map(|part| (means[0][part][pixel] - means[1][part][pixel]).powi(2));
            squares.sum::<f64>().sqrt()
        };
        let color = (0..a.color.len()).map(distance).collect();
        let product = |one: &[f64], other: &[f64]| {
            blur(&one.iter().zip(other).map(|(x, y)| x * y).collect::<Vec<f64>>())
        };
        let (light_a, light_b) = (&lab_a[0], &lab_b[0]);
        let (aa, bb, ab) = (product(light_a, light_a), product(light_b, light_b), product(light_a, light_b));
        let similarity = |pixel: usize| {
            let (x, y) = (means[0][0][pixel], means[1][0][pixel]);
            let [c1, c2] = STABLE;
            let luminance = (2.0 * x * y + c1) / (x * x + y * y + c1);
            let (variance_a, variance_b, covariance) =
                (aa[pixel] - x * x, bb[pixel] - y * y, ab[pixel] - x * y);
            luminance * (2.0 * covariance + c2) / (variance_a + variance_b + c2)
        };
        let structure = (0..a.color.len()).map(similarity).collect();
        Some(Self { width: a.width, color, structure })
    }

    /// What of it is beyond the limits, in words; `None` when the pictures count as the same.
    pub fn beyond(&self, limits: &Limits) -> Option<String> {
        let within = self.different(limits) as f64 <= limits.share * self.color.len() as f64
            && mean(&self.color) <= limits.mean_color
            && mean(&self.structure) >= limits.mean_structure;
        (!within).then(|| self.describe(limits))
    }

    /// How much is different, beside the limits.
    pub fn describe(&self, limits: &Limits) -> String {
        format!(
            "{} of {} pixels differ (at most {:.0}); colours are {:.3} apart in the mean (at most {}), {:.2} at the worst; \
             similarity of structure is {:.4} in the mean (at least {}), {:.2} at the worst",
            self.different(limits),
            self.color.len(),
            (limits.share * self.color.len() as f64).floor(),
            mean(&self.color),
            limits.mean_color,
            self.color.iter().copied().fold(0.0, f64::max),
            mean(&self.structure),
            limits.mean_structure,
            self.structure.iter().copied().fold(1.0, f64::min),
        )
    }

    fn different(&self, limits: &Limits) -> usize {
        (0..self.color.len()).filter(|pixel| self.differs(*pixel, limits)).count()
    }

    /// What is different in red over what was expected, in grey and pale.
    pub fn picture(&self, expected: &Picture, limits: &Limits) -> Picture {
        let pixel = |(index, [r, g, b, _]): (usize, &[u8; 4])| {
            let gray = 128 + ((u16::from(*r) + 2 * u16::from(*g) + u16::from(*b)) / 8) as u8;
            let shade = (self.color[index] / limits.color)
                .max((1.0 - self.structure[index]) / (1.0 - limits.structure));
            let pale = (f64::from(gray) * (1.0 - shade.min(1.0))) as u8;
            if self.differs(index, limits) {
                [255, 0, 0, 255]
            } else {
                [gray, pale.max(gray / 2), pale.max(gray / 2), 255]
            }
        };
        let color = expected.color.iter().enumerate().map(pixel).collect();
        Picture { width: self.width, height: expected.height, color }
    }

    fn differs(&self, pixel: usize, limits: &Limits) -> bool {
        self.color[pixel] > limits.color || self.structure[pixel] < limits.structure
    }
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

/// Lightness, red against green, yellow against blue.
fn lab_planes(picture: &Picture) -> [Vec<f64>; 3] {
    let mut planes = [const { Vec::new() }; 3];
    for [r, g, b, _] in &picture.color {
        let lab = lab([*r, *g, *b]);
        planes.iter_mut().zip(lab).for_each(|(plane, part)| plane.push(part));
    }
    planes
}

/// L\*a\*b\* of a colour in sRGB (IEC 61966-2-1), both under D65.
pub fn lab(srgb: [u8; 3]) -> [f64; 3] {
    let [r, g, b] = srgb.map(|part| {
        let part = f64::from(part) / 255.0;
        if part <= 0.04045 { part / 12.92 } else { ((part + 0.055) / 1.055).powf(2.4) }
    });
    let x = (0.4124564 * r + 0.3575761 * g + 0.1804375 * b) / 0.95047;
    let y = 0.2126729 * r + 0.7151522 * g + 0.0721750 * b;
    let z = (0.0193339 * r + 0.1191920 * g + 0.9503041 * b) / 1.08883;
    let [x, y, z] = [x, y, z].map(|part| {
        let knee: f64 = 6.0 / 29.0;
        if part > knee.powi(3) { part.cbrt() } else { part / (3.0 * knee * knee) + 4.0 / 29.0 }
    });
    [116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)]
}

/// A plane blurred by a Gaussian that ends at the picture's edges.
fn blurred(plane: &[f64], width: usize) -> Vec<f64> {
    let height = plane.len() / width;
    let reach = (3.0 * SIGMA).ceil() as usize;
    let weights: Vec<f64> = (0..=reach).map(|step| (-0.5 * (step as f64 / SIGMA).powi(2)).exp()).collect();
    let along = |from: &[f64], count: usize, at: &dyn Fn(usize) -> usize, into: &mut [f64]| {
        for centre in 0..count {
            let (mut sum, mut weight) = (0.0, 0.0);
            for other in centre.saturating_sub(reach)..=(centre + reach).min(count - 1) {
                let share = weights[other.abs_diff(centre)];
                sum += share * from[at(other)];
                weight += share;
            }
            into[at(centre)] = sum / weight;
        }
    };
    let mut rows = vec![0.0; plane.len()];
    (0..height).for_each(|y| along(plane, width, &|x| y * width + x, &mut rows));
    let mut both = vec![0.0; plane.len()];
    (0..width).for_each(|x| along(&rows, height, &|y| y * width + x, &mut both));
    both
}
