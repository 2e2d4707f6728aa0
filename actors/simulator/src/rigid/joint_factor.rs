//! Factor L·D·Lᵀ of the joints' matrix, in blocks of six, with the fill of a minimum-degree ordering: a chain and a tree
//! cost in proportion to their joints.

use nalgebra::{Matrix6, Vector6};

use super::body_joint::{JointRows, Locked};
use crate::linear_algebra::minimum_degree;

/// Share of a pivot's own entry below which what it locks is locked already: its impulse is zero.
const REDUNDANT: f64 = 1e-11;

/// The factor.
#[derive(Clone, Debug, Default)]
pub(super) struct JointFactor {
    /// Joints in the order of their elimination, and the place of each in it.
    order: Vec<u32>,
    places: Vec<u32>,
    /// Later joints that each couples with, as places, ascending; the start of each.
    below: Vec<u32>,
    starts: Vec<u32>,
    /// Block of each of these, and the inverse of each diagonal one.
    blocks: Vec<Matrix6<f64>>,
    diagonal: Vec<Matrix6<f64>>,
    /// The column being eliminated, before it is divided.
    column: Vec<Matrix6<f64>>,
}

impl JointFactor {
    /// Finds the fill, for the pairs of joints that share a body that moves. Returns the number of block products if they are
    /// more than `most`.
    pub fn analyse(
        &mut self,
        joints: usize,
        pairs: impl Iterator<Item = (u32, u32)> + Clone,
        most: usize,
    ) -> Result<(), usize> {
        self.order = if joints == 0 { Vec::new() } else { minimum_degree(joints, pairs.clone()) };
        self.places.clear();
        self.places.resize(joints, 0);
        for (place, joint) in self.order.iter().enumerate() {
            self.places[*joint as usize] = place as u32;
        }
        let mut columns: Vec<Vec<u32>> = vec![Vec::new(); joints];
        for (a, b) in pairs {
            let [a, b] = [a, b].map(|joint| self.places[joint as usize]);
            columns[a.min(b) as usize].push(a.max(b));
        }
        let mut products = 0;
        self.below.clear();
        self.starts.clear();
        for place in 0..joints {
            let mut own = std::mem::take(&mut columns[place]);
            own.sort_unstable();
            own.dedup();
            products += own.len() * (own.len() + 1) / 2;
            if products > most {
                return Err(products);
            }
            // Eliminating it couples all that it is coupled with: the first of them takes over the others.
            if let Some((first, rest)) = own.split_first() {
                columns[*first as usize].extend_from_slice(rest);
            }
            self.starts.push(self.below.len() as u32);
            self.below.extend(own);
        }
        self.starts.push(self.below.len() as u32);
        self.blocks = vec![Matrix6::zeros(); self.below.len()];
        self.diagonal = vec![Matrix6::identity(); joints];
        let longest = self.starts.windows(2).map(|pair| pair[1] - pair[0]).max().unwrap_or(0);
        self.column = Vec::with_capacity(longest as usize);
        Ok(())
    }

    /// Place of a joint in the order of elimination.
    pub fn position(&self, joint: u32) -> u32 {
        self.places[joint as usize]
    }

    fn slots(&self, place: usize) -> std::ops::Range<usize> {
        self.starts[place] as usize..self.starts[place + 1] as usize
    }

    /// Factorises the matrix of these joints, which hang together with no others, in the order of their elimination.
    pub fn factorise(&mut self, members: &[u32], rows: &[JointRows]) {
        for &joint in members {
            let place = self.places[joint as usize] as usize;
            let own = &rows[joint as usize];
            self.diagonal[place] = block(own, own, true);
            for slot in self.slots(place) {
                let other = &rows[self.order[self.below[slot] as usize] as usize];
                self.blocks[slot] = block(other, own, false);
            }
        }
        for &joint in members {
            let place = self.places[joint as usize] as usize;
            let own = &rows[joint as usize];
            let size: [f64; 6] =
                std::array::from_fn(|k| if k < own.count { own.mobility(k, own, k) } else { 1.0 });
            let inverse = inverse(&self.diagonal[place], &size);
            self.diagonal[place] = inverse;
            let slots = self.slots(place);
            self.column.clear();
            self.column.extend_from_slice(&self.blocks[slots.clone()]);
            for slot in slots.clone() {
                self.blocks[slot] *= inverse;
            }
            for (j, column) in slots.clone().enumerate() {
                let to = self.below[column] as usize;
                let before = self.column[j].transpose();
                self.diagonal[to] -= self.blocks[column] * before;
                let mut target = self.slots(to).start;
                for row in column + 1..slots.end {
                    // Both are ascending, and all of these are in the column.
                    while self.below[target] != self.below[row] {
                        target += 1;
                    }
                    let product = self.blocks[row] * before;
                    self.blocks[target] -= product;
                }
            }
        }
    }

    /// Solves for the joints of a cluster, in the order of their elimination.
    pub fn solve(&self, members: &[u32], x: &mut [Locked]) {
        for &joint in members {
            let place = self.places[joint as usize] as usize;
            let own = Vector6::from(x[joint as usize]);
            for slot in self.slots(place) {
                let to = &mut x[self.order[self.below[slot] as usize] as usize];
                *to = (Vector6::from(*to) - self.blocks[slot] * own).into();
            }
        }
        for &joint in members.iter().rev() {
            let place = self.places[joint as usize] as usize;
            let mut own = self.diagonal[place] * Vector6::from(x[joint as usize]);
            for slot in self.slots(place) {
                let other = Vector6::from(x[self.order[self.below[slot] as usize] as usize]);
                own -= self.blocks[slot].tr_mul(&other);
            }
            x[joint as usize] = own.into();
        }
    }
}

/// The block of two joints; on the diagonal, what a joint does not lock has a one.
fn block(row: &JointRows, column: &JointRows, is_diagonal: bool) -> Matrix6<f64> {
    Matrix6::from_fn(|i, j| {
        if i < row.count && j < column.count {
            row.mobility(i, column, j)
        } else {
            f64::from(u8::from(is_diagonal && i == j))
        }
    })
}

/// Inverse of a symmetric block by its factor L·D·Lᵀ, where pivots that vanish beside `size` count as locked already.
fn inverse(block: &Matrix6<f64>, size: &[f64; 6]) -> Matrix6<f64> {
    let (mut lower, mut pivots) = (Matrix6::identity(), [0.0; 6]);
    for j in 0..6 {
        let mut pivot = block[(j, j)];
        for k in 0..j {
            pivot -= lower[(j, k)] * lower[(j, k)] * pivots[k];
        }
        let is_free = pivot > REDUNDANT * size[j];
        pivots[j] = if is_free { pivot } else { 0.0 };
        for i in j + 1..6 {
            let mut entry = block[(i, j)];
            for k in 0..j {
                entry -= lower[(i, k)] * lower[(j, k)] * pivots[k];
            }
            lower[(i, j)] = if is_free { entry / pivot } else { 0.0 };
        }
    }
    let mut inverse = Matrix6::zeros();
    for column in 0..6 {
        let mut x = [0.0; 6];
        x[column] = 1.0;
        for i in 0..6 {
            for k in 0..i {
                x[i] -= lower[(i, k)] * x[k];
            }
        }
        for i in 0..6 {
            x[i] = if pivots[i] > 0.0 { x[i] / pivots[i] } else { 0.0 };
        }
        for i in (0..6).rev() {
            for k in i + 1..6 {
                x[i] -= lower[(k, i)] * x[k];
            }
        }
        for i in 0..6 {
            inverse[(i, column)] = x[i];
        }
    }
    inverse
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_inverse_leaves_out_what_is_locked_already() {
        let base =
            Matrix6::from_fn(|i, j| if i == j { 3.0 + i as f64 } else { 1.0 / (1.0 + (i + j) as f64) });
        let size: [f64; 6] = std::array::from_fn(|k| base[(k, k)]);
        assert!((inverse(&base, &size) * base - Matrix6::identity()).norm() < 1e-14);
        // The last row repeats the first.
        let mut twice = base;
        for k in 0..6 {
            twice[(5, k)] = twice[(0, k)];
        }
        for k in 0..6 {
            twice[(k, 5)] = twice[(k, 0)];
        }
        let right = twice * Vector6::new(1.0, -2.0, 0.5, 0.0, 3.0, 0.0);
        let found = inverse(&twice, &size) * right;
        assert!((twice * found - right).norm() < 1e-12 && found[5] == 0.0, "{found}");
    }
}
