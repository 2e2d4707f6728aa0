//! Normals and ambient occlusion from heights.

use super::image8::encode_normal;

/// Tangent-space normals (OpenGL's convention: +x to the right, +y to the picture's upper edge) of a square of
/// heights that tiles, by central differences; `steepness` is the height of 1 in widths of the tile.
pub fn normals(heights: &[f32], size: u32, steepness: f32) -> Vec<[u8; 3]> {
    let n = size as usize;
    let scale = 0.5 * steepness * size as f32;
    let mut normals = Vec::with_capacity(heights.len());
    for y in 0..n {
        let row = &heights[y * n..(y + 1) * n];
        let above = &heights[(y + n - 1) % n * n..][..n];
        let below = &heights[(y + 1) % n * n..][..n];
        for x in 0..n {
            let right = if x + 1 == n { row[0] } else { row[x + 1] };
            let left = if x == 0 { row[n - 1] } else { row[x - 1] };
            let (dx, dy) = ((right - left) * scale, (above[x] - below[x]) * scale);
            let length = (dx * dx + dy * dy + 1.0).sqrt();
            normals.push(encode_normal([-dx / length, -dy / length, 1.0 / length]));
        }
    }
    normals
}

/// A tiling square after two box filters of `2·radius + 1` texels: close to a Gaussian, at a cost that does not depend
/// on the radius.
pub fn blurred(values: &[f32], size: u32, radius: u32) -> Vec<f32> {
    let (n, radius) = (size as usize, (radius as usize).min((size as usize - 1) / 2));
    let mut current = values.to_vec();
    let mut next = vec![0.0; values.len()];
    let share = 1.0 / (2 * radius + 1) as f32;
    for _ in 0..2 {
        for row in 0..n {
            let line = &current[row * n..(row + 1) * n];
            let mut sum: f32 = (0..=2 * radius).map(|k| line[(n + k - radius) % n]).sum();
            for x in 0..n {
                next[row * n + x] = sum * share;
                sum += line[(x + radius + 1) % n] - line[(x + n - radius) % n];
            }
        }
        // Down the columns, one row at a time, so that memory is accessed in order.
        let mut sums = vec![0.0f32; n];
        for k in 0..=2 * radius {
            let line = &next[(n + k - radius) % n * n..][..n];
            sums.iter_mut().zip(line).for_each(|(sum, value)| *sum += value);
        }
        for y in 0..n {
            let (entering, leaving) = ((y + radius + 1) % n * n, (y + n - radius) % n * n);
            for x in 0..n {
                current[y * n + x] = sums[x] * share;
                sums[x] += next[entering + x] - next[leaving + x];
            }
        }
    }
    current
}

/// Openness to ambient light of each texel, in \[0, 1\]: lower where it lies below its surroundings (a "cavity map").
/// `strength` is the loss at a depth of 1.
pub fn openness(heights: &[f32], size: u32, strength: f32) -> Vec<f32> {
    let surroundings = blurred(heights, size, (size / 48).max(1));
    heights
        .iter()
        .zip(&surroundings)
        .map(|(own, mean)| (1.0 - strength * (mean - own).max(0.0)).clamp(0.0, 1.0))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::super::image8::decode_normal;
    use super::super::noise::wave;
    use super::*;

    #[test]
    fn a_ramp_leans_against_its_slope() {
        let size = 64;
        let heights: Vec<f32> =
            (0..size * size).map(|i| wave((i % size) as f32 / size as f32 + 0.001)).collect();
        let found = normals(&heights, size, 0.1);
        // Rising to the right at the left edge: the normal leans to the left, by the slope 0.1 · 8 of the parabola.
        let [x, y, z] = decode_normal([found[0][0], found[0][1], found[0][2], 0]);
        assert!(y.abs() < 0.01 && (-x / z - 0.8).abs() < 0.05, "{x} {y} {z}");
        let turned: Vec<f32> =
            (0..size * size).map(|i| wave((i / size) as f32 / size as f32 + 0.001)).collect();
        // Rising downwards: it leans to the upper edge, which is +y.
        let found = normals(&turned, size, 0.1);
        let [x, y, z] = decode_normal([found[0][0], found[0][1], found[0][2], 0]);
        assert!(x.abs() < 0.01 && (y / z - 0.8).abs() < 0.05, "{x} {y} {z}");
    }

    #[test]
    fn blurring_keeps_the_mean_and_wraps() {
        let size = 32;
        let mut values = vec![0.0; 1024];
        values[0] = 1.0;
        let soft = blurred(&values, size, 3);
        assert!((soft.iter().sum::<f32>() - 1.0).abs() < 1e-4);
        assert!(
            (soft[1] - soft[31]).abs() < 1e-6 && (soft[32] - soft[31 * 32]).abs() < 1e-6 && soft[31] > 0.0
        );
        assert!(blurred(&[2.0; 16], 4, 50).iter().all(|x| (x - 2.0).abs() < 1e-6));
    }

    #[test]
    fn hollows_are_darker_than_plains() {
        let size = 64;
        let mut heights = vec![1.0; 64 * 64];
        heights[20 * 64 + 20] = 0.0;
        let open = openness(&heights, size, 2.0);
        assert!(open[20 * 64 + 20] < 0.1 && open[0] > 0.999 && open[20 * 64 + 21] > 0.999);
    }
}
