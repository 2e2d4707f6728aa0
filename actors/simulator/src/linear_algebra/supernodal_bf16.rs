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

use super::nested_dissection;
use crate::simd::dispatch::wide;

/// Columns that are taken at once, and lanes of a sum; rows are filled up to a multiple of these.
const WIDE: usize = 4;
const LANES: usize = 8;

/// The upper half of a number, with eight bits of mantissa: what holds a solve back is what it reads, and a
/// preconditioner needs no more.
fn short(value: f64) -> u16 {
    let bits = (value as f32).to_bits();
    // To the nearest, the even one of two.
    (bits.wrapping_add(0x7FFF + ((bits >> 16) & 1)) >> 16) as u16
}

#[inline(always)]
fn long(value: u16) -> f32 {
    f32::from_bits(u32::from(value) << 16)
}

/// Columns with the same rows below them. With S their square and B what is below it, it holds S⁻¹ on top of −B S⁻¹: one
/// product with what stands at its columns solves for them and says what rows further down get of it, and one with the
/// transposed is the way back, neither with a number that waits for the one before (Raghavan 1998).
#[derive(Clone, Debug)]
struct Panel {
    /// First of its columns, and how many there are.
    start: usize,
    columns: usize,
    /// Where the rows below the square begin, and how many there are.
    rows_from: usize,
    rows: usize,
    /// Where its numbers begin, by columns, and how long a column is, filled up.
    values_from: usize,
    height: usize,
}

/// L of a matrix L Lᵀ, its rows in an order of little fill.
#[derive(Clone, Debug, Default)]
pub(crate) struct Triangles {
    panels: Vec<Panel>,
    rows: Vec<u32>,
    values: Vec<u16>,
    /// Which row of the matrix stands at each place of the factor.
    order: Vec<u32>,
    solved: Vec<f32>,
    /// Of one panel: what stands at its columns and at its rows.
    column: Vec<f32>,
    /// And of each of its columns the lanes of a product.
    products: Vec<[f32; LANES]>,
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

    /// Numbers that a solve reads, there and back once each.
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
    // What fills a column up is times nothing, but has to be a number.
    below[rows.len()..].fill(0.0);
    let own = &mut solved[panel.start..panel.start + columns];
    // All lanes are kept before any are added up: compiled into one loop, both would run two lanes at a time.
    let products = &mut products[..columns];
    for (product, entries) in products.iter_mut().zip(values.chunks_exact(height)) {
        *product = dot(entries, column);
    }
    for (slot, product) in own.iter_mut().zip(products) {
        *slot = sum(*product);
    }
}

/// Lanes of the product of slices whose length is a multiple of them: a sum in one order would run one number at a time.
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

/// By halves, as registers are.
#[inline(always)]
fn sum([a, b, c, d, e, f, g, h]: [f32; LANES]) -> f32 {
    ((a + e) + (c + g)) + ((b + f) + (d + h))
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
            // As near as numbers of eight bits, each wrong by up to 1/512, say it.
            assert!((found - wanted).abs() < 0.02, "{found}, not {wanted}");
        }
        entries[0].2 = -100.0;
        assert!(Triangles::factor(&places, entries).is_none());
    }
}
