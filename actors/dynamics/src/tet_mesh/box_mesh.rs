//! Box meshes of regular cells, each cut into six tetrahedra around one diagonal (Kuhn 1960), for tests and procedural
//! scenes.

use nalgebra::{Point3, Vector3};

/// A regular box of cells.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BoxCells {
    /// Cells along x, y, z.
    pub cells: [usize; 3],
    /// Size of the box \[m\].
    pub size: Vector3<f64>,
    /// Its smallest corner \[m\].
    pub origin: Point3<f64>,
}

impl BoxCells {
    /// The number of the node at a corner of the grid: z runs fastest, x slowest.
    #[must_use]
    pub fn node(&self, [i, j, k]: [usize; 3]) -> u32 {
        let [_, ny, nz] = self.cells;
        ((i * (ny + 1) + j) * (nz + 1) + k) as u32
    }
}

/// Nodes and positively oriented elements of a box, six per cell, all around the diagonal from its smallest to its
/// largest corner, so that neighbouring cells share faces.
#[must_use]
pub fn box_cells(grid: &BoxCells) -> (Vec<Point3<f64>>, Vec<[u32; 4]>) {
    const SIX: [[usize; 4]; 6] =
        [[0, 4, 6, 7], [0, 6, 2, 7], [0, 2, 3, 7], [0, 3, 1, 7], [0, 1, 5, 7], [0, 5, 4, 7]];
    let [nx, ny, nz] = grid.cells;
    let mut nodes = Vec::with_capacity((nx + 1) * (ny + 1) * (nz + 1));
    let along = |index: usize, cells: usize| index as f64 / cells.max(1) as f64;
    for i in 0..=nx {
        for j in 0..=ny {
            for k in 0..=nz {
                let at = Vector3::new(along(i, nx), along(j, ny), along(k, nz));
                nodes.push(grid.origin + at.component_mul(&grid.size));
            }
        }
    }
    let mut tets = Vec::with_capacity(6 * nx * ny * nz);
    for i in 0..nx {
        for j in 0..ny {
            for k in 0..nz {
                let corner =
                    |local: usize| grid.node([i + (local >> 2), j + (local >> 1 & 1), k + (local & 1)]);
                tets.extend(SIX.map(|tet| tet.map(corner)));
            }
        }
    }
    (nodes, tets)
}
