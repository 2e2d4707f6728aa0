//! Direct solve of what jaws hold: all contacts of an island as one system of equations, with an active set.
//!
//! Jaws that squeeze a light body with a strong drive are the worst case of sequential impulses: each iteration passes
//! on from one pad to the other only the share of the impulse that the body's mass has in that of the jaws, and with a
//! thousand times its weight between the pads, hundreds of iterations are not enough for friction to hold it. Few
//! contacts take part, so elimination is cheap. A contact sticks (no velocity), slides (no normal velocity, friction at
//! the limit of its cone against the slip) or is open; the set is corrected until it agrees with its solution (Moreau,
//! *Unilateral contact and dry friction*, 1988; active sets as in Baraff, *Fast contact force computation*, 1994).
//! Sequential impulses go on from there, so that a set that does not settle costs time and nothing else.

use nalgebra::{Matrix3, Vector3};

use super::contact_constraint::{Row, Twist};
use super::jaw_joint::{Joint, Turning};

/// Maximum number of contacts.
pub(super) const ROWS_MAX: usize = 24;
/// Maximum corrections of the set.
const ROUNDS_MAX: usize = 12;
/// Compliance of each contact, in units of its own mobility: among the solutions of a body that is held by more contacts
/// than it takes, it picks the one that spreads the load evenly.
const SPREAD: f64 = 1e-9;
/// A velocity that counts as none \[m/s\].
const STILL: f64 = 1e-7;
/// A change of a slip's direction that counts as none.
const SAME_DIRECTION: f64 = 1e-4;

#[derive(Clone, Copy, Debug, PartialEq)]
enum Kind {
    Open,
    Sticks,
    /// Friction's direction on the first body.
    Slides(Vector3<f64>),
}

/// Buffers of the solve.
#[derive(Clone, Debug, Default)]
pub(super) struct DirectGrasp {
    kinds: Vec<Kind>,
    /// Velocity of each contact per impulse on each other one.
    mobility: Vec<Matrix3<f64>>,
    /// Velocity of each contact without any impulse.
    free: Vec<Vector3<f64>>,
    impulses: Vec<Vector3<f64>>,
    /// Where each contact's unknowns begin.
    begins: Vec<usize>,
    /// The equations, each with its right side at its end.
    equations: Vec<f64>,
    unknowns: Vec<f64>,
}

impl DirectGrasp {
    /// Solves an island, and returns whether its set has settled; otherwise nothing changes but drives at their limits.
    #[allow(clippy::too_many_arguments)] // the island, and its velocities
    pub fn solve(
        &mut self,
        rows: &mut [Row],
        of_rows: &[u32],
        joints: &[Joint],
        of_joints: &[u32],
        dt: f64,
        twists: &mut [Twist],
        turning: &mut [Turning],
    ) -> bool {
        let count = of_rows.len();
        for &joint in of_joints {
            turning[joint as usize].saturate(&joints[joint as usize], dt);
        }
        let row = |index: usize| of_rows[index] as usize;
        self.mobility.clear();
        for i in 0..count {
            self.mobility.extend((0..count).map(|j| rows[row(i)].mobility(&rows[row(j)], turning)));
        }
        self.free.clear();
        for i in 0..count {
            let pushed: Vector3<f64> =
                (0..count).map(|j| self.mobility[i * count + j] * rows[row(j)].impulse()).sum();
            self.free.push(rows[row(i)].speed(twists, turning) - pushed);
        }
        self.kinds.clear();
        self.kinds
            .extend((0..count).map(|i| if rows[row(i)].is_loaded() { Kind::Sticks } else { Kind::Open }));
        let settled = (0..ROUNDS_MAX).any(|_| self.eliminate(rows, of_rows) && !self.correct(rows, of_rows));
        if settled {
            for (&row, impulse) in of_rows.iter().zip(&self.impulses) {
                rows[row as usize].take(impulse, twists, turning);
            }
        }
        settled
    }

    /// Finds the impulses of the present set; `false` where it has no solution.
    fn eliminate(&mut self, rows: &[Row], of_rows: &[u32]) -> bool {
        let count = of_rows.len();
        self.begins.clear();
        let mut size = 0;
        for kind in &self.kinds {
            self.begins.push(size);
            size += match kind {
                Kind::Open => 0,
                Kind::Sticks => 3,
                Kind::Slides(_) => 1,
            };
        }
        let width = size + 1;
        self.equations.clear();
        self.equations.resize(size * width, 0.0);
        let contacts = || of_rows.iter().map(|row| &rows[*row as usize]).enumerate();
        for (i, row) in contacts() {
            let wanted = row.target() - self.free[i];
            let at = self.begins[i];
            for (j, other) in contacts() {
                let block = &self.mobility[i * count + j];
                let to = self.begins[j];
                let own = if i == j { block.trace() / 3.0 * SPREAD + row.softness() } else { 0.0 };
                match (self.kinds[i], self.kinds[j]) {
                    (Kind::Open, _) | (_, Kind::Open) => {}
                    (Kind::Sticks, Kind::Sticks) => {
                        for a in 0..3 {
                            for b in 0..3 {
                                let soft = if a == b { own } else { 0.0 };
                                self.equations[(at + a) * width + to + b] = block[(a, b)] + soft;
                            }
                        }
                    }
                    (Kind::Sticks, Kind::Slides(along)) => {
                        let speed = block * (other.normal + along * other.friction());
                        for a in 0..3 {
                            self.equations[(at + a) * width + to] = speed[a];
                        }
                    }
                    (Kind::Slides(_), Kind::Sticks) => {
                        for b in 0..3 {
                            self.equations[at * width + to + b] = row.normal.dot(&block.column(b));
                        }
                    }
                    (Kind::Slides(_), Kind::Slides(along)) => {
                        let speed = block * (other.normal + along * other.friction());
                        self.equations[at * width + to] = row.normal.dot(&speed) + own;
                    }
                }
            }
            match self.kinds[i] {
                Kind::Open => {}
                Kind::Sticks => (0..3).for_each(|a| self.equations[(at + a) * width + size] = wanted[a]),
                Kind::Slides(_) => self.equations[at * width + size] = row.normal.dot(&wanted),
            }
        }
        if !eliminate(&mut self.equations, size, &mut self.unknowns) {
            return false;
        }
        self.impulses.clear();
        for (i, row) in contacts() {
            let found = &self.unknowns[self.begins[i]..];
            self.impulses.push(match self.kinds[i] {
                Kind::Open => Vector3::zeros(),
                Kind::Sticks => Vector3::new(found[0], found[1], found[2]),
                Kind::Slides(along) => (row.normal + along * row.friction()) * found[0],
            });
        }
        true
    }

    /// Corrects the set by the impulses found; returns whether anything changed.
    fn correct(&mut self, rows: &[Row], of_rows: &[u32]) -> bool {
        let count = of_rows.len();
        let mut has_changed = false;
        for (i, row) in of_rows.iter().map(|row| &rows[*row as usize]).enumerate() {
            let pushed: Vector3<f64> =
                (0..count).map(|j| self.mobility[i * count + j] * self.impulses[j]).sum();
            let speed = self.free[i] + pushed;
            let impulse = self.impulses[i];
            let along = impulse.dot(&row.normal);
            let across = impulse - row.normal * along;
            let slip = speed - row.normal * speed.dot(&row.normal);
            let next = match self.kinds[i] {
                Kind::Open if speed.dot(&row.normal) < row.wanted - STILL => Kind::Sticks,
                Kind::Open => Kind::Open,
                _ if along < 0.0 => Kind::Open,
                Kind::Sticks => match across.try_normalize(row.friction() * along * (1.0 + 1e-9)) {
                    Some(against) => Kind::Slides(against),
                    None => Kind::Sticks,
                },
                Kind::Slides(before) => match slip.try_normalize(STILL) {
                    Some(slip) if slip.dot(&before) > 0.0 => Kind::Sticks,
                    Some(slip) if (slip + before).norm() > SAME_DIRECTION => Kind::Slides(-slip),
                    _ => Kind::Slides(before),
                },
            };
            has_changed |= next != self.kinds[i];
            self.kinds[i] = next;
        }
        has_changed
    }
}

/// Gaussian elimination with partial pivoting of `size` equations, each followed by its right side. Returns whether they
/// have a solution.
fn eliminate(equations: &mut [f64], size: usize, unknowns: &mut Vec<f64>) -> bool {
    let width = size + 1;
    for step in 0..size {
        let largest = |row: &usize| equations[row * width + step].abs();
        let pivot = (step..size).max_by(|a, b| largest(a).total_cmp(&largest(b))).unwrap_or(step);
        if largest(&pivot) < f64::MIN_POSITIVE {
            return false;
        }
        if pivot != step {
            (0..width).for_each(|column| equations.swap(step * width + column, pivot * width + column));
        }
        let (done, rest) = equations.split_at_mut((step + 1) * width);
        let top = &done[step * width + step..];
        for row in rest.chunks_exact_mut(width) {
            let share = row[step] / top[0];
            if share != 0.0 {
                row[step..].iter_mut().zip(top).for_each(|(x, y)| *x -= share * y);
            }
        }
    }
    unknowns.clear();
    unknowns.resize(size, 0.0);
    for step in (0..size).rev() {
        let row = &equations[step * width..][..width];
        let known: f64 = row[step + 1..size].iter().zip(&unknowns[step + 1..]).map(|(a, x)| a * x).sum();
        unknowns[step] = (row[size] - known) / row[step];
    }
    unknowns.iter().all(|x| x.is_finite())
}

#[cfg(test)]
mod tests {
    use super::eliminate;

    #[test]
    fn elimination_finds_the_solution_also_where_a_pivot_is_zero() {
        // 0x + 2y = 4, 3x + y = 5, with z = 7 apart.
        let mut equations = vec![0.0, 2.0, 0.0, 4.0, 3.0, 1.0, 0.0, 5.0, 0.0, 0.0, 2.0, 14.0];
        let mut unknowns = Vec::new();
        assert!(eliminate(&mut equations, 3, &mut unknowns));
        assert_eq!(unknowns, [1.0, 2.0, 7.0]);
        assert!(!eliminate(&mut [1.0, 1.0, 1.0, 2.0, 2.0, 2.0], 2, &mut unknowns), "of rank one");
    }
}
