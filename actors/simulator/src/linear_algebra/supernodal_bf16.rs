//! Supernodal sparse Cholesky factor for preconditioning, stored in bf16, laid out for many solves: neighbouring
//! columns with common rows are stored together, so that the inner loops run over contiguous slices.

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

use super::nested_dissection;
use crate::simd::dispatch::wide;

/// Columns processed at once, and lanes of a sum; rows are padded to a multiple of these.
const WIDE: usize = 4;
const LANES: usize = 8;

/// Rounds to bf16, eight bits of mantissa: a solve is limited by memory bandwidth, and a preconditioner needs no more.
fn short(value: f64) -> u16 {
    let bits = (value as f32).to_bits();
    // Round to nearest, ties to even.
    (bits.wrapping_add(0x7FFF + ((bits >> 16) & 1)) >> 16) as u16
}

#[inline(always)]
fn long(value: u16) -> f32 {
    f32::from_bits(u32::from(value) << 16)
}

/// A supernode: columns with the same rows below them. With S their diagonal square and B the rows below it, it stores
/// S⁻¹ on top of −B S⁻¹: one product with the entries at its columns solves for them and updates the rows below, and
/// one with the transpose is the backward solve, without sequential dependencies (Raghavan 1998).
#[derive(Clone, Debug)]
struct Panel {
    /// Its first column, and their number.
    start: usize,
    columns: usize,
    /// Start and number of the rows below the square.
    rows_from: usize,
    rows: usize,
    /// Start of its values, by columns, and the padded length of a column.
    values_from: usize,
    height: usize,
}

/// L of a matrix L Lᵀ in a fill-reducing order.
#[derive(Clone, Debug, Default)]
pub(crate) struct Triangles {
    panels: Vec<Panel>,
    rows: Vec<u32>,
    values: Vec<u16>,
    /// Row of the matrix at each position of the factor.
    order: Vec<u32>,
    solved: Vec<f32>,
    /// Vector entries at a panel's columns and at its rows.
    column: Vec<f32>,
    /// Lane sums of the products of its columns.
    products: Vec<[f32; LANES]>,
}

impl Triangles {
    /// Factorises a symmetric matrix with one row per point in `places`, given by the entries (row, column, value) of
    /// its lower triangle, each at most once. `None` where it is not positive definite or there is not enough memory.
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
        let mut triangles = Self { order, solved: vec![0.0; size], ..Self::default() };
        let mut inverse = Vec::new();
        for index in 0..raw.n_supernodes() {
            let node = factor.supernode(index);
            let all = node.val();
            let (columns, rows) = (all.ncols(), node.pattern().len());
            let height = (columns + rows).next_multiple_of(LANES);
            let (rows_from, values_from) = (triangles.rows.len(), triangles.values.len());
            triangles.panels.push(Panel {
                start: node.start(),
                columns,
                rows_from,
                rows,
                values_from,
                height,
            });
            triangles.rows.extend(node.pattern().iter().map(|&row| row as u32));
            for column in 0..columns {
                // S y = a unit vector, by substitution.
                inverse.clear();
                inverse.resize(columns, 0.0);
                inverse[column] = 1.0 / all[(column, column)];
                for row in column + 1..columns {
                    let sum: f64 = (column..row).map(|of| all[(row, of)] * inverse[of]).sum();
                    inverse[row] = -sum / all[(row, row)];
                }
                triangles.values.extend(inverse.iter().map(|&value| short(value)));
                triangles.values.extend((columns..columns + rows).map(|row| {
                    let sum: f64 = (column..columns).map(|of| all[(row, of)] * inverse[of]).sum();
                    short(-sum)
                }));
                triangles.values.resize(values_from + (column + 1) * height, 0);
            }
        }
        let longest = triangles.panels.iter().map(|panel| panel.height).max().unwrap_or(0);
        triangles.column = vec![0.0; longest];
        let widest = triangles.panels.iter().map(|panel| panel.columns).max().unwrap_or(0);
        triangles.products = vec![[0.0; LANES]; widest];
        triangles.values.iter().all(|&value| long(value).is_finite()).then_some(triangles)
    }

    /// Number of entries, each read twice in a solve.
    pub fn entries(&self) -> usize {
        self.values.len()
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
        let Self { panels, rows, values, order, solved, column, products } = self;
        for (slot, &row) in solved.iter_mut().zip(order.iter()) {
            *slot = vector[row as usize];
        }
        for panel in panels.iter() {
            forward(panel, &rows[panel.rows_from..][..panel.rows], values, solved, column);
        }
        for panel in panels.iter().rev() {
            backward(panel, &rows[panel.rows_from..][..panel.rows], values, solved, (column, products));
        }
        for (value, &row) in solved.iter().zip(order.iter()) {
            vector[row as usize] = *value;
        }
    }
}

#[inline(always)]
fn forward(panel: &Panel, rows: &[u32], values: &[u16], solved: &mut [f32], column: &mut [f32]) {
    let Panel { columns, height, .. } = *panel;
    let values = &values[panel.values_from..][..columns * height];
    let own = &mut solved[panel.start..panel.start + columns];
    let sums = &mut column[..height];
    sums.fill(0.0);
    let (wide, numbers) = (values.chunks_exact(WIDE * height), own.chunks_exact(WIDE));
    for (single, number) in wide.remainder().chunks_exact(height).zip(numbers.remainder()) {
        for (sum, entry) in sums.iter_mut().zip(single) {
            *sum += long(*entry) * number;
        }
    }
    for (wide, number) in wide.zip(numbers) {
        let (first, wide) = wide.split_at(height);
        let (second, wide) = wide.split_at(height);
        let (third, fourth) = wide.split_at(height);
        for ((((sum, a), b), c), d) in sums.iter_mut().zip(first).zip(second).zip(third).zip(fourth) {
            *sum +=
                long(*a) * number[0] + long(*b) * number[1] + (long(*c) * number[2] + long(*d) * number[3]);
        }
    }
    own.copy_from_slice(&sums[..columns]);
    for (&row, sum) in rows.iter().zip(&sums[columns..]) {
        solved[row as usize] += sum;
    }
}

#[inline(always)]
fn backward(
    panel: &Panel,
    rows: &[u32],
    values: &[u16],
    solved: &mut [f32],
    (column, products): (&mut [f32], &mut [[f32; LANES]]),
) {
    let Panel { columns, height, .. } = *panel;
    let values = &values[panel.values_from..][..columns * height];
    let column = &mut column[..height];
    let (top, below) = column.split_at_mut(columns);
    top.copy_from_slice(&solved[panel.start..panel.start + columns]);
    for (slot, &row) in below.iter_mut().zip(rows) {
        *slot = solved[row as usize];
    }
    // Padding is multiplied by zero, but has to be finite.
    below[rows.len()..].fill(0.0);
    let own = &mut solved[panel.start..panel.start + columns];
    // All lanes are stored before any are summed: fused into one loop, both would use only two lanes at a time.
    let products = &mut products[..columns];
    for (product, entries) in products.iter_mut().zip(values.chunks_exact(height)) {
        *product = dot(entries, column);
    }
    for (slot, product) in own.iter_mut().zip(products) {
        *slot = sum(*product);
    }
}

/// Lane sums of the dot product of slices whose length is a multiple of the lanes: a sequential sum would not
/// vectorise.
#[inline(always)]
fn dot(column: &[u16], vector: &[f32]) -> [f32; LANES] {
    let mut lanes = [0.0_f32; LANES];
    for (a, v) in column.chunks_exact(LANES).zip(vector.chunks_exact(LANES)) {
        for lane in 0..LANES {
            lanes[lane] += long(a[lane]) * v[lane];
        }
    }
    lanes
}

/// Pairwise, by halves of a register.
#[inline(always)]
fn sum([a, b, c, d, e, f, g, h]: [f32; LANES]) -> f32 {
    ((a + e) + (c + g)) + ((b + f) + (d + h))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_solved_fulfils_the_equations() {
        // A grid of springs with a weak support at each node.
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
            // Within the accuracy of eight-bit mantissas, with relative errors up to 1/512.
            assert!((found - wanted).abs() < 0.02, "{found}, not {wanted}");
        }
        entries[0].2 = -100.0;
        assert!(Triangles::factor(&places, entries).is_none());
    }
}
