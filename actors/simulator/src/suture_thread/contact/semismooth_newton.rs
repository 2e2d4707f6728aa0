//! Forces of many coupled contacts by a semismooth Newton method on their regularised force laws (Alart, Curnier 1991,
//! for Coulomb's), on the assembled dense compliance.

use super::force_law::{ContactState, Equation, ForceLaw};
use crate::simd::dispatch::wide;

/// Maximum Newton steps from the warm-started forces.
const STEPS_MAX: usize = 24;
/// Compliance factors for numerical continuation where those steps cycle (Allgower, Georg 1990): the soft problem is
/// solved easily, and each solution starts the next, stiffer one.
pub(crate) const SOFTENING: [f64; 5] = [1e4, 1e3, 1e2, 1e1, 1.0];
/// Maximum number of single exchanges (Murty 1974) where contacts with bounds cycle.
const EXCHANGES_MAX: usize = 400;
/// During exchanges, a force violates its bounds only by more than this share of its magnitude, or of a newton.
const ROUNDING: f64 = 1e-10;
/// Maximum Newton steps with each of [`SOFTENING`].
const SOFTENED_STEPS_MAX: usize = 20;

/// One unknown of a Newton step.
#[derive(Clone, Copy, Debug)]
struct Unknown {
    place: usize,
    equation: Equation,
}

/// The problem `gap = offset + (W + C) force` with a force law at every contact, and its solution.
#[derive(Clone, Debug, Default)]
pub(crate) struct Complementarity {
    /// `W`, column by column, with `C` on its diagonal \[m/N\].
    pub compliance: Vec<f64>,
    /// Gaps of the rows with the forces, contact compliance included \[m\].
    pub gap: Vec<f64>,
    /// Initial guess, then the solution \[N\].
    pub force: Vec<f64>,
    /// Force law of each contact.
    pub rules: Vec<ForceLaw>,
    /// `C` of each contact \[m/N\].
    pub yields: Vec<[f64; 3]>,
    offset: Vec<f64>,
    state: Vec<ContactState>,
    unknowns: Vec<Unknown>,
    known: Vec<f64>,
    /// The forces with the smallest error so far.
    nearest: Vec<f64>,
    /// Row-major system matrix, with the right-hand side last.
    system: Vec<f64>,
    column: Vec<f64>,
}

impl Complementarity {
    /// Resets to this many contacts of three rows each; initial forces are 0.
    pub fn clear(&mut self, places: usize) {
        let rows = 3 * places;
        for (list, length) in
            [(&mut self.compliance, rows * rows), (&mut self.gap, rows), (&mut self.force, rows)]
        {
            list.clear();
            list.resize(length, 0.0);
        }
        self.rules.clear();
        self.yields.clear();
    }

    /// Finds forces whose error at each contact is at most `tolerance` \[m\], in at most `steps` Newton steps. Returns
    /// the number of steps; a number above `steps` means that it did not converge and the best forces are kept.
    pub fn solve(&mut self, steps: usize, tolerance: f64) -> usize {
        if self.error() <= tolerance {
            // A state at rest needs no step.
            return 0;
        }
        self.offset.clone_from(&self.gap);
        for row in 0..self.force.len() {
            if self.force[row] != 0.0 {
                let column = &self.compliance[row * self.force.len()..][..self.force.len()];
                add(&mut self.offset, column, -self.force[row]);
            }
        }
        self.state.clear();
        for place in 0..self.rules.len() {
            let (force, apart, yields) = (self.force(place), self.apart(place), self.yields[place]);
            self.state.push(self.rules[place].begin(force, apart, yields));
        }
        self.nearest.clone_from(&self.force);
        let mut least = f64::INFINITY;
        let (mut done, mut exchanges) = (0, 0);
        let has_ties = self.rules.iter().any(ForceLaw::is_bounded);
        let plain = std::iter::once((1.0, STEPS_MAX, false));
        let one_by_one = has_ties.then_some((1.0, EXCHANGES_MAX, true));
        let soft = SOFTENING.map(|softness| (softness, SOFTENED_STEPS_MAX, false));
        for (softness, most, one_by_one) in plain.chain(one_by_one).chain(soft) {
            for _ in 0..most {
                if (done >= steps && !one_by_one) || !self.newton(softness) {
                    break;
                }
                done += usize::from(!one_by_one);
                exchanges += usize::from(one_by_one);
                let error = self.error();
                if softness == 1.0 && error < least {
                    least = error;
                    self.nearest.clone_from(&self.force);
                    if error <= tolerance {
                        self.confine();
                        return done + exchanges;
                    }
                }
                if !self.next(softness, one_by_one) {
                    break;
                }
            }
        }
        self.force.clone_from(&self.nearest);
        self.confine();
        steps + exchanges + 1
    }

    /// The largest error over all contacts \[m\].
    pub fn error(&self) -> f64 {
        (0..self.rules.len()).map(|place| self.error_of(place)).fold(0.0, f64::max)
    }

    /// Error of a contact: the distance that it would have to move to satisfy its law \[m\].
    pub fn error_of(&self, place: usize) -> f64 {
        let (rows, at) = (self.force.len(), 3 * place);
        let mut own: [f64; 3] = std::array::from_fn(|k| self.compliance[(at + k) * (rows + 1)]);
        if matches!(self.rules[place], ForceLaw::Contact { .. } | ForceLaw::Skin { .. }) {
            own[1] = own[1].max(own[2]);
            own[2] = own[1];
        }
        let force = self.force(place);
        let wanted = self.rules[place].wanted(force, self.gap(place), own);
        let off: [f64; 3] = std::array::from_fn(|k| (wanted[k] - force[k]) * own[k]);
        let across = (off[1] * off[1] + off[2] * off[2]).sqrt();
        // NaN counts as an infinite error.
        if off[0].is_nan() || across.is_nan() { f64::INFINITY } else { off[0].abs().max(across) }
    }

    /// Forces and gaps of the linearised laws with compliances multiplied by `softness`. False where the system is
    /// singular.
    fn newton(&mut self, softness: f64) -> bool {
        let rows = self.force.len();
        self.unknowns.clear();
        self.known.clear();
        for (place, state) in self.state.iter().enumerate() {
            let unknowns = &mut self.unknowns;
            let push = |equation| unknowns.push(Unknown { place, equation });
            let known = self.rules[place].linearise(*state, self.yields[place], softness, push);
            self.known.extend(known);
        }
        // Gaps due to the known part of the forces.
        self.gap.clone_from(&self.offset);
        for (row, known) in self.known.iter().enumerate() {
            if *known != 0.0 {
                add(&mut self.gap, &self.compliance[row * rows..][..rows], *known);
            }
        }
        let count = self.unknowns.len();
        let width = count + 1;
        self.system.clear();
        self.system.resize(count * width, 0.0);
        for column in 0..count {
            let Unknown { place, equation } = self.unknowns[column];
            // Response of every row to this unknown.
            self.column.clear();
            self.column.resize(rows, 0.0);
            for (k, force) in equation.force.into_iter().enumerate() {
                if force != 0.0 {
                    add(&mut self.column, &self.compliance[(3 * place + k) * rows..][..rows], force);
                }
            }
            for (row, unknown) in self.unknowns.iter().enumerate() {
                self.system[row * width + column] = unknown.of(&self.column);
            }
            self.system[column * width + column] += equation.yields;
        }
        for (row, unknown) in self.unknowns.iter().enumerate() {
            self.system[row * width + count] = -unknown.of(&self.gap);
        }
        if !eliminate(&mut self.system, count) {
            return false;
        }
        self.force.clone_from(&self.known);
        for (row, unknown) in self.unknowns.iter().enumerate() {
            let size = self.system[row * width + count];
            for k in 0..3 {
                self.force[3 * unknown.place + k] += unknown.equation.force[k] * size;
            }
        }
        self.gap.clone_from(&self.offset);
        for row in 0..rows {
            if self.force[row] != 0.0 {
                add(&mut self.gap, &self.compliance[row * rows..][..rows], self.force[row]);
            }
        }
        true
    }

    /// The active set for the next step; with `one_by_one`, only one of the bounded contacts may change. Returns
    /// whether anything changed.
    fn next(&mut self, softness: f64, one_by_one: bool) -> bool {
        let (mut changed, mut exchanged) = (false, false);
        for place in 0..self.state.len() {
            let (law, now, before) = (self.rules[place], self.force(place), self.state[place]);
            let (force, found) =
                law.of(self.apart(place), self.yields[place].map(|yields| softness * yields));
            let mut next = law.next(before, found);
            let lacking = (0..3).fold(0.0, |most, k| f64::max(most, (force[k] - now[k]).abs()));
            if one_by_one && law.is_bounded() && !before.is_like(&next) {
                let size = force.iter().fold(1.0, |most, force| f64::max(most, force.abs()));
                if exchanged || lacking < ROUNDING * size {
                    continue;
                }
                next = before.exchanged(&next);
                exchanged = true;
            }
            changed |= next != before && lacking > 0.0;
            self.state[place] = next;
        }
        changed
    }

    /// Projects each force onto those that its law allows, removing violations within the tolerance.
    fn confine(&mut self) {
        for (force, law) in self.force.chunks_exact_mut(3).zip(&self.rules) {
            force.copy_from_slice(&law.confined([force[0], force[1], force[2]]));
        }
    }

    /// The gaps of a contact's three rows \[m\].
    pub fn gap(&self, place: usize) -> [f64; 3] {
        std::array::from_fn(|k| self.gap[3 * place + k])
    }

    /// The force of a contact \[N\].
    pub fn force(&self, place: usize) -> [f64; 3] {
        std::array::from_fn(|k| self.force[3 * place + k])
    }

    /// Separation of a contact's surfaces, without its own compliance \[m\].
    fn apart(&self, place: usize) -> [f64; 3] {
        let yields = self.yields[place];
        std::array::from_fn(|k| self.gap[3 * place + k] - yields[k] * self.force[3 * place + k])
    }
}

impl Unknown {
    /// Applies a contact's equation to these three rows.
    #[inline]
    fn of(&self, rows: &[f64]) -> f64 {
        let at = &rows[3 * self.place..][..3];
        let along = &self.equation.along;
        along[0] * at[0] + along[1] * at[1] + along[2] * at[2]
    }
}

/// Width of the panels in the elimination.
const PANEL: usize = 4;

/// Solves a system in place by Gaussian elimination with row pivoting, in panels of a few columns; the solution is left
/// in the last column. False where the system is singular.
fn eliminate(system: &mut [f64], count: usize) -> bool {
    wide(
        #[inline(always)]
        || eliminate_here(system, count),
    )
}

#[inline(always)]
fn eliminate_here(system: &mut [f64], count: usize) -> bool {
    let width = count + 1;
    for first in (0..count).step_by(PANEL) {
        let last = (first + PANEL).min(count);
        for pivot in first..last {
            let size = |row: usize| system[row * width + pivot].abs();
            let best = (pivot..count).max_by(|&a, &b| size(a).total_cmp(&size(b))).unwrap_or(pivot);
            let value = system[best * width + pivot];
            if !value.is_finite() || value == 0.0 {
                return false;
            }
            if best != pivot {
                let (above, below) = system.split_at_mut(best * width);
                above[pivot * width..][..width].swap_with_slice(&mut below[..width]);
            }
            let (above, below) = system.split_at_mut((pivot + 1) * width);
            let of = &above[pivot * width..];
            for values in below.chunks_exact_mut(width) {
                let factor = values[pivot] / value;
                values[pivot] = factor;
                add(&mut values[pivot + 1..last], &of[pivot + 1..last], -factor);
            }
        }
        let (above, below) = system.split_at_mut(last * width);
        let panel = &mut above[first * width..];
        for row in 1..last - first {
            let (before, values) = panel.split_at_mut(row * width);
            for (k, of) in before.chunks_exact(width).enumerate() {
                let factor = values[first + k];
                add(&mut values[last..width], &of[last..], -factor);
            }
        }
        if last - first < PANEL {
            continue;
        }
        let [a, b, c, d] = std::array::from_fn(|k| &above[(first + k) * width + last..][..width - last]);
        for row in below.chunks_exact_mut(width) {
            let (factors, row) = row[first..].split_at_mut(PANEL);
            for ((((x, a), b), c), d) in row.iter_mut().zip(a).zip(b).zip(c).zip(d) {
                *x -= factors[0] * a + factors[1] * b + factors[2] * c + factors[3] * d;
            }
        }
    }
    for row in (0..count).rev() {
        let mut value = system[row * width + count];
        for column in row + 1..count {
            value -= system[row * width + column] * system[column * width + count];
        }
        system[row * width + count] = value / system[row * width + row];
    }
    true
}

#[inline(always)]
fn add(sum: &mut [f64], column: &[f64], factor: f64) {
    for (sum, value) in sum.iter_mut().zip(column) {
        *sum += value * factor;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// One contact on a body with isotropic compliance.
    fn single(offset: [f64; 3], friction: f64) -> Complementarity {
        let mut problem = Complementarity::default();
        problem.clear(1);
        problem.rules.push(ForceLaw::Contact { friction });
        problem.yields.push([1e-6; 3]);
        for k in 0..3 {
            problem.compliance[4 * k] = 1e-3;
        }
        problem.gap.copy_from_slice(&offset);
        problem
    }

    #[test]
    fn a_contact_pushes_sticks_slides_or_is_open() {
        let coulomb = 0.5;
        let mut open = single([1e-3, 1e-3, 0.0], coulomb);
        open.solve(10, 1e-12);
        assert_eq!(open.force, [0.0; 3]);
        let mut sticks = single([-2e-3, 0.6e-3, -0.6e-3], coulomb);
        sticks.solve(10, 1e-12);
        assert!(sticks.gap(0).iter().all(|gap| gap.abs() < 1e-15) && (sticks.force[0] - 2.0).abs() < 1e-12);
        let mut slides = single([-2e-3, 3e-3, -4e-3], coulomb);
        slides.solve(10, 1e-12);
        assert!((slides.force[1].hypot(slides.force[2]) - 1.0).abs() < 1e-12);
        assert!((slides.gap(0)[1] - 2.4e-3).abs() < 1e-12 && (slides.gap(0)[2] + 3.2e-3).abs() < 1e-12);
    }

    #[test]
    fn a_chain_of_contacts_ends_where_every_law_holds() {
        // Neighbouring contacts are coupled through a common body.
        let places = 12;
        let rows = 3 * places;
        let mut problem = Complementarity::default();
        problem.clear(places);
        for r in 0..rows {
            for c in 0..rows {
                let near = (-((r / 3) as f64 - (c / 3) as f64).abs() / 2.0).exp();
                problem.compliance[c * rows + r] = if r % 3 == c % 3 { near } else { 0.1 * near };
            }
            problem.gap[r] = ((r * 7 % 11) as f64 - 5.5) * 0.1;
        }
        problem.rules = vec![ForceLaw::Contact { friction: 0.3 }; places];
        problem.yields = vec![[1e-3; 3]; places];
        problem.solve(300, 1e-12);
        for place in 0..places {
            let (force, gap) = (&problem.force[3 * place..][..3], problem.gap(place));
            assert!(force[0] >= 0.0 && gap[0] > -1e-9 && (force[0] * gap[0]).abs() < 1e-9);
            let held = force[1].hypot(force[2]);
            assert!(held <= 0.3 * force[0] + 1e-12);
            if held < 0.3 * force[0] - 1e-9 {
                assert!(gap[1].hypot(gap[2]) < 1e-8, "sticks without holding still");
            }
        }
    }

    #[test]
    fn places_with_bounds_end_at_them_or_hold() {
        use nalgebra::DMatrix;
        use rand::{Rng, SeedableRng};
        let mut random = rand_pcg::Pcg64Mcg::seed_from_u64(11);
        let places = 9;
        let rows = 3 * places;
        for case in 0..40 {
            let mut problem = Complementarity::default();
            problem.clear(places);
            let any = DMatrix::from_fn(rows, rows, |_, _| random.random_range(-1.0..1.0));
            let whole = &any * any.transpose() + DMatrix::identity(rows, rows) * 0.01;
            problem.compliance.copy_from_slice(whole.as_slice());
            problem.gap.iter_mut().for_each(|gap| *gap = random.random_range(-1.0..1.0));
            problem.yields = vec![[1e-6; 3]; places];
            problem.rules = (0..places)
                .map(|place| match place % 3 {
                    0 => ForceLaw::Within { least: [-0.1, -1.0, 0.0], most: [0.0, 1.0, 0.2] },
                    1 => ForceLaw::Passes { base: 0.05, friction: 0.1 },
                    _ => ForceLaw::HELD,
                })
                .collect();
            problem.solve(200, 1e-10);
            assert!(problem.error() < 1e-9, "case {case}: {}", problem.error());
            for place in 0..places {
                let (force, gap) = (problem.force(place), problem.gap(place));
                if let ForceLaw::Within { least, most } = problem.rules[place] {
                    for k in 0..3 {
                        // At a bound it is pushed on, in between it holds.
                        let holds = gap[k].abs() < 1e-9;
                        let pushed =
                            (force[k] == least[k] && gap[k] > 0.0) || (force[k] == most[k] && gap[k] < 0.0);
                        assert!(holds || pushed, "case {case}: {} N, {} m", force[k], gap[k]);
                    }
                }
            }
        }
    }

    #[test]
    fn panels_and_wide_registers_solve_what_elimination_solves() {
        use nalgebra::DMatrix;
        use rand::{Rng, SeedableRng};
        for count in [1, 3, 4, 5, 8, 23] {
            let mut random = rand_pcg::Pcg64Mcg::seed_from_u64(count as u64);
            let system: Vec<f64> = (0..count * (count + 1)).map(|_| random.random_range(-1.0..1.0)).collect();
            let dense = DMatrix::from_row_slice(count, count + 1, &system);
            let expected = dense
                .columns(0, count)
                .into_owned()
                .lu()
                .solve(&dense.column(count).into_owned())
                .expect("regular");
            let (mut plain, mut wide) = (system.clone(), system);
            assert!(eliminate_here(&mut plain, count) && eliminate(&mut wide, count));
            assert_eq!(plain, wide, "the same to the bit");
            for row in 0..count {
                assert!((wide[row * (count + 1) + count] - expected[row]).abs() < 1e-9, "{row} of {count}");
            }
        }
    }

    #[test]
    fn what_has_no_solution_is_left_where_it_was() {
        let mut nothing = single([-1e-3, 1e-3, 0.0], 0.3);
        nothing.compliance[4] = f64::NAN;
        assert_eq!(nothing.solve(10, 1e-12), 11);
        assert_eq!(nothing.force, [0.0; 3]);
    }
}
