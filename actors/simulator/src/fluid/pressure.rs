//! Pressure solver: the least p ≥ 0 with A p ≥ b, where A is the divergence of the gradient on particles; pressures
//! prevent compression and are never tensile. Solved by bound-constrained conjugate gradients, MPRGP (Dostál and
//! Schöberl, *Minimizing quadratic functions subject to bound constraints with the rate of convergence and finite
//! termination*, 2005), with diagonal scaling.

use nalgebra::Vector3;

use super::neighbour_lists::Rows;
use super::neighbour_search::LANES;
use crate::simd::f32x8::{Eight, ForEight, with_eight};

/// Iterations after which the gradient is recomputed, if rows were clamped to their bounds since.
const RENEWAL: u32 = 10;

/// Upper bound of a row's effect on all others, relative to its effect on itself.
const SPREAD: f64 = 8.0;

/// Buffers of the solver, reused.
#[derive(Clone, Debug, Default)]
pub(super) struct Solver {
    /// Pressure over density of each row \[m²/s²\]: the initial guess, then the solution.
    pub pressures: Vec<f32>,
    /// Right-hand side of each row, as a fraction; ignored for rows without pressure.
    pub wanted: Vec<f32>,
    /// Whether each row can have a pressure.
    pub is_active: Vec<bool>,
    /// Velocity buffer.
    pub velocities: Vec<[f32; 4]>,
    scale: Vec<f32>,
    /// The inverse scale; 0 for rows without one.
    inverse: Vec<f32>,
    scaled: Vec<f32>,
    slope: Vec<f32>,
    direction: Vec<f32>,
    image: Vec<f32>,
    /// Accumulated clamping at the bounds since the gradient was recomputed: the effect of each row on itself, as a
    /// fraction, summed.
    drift: f64,
}

impl Solver {
    /// Resizes for this many rows.
    pub(super) fn resize(&mut self, count: usize) {
        for list in [
            &mut self.pressures,
            &mut self.wanted,
            &mut self.scale,
            &mut self.inverse,
            &mut self.scaled,
            &mut self.slope,
            &mut self.direction,
            &mut self.image,
        ] {
            list.clear();
            list.resize(count, 0.0);
        }
        self.is_active.clear();
        self.is_active.resize(count, false);
        self.velocities.clear();
        self.velocities.resize(count, [0.0; 4]);
    }

    /// Copies the particles' velocities to their rows.
    pub(super) fn set_velocities(&mut self, rows: &Rows, velocities: &[Vector3<f64>]) {
        for (velocity, row) in velocities.iter().zip(&rows.row_of) {
            self.velocities[*row as usize] = [velocity.x as f32, velocity.y as f32, velocity.z as f32, 0.0];
        }
    }

    /// `image` = scaled A times the direction, or times the scaled pressures: in single precision, since it computes a
    /// small correction.
    fn apply(&mut self, rows: &mut Rows, dt: f32, of_direction: bool) {
        let of = if of_direction { &self.direction } else { &self.scaled };
        rows.product((&self.scale, dt * dt), of, &mut self.velocities, &mut self.image);
    }

    /// Recomputes the gradient at the iterate, and the direction of the free rows.
    fn renew_slope(&mut self, rows: &mut Rows, dt: f32) -> ResidualNorms {
        self.apply(rows, dt, false);
        for ((slope, image), (wanted, scale)) in
            self.slope.iter_mut().zip(&self.image).zip(self.wanted.iter().zip(&self.scale))
        {
            *slope = image - wanted * scale;
        }
        let left = self.go(0.0);
        self.drift = 0.0;
        self.turn(0.0);
        left
    }

    /// Solves for a substep \[s\] until the mean residual is at most `tolerance`. Returns iterations and residual.
    pub(super) fn solve(&mut self, rows: &mut Rows, dt: f32, tolerance: f64, most: u32) -> (u32, f64) {
        let mut active = 0_usize;
        for row in 0..self.scale.len() {
            let (scale, inverse) = match self.is_active[row] {
                true => {
                    let inverse = dt * rows.diagonal[row].sqrt();
                    (1.0 / inverse, inverse)
                }
                false => (0.0, 0.0),
            };
            active += usize::from(self.is_active[row]);
            (self.scale[row], self.inverse[row]) = (scale, inverse);
            self.scaled[row] = (self.pressures[row] * inverse).max(0.0);
        }
        let mut iterations = 0;
        let mut rest = 0.0;
        let mut since = 0;
        if active > 0 {
            let mut left = self.renew_slope(rows, dt);
            loop {
                let mean = left.sum / active as f64;
                // Clamping affects others by at most this much.
                let unknown = SPREAD * self.drift / active as f64;
                let is_done = mean + unknown <= tolerance;
                if self.drift > 0.0 && !is_done && (mean <= tolerance || since >= RENEWAL) {
                    left = self.renew_slope(rows, dt);
                    since = 0;
                    continue;
                }
                rest = mean + unknown;
                if is_done || iterations >= most {
                    break;
                }
                since += 1;
                iterations += 1;
                let further = match left.bound > left.free {
                    true => self.release_bounds(rows, dt),
                    false => self.advance(rows, dt),
                };
                let Some(further) = further else { break };
                left = further;
            }
        }
        for ((pressure, value), scale) in self.pressures.iter_mut().zip(&self.scaled).zip(&self.scale) {
            *pressure = value * scale;
        }
        (iterations, rest)
    }

    /// Releases rows from their bounds; returns the residual, or `None` where there is no descent.
    fn release_bounds(&mut self, rows: &mut Rows, dt: f32) -> Option<ResidualNorms> {
        for ((direction, slope), (value, scale)) in
            self.direction.iter_mut().zip(&self.slope).zip(self.scaled.iter().zip(&self.scale))
        {
            *direction = if *value <= 0.0 && *scale > 0.0 { slope.min(0.0) } else { 0.0 };
        }
        self.apply(rows, dt, true);
        let (curvature, descent) = self.along();
        (curvature > 0.0).then(|| {
            let left = self.go((descent / curvature) as f32);
            self.turn(0.0);
            left
        })
    }

    /// A conjugate gradient step, or one to the first bound and beyond; returns the residual, or `None` where there is
    /// no descent.
    fn advance(&mut self, rows: &mut Rows, dt: f32) -> Option<ResidualNorms> {
        self.apply(rows, dt, true);
        let (curvature, descent) = self.along();
        (curvature > 0.0).then(|| {
            let left = self.go((descent / curvature) as f32);
            self.turn((left.along / curvature) as f32);
            left
        })
    }

    /// The direction times its image, and times the gradient.
    fn along(&self) -> (f64, f64) {
        with_eight(DirectionProducts { slope: &self.slope, direction: &self.direction, image: &self.image })
    }

    /// Moves against the direction by this length, and returns the residual.
    ///
    /// Rows beyond their bound are clamped to it. The effect on others is small, and included when the gradient is next
    /// recomputed: at the latest when it might matter.
    fn go(&mut self, length: f32) -> ResidualNorms {
        let left = with_eight(DirectionStep {
            scaled: &mut self.scaled,
            slope: &mut self.slope,
            direction: &self.direction,
            image: &self.image,
            inverse: &self.inverse,
            length,
        });
        self.drift += left.past;
        left
    }

    /// The next direction: the gradient of the free rows minus this multiple of the last direction.
    fn turn(&mut self, share: f32) {
        with_eight(DirectionUpdate {
            scaled: &self.scaled,
            slope: &self.slope,
            direction: &mut self.direction,
            share,
        });
    }
}

/// Residual norms.
#[derive(Clone, Copy)]
struct ResidualNorms {
    /// Sum over all rows, as a fraction.
    sum: f64,
    /// Squared gradient of the free rows, and of those about to leave their bounds.
    free: f64,
    bound: f64,
    /// Gradient times image of the free rows.
    along: f64,
    /// How far rows would have exceeded their bounds, as fractions.
    past: f64,
}

/// Groups of eight items of a list.
#[inline(always)]
fn eights(list: &[f32]) -> &[[f32; LANES]] {
    list.as_chunks().0
}

#[inline(always)]
fn eights_mut(list: &mut [f32]) -> &mut [[f32; LANES]] {
    list.as_chunks_mut().0
}

/// Dot products of a direction.
struct DirectionProducts<'a> {
    slope: &'a [f32],
    direction: &'a [f32],
    image: &'a [f32],
}

impl ForEight for DirectionProducts<'_> {
    type Output = (f64, f64);

    #[inline(always)]
    fn run<E: Eight>(self, eight: E) -> (f64, f64) {
        let [mut curvature, mut descent] = [eight.nothing(); 2];
        let lists = eights(self.direction).iter().zip(eights(self.image)).zip(eights(self.slope));
        for ((direction, image), slope) in lists {
            let direction = eight.load(direction);
            curvature = eight.add_to(curvature, eight.mul(direction, eight.load(image)));
            descent = eight.add_to(descent, eight.mul(direction, eight.load(slope)));
        }
        (eight.sums(curvature).iter().sum(), eight.sums(descent).iter().sum())
    }
}

/// A step along a direction.
struct DirectionStep<'a> {
    scaled: &'a mut [f32],
    slope: &'a mut [f32],
    direction: &'a [f32],
    image: &'a [f32],
    inverse: &'a [f32],
    length: f32,
}

impl ForEight for DirectionStep<'_> {
    type Output = ResidualNorms;

    #[inline(always)]
    fn run<E: Eight>(self, eight: E) -> ResidualNorms {
        let [mut sum, mut free, mut bound, mut along, mut past] = [eight.nothing(); 5];
        let (zero, length) = (eight.all(0.0), eight.all(self.length));
        let state = eights_mut(self.scaled).iter_mut().zip(eights_mut(self.slope));
        let ways = eights(self.direction).iter().zip(eights(self.image)).zip(eights(self.inverse));
        for ((value, slope), ((direction, image), inverse)) in state.zip(ways) {
            let (image, inverse) = (eight.load(image), eight.load(inverse));
            let to = eight.sub(eight.load(value), eight.mul(length, eight.load(direction)));
            let its = eight.sub(eight.load(slope), eight.mul(length, image));
            let kept = eight.max(to, zero);
            past = eight.add_to(past, eight.mul(eight.sub(kept, to), inverse));
            let is_free = eight.less(zero, kept);
            let goes = eight.choose(is_free, its, zero);
            // At its bound a row may only rise.
            let rises = eight.choose(is_free, zero, eight.max(eight.sub(zero, its), zero));
            let size = eight.add(eight.max(goes, eight.sub(zero, goes)), rises);
            sum = eight.add_to(sum, eight.mul(size, inverse));
            free = eight.add_to(free, eight.mul(goes, goes));
            bound = eight.add_to(bound, eight.mul(rises, rises));
            along = eight.add_to(along, eight.mul(goes, image));
            (*value, *slope) = (eight.store(kept), eight.store(its));
        }
        let [sum, free, bound, along, past] =
            [sum, free, bound, along, past].map(|sums| eight.sums(sums).iter().sum());
        ResidualNorms { sum, free, bound, along, past }
    }
}

/// A conjugate direction.
struct DirectionUpdate<'a> {
    scaled: &'a [f32],
    slope: &'a [f32],
    direction: &'a mut [f32],
    share: f32,
}

impl ForEight for DirectionUpdate<'_> {
    type Output = ();

    #[inline(always)]
    fn run<E: Eight>(self, eight: E) {
        let (zero, share) = (eight.all(0.0), eight.all(self.share));
        let rows = eights(self.scaled).iter().zip(eights(self.slope));
        for (direction, (value, slope)) in eights_mut(self.direction).iter_mut().zip(rows) {
            let turned = eight.sub(eight.load(slope), eight.mul(share, eight.load(direction)));
            let is_free = eight.less(zero, eight.load(value));
            *direction = eight.store(eight.choose(is_free, turned, zero));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fluid::cell_grid::{CellGrid, CellStarts};
    use crate::fluid::kernel::Kernel;
    use crate::fluid::neighbour_clusters::PressureForces;
    use crate::fluid::neighbour_lists::Walls;
    use nalgebra::{DMatrix, DVector, Point3};
    use rand::{Rng, SeedableRng};

    /// A slightly disordered block of particles, without walls.
    fn rows() -> Rows {
        let mut random = rand_pcg::Pcg64::seed_from_u64(5);
        let mut points = Vec::new();
        for (i, j, k) in (0..5).flat_map(|i| (0..5).flat_map(move |j| (0..4).map(move |k| (i, j, k)))) {
            let place = [i, j, k].map(|x| 0.1 * (f64::from(x) + random.random_range(-0.1..0.1)) + 0.2);
            points.push(Point3::from(place));
        }
        let grid = CellGrid::new(Point3::origin(), Point3::new(1.0, 1.0, 1.0), 0.2);
        let (mut cells, mut none) = (CellStarts::default(), CellStarts::default());
        cells.sort(&grid, &points);
        none.sort(&grid, &[]);
        let mut rows = Rows::default();
        let sorted = cells.order.iter().map(|index| points[*index as usize]);
        rows.liquid = sorted.map(|p| [p.x as f32, p.y as f32, p.z as f32, 1e-3]).collect();
        let walls = Walls { cells: &none, places: &[], smooth: &[] };
        rows.build(&grid, [&cells, &none], &walls, &Kernel::new(0.2), 1e-3, 0.15);
        rows
    }

    /// The particles' values in a list by rows.
    fn of_particles<T: Copy>(rows: &Rows, list: &[T]) -> Vec<T> {
        rows.row_of.iter().map(|row| list[*row as usize]).collect()
    }

    /// The operator as a matrix over the particles, for a step of a second.
    fn matrix(rows: &mut Rows) -> DMatrix<f64> {
        let (count, particles) = (rows.count(), rows.row_of.len());
        assert!(count > particles && count.is_multiple_of(LANES), "some rows are no one's: {count}");
        let mut a = DMatrix::zeros(particles, particles);
        let mut unit = vec![0.0_f32; count];
        let mut velocities = vec![[0.0; 4]; count];
        let (mut rates, ones) = (vec![0.0; count], vec![1.0; count]);
        for column in 0..particles {
            unit.fill(0.0);
            unit[rows.row_of[column] as usize] = 1.0;
            rows.product((&ones, 1.0), &unit, &mut velocities, &mut rates);
            let of_all: f32 = rates.iter().map(|rate| rate.abs()).sum();
            let rates = of_particles(rows, &rates);
            assert_eq!(
                of_all,
                rates.iter().map(|rate| rate.abs()).sum::<f32>(),
                "a row that is no one's has no part"
            );
            (0..particles).for_each(|row| a[(row, column)] = f64::from(rates[row]));
        }
        a
    }

    #[test]
    fn the_operator_is_symmetric_has_its_diagonal_and_no_negative_eigenvalue() {
        let mut rows = rows();
        let a = matrix(&mut rows);
        assert!((&a - a.transpose()).amax() < 1e-5 * a.amax());
        for (row, diagonal) in of_particles(&rows, &rows.diagonal).into_iter().enumerate() {
            let diagonal = f64::from(diagonal);
            assert!((a[(row, row)] - diagonal).abs() < 1e-4 * diagonal, "{row}");
            let spread = a.column(row).abs().sum() / diagonal;
            assert!((1.5..SPREAD).contains(&spread), "what {row} changes of others: {spread}");
        }
        let least = ((&a + a.transpose()) * 0.5).symmetric_eigenvalues().min();
        assert!(least > -1e-4 * a.amax(), "{least}");
    }

    #[test]
    fn the_operator_is_the_divergence_of_the_gradient_as_it_stands() {
        let mut rows = rows();
        let mut random = rand_pcg::Pcg64::seed_from_u64(9);
        let pressures: Vec<f32> = (0..rows.count()).map(|_| random.random_range(0.0..1.0)).collect();
        let mut pushes = vec![Vector3::zeros(); rows.count()];
        rows.each(&mut pushes, &PressureForces { pressures: &pressures, scale: 1.0 });
        let gradients: Vec<[f32; 4]> =
            pushes.iter().map(|push| [push.x as f32, push.y as f32, push.z as f32, 0.0]).collect();
        let (mut expected, mut rates) = (vec![0.0; rows.count()], vec![0.0; rows.count()]);
        rows.compression_rate(&gradients, &mut expected);
        let mut velocities = vec![[0.0; 4]; rows.count()];
        let ones = vec![1.0; rows.count()];
        rows.product((&ones, 1.0), &pressures, &mut velocities, &mut rates);
        let most = expected.iter().fold(0.0_f32, |most, rate| most.max(rate.abs()));
        for row in 0..rows.count() {
            assert!(
                (rates[row] - expected[row]).abs() < 1e-5 * most,
                "{row}: {} {}",
                rates[row],
                expected[row]
            );
            let apart =
                (0..3).map(|axis| (velocities[row][axis] - gradients[row][axis]).abs()).fold(0.0, f32::max);
            let length = gradients[row].iter().fold(0.0_f32, |most, along| most.max(along.abs()));
            assert!(apart < 1e-4 * length.max(1.0), "{row}: {apart} of {length}");
        }
    }

    #[test]
    fn pressures_are_at_their_bounds_or_their_rows_lack_nothing() {
        let mut rows = rows();
        let a = matrix(&mut rows);
        let mut random = rand_pcg::Pcg64::seed_from_u64(7);
        let dt = 0.01;
        let mut solver = Solver::default();
        solver.resize(rows.count());
        for (particle, row) in rows.row_of.iter().enumerate() {
            solver.wanted[*row as usize] = random.random_range(-0.02..0.02);
            solver.is_active[*row as usize] = particle % 17 != 3;
        }
        let (iterations, left) = solver.solve(&mut rows, dt, 1e-6, 500);
        assert!(left <= 1e-6 && iterations < 400, "{iterations}: {left}");
        let p = of_particles(&rows, &solver.pressures);
        let p = DVector::from_iterator(p.len(), p.into_iter().map(f64::from));
        let (wanted, is_active) =
            (of_particles(&rows, &solver.wanted), of_particles(&rows, &solver.is_active));
        let rest = &a * &p * f64::from(dt * dt);
        let mut bound = 0;
        for row in 0..p.len() {
            let lacks = f64::from(wanted[row]) - rest[row];
            assert!(p[row] >= 0.0);
            if !is_active[row] {
                assert_eq!(p[row], 0.0);
            } else if p[row] > 0.0 {
                assert!(lacks.abs() < 1e-4, "{row}: {lacks}");
            } else {
                bound += 1;
                assert!(lacks < 1e-4, "{row}: {lacks}");
            }
        }
        assert!((5..95).contains(&bound), "{bound} of 100 at their bound");
        // At the solution there is nothing left to do.
        let before = solver.pressures.clone();
        let (iterations, _) = solver.solve(&mut rows, dt, 1e-5, 500);
        assert_eq!(iterations, 0);
        let far = solver.pressures.iter().zip(&before).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        assert!(far < 1e-6 * before.iter().copied().fold(0.0, f32::max), "{far}");
    }
}
