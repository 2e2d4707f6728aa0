//! Constraint rows (Jacobian) of a contact: separation of the surfaces along a direction per motion of nodes and turn
//! angles.

use nalgebra::{Point3, Vector3};

use crate::linear_algebra::block_banded::{Cell, LANES, LaneCell};

/// Three directions at one contact, each as weights on at most four block rows.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Rows {
    pub nodes: [u32; 4],
    /// Weights of each direction on each block row.
    pub cells: [[Cell; 4]; 3],
    /// Block rows in use: two for an obstacle, four for another strand, none for a contact without the rod.
    pub used: usize,
    /// Unit vectors in the world: the normal, from the other feature to the edge, and two tangents.
    pub directions: [Vector3<f64>; 3],
}

/// A point on the surface of an edge.
pub(crate) struct Side {
    pub edge: usize,
    /// Parameter along the edge, 0 to 1.
    pub along: f64,
    /// Vector from the centre line to the surface \[m\].
    pub arm: Vector3<f64>,
    pub tangent: Vector3<f64>,
    pub length: f64,
}

impl Side {
    /// Motion of the point along `direction`, as weights on the two nodes and the turn angle of the edge. The point
    /// rotates with the edge about its axis and with its nodes: forces act where the surfaces touch, and angular
    /// momentum is conserved.
    #[inline]
    pub fn weights(&self, direction: &Vector3<f64>) -> [Cell; 2] {
        let turn = direction.dot(&self.tangent.cross(&self.arm));
        // (t × δe) × arm / |e| = (δe (t·arm) − t (δe·arm)) / |e|.
        let lean =
            (direction * self.tangent.dot(&self.arm) - self.arm * direction.dot(&self.tangent)) / self.length;
        let first = direction * (1.0 - self.along) - lean;
        let second = direction * self.along + lean;
        [Cell::new(first.x, first.y, first.z, turn), Cell::new(second.x, second.y, second.z, 0.0)]
    }
}

impl Rows {
    /// Rows of a contact of `side` with another edge, or with anything that is not part of the thread.
    pub fn new(side: &Side, other: Option<&Side>, directions: [Vector3<f64>; 3]) -> Self {
        let mut rows = Self { nodes: [0; 4], cells: [[Cell::zeros(); 4]; 3], used: 2, directions };
        let edge = side.edge as u32;
        (rows.nodes[0], rows.nodes[1]) = (edge, edge + 1);
        for (cells, direction) in rows.cells.iter_mut().zip(&directions) {
            [cells[0], cells[1]] = side.weights(direction);
        }
        if let Some(other) = other {
            let edge = other.edge as u32;
            (rows.nodes[2], rows.nodes[3], rows.used) = (edge, edge + 1, 4);
            for (cells, direction) in rows.cells.iter_mut().zip(&directions) {
                let [first, second] = other.weights(direction);
                (cells[2], cells[3]) = (-first, -second);
            }
        }
        rows
    }

    /// The same for a thread of so many nodes: the edge that begins at the last one leads back to the first.
    #[must_use]
    pub fn around(mut self, nodes: usize) -> Self {
        for node in &mut self.nodes[..self.used] {
            if *node as usize == nodes {
                *node = 0;
            }
        }
        self
    }

    /// The first block row that it touches; past the end where there is none.
    pub fn first(&self) -> usize {
        self.nodes[..self.used].iter().copied().min().unwrap_or(u32::MAX) as usize
    }

    /// Separation of the surfaces along the three directions for a motion.
    #[inline]
    pub fn apart(&self, moved: &[Cell]) -> [f64; 3] {
        let mut sum = [0.0; 3];
        for (sum, cells) in sum.iter_mut().zip(&self.cells) {
            for k in 0..self.used {
                *sum += cells[k].dot(&moved[self.nodes[k] as usize]);
            }
        }
        sum
    }

    /// The same for several motions at once, along one direction.
    #[inline(always)]
    pub fn apart_lanes(&self, direction: usize, moved: &[LaneCell]) -> [f64; LANES] {
        let mut sum = [0.0; LANES];
        for k in 0..self.used {
            let (weights, cell) = (&self.cells[direction][k], &moved[self.nodes[k] as usize]);
            for axis in 0..4 {
                for lane in 0..LANES {
                    sum[lane] += weights[axis] * cell[axis][lane];
                }
            }
        }
        sum
    }

    /// Adds forces along the three directions to their block rows.
    #[inline]
    pub fn push(&self, forces: &[f64; 3], right: &mut [Cell]) {
        for (force, cells) in forces.iter().zip(&self.cells) {
            for k in 0..self.used {
                right[self.nodes[k] as usize] += cells[k] * *force;
            }
        }
    }

    /// The world vector with these components along the three directions.
    pub fn vector(&self, components: &[f64; 3]) -> Vector3<f64> {
        self.directions[0] * components[0]
            + self.directions[1] * components[1]
            + self.directions[2] * components[2]
    }
}

/// Two tangents perpendicular to `normal`, the first as near to `along` as possible.
pub(crate) fn tangents(normal: &Vector3<f64>, along: &Vector3<f64>) -> [Vector3<f64>; 2] {
    let first = crate::suture_thread::bishop_frame::perpendicular(along, normal);
    [first, normal.cross(&first)]
}

/// A point on an edge \[m\].
pub(crate) fn place(edge: &[Point3<f64>; 2], along: f64) -> Vector3<f64> {
    edge[0].coords.lerp(&edge[1].coords, along)
}
