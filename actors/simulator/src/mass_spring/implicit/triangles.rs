//! A sparse Cholesky factor in single precision, laid out for being solved with many times: neighbouring columns that
//! share their rows stand together, so that the inner loops run over plain slices.

use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::cholesky::llt::factor::LltRegularization;
use faer::perm::PermRef;
use faer::sparse::linalg::SupernodalThreshold;
use faer::sparse::linalg::cholesky::supernodal::SupernodalLltRef;
use faer::sparse::linalg::cholesky::{
    CholeskySymbolicParams, SymbolicCholeskyRaw, SymmetricOrdering, factorize_symbolic_cholesky,
};
use faer::sparse::{SparseColMatRef, SymbolicSparseColMat};
use faer::{Par, Side, Spec};
use nalgebra::Point3;

use crate::sparse::nested_dissection;
use crate::wide::wide;

/// Columns that are taken at once, and lanes of a sum; rows are filled up to a multiple of these.
const WIDE: usize = 4;
const LANES: usize = 8;

/// Columns with the same rows below them.
#[derive(Clone, Debug)]
struct Panel {
    /// First of its columns, and how many there are.
    start: usize,
    columns: usize,
    /// Where its rows below the square begin, and how many there are.
    rows_from: usize,
    rows: usize,
    /// Where its numbers begin: the square by columns, one over the diagonal on it; then the columns below it.
    values_from: usize,
}

/// L of a matrix L Lᵀ, its rows in an order of little fill.
#[derive(Clone, Debug, Default)]
pub(super) struct Triangles {
    panels: Vec<Panel>,
    rows: Vec<u32>,
    values: Vec<f32>,
    /// Which row of the matrix stands at each place of the factor.
    order: Vec<u32>,
    solved: Vec<f32>,
    below: Vec<f32>,
}

impl Triangles {
    /// Factors a symmetric matrix with a row for each of these `places`, given by the entries (row, column, value) of its lower
    /// triangle, each at most once. `None` where it is not definite or there is no room.
    pub fn factor(places: &[Point3<f64>], mut entries: Vec<(u32, u32, f64)>) -> Option<Self> {
        let size = places.len();
        let edges = entries.iter().map(|&(row, column, _)| (row, column));
        let order: Vec<usize> =
            nested_dissection(places, edges).into_iter().map(|row| row as usize).collect();
        let mut inverse = vec![0; size];
        order.iter().enumerate().for_each(|(place, &row)| inverse[row] = place);
        let ordering = SymmetricOrdering::Custom(PermRef::new_checked(&order, &inverse, size));
        entries.sort_unstable_by_key(|&(row, column, _)| (column, row));
        let mut starts = vec![0; size + 1];
        entries.iter().for_each(|&(_, column, _)| starts[column as usize + 1] += 1);
        (0..size).for_each(|column| starts[column + 1] += starts[column]);
        let rows = entries.iter().map(|&(row, ..)| row as usize).collect();
        let values: Vec<f64> = entries.iter().map(|&(.., value)| value).collect();
        let pattern = SymbolicSparseColMat::new_checked(size, size, starts, None, rows);
        let params = CholeskySymbolicParams {
            supernodal_flop_ratio_threshold: SupernodalThreshold::FORCE_SUPERNODAL,
            ..Default::default()
        };
        let symbolic = factorize_symbolic_cholesky(pattern.as_ref(), Side::Lower, ordering, params).ok()?;
        let mut memory =
            MemBuffer::try_new(symbolic.factorize_numeric_llt_scratch::<f64>(Par::Seq, Spec::default()))
                .ok()?;
        let mut numbers = vec![0.0; symbolic.len_val()];
        let matrix = SparseColMatRef::new(pattern.as_ref(), values.as_slice());
        let regular = LltRegularization::default();
        let stack = MemStack::new(&mut memory);
        symbolic
            .factorize_numeric_llt(
                &mut numbers,
                matrix,
                Side::Lower,
                regular,
                Par::Seq,
                stack,
                Spec::default(),
            )
            .ok()?;
        let order = order.into_iter().map(|row| row as u32).collect();
        let SymbolicCholeskyRaw::Supernodal(raw) = symbolic.raw() else { return None };
        let factor = SupernodalLltRef::new(raw, &numbers);
        let mut triangles = Self { order, solved: vec![0.0; size + 1], ..Self::default() };
        for index in 0..raw.n_supernodes() {
            let node = factor.supernode(index);
            let all = node.val();
            let columns = all.ncols();
            let filled = node.pattern().len();
            let rows = filled.next_multiple_of(LANES);
            let (rows_from, values_from) = (triangles.rows.len(), triangles.values.len());
            triangles.panels.push(Panel { start: node.start(), columns, rows_from, rows, values_from });
            triangles.rows.extend(node.pattern().iter().map(|&row| row as u32));
            // A row beyond the last, which nothing reads.
            triangles.rows.extend((filled..rows).map(|_| size as u32));
            for column in 0..columns {
                for row in 0..columns {
                    let value = all[(row, column)];
                    let value = if row < column {
                        0.0
                    } else if row == column {
                        1.0 / value
                    } else {
                        value
                    };
                    triangles.values.push(value as f32);
                }
            }
            for column in 0..columns {
                triangles.values.extend((0..filled).map(|row| all[(columns + row, column)] as f32));
                triangles.values.extend((filled..rows).map(|_| 0.0));
            }
        }
        let longest = triangles.panels.iter().map(|panel| panel.rows).max().unwrap_or(0);
        triangles.below = vec![0.0; longest];
        triangles.values.iter().all(|value| value.is_finite()).then_some(triangles)
    }

    /// Solves L Lᵀ x = b in place.
    pub fn solve(&mut self, vector: &mut [f32]) {
        wide(
            #[inline(always)]
            || self.solve_here(vector),
        );
    }

    #[inline(always)]
    fn solve_here(&mut self, vector: &mut [f32]) {
        let Self { panels, rows, values, order, solved, below } = self;
        for (slot, &row) in solved.iter_mut().zip(order.iter()) {
            *slot = vector[row as usize];
        }
        for panel in panels.iter() {
            forward(panel, &rows[panel.rows_from..][..panel.rows], values, solved, below);
        }
        for panel in panels.iter().rev() {
            backward(panel, &rows[panel.rows_from..][..panel.rows], values, solved, below);
        }
        for (value, &row) in solved.iter().zip(order.iter()) {
            vector[row as usize] = *value;
        }
    }
}

#[inline(always)]
fn forward(panel: &Panel, rows: &[u32], values: &[f32], solved: &mut [f32], below: &mut [f32]) {
    let count = panel.columns;
    let (square, rest) = values[panel.values_from..].split_at(count * count);
    let own = &mut solved[panel.start..panel.start + count];
    for column in 0..count {
        let entries = &square[column * count..(column + 1) * count];
        let value = own[column] * entries[column];
        own[column] = value;
        for (slot, entry) in own[column + 1..].iter_mut().zip(&entries[column + 1..]) {
            *slot -= entry * value;
        }
    }
    if rows.is_empty() {
        return;
    }
    let below = &mut below[..rows.len()];
    below.fill(0.0);
    let own = &solved[panel.start..panel.start + count];
    let (columns, numbers) =
        (rest[..count * rows.len()].chunks_exact(WIDE * rows.len()), own.chunks_exact(WIDE));
    for (column, number) in columns.remainder().chunks_exact(rows.len()).zip(numbers.remainder()) {
        for (sum, entry) in below.iter_mut().zip(column) {
            *sum += entry * number;
        }
    }
    for (wide, number) in columns.zip(numbers) {
        let (first, wide) = wide.split_at(rows.len());
        let (second, wide) = wide.split_at(rows.len());
        let (third, fourth) = wide.split_at(rows.len());
        for ((((sum, a), b), c), d) in below.iter_mut().zip(first).zip(second).zip(third).zip(fourth) {
            *sum += a * number[0] + b * number[1] + (c * number[2] + d * number[3]);
        }
    }
    for (&row, sum) in rows.iter().zip(below.iter()) {
        solved[row as usize] -= sum;
    }
}

#[inline(always)]
fn backward(panel: &Panel, rows: &[u32], values: &[f32], solved: &mut [f32], below: &mut [f32]) {
    let count = panel.columns;
    let (square, rest) = values[panel.values_from..].split_at(count * count);
    if !rows.is_empty() {
        let below = &mut below[..rows.len()];
        for (slot, &row) in below.iter_mut().zip(rows) {
            *slot = solved[row as usize];
        }
        let columns = rest[..count * rows.len()].chunks_exact(WIDE * rows.len());
        let slots = solved[panel.start..panel.start + count].chunks_exact_mut(WIDE);
        let done = count - count % WIDE;
        let last = columns.remainder();
        for (wide, slots) in columns.zip(slots) {
            let sums = dots(wide, below);
            slots.iter_mut().zip(sums).for_each(|(slot, sum)| *slot -= sum);
        }
        let slots = &mut solved[panel.start + done..panel.start + count];
        for (column, slot) in last.chunks_exact(rows.len()).zip(slots) {
            *slot -= dot(column, below);
        }
    }
    let own = &mut solved[panel.start..panel.start + count];
    for column in (0..count).rev() {
        let entries = &square[column * count..(column + 1) * count];
        let sum = dot(&entries[column + 1..], &own[column + 1..]);
        own[column] = (own[column] - sum) * entries[column];
    }
}

/// Of four columns with one vector whose length is a multiple of the lanes.
#[inline(always)]
fn dots(columns: &[f32], vector: &[f32]) -> [f32; WIDE] {
    let (first, rest) = columns.split_at(vector.len());
    let (second, rest) = rest.split_at(vector.len());
    let (third, fourth) = rest.split_at(vector.len());
    let mut lanes = [[0.0_f32; LANES]; WIDE];
    let columns = first.chunks_exact(LANES).zip(second.chunks_exact(LANES));
    let columns = columns.zip(third.chunks_exact(LANES).zip(fourth.chunks_exact(LANES)));
    for (((a, b), (c, d)), v) in columns.zip(vector.chunks_exact(LANES)) {
        for lane in 0..LANES {
            lanes[0][lane] += a[lane] * v[lane];
            lanes[1][lane] += b[lane] * v[lane];
            lanes[2][lane] += c[lane] * v[lane];
            lanes[3][lane] += d[lane] * v[lane];
        }
    }
    lanes.map(sum)
}

/// In lanes: a sum in one order would run one number at a time.
#[inline(always)]
fn dot(first: &[f32], second: &[f32]) -> f32 {
    let mut lanes = [0.0_f32; LANES];
    let (first_lanes, second_lanes) = (first.chunks_exact(LANES), second.chunks_exact(LANES));
    let rest: f32 = first_lanes.remainder().iter().zip(second_lanes.remainder()).map(|(a, b)| a * b).sum();
    for (a, b) in first_lanes.zip(second_lanes) {
        for lane in 0..LANES {
            lanes[lane] += a[lane] * b[lane];
        }
    }
    rest + sum(lanes)
}

#[inline(always)]
fn sum(lanes: [f32; LANES]) -> f32 {
    let [a, b, c, d, e, f, g, h] = lanes;
    ((a + b) + (c + d)) + ((e + f) + (g + h))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_solved_fulfils_the_equations() {
        // A grid of springs, each node held a little.
        let side = 23_u32;
        let mut entries = Vec::new();
        let mut diagonal = vec![0.1; (side * side) as usize];
        let at = |i: u32, j: u32| j * side + i;
        for j in 0..side {
            for i in 0..side {
                for (p, q) in [(i + 1, j), (i, j + 1), (i + 1, j + 1)] {
                    if p < side && q < side {
                        let stiff = 1.0 + 0.5 * f64::from((3 * i + 5 * j) % 7);
                        entries.push((at(p, q), at(i, j), -stiff));
                        diagonal[at(p, q) as usize] += stiff;
                        diagonal[at(i, j) as usize] += stiff;
                    }
                }
            }
        }
        entries.extend(diagonal.iter().enumerate().map(|(row, &value)| (row as u32, row as u32, value)));
        let wanted: Vec<f32> = (0..side * side).map(|row| (0.37 * row as f32).sin()).collect();
        let mut right = vec![0.0_f32; wanted.len()];
        for &(row, column, value) in &entries {
            right[row as usize] += value as f32 * wanted[column as usize];
            if row != column {
                right[column as usize] += value as f32 * wanted[row as usize];
            }
        }
        let places: Vec<_> = (0..side * side)
            .map(|row| Point3::new(f64::from(row % side), f64::from(row / side), 0.0))
            .collect();
        let mut factor = Triangles::factor(&places, entries.clone()).expect("definite");
        factor.solve(&mut right);
        for (found, wanted) in right.iter().zip(&wanted) {
            assert!((found - wanted).abs() < 2e-4, "{found}, not {wanted}");
        }
        entries[0].2 = -100.0;
        assert!(Triangles::factor(&places, entries).is_none());
    }
}
