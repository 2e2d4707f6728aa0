//! Meshes shared by tests of electrosurgery.

use nalgebra::Point3;

/// A block of cubes, six tetrahedra each, from the origin.
pub(crate) fn bar(cells: [u32; 3], spacing: f64) -> (Vec<Point3<f64>>, Vec<[u32; 4]>) {
    let [nx, ny, nz] = cells;
    let at = |i: u32, j: u32, k: u32| (i * (ny + 1) + j) * (nz + 1) + k;
    let mut positions = Vec::new();
    for (i, j, k) in triples(nx + 1, ny + 1, nz + 1) {
        positions.push(Point3::from([i, j, k].map(|index| f64::from(index) * spacing)));
    }
    let mut tets = Vec::new();
    for (i, j, k) in triples(nx, ny, nz) {
        let corner = |index: u32| at(i + index / 4, j + index / 2 % 2, k + index % 2);
        let six = [[0, 4, 6, 7], [0, 6, 2, 7], [0, 2, 3, 7], [0, 3, 1, 7], [0, 1, 5, 7], [0, 5, 4, 7]];
        tets.extend(six.map(|tet: [u32; 4]| tet.map(corner)));
    }
    (positions, tets)
}

/// A square of `n` × `n` cells of two triangles at z = 0, from the origin.
pub(crate) fn grid_of_triangles(n: u32, spacing: f64) -> (Vec<Point3<f64>>, Vec<[u32; 3]>) {
    let positions = triples(n + 1, n + 1, 1)
        .map(|(i, j, _)| Point3::new(f64::from(i) * spacing, f64::from(j) * spacing, 0.0))
        .collect();
    let at = |i: u32, j: u32| i * (n + 1) + j;
    let triangles = triples(n, n, 1)
        .flat_map(|(i, j, _)| {
            [[at(i, j), at(i + 1, j), at(i + 1, j + 1)], [at(i, j), at(i + 1, j + 1), at(i, j + 1)]]
        })
        .collect();
    (positions, triangles)
}

fn triples(x: u32, y: u32, z: u32) -> impl Iterator<Item = (u32, u32, u32)> {
    (0..x).flat_map(move |i| (0..y).flat_map(move |j| (0..z).map(move |k| (i, j, k))))
}
