//! Periodic noise on the unit square: gradient noise (Perlin, "Improving noise", 2002), cellular noise (Worley,
//! "A cellular texture basis function", 1996) and fractal sums of the former.
//!
//! All functions here have period 1 in both directions, so that textures computed from them tile without a seam. They
//! use only `+ − × ÷ √` and rounding: the same seed gives the same bits on every machine.

use trocar_scene::random::SplitMix64;

/// `x − ⌊x⌋`, in \[0, 1).
pub fn wrap(x: f32) -> f32 {
    // Via an integer: without SSE 4.1, `floor` is a call into the C library.
    let fraction = x - x as i32 as f32;
    let fraction = if fraction < 0.0 { fraction + 1.0 } else { fraction };
    if fraction < 1.0 { fraction } else { 0.0 }
}

/// Difference of two coordinates on the circle of length 1, in \[−0.5, 0.5\].
pub fn wrapped_difference(a: f32, b: f32) -> f32 {
    let difference = a - b;
    difference - difference.round()
}

/// 0 below `low`, 1 above `high`, a cubic between them.
pub fn smoothstep(low: f32, high: f32, x: f32) -> f32 {
    let t = ((x - low) / (high - low)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

/// `a` at 0, `b` at 1.
pub fn lerp(a: f32, b: f32, t: f32) -> f32 {
    a + (b - a) * t
}

/// A colour between two.
pub fn mix(a: [f32; 3], b: [f32; 3], t: f32) -> [f32; 3] {
    [lerp(a[0], b[0], t), lerp(a[1], b[1], t), lerp(a[2], b[2], t)]
}

/// A wave of period 1 between −1 and 1, 0 at 0, shaped like a sine (within 0.06; two parabolas).
pub fn wave(x: f32) -> f32 {
    let t = wrap(x) * 2.0;
    if t < 1.0 { 4.0 * t * (1.0 - t) } else { -4.0 * (t - 1.0) * (2.0 - t) }
}

/// Lattice cell left of a coordinate, the one right of it, and the fraction between them.
fn cell(x: f32, cells: u32) -> (usize, usize, f32) {
    let scaled = wrap(x) * cells as f32;
    let left = (scaled as u32).min(cells - 1);
    let right = if left + 1 == cells { 0 } else { left + 1 };
    (left as usize, right as usize, scaled - left as f32)
}

/// Improved gradient noise with a period.
#[derive(Clone, Debug)]
pub struct Perlin {
    cells: [u32; 2],
    /// Origin of the lattice: with a common origin, the lattice lines of all octaves would coincide and show.
    origin: [f32; 2],
    gradients: Vec<[f32; 2]>,
}

impl Perlin {
    /// A lattice of `cells` across the period (at least 1 each way).
    pub fn new(seed: u64, cells: [u32; 2]) -> Self {
        // Sixteen directions all around: with fewer, the lattice shows.
        const DIAGONAL: f32 = std::f32::consts::FRAC_1_SQRT_2;
        const FLAT: f32 = 0.923_879_5;
        const STEEP: f32 = 0.382_683_43;
        const QUARTER: [[f32; 2]; 4] = [[1.0, 0.0], [FLAT, STEEP], [DIAGONAL, DIAGONAL], [STEEP, FLAT]];
        let cells = cells.map(|count| count.max(1));
        let mut random = SplitMix64::new(seed);
        let origin = [random.unit_f32(), random.unit_f32()];
        let gradients = (0..cells[0] as usize * cells[1] as usize)
            .map(|_| {
                let bits = random.next_u64() >> 60;
                let [x, y] = QUARTER[(bits & 3) as usize];
                match bits >> 2 {
                    0 => [x, y],
                    1 => [-y, x],
                    2 => [-x, -y],
                    _ => [y, -x],
                }
            })
            .collect();
        Self { cells, origin, gradients }
    }

    /// The noise at a point, in \[−1, 1\], 0 at lattice points.
    pub fn at(&self, u: f32, v: f32) -> f32 {
        let (left, right, x) = cell(u - self.origin[0], self.cells[0]);
        let (upper, lower, y) = cell(v - self.origin[1], self.cells[1]);
        let columns = self.cells[0] as usize;
        let slope = |row: usize, column: usize, dx: f32, dy: f32| {
            let [gx, gy] = self.gradients[row * columns + column];
            gx * dx + gy * dy
        };
        let fade = |t: f32| t * t * t * (t * (t * 6.0 - 15.0) + 10.0);
        let (fx, fy) = (fade(x), fade(y));
        let top = lerp(slope(upper, left, x, y), slope(upper, right, x - 1.0, y), fx);
        let bottom = lerp(slope(lower, left, x, y - 1.0), slope(lower, right, x - 1.0, y - 1.0), fx);
        // Unit gradients in two dimensions reach √½.
        lerp(top, bottom, fy) * std::f32::consts::SQRT_2
    }
}

impl Perlin {
    /// Adds `strength` times the noise at the centre of each texel of a square of `size × size`: the same as
    /// [`Perlin::at`] there, but several times faster, since the lattice cell rarely changes along a row.
    fn add_to(&self, values: &mut [f32], size: u32, strength: f32) {
        let middle = |index: u32| (index as f32 + 0.5) / size as f32;
        let fade = |t: f32| t * t * t * (t * (t * 6.0 - 15.0) + 10.0);
        let scale = strength * std::f32::consts::SQRT_2;
        let columns: Vec<_> = (0..size).map(|x| cell(middle(x) - self.origin[0], self.cells[0])).collect();
        let offsets: Vec<f32> = columns.iter().map(|column| column.2).collect();
        let fades: Vec<f32> = offsets.iter().map(|x| fade(*x)).collect();
        let count = self.cells[0] as usize;
        for (row, line) in values.chunks_exact_mut(size as usize).enumerate() {
            let (upper, lower, y) = cell(middle(row as u32) - self.origin[1], self.cells[1]);
            let fy = fade(y);
            let mut start = 0;
            for run in columns.chunk_by(|a, b| a.0 == b.0) {
                let (left, right, _) = run[0];
                let corner = |row: usize, column: usize, dx: f32, dy: f32| {
                    let [gx, gy] = self.gradients[row * count + column];
                    // Value at the cell's left edge, and slope along the row.
                    (gx * dx + gy * dy, gx)
                };
                let (a, b) = (corner(upper, left, 0.0, y), corner(upper, right, -1.0, y));
                let (c, d) = (corner(lower, left, 0.0, y - 1.0), corner(lower, right, -1.0, y - 1.0));
                let end = start + run.len();
                let texels = line[start..end].iter_mut().zip(&offsets[start..end]).zip(&fades[start..end]);
                for ((texel, x), fx) in texels {
                    let top = lerp(a.0 + a.1 * x, b.0 + b.1 * x, *fx);
                    let bottom = lerp(c.0 + c.1 * x, d.0 + d.1 * x, *fx);
                    *texel += lerp(top, bottom, fy) * scale;
                }
                start = end;
            }
        }
    }
}

/// Noise at the centre of each texel of a square.
#[derive(Clone, Debug)]
pub struct Field {
    size: u32,
    values: Vec<f32>,
}

impl Field {
    /// The value of the texel that a point of the unit square lies in.
    pub fn at(&self, u: f32, v: f32) -> f32 {
        let coordinate = |x: f32| ((x * self.size as f32) as u32).min(self.size - 1) as usize;
        self.values[coordinate(v) * self.size as usize + coordinate(u)]
    }
}

/// Fractal Brownian motion: octaves of [`Perlin`], each twice as fine as the one before.
#[derive(Clone, Debug)]
pub struct Fbm {
    octaves: Vec<(Perlin, f32)>,
}

impl Fbm {
    /// `octaves` of them, the first with `cells` across, each `gain` times as strong as the one before. Octaves too
    /// fine for an image of `size` texels are left out, since they would only alias.
    pub fn new(seed: u64, cells: [u32; 2], octaves: u32, gain: f32, size: u32) -> Self {
        let mut strength = 1.0;
        let mut kept = Vec::new();
        let mut total = 0.0;
        for octave in 0..octaves.min(16) {
            let scaled = cells.map(|count| count.max(1) << octave);
            total += strength;
            if octave == 0 || scaled[0].max(scaled[1]) * 2 <= size {
                kept.push((Perlin::new(seed ^ (u64::from(octave) << 48), scaled), strength));
            }
            strength *= gain;
        }
        // By the strength of all octaves, so that a coarser image has the same contrast.
        kept.iter_mut().for_each(|(_, strength)| *strength /= total);
        Self { octaves: kept }
    }

    /// The sum of such octaves at every texel of a square, for a single use.
    pub fn field(seed: u64, cells: [u32; 2], octaves: u32, gain: f32, size: u32) -> Field {
        let mut values = vec![0.0; size as usize * size as usize];
        for (noise, strength) in &Self::new(seed, cells, octaves, gain, size).octaves {
            noise.add_to(&mut values, size, *strength);
        }
        Field { size, values }
    }

    /// The sum at a point, in \[−1, 1\].
    pub fn at(&self, u: f32, v: f32) -> f32 {
        self.octaves.iter().map(|(noise, strength)| noise.at(u, v) * strength).sum()
    }
}

/// Cellular noise at a point; distances in cells.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cell {
    /// Distance to the nearest feature point.
    pub nearest: f32,
    /// Distance to the second nearest.
    pub second: f32,
    /// A random fraction in \[0, 1) of the nearest feature point.
    pub value: f32,
}

impl Cell {
    /// 0 on the border between two cells, about 1 in the middle of one.
    pub fn border(&self) -> f32 {
        self.second - self.nearest
    }
}

/// Cellular noise with a period.
#[derive(Clone, Debug)]
pub struct Worley {
    cells: [u32; 2],
    /// Origin of the lattice.
    origin: [f32; 2],
    /// Per cell: its feature point within the cell, and its random value.
    points: Vec<[f32; 3]>,
}

impl Worley {
    /// A lattice of `cells` across the period (at least 3 each way, so that no cell is its own neighbour) with one
    /// feature point each, displaced from the centre by up to `jitter` (0 to 0.35) cells.
    pub fn new(seed: u64, cells: [u32; 2], jitter: f32) -> Self {
        let cells = cells.map(|count| count.max(3));
        let jitter = jitter.clamp(0.0, 0.35);
        let mut random = SplitMix64::new(seed);
        let origin = [random.unit_f32(), random.unit_f32()];
        let points = (0..cells[0] as usize * cells[1] as usize)
            .map(|_| {
                let x = 0.5 + jitter * (2.0 * random.unit_f32() - 1.0);
                let y = 0.5 + jitter * (2.0 * random.unit_f32() - 1.0);
                [x, y, random.unit_f32()]
            })
            .collect();
        Self { cells, origin, points }
    }

    /// The two nearest feature points of a point.
    pub fn at(&self, u: f32, v: f32) -> Cell {
        let (column, next_column, x) = cell(u - self.origin[0], self.cells[0]);
        let (row, next_row, y) = cell(v - self.origin[1], self.cells[1]);
        let before = |index: usize, count: u32| if index == 0 { count as usize - 1 } else { index - 1 };
        let columns = [before(column, self.cells[0]), column, next_column];
        let rows = [before(row, self.cells[1]), row, next_row];
        let mut found = Cell { nearest: f32::MAX, second: f32::MAX, value: 0.0 };
        for (j, row) in rows.into_iter().enumerate() {
            for (i, column) in columns.into_iter().enumerate() {
                let [px, py, value] = self.points[row * self.cells[0] as usize + column];
                let (dx, dy) = (px + i as f32 - 1.0 - x, py + j as f32 - 1.0 - y);
                let distance = dx * dx + dy * dy;
                if distance < found.nearest {
                    found = Cell { nearest: distance, second: found.nearest, value };
                } else if distance < found.second {
                    found.second = distance;
                }
            }
        }
        Cell { nearest: found.nearest.sqrt(), second: found.second.sqrt(), value: found.value }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn points() -> impl Iterator<Item = (f32, f32)> {
        let mut random = SplitMix64::new(7);
        (0..4000).map(move |_| (random.unit_f32(), random.unit_f32()))
    }

    #[test]
    fn gradient_noise_repeats_is_zero_on_the_lattice_and_stays_in_range() {
        let noise = Perlin::new(1, [5, 8]);
        let mut extremes = [0.0f32; 2];
        for (u, v) in points() {
            let value = noise.at(u, v);
            assert!((noise.at(u + 1.0, v - 2.0) - value).abs() < 1e-4);
            extremes = [extremes[0].min(value), extremes[1].max(value)];
        }
        assert!(extremes[0] >= -1.0 && extremes[1] <= 1.0, "{extremes:?}");
        assert!(extremes[0] < -0.4 && extremes[1] > 0.4, "the range is used: {extremes:?}");
        for i in 0..5 {
            for j in 0..8 {
                assert!(
                    noise.at(noise.origin[0] + i as f32 / 5.0, noise.origin[1] + j as f32 / 8.0).abs() < 1e-4
                );
            }
        }
    }

    #[test]
    fn gradient_noise_is_continuous_across_the_seam() {
        let noise = Fbm::new(3, [4, 4], 5, 0.5, 1024);
        for (_, v) in points() {
            assert!((noise.at(0.0, v) - noise.at(0.999_999, v)).abs() < 1e-3);
            assert!((noise.at(v, 0.0) - noise.at(v, 0.999_999)).abs() < 1e-3);
        }
    }

    #[test]
    fn a_field_holds_what_the_noise_is_at_each_texel() {
        let (noise, field) = (Fbm::new(3, [3, 7], 4, 0.5, 64), Fbm::field(3, [3, 7], 4, 0.5, 64));
        for (x, y) in (0..64).flat_map(|y| (0..64).map(move |x| (x, y))) {
            let (u, v) = ((x as f32 + 0.5) / 64.0, (y as f32 + 0.5) / 64.0);
            assert!((noise.at(u, v) - field.at(u, v)).abs() < 1e-5, "({x}, {y})");
        }
        assert_eq!(field.at(1.0, 1.0), field.values[64 * 64 - 1]);
    }

    #[test]
    fn octaves_beyond_the_picture_are_left_out_at_the_same_contrast() {
        let (fine, coarse) = (Fbm::new(3, [4, 4], 6, 0.5, 1024), Fbm::new(3, [4, 4], 6, 0.5, 16));
        assert_eq!((fine.octaves.len(), coarse.octaves.len()), (6, 2));
        assert_eq!(fine.octaves[1].1, coarse.octaves[1].1);
    }

    #[test]
    fn cellular_noise_finds_the_two_nearest_of_all_feature_points() {
        let noise = Worley::new(9, [6, 4], 0.35);
        for (u, v) in points() {
            let mut all: Vec<f32> = Vec::new();
            for (index, [x, y, _]) in noise.points.iter().enumerate() {
                let (column, row) = ((index % 6) as f32, (index / 6) as f32);
                for (shift_x, shift_y) in (-2..=2).flat_map(|a| (-2..=2).map(move |b| (a as f32, b as f32))) {
                    let dx = (column + x) + 6.0 * shift_x - (u - noise.origin[0]) * 6.0;
                    let dy = (row + y) + 4.0 * shift_y - (v - noise.origin[1]) * 4.0;
                    all.push((dx * dx + dy * dy).sqrt());
                }
            }
            all.sort_by(f32::total_cmp);
            let found = noise.at(u, v);
            assert!((found.nearest - all[0]).abs() < 1e-4, "{found:?} {:?}", &all[..2]);
            assert!((found.second - all[1]).abs() < 1e-4, "{found:?} {:?}", &all[..2]);
            let again = noise.at(u - 3.0, v + 1.0);
            assert!((again.nearest - found.nearest).abs() < 1e-4);
        }
    }

    #[test]
    fn coordinates_on_the_seam_do_not_leave_the_lattice() {
        let (perlin, worley) = (Perlin::new(1, [3, 3]), Worley::new(1, [3, 3], 0.3));
        for edge in [-1e-9f32, 1.0, -1.0, 0.999_999_94, f32::MIN_POSITIVE, -f32::MIN_POSITIVE, 1e9] {
            assert!(perlin.at(edge, edge).is_finite());
            assert!(worley.at(edge, edge).nearest.is_finite());
        }
    }

    #[test]
    fn waves_and_steps_have_their_values() {
        assert_eq!([wave(0.0), wave(0.25), wave(0.5), wave(0.75), wave(1.25)], [0.0, 1.0, 0.0, -1.0, 1.0]);
        assert_eq!(
            [smoothstep(1.0, 2.0, 0.0), smoothstep(1.0, 2.0, 1.5), smoothstep(1.0, 2.0, 9.0)],
            [0.0, 0.5, 1.0]
        );
        assert!((wrapped_difference(0.95, 0.05) + 0.1).abs() < 1e-6);
    }
}
