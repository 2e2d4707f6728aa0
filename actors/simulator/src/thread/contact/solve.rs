//! Forces of many contacts that act on each other through one elastic body: nonlinear block Gauss–Seidel over
//! Coulomb's law (Jourdan, Alart, Jean 1998) on the assembled compliance, with conjugate steps.

/// The problem `gap = gap₀ + (W + C) (force − force₀)`, and its solution.
#[derive(Clone, Debug, Default)]
pub(crate) struct Complementarity {
    /// `W`, column by column, then with the compliance of the contacts on its diagonal \[m/N\].
    pub compliance: Vec<f64>,
    /// What the rows are with the forces, the yielding of the contacts included \[m\].
    pub gap: Vec<f64>,
    /// Where to begin, then the solution \[N\].
    pub force: Vec<f64>,
    /// Of each place: the first row pushes only, the other two hold up to this times that push.
    pub frictions: Vec<f64>,
    /// Forces before the sweep, and the last step.
    start: Vec<f64>,
    direction: Vec<f64>,
}

impl Complementarity {
    /// For so many places of three rows each; the force to begin at is 0.
    pub fn clear(&mut self, places: usize) {
        let rows = 3 * places;
        for (list, length) in
            [(&mut self.compliance, rows * rows), (&mut self.gap, rows), (&mut self.force, rows)]
        {
            list.clear();
            list.resize(length, 0.0);
        }
        self.frictions.clear();
    }

    /// Improves the forces until a sweep moves no place by more than `tolerance` \[m\], with at most so many `sweeps`. Says
    /// how many.
    ///
    /// A sweep is a step of descent, and successive steps are made conjugate (Silcowitz, Niebe, Erleben 2010): sweeps
    /// alone need as many as there are contacts, squared, before the tension of a strand that all of them hold has
    /// settled; so it is about as many as there are contacts.
    pub fn solve(&mut self, sweeps: usize, tolerance: f64) -> usize {
        let rows = self.force.len();
        self.direction.clear();
        self.direction.resize(rows, 0.0);
        let mut before = 0.0_f64;
        for sweep in 1..=sweeps {
            self.start.clone_from(&self.force);
            let largest = self.sweep();
            if largest <= tolerance || sweep == sweeps {
                return sweep;
            }
            let square: f64 = self.force.iter().zip(&self.start).map(|(a, b)| (a - b) * (a - b)).sum();
            let keep = if before > 0.0 && square <= before { square / before } else { 0.0 };
            before = square;
            for row in 0..rows {
                let along = keep * self.direction[row];
                self.direction[row] = along + self.force[row] - self.start[row];
                if along != 0.0 {
                    self.force[row] += along;
                    add(&mut self.gap, &self.compliance[row * rows..][..rows], along);
                }
            }
        }
        sweeps
    }

    /// There and back again, so that a strand passes what it feels on in either direction; how far a place moved at most.
    fn sweep(&mut self) -> f64 {
        let mut largest = 0.0_f64;
        for place in 0..self.frictions.len() {
            largest = largest.max(self.relax(place));
        }
        for place in (0..self.frictions.len()).rev() {
            largest = largest.max(self.relax(place));
        }
        largest
    }

    /// Solves one place with the others as they are; returns how far it moved \[m\].
    fn relax(&mut self, place: usize) -> f64 {
        let (rows, at) = (self.force.len(), 3 * place);
        let w = |row: usize, column: usize| self.compliance[(at + column) * rows + at + row];
        let before = [self.force[at], self.force[at + 1], self.force[at + 2]];
        let gap = [self.gap[at], self.gap[at + 1], self.gap[at + 2]];
        let normal = (before[0] - gap[0] / w(0, 0)).max(0.0);
        let pushed = normal - before[0];
        let (g1, g2) = (gap[1] + w(1, 0) * pushed, gap[2] + w(2, 0) * pushed);
        let determinant = w(1, 1) * w(2, 2) - w(1, 2) * w(2, 1);
        let first = before[1] - (w(2, 2) * g1 - w(1, 2) * g2) / determinant;
        let second = before[2] - (w(1, 1) * g2 - w(2, 1) * g1) / determinant;
        let (size, most) = (first.hypot(second), self.frictions[place] * normal);
        let scale = if size > most { most / size } else { 1.0 };
        let after = [normal, first * scale, second * scale];
        let mut moved = 0.0_f64;
        for k in 0..3 {
            let change = after[k] - before[k];
            if change != 0.0 {
                moved = moved.max((change * w(k, k)).abs());
            }
        }
        for k in 0..3 {
            let change = after[k] - before[k];
            if change != 0.0 {
                add(&mut self.gap, &self.compliance[(at + k) * rows..][..rows], change);
                self.force[at + k] = after[k];
            }
        }
        moved
    }

    /// The three rows of a place \[m\].
    pub fn gap(&self, place: usize) -> [f64; 3] {
        std::array::from_fn(|k| self.gap[3 * place + k])
    }
}

#[inline]
fn add(sum: &mut [f64], column: &[f64], factor: f64) {
    for (sum, value) in sum.iter_mut().zip(column) {
        *sum += value * factor;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// One place on a body as stiff in any direction.
    fn single(offset: [f64; 3], friction: f64) -> Complementarity {
        let mut problem = Complementarity::default();
        problem.clear(1);
        problem.frictions.push(friction);
        for k in 0..3 {
            problem.compliance[4 * k] = 1e-3;
        }
        problem.gap.copy_from_slice(&offset);
        problem
    }

    #[test]
    fn a_contact_pushes_sticks_slides_or_is_open() {
        let law = 0.5;
        let mut open = single([1e-3, 1e-3, 0.0], law);
        open.solve(10, 1e-12);
        assert_eq!(open.force, [0.0; 3]);
        let mut sticks = single([-2e-3, 0.6e-3, -0.6e-3], law);
        sticks.solve(10, 1e-12);
        assert!(sticks.gap(0).iter().all(|gap| gap.abs() < 1e-15) && (sticks.force[0] - 2.0).abs() < 1e-12);
        let mut slides = single([-2e-3, 3e-3, -4e-3], law);
        slides.solve(10, 1e-12);
        assert!((slides.force[1].hypot(slides.force[2]) - 1.0).abs() < 1e-12);
        assert!((slides.gap(0)[1] - 2.4e-3).abs() < 1e-12 && (slides.gap(0)[2] + 3.2e-3).abs() < 1e-12);
    }

    #[test]
    fn a_chain_of_contacts_ends_where_every_law_holds() {
        // Neighbours push each other through a common body.
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
        problem.frictions = vec![0.3; places];
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
}
