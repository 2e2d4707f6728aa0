//! Active set: the Cholesky factor of the active rows and columns of W, updated as constraints are added and removed.
//! Appending a row is a triangular solve; deleting one is a rank-one update of the rows below it (Golub, Van Loan 2013,
//! §6.5.4). Both are O(k²).

/// A pivot below this fraction of its diagonal means a redundant constraint. The compliance is accurate to 1.2e-7 of
/// it, so that accepted pivots are accurate to 0.2 % and better.
const PIVOT_MIN: f64 = 1e-4;

/// A symmetric matrix of variable size, its lower triangle by rows.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Packed {
    pub values: Vec<f64>,
    pub size: usize,
}

fn start(row: usize) -> usize {
    row * (row + 1) / 2
}

impl Packed {
    /// Entry (row, column) of the symmetric matrix.
    pub fn at(&self, row: usize, column: usize) -> f64 {
        self.values[start(row.max(column)) + row.min(column)]
    }

    fn row(&self, row: usize) -> &[f64] {
        &self.values[start(row)..start(row + 1)]
    }

    /// Removes row and column `out`.
    pub fn remove(&mut self, out: usize) {
        let mut to = start(out);
        for row in out + 1..self.size {
            let from = start(row);
            self.values.copy_within(from..from + out, to);
            self.values.copy_within(from + out + 1..from + row + 1, to + out);
            to += row;
        }
        self.size -= 1;
        self.values.truncate(start(self.size));
    }
}

/// Active rows, in the order in which they were added, and the factor of W between them.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct ActiveSet {
    pub rows: Vec<u32>,
    pub factor: Packed,
    update: Vec<f64>,
}

impl ActiveSet {
    /// Activates a row of W; `false`, with nothing changed, where it is linearly dependent.
    pub fn append(&mut self, row: usize, w: &Packed) -> bool {
        self.append_above(row, w, PIVOT_MIN)
    }

    /// The same with another pivot threshold.
    pub fn append_above(&mut self, row: usize, w: &Packed, share: f64) -> bool {
        let size = self.factor.size;
        let begin = self.factor.values.len();
        let mut pivot = w.at(row, row);
        let least = share * pivot;
        for k in 0..size {
            let (known, new) = self.factor.values.split_at(begin);
            let of_k = &known[start(k)..start(k + 1)];
            let sum: f64 = of_k[..k].iter().zip(new).map(|(a, b)| a * b).sum();
            let entry = (w.at(row, self.rows[k] as usize) - sum) / of_k[k];
            self.factor.values.push(entry);
            pivot -= entry * entry;
        }
        if !(pivot > least && pivot.is_finite()) {
            self.factor.values.truncate(begin);
            return false;
        }
        self.factor.values.push(pivot.sqrt());
        self.factor.size += 1;
        self.rows.push(row as u32);
        true
    }

    /// Deactivates the row at this position.
    pub fn delete(&mut self, place: usize) {
        self.update.clear();
        for row in place + 1..self.factor.size {
            self.update.push(self.factor.values[start(row) + place]);
        }
        self.factor.remove(place);
        self.rows.remove(place);
        // The deleted column is added back to the rows below: L Lᵀ + x xᵀ, by Givens rotations.
        for column in place..self.factor.size {
            let x = self.update[column - place];
            let at = start(column) + column;
            let old = self.factor.values[at];
            let radius = old.hypot(x);
            let (cos, sin) = (old / radius, x / radius);
            self.factor.values[at] = radius;
            for row in column + 1..self.factor.size {
                let entry = &mut self.factor.values[start(row) + column];
                let other = &mut self.update[row - place];
                let turned = cos * *entry + sin * *other;
                *other = cos * *other - sin * *entry;
                *entry = turned;
            }
        }
    }

    /// Solves W x = b between the active rows, in place, in their order.
    pub fn solve(&self, b: &mut [f64]) {
        let size = self.factor.size;
        for row in 0..size {
            let of_row = self.factor.row(row);
            let sum: f64 = of_row[..row].iter().zip(&*b).map(|(l, x)| l * x).sum();
            b[row] = (b[row] - sum) / of_row[row];
        }
        for row in (0..size).rev() {
            let of_row = self.factor.row(row);
            b[row] /= of_row[row];
            let own = b[row];
            for (x, l) in b[..row].iter_mut().zip(of_row) {
                *x -= l * own;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{DMatrix, DVector};
    use proptest::prelude::*;

    fn packed(full: &DMatrix<f64>) -> Packed {
        let size = full.nrows();
        Packed { values: (0..size).flat_map(|r| (0..=r).map(move |c| full[(r, c)])).collect(), size }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(200))]
        /// After any additions and removals: the solution equals that of a new factorisation.
        #[test]
        fn the_factor_follows_what_comes_and_goes(
            numbers in prop::collection::vec(-1.0..1.0_f64, 144),
            order in prop::collection::vec((0..12_usize, any::<bool>()), 1..60),
        ) {
            let a = DMatrix::from_vec(12, 12, numbers);
            let full = &a * a.transpose() + DMatrix::identity(12, 12);
            let w = packed(&full);
            let mut active = ActiveSet::default();
            for (row, come) in order {
                match active.rows.iter().position(|&known| known as usize == row) {
                    Some(place) if !come => active.delete(place),
                    None if come => prop_assert!(active.append(row, &w)),
                    _ => {}
                }
            }
            let rows: Vec<usize> = active.rows.iter().map(|&row| row as usize).collect();
            let part = DMatrix::from_fn(rows.len(), rows.len(), |r, c| full[(rows[r], rows[c])]);
            let b = DVector::from_fn(rows.len(), |r, _| 1.0 + r as f64);
            let mut x = b.as_slice().to_vec();
            active.solve(&mut x);
            let back = part * DVector::from_vec(x) - b;
            prop_assert!(back.amax() < 1e-10, "{back}");
        }

        #[test]
        fn a_row_and_its_column_are_taken_away(out in 0..6_usize) {
            let full = DMatrix::from_fn(6, 6, |r, c| (10 * r.max(c) + r.min(c)) as f64);
            let mut w = packed(&full);
            w.remove(out);
            prop_assert_eq!(w, packed(&full.remove_row(out).remove_column(out)));
        }
    }

    #[test]
    fn a_row_that_says_nothing_new_is_refused() {
        let full = DMatrix::from_row_slice(2, 2, &[1.0, 1.0, 1.0, 1.000_01]);
        let w = packed(&full);
        let mut active = ActiveSet::default();
        assert!(active.append(0, &w));
        let before = active.clone();
        assert!(!active.append(1, &w));
        assert_eq!(active, before);
    }
}
