//! Forces of rows that hold, push or rub, through everything that is between them: `gap = gap₀ + W force`, with each row's
//! force within bounds and its gap against it where it is at one (a box-constrained least-squares problem, solved by a
//! primal–dual active set: Hintermüller, Ito, Kunisch 2003; by single exchanges, Murty 1974, where that goes in circles).
//! Bounds of friction follow what presses, and are found anew until they are the ones that were used.

/// Rounds over the bounds of friction at most.
const FRICTION_ROUNDS: usize = 24;
/// Exchanges of all rows at once before they are made one by one.
const BLOCK_ROUNDS: usize = 12;
/// By as little, a force is not beyond its bound \[N\], and a gap not against it \[m\]: else what is just at its limit comes
/// and goes by rounding.
const ROUNDING: f64 = 1e-11;
/// Rounds after which bounds go only half of the way to what they should be, so that they do not swing.
const SWINGS: usize = 4;
/// Bounds of friction are found when they change by less than this share, or this \[N\].
const BOUND_TOLERANCE: f64 = 1e-6;
const BOUND_LEAST: f64 = 1e-9;

/// What a row may do.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Law {
    /// Holds with any force.
    Held,
    /// Holds with a force in these bounds \[N\], or gives way with one of them.
    Within { least: f64, most: f64 },
    /// Sticks up to a force `base` \[N\] and `coefficient` times what presses in two other rows, and slides with that.
    Rubs { base: f64, coefficient: f64, by: [u32; 2] },
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum At {
    Free,
    Least,
    Most,
}

/// The problem and its solution.
#[derive(Clone, Debug, Default)]
pub(super) struct Bounded {
    /// `W`, symmetric, row by row \[m/N\].
    pub compliance: Vec<f64>,
    /// Without forces \[m\].
    pub gap: Vec<f64>,
    pub laws: Vec<Law>,
    /// Where to begin, then the solution \[N\].
    pub force: Vec<f64>,
    bounds: Vec<[f64; 2]>,
    at: Vec<At>,
    free: Vec<usize>,
    factor: Vec<f64>,
    right: Vec<f64>,
}

/// How a problem was solved.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Solved {
    /// Factorisations.
    pub rounds: usize,
    /// Whether every row obeys its law.
    pub settled: bool,
}

impl Bounded {
    /// Of so many rows, all zero.
    pub fn clear(&mut self, rows: usize) {
        self.compliance.clear();
        self.compliance.resize(rows * rows, 0.0);
        for list in [&mut self.gap, &mut self.force] {
            list.clear();
            list.resize(rows, 0.0);
        }
        self.laws.clear();
    }

    /// Forgets which rows gave way; else a problem of as many rows begins with those of the last one.
    pub fn forget(&mut self) {
        self.at.clear();
    }

    /// Whether a row gives way: its force is at a bound.
    pub fn gives_way(&self, row: usize) -> bool {
        self.at[row] != At::Free
    }

    /// The gap of a row with the forces \[m\].
    pub fn gap_of(&self, row: usize) -> f64 {
        let rows = self.force.len();
        let through: f64 =
            self.compliance[row * rows..][..rows].iter().zip(&self.force).map(|(w, f)| w * f).sum();
        self.gap[row] + through
    }

    /// Finds forces that obey every law; not settled where that took too many rounds or a number is none.
    pub fn solve(&mut self) -> Solved {
        let rows = self.laws.len();
        if self.at.len() != rows {
            self.at.clear();
            self.at.resize(rows, At::Free);
        }
        self.bounds.clear();
        self.bounds.resize(rows, [f64::NEG_INFINITY, f64::INFINITY]);
        for row in 0..rows {
            if self.laws[row] == Law::Held {
                self.at[row] = At::Free;
            }
        }
        let mut solved = Solved::default();
        for round in 0..FRICTION_ROUNDS {
            let moved = self.bound(if round < SWINGS { 1.0 } else { 0.5 });
            if solved.rounds > 0 && !moved {
                solved.settled = self.force.iter().all(|force| force.is_finite());
                return solved;
            }
            if !self.exchange(&mut solved.rounds) {
                return solved;
            }
        }
        // The bounds are those of the round before: what is left is a friction's change from one to the next.
        solved.settled = self.force.iter().all(|force| force.is_finite());
        solved
    }

    /// Bounds from the forces; says whether one has moved.
    fn bound(&mut self, share: f64) -> bool {
        let mut moved = false;
        for row in 0..self.laws.len() {
            let bounds = match self.laws[row] {
                Law::Held => continue,
                Law::Within { least, most } => [least, most],
                Law::Rubs { base, coefficient, by } => {
                    let [first, second] = by.map(|row| self.force[row as usize]);
                    let presses = if by[0] == by[1] { first.abs() } else { first.hypot(second) };
                    let most = base + coefficient * presses;
                    [-most, most]
                }
            };
            let before = self.bounds[row];
            let differs = |k: usize| {
                let by = (bounds[k] - before[k]).abs();
                bounds[k] != before[k]
                    && (by.is_nan() || by > BOUND_TOLERANCE * bounds[k].abs() + BOUND_LEAST)
            };
            moved |= differs(0) || differs(1);
            self.bounds[row] = if share < 1.0 && before[0].is_finite() && before[1].is_finite() {
                [0, 1].map(|k| before[k] + share * (bounds[k] - before[k]))
            } else {
                bounds
            };
        }
        moved
    }

    /// Solves for the bounds as they are.
    fn exchange(&mut self, rounds: &mut usize) -> bool {
        let rows = self.laws.len();
        for round in 0..BLOCK_ROUNDS + 8 * rows {
            *rounds += 1;
            if !self.held() {
                return false;
            }
            let mut changed = false;
            for row in 0..rows {
                let [least, most] = self.bounds[row];
                let slack = ROUNDING * (1.0 + most.abs().min(least.abs()));
                let next = match self.at[row] {
                    At::Free if self.force[row] > most + slack => At::Most,
                    At::Free if self.force[row] < least - slack => At::Least,
                    At::Most if self.gap_of(row) > ROUNDING && least < most => At::Free,
                    At::Least if self.gap_of(row) < -ROUNDING && least < most => At::Free,
                    at => at,
                };
                if next != self.at[row] {
                    self.at[row] = next;
                    changed = true;
                    if round >= BLOCK_ROUNDS {
                        break;
                    }
                }
            }
            if !changed {
                return true;
            }
        }
        false
    }

    /// Forces of the rows that hold, with the others at their bounds. False where there are none.
    fn held(&mut self) -> bool {
        let rows = self.laws.len();
        self.free.clear();
        for row in 0..rows {
            match self.at[row] {
                At::Free => self.free.push(row),
                At::Least => self.force[row] = self.bounds[row][0],
                At::Most => self.force[row] = self.bounds[row][1],
            }
        }
        let size = self.free.len();
        self.factor.clear();
        self.right.clear();
        for (i, &row) in self.free.iter().enumerate() {
            let of = &self.compliance[row * rows..][..rows];
            self.factor.extend(self.free[..=i].iter().map(|&column| of[column]));
            let by_bounds: f64 = (0..rows)
                .filter(|&other| self.at[other] != At::Free)
                .map(|other| of[other] * self.force[other])
                .sum();
            self.right.push(-self.gap[row] - by_bounds);
        }
        // Cholesky, packed by rows.
        let start = |row: usize| row * (row + 1) / 2;
        for i in 0..size {
            for j in 0..=i {
                let (above, own) = self.factor.split_at(start(i));
                let of_j = if j == i { &own[..j] } else { &above[start(j)..start(j) + j] };
                let sum: f64 = own[..j].iter().zip(of_j).map(|(a, b)| a * b).sum();
                let value = self.factor[start(i) + j] - sum;
                self.factor[start(i) + j] = if j < i {
                    value / self.factor[start(j) + j]
                } else if value > 0.0 {
                    value.sqrt()
                } else {
                    return false;
                };
            }
        }
        for i in 0..size {
            let of = &self.factor[start(i)..start(i) + i];
            let sum: f64 = of.iter().zip(&self.right).map(|(l, x)| l * x).sum();
            self.right[i] = (self.right[i] - sum) / self.factor[start(i) + i];
        }
        for i in (0..size).rev() {
            self.right[i] /= self.factor[start(i) + i];
            let own = self.right[i];
            for j in 0..i {
                self.right[j] -= self.factor[start(i) + j] * own;
            }
        }
        for (&row, &force) in self.free.iter().zip(&self.right) {
            self.force[row] = force;
        }
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{Rng, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    /// Random rows that act on each other, every third of them friction on the two before.
    fn problem(seed: u64, rows: usize, coefficient: f64) -> Bounded {
        let mut random = Pcg64Mcg::seed_from_u64(seed);
        let mut problem = Bounded::default();
        problem.clear(rows);
        let factor: Vec<f64> = (0..rows * rows).map(|_| random.random_range(-1.0..1.0)).collect();
        for i in 0..rows {
            for j in 0..rows {
                let product: f64 = (0..rows).map(|k| factor[i * rows + k] * factor[j * rows + k]).sum();
                problem.compliance[i * rows + j] = product / rows as f64 + if i == j { 0.5 } else { 0.0 };
            }
            problem.gap[i] = random.random_range(-2.0..2.0);
            problem.laws.push(match i % 3 {
                0 => Law::Within { least: 0.0, most: f64::INFINITY },
                1 => Law::Held,
                _ => Law::Rubs { base: 0.1, coefficient, by: [i as u32 - 2, i as u32 - 1] },
            });
        }
        problem
    }

    #[test]
    fn every_law_is_obeyed() {
        for seed in 0..200 {
            let mut problem = problem(seed, 30, 0.2);
            let solved = problem.solve();
            assert!(solved.settled, "seed {seed}: {solved:?}");
            for row in 0..30 {
                let (force, gap) = (problem.force[row], problem.gap_of(row));
                match problem.laws[row] {
                    Law::Held => assert!(gap.abs() < 1e-9),
                    Law::Within { .. } => {
                        assert!(force >= 0.0 && gap > -1e-9 && (force * gap).abs() < 1e-8);
                    }
                    Law::Rubs { base, coefficient, by } => {
                        let [a, b] = by.map(|row| problem.force[row as usize]);
                        let most = base + coefficient * a.hypot(b);
                        assert!(force.abs() <= most * (1.0 + 1e-6) + 1e-9, "{force} of {most}");
                        if force.abs() < most * (1.0 - 1e-5) {
                            assert!(gap.abs() < 1e-9, "seed {seed} row {row} sticks with a gap of {gap}");
                        } else {
                            assert!(force * gap <= 1e-9, "friction drives");
                        }
                    }
                }
            }
        }
    }

    #[test]
    fn what_is_no_number_is_not_settled() {
        let mut problem = problem(1, 9, 0.1);
        problem.gap[1] = f64::NAN;
        assert!(!problem.solve().settled);
        let mut problem = self::problem(1, 9, 0.1);
        problem.compliance[0] = -5.0;
        problem.laws[0] = Law::Held;
        assert!(!problem.solve().settled);
    }
}
