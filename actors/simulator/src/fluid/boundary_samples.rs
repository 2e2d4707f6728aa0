//! Boundary samples of surfaces, as walls of a liquid: points bound to triangles, which move with them and keep a
//! minimum distance.

use std::collections::BTreeMap;

use nalgebra::{Point3, Vector3};

/// Least distance between samples, in spacings.
const APART: f64 = 0.7;
/// Maximum number of samples along an edge of one triangle.
const DIVISIONS_MAX: f64 = 400.0;

/// A sample point of a surface: a triangle and barycentric weights.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WallSample {
    /// Corners.
    pub nodes: [u32; 3],
    /// Barycentric weights; their sum is 1.
    pub weights: [f64; 3],
}

impl WallSample {
    /// Its position for these vertices.
    #[must_use]
    pub fn place(&self, positions: &[Point3<f64>]) -> Point3<f64> {
        let parts = self.nodes.iter().zip(self.weights);
        Point3::from(
            parts.fold(Vector3::zeros(), |sum, (&node, weight)| {
                sum + positions[node as usize].coords * weight
            }),
        )
    }

    /// Normal of its triangle for these vertices, not normalised \[m²\].
    #[must_use]
    pub fn across(&self, positions: &[Point3<f64>]) -> Vector3<f64> {
        let [a, b, c] = self.nodes.map(|node| positions[node as usize]);
        (b - a).cross(&(c - a))
    }
}

/// Samples of a surface, about a `spacing` \[m\] apart, at most `most`. Triangles with missing corners are skipped.
#[must_use]
pub fn sample(
    positions: &[Point3<f64>],
    triangles: &[[u32; 3]],
    spacing: f64,
    most: usize,
) -> Vec<WallSample> {
    let mut samples: Vec<WallSample> = Vec::new();
    let mut places: Vec<Point3<f64>> = Vec::new();
    let mut cells: BTreeMap<[i64; 3], Vec<u32>> = BTreeMap::new();
    let apart = APART * spacing;
    let cell = |place: &Point3<f64>| [place.x, place.y, place.z].map(|x| (x / apart).floor() as i64);
    for nodes in triangles {
        if nodes.iter().any(|node| *node as usize >= positions.len()) {
            continue;
        }
        let corners = nodes.map(|node| positions[node as usize]);
        let longest = (0..3).map(|k| (corners[k] - corners[(k + 1) % 3]).norm()).fold(0.0, f64::max);
        let divisions = (longest / spacing).ceil().clamp(1.0, DIVISIONS_MAX);
        for i in 0..=divisions as u32 {
            for j in 0..=divisions as u32 - i {
                let (u, v) = (f64::from(i) / divisions, f64::from(j) / divisions);
                let sample = WallSample { nodes: *nodes, weights: [1.0 - u - v, u, v] };
                let place = sample.place(positions);
                let [x, y, z] = cell(&place);
                let is_near = (-1..=1).any(|dx| {
                    (-1..=1).any(|dy| {
                        (-1..=1).any(|dz| {
                            let known = cells.get(&[x + dx, y + dy, z + dz]);
                            let near = |other: &u32| (places[*other as usize] - place).norm() < apart;
                            known.is_some_and(|known| known.iter().any(near))
                        })
                    })
                });
                if !is_near && samples.len() < most {
                    cells.entry([x, y, z]).or_default().push(samples.len() as u32);
                    samples.push(sample);
                    places.push(place);
                }
            }
        }
    }
    samples
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_surface_is_covered_and_no_two_samples_are_in_one_place() {
        let positions: Vec<Point3<f64>> =
            [[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.1, 0.08, 0.0], [0.0, 0.08, 0.0]].map(Point3::from).to_vec();
        let triangles = [[0, 1, 2], [0, 2, 3], [0, 1, 9]];
        let samples = sample(&positions, &triangles, 0.004, 100_000);
        let places: Vec<Point3<f64>> = samples.iter().map(|sample| sample.place(&positions)).collect();
        for (index, place) in places.iter().enumerate() {
            assert!(samples[index].weights.iter().all(|weight| *weight >= -1e-12));
            assert!(places[..index].iter().all(|other| (other - place).norm() >= 0.7 * 0.004));
        }
        // Every point of the surface is near to one.
        for (i, j) in (0..=40).flat_map(|i| (0..=32).map(move |j| (i, j))) {
            let at = Point3::new(f64::from(i) * 0.0025, f64::from(j) * 0.0025, 0.0);
            let nearest = places.iter().map(|place| (place - at).norm()).fold(1.0, f64::min);
            assert!(nearest < 0.75 * 0.004, "{at}: {nearest}");
        }
        assert_eq!(sample(&positions, &triangles, 0.004, 7).len(), 7);
        // Triangles finer than the spacing do not give more.
        let n = 40_u32;
        let at = |i: u32, j: u32| i * (n + 1) + j;
        let fine: Vec<Point3<f64>> = (0..=n)
            .flat_map(|i| (0..=n).map(move |j| Point3::new(f64::from(i), f64::from(j), 0.0) * 1e-3))
            .collect();
        let cells = (0..n).flat_map(|i| (0..n).map(move |j| (i, j)));
        let fine_triangles: Vec<[u32; 3]> = cells
            .flat_map(|(i, j)| {
                [[at(i, j), at(i + 1, j), at(i, j + 1)], [at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)]]
            })
            .collect();
        let coarse = sample(&fine, &fine_triangles, 0.004, 100_000).len();
        assert!((100..260).contains(&coarse), "{coarse} samples of 16 cm²");
    }
}
