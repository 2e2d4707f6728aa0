//! A box of twelve triangles, outward.

use nalgebra::Point3;

/// From its lowest corner to its highest.
pub fn cuboid(low: [f64; 3], high: [f64; 3]) -> (Vec<Point3<f64>>, Vec<[u32; 3]>) {
    let corner = |bits: usize| {
        Point3::from([0, 1, 2].map(|axis| if bits >> axis & 1 == 1 { high[axis] } else { low[axis] }))
    };
    let vertices = (0..8).map(corner).collect();
    let sides = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
    let triangles = sides.iter().flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]).collect();
    (vertices, triangles)
}
