//! Forces of many contacts that act on each other through one elastic body: block Gauss–Seidel over Coulomb's law
//! (Jourdan, Alart, Jean 1998) on the assembled compliance, with conjugate steps, and Newton's method for what it leaves
//! (Alart, Curnier 1991).

/// Equations of one Newton step at most; of more, sweeps are cheaper.
const UNKNOWNS_MAX: usize = 500;
/// Sweeps after the first Newton steps that did not end; twice as many after the next ones.
const PATIENCE: usize = 24;
/// Newton steps in a row at most.
const NEWTON_MAX: usize = 12;
/// After so many they have to be nearer to the law than the sweeps were.
const NEWTON_TRIALS: usize = 4;

/// One equation of a Newton step.
#[derive(Clone, Copy, Debug)]
struct Unknown {
    /// The row, or the first of the two rows that `across` weighs.
    row: usize,
    across: Option<[f64; 2]>,
    stiffening: f64,
}

/// A place that slides.
#[derive(Clone, Copy, Debug)]
struct Slide {
    place: usize,
    /// Which unknown its push is.
    normal: usize,
    /// Direction of its friction.
    along: [f64; 2],
    friction: f64,
}

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
    /// Forces and gaps before a Newton step.
    start: Vec<f64>,
    start_gap: Vec<f64>,
    /// The last step of conjugate sweeps.
    direction: Vec<f64>,
    unknowns: Vec<Unknown>,
    slides: Vec<Slide>,
    /// Row by row, the right-hand side last.
    system: Vec<f64>,
    column: Vec<f64>,
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

    /// Improves the forces until no place is further than `tolerance` \[m\] from obeying its law, with at most so many
    /// `sweeps`. Says how many; more than that many mean that it got no further.
    ///
    /// Sweeps find out which places push and which of them slide; Newton steps on the equations of those places (Alart,
    /// Curnier 1991) then carry the tension of a strand along all that hold it at once, for which sweeps alone need as
    /// many as there are places, squared. Newton steps that do not end where the law holds are taken back, and more sweeps
    /// come before the next ones.
    pub fn solve(&mut self, sweeps: usize, tolerance: f64) -> usize {
        // What is at rest needs no sweep.
        let mut patience = 0;
        let mut done = 0;
        while done < sweeps {
            done += self.sweeps(patience.min(sweeps - done), tolerance);
            let before = self.error();
            if before <= tolerance {
                return done;
            }
            self.start.clone_from(&self.force);
            self.start_gap.clone_from(&self.gap);
            for step in 0..NEWTON_MAX {
                if !self.newton() {
                    break;
                }
                done += 1;
                let after = self.error();
                if after <= tolerance {
                    return done;
                }
                if after.is_infinite() || (step + 1 >= NEWTON_TRIALS && after > before) {
                    break;
                }
            }
            std::mem::swap(&mut self.force, &mut self.start);
            std::mem::swap(&mut self.gap, &mut self.start_gap);
            patience = (2 * patience).max(PATIENCE);
        }
        sweeps + 1
    }

    /// How far the place that is furthest from its law would have to move for it \[m\].
    fn error(&self) -> f64 {
        let mut largest = 0.0_f64;
        for place in 0..self.frictions.len() {
            let (force, most, w) = self.wanted(place);
            let now = &self.force[3 * place..][..3];
            let normal = (force[0].max(0.0) - now[0]) * w[0];
            let size = force[1].hypot(force[2]);
            let scale = if size > most { most / size } else { 1.0 };
            let across = (force[1] * scale - now[1]).hypot(force[2] * scale - now[2]) * w[1];
            // Not a number is the furthest of all.
            let error = normal.abs().max(across);
            largest = if error.is_nan() { f64::INFINITY } else { largest.max(error) };
        }
        largest
    }

    /// What a place would answer if nothing but itself gave way and it stuck, what friction allows of that \[N\], and how
    /// far it gives way, along and across its normal \[m/N\].
    fn wanted(&self, place: usize) -> ([f64; 3], f64, [f64; 2]) {
        let (rows, at) = (self.force.len(), 3 * place);
        let own = |k: usize| self.compliance[(at + k) * (rows + 1)];
        let w = [own(0), own(1).max(own(2))];
        let force = std::array::from_fn(|k| self.force[at + k] - self.gap[at + k] / w[k.min(1)]);
        (force, self.frictions[place] * force[0].max(0.0), w)
    }

    /// One step of Newton's method for the places that push: those that stick get what keeps them where they are, those
    /// that slide what their push allows, against their slide. `start` and `start_gap` keep what was. Says whether
    /// there was a step to take.
    fn newton(&mut self) -> bool {
        let rows = self.force.len();
        self.unknowns.clear();
        self.slides.clear();
        for place in 0..self.frictions.len() {
            let (force, most, w) = self.wanted(place);
            if force[0] <= 0.0 {
                continue;
            }
            let size = force[1].hypot(force[2]);
            let at = 3 * place;
            self.unknowns.push(Unknown { row: at, across: None, stiffening: 0.0 });
            if size <= most {
                self.unknowns.push(Unknown { row: at + 1, across: None, stiffening: 0.0 });
                self.unknowns.push(Unknown { row: at + 2, across: None, stiffening: 0.0 });
                continue;
            }
            let along = [force[1] / size, force[2] / size];
            let normal = self.unknowns.len() - 1;
            self.slides.push(Slide { place, normal, along, friction: self.frictions[place] });
            // Across its slide a place is held the more the less it slides.
            let share = most / size;
            if share > 1e-6 {
                let stiffening = w[1] * (1.0 - share) / share;
                self.unknowns.push(Unknown { row: at + 1, across: Some([-along[1], along[0]]), stiffening });
            }
        }
        let count = self.unknowns.len();
        if count == 0 || count > UNKNOWNS_MAX {
            return false;
        }
        // Forces of places that do not push, and slides that are not at their limit, go first; the gaps follow.
        for place in 0..self.frictions.len() {
            let pushes = self.unknowns.binary_search_by_key(&(3 * place), |unknown| unknown.row).is_ok();
            if !pushes {
                self.set(place, [0.0; 3]);
            }
        }
        for slide in 0..self.slides.len() {
            let Slide { place, along, friction, .. } = self.slides[slide];
            let held = friction * self.force[3 * place].max(0.0);
            let across = self.force[3 * place + 2] * along[0] - self.force[3 * place + 1] * along[1];
            let force = [
                self.force[3 * place],
                held * along[0] - across * along[1],
                held * along[1] + across * along[0],
            ];
            self.set(place, force);
        }
        self.system.clear();
        self.system.resize(count * (count + 1), 0.0);
        let mut slides = self.slides.iter().peekable();
        for column in 0..count {
            let of = self.unknowns[column];
            // How far every row moves for this force, and for the friction that comes with it.
            self.column.clear();
            self.column.resize(rows, 0.0);
            match of.across {
                None => add(&mut self.column, &self.compliance[of.row * rows..][..rows], 1.0),
                Some(across) => {
                    for (k, share) in across.into_iter().enumerate() {
                        let from = &self.compliance[(of.row + k) * rows..][..rows];
                        add(&mut self.column, from, share);
                    }
                }
            }
            if let Some(slide) = slides.next_if(|slide| slide.normal == column) {
                for (k, share) in slide.along.into_iter().enumerate() {
                    let from = &self.compliance[(of.row + 1 + k) * rows..][..rows];
                    add(&mut self.column, from, slide.friction * share);
                }
            }
            for (row, unknown) in self.unknowns.iter().enumerate() {
                self.system[row * (count + 1) + column] = match unknown.across {
                    None => self.column[unknown.row],
                    Some([x, y]) => self.column[unknown.row] * x + self.column[unknown.row + 1] * y,
                };
            }
            self.system[column * (count + 1) + column] += of.stiffening;
        }
        for row in 0..count {
            let of = self.unknowns[row];
            let (gap, force) = match of.across {
                None => (self.gap[of.row], 0.0),
                Some([x, y]) => (
                    self.gap[of.row] * x + self.gap[of.row + 1] * y,
                    self.force[of.row] * x + self.force[of.row + 1] * y,
                ),
            };
            self.system[row * (count + 1) + count] = -gap - of.stiffening * force;
        }
        if !eliminate(&mut self.system, count) {
            return false;
        }
        self.take(count);
        true
    }

    /// Adds what was found to the forces, as far as the law allows.
    fn take(&mut self, count: usize) {
        let mut index = 0;
        while index < count {
            let place = self.unknowns[index].row / 3;
            let mut force: [f64; 3] = std::array::from_fn(|k| self.force[3 * place + k]);
            let before = force[0];
            let mut next = index;
            while next < count && self.unknowns[next].row / 3 == place {
                let by = self.system[next * (count + 1) + count];
                match self.unknowns[next].across {
                    None => force[self.unknowns[next].row - 3 * place] += by,
                    Some([x, y]) => (force[1], force[2]) = (force[1] + by * x, force[2] + by * y),
                }
                next += 1;
            }
            if let Some(slide) = self.slides.iter().find(|slide| slide.normal == index) {
                let more = slide.friction * (force[0] - before);
                (force[1], force[2]) = (force[1] + more * slide.along[0], force[2] + more * slide.along[1]);
            }
            self.set(place, force);
            index = next;
        }
    }

    /// Gives a place other forces, and lets the gaps follow.
    fn set(&mut self, place: usize, force: [f64; 3]) {
        let rows = self.force.len();
        for (k, force) in force.into_iter().enumerate() {
            let row = 3 * place + k;
            let change = force - self.force[row];
            if change != 0.0 {
                add(&mut self.gap, &self.compliance[row * rows..][..rows], change);
                self.force[row] = force;
            }
        }
    }

    /// So many sweeps, each a step of descent, with successive steps made conjugate (Silcowitz, Niebe, Erleben 2010): of a
    /// strand that slides as a whole they come nearer than Newton's steps, which lose their way among its places.
    fn sweeps(&mut self, count: usize, tolerance: f64) -> usize {
        let rows = self.force.len();
        self.direction.clear();
        self.direction.resize(rows, 0.0);
        let mut before = 0.0_f64;
        for done in 1..=count {
            self.start.clone_from(&self.force);
            if self.sweep() <= tolerance || done == count {
                return done;
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
        count
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

/// Solves a system in place by elimination with row exchanges; the solution is left in its last column. False where it
/// has none.
fn eliminate(system: &mut [f64], count: usize) -> bool {
    let width = count + 1;
    for pivot in 0..count {
        let size = |row: usize| system[row * width + pivot].abs();
        let best = (pivot..count).max_by(|&a, &b| size(a).total_cmp(&size(b))).unwrap_or(pivot);
        let value = system[best * width + pivot];
        if !value.is_finite() || value == 0.0 {
            return false;
        }
        if best != pivot {
            for column in pivot..width {
                system.swap(best * width + column, pivot * width + column);
            }
        }
        let (above, below) = system.split_at_mut((pivot + 1) * width);
        let of = &above[pivot * width..];
        for row in below.chunks_exact_mut(width) {
            let factor = row[pivot] / value;
            if factor != 0.0 {
                add(&mut row[pivot + 1..], &of[pivot + 1..], -factor);
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
