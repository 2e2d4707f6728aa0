//! Liquid as smoothed particles that keep their volume: DFSPH (Bender and Koschier, *Divergence-free smoothed particle
//! hydrodynamics*, 2015). Two implicit solvers, one against compression at the end of the step, one against compression
//! in progress; walls are particles that weigh what they stand for (Akinci et al., *Versatile rigid-fluid coupling for
//! incompressible SPH*, 2012). Walls are smooth: they push, but do not hold.
//!
//! One thread; each pair of particles is looked at once, so that momentum is kept to the last bits.

use nalgebra::{Point3, Vector3};

use super::config::{FluidConfig, FluidReport, FluidState};
use super::error::{FluidError, FluidStepError, parameter};
use super::kernel::Kernel;
use super::neighbours::{CellGrid, CellStarts};

/// Support of the kernel in spacings of particles.
const SUPPORT: f64 = 2.0;
/// Fewer neighbours are spray: it is not kept from parting.
const NEIGHBOURS_MIN: u16 = 8;
/// No particle comes nearer to a sample of a wall, in spacings: in the middle of a square of samples, 0.71 away from each, it
/// would be through.
const NEAREST: f64 = 0.9;
/// Compression goes in this share of the time in which a particle falls its own size,
const RELIEF: f64 = 0.5;
/// but not more than this share of it in a part of a step.
const RELIEF_MAX: f64 = 0.3;
const CELLS_MAX: usize = 8_000_000;

#[derive(Clone, Copy, Debug)]
struct Pair {
    a: u32,
    b: u32,
    /// ∇W = slope (x_a − x_b).
    slope: f64,
}

/// A liquid.
#[derive(Clone, Debug)]
pub struct Fluid {
    config: FluidConfig,
    kernel: Kernel,
    grid: CellGrid,
    state: FluidState,
    backup: FluidState,
    cells: CellStarts,
    wall_cells: CellStarts,
    walls: Vec<Point3<f64>>,
    wall_velocities: Vec<Vector3<f64>>,
    /// What each stands for \[m³\].
    wall_volumes: Vec<f64>,
    /// As they were given: which one it is.
    wall_forces: Vec<Vector3<f64>>,
    pairs: Vec<Pair>,
    wall_pairs: Vec<Pair>,
    compression: Vec<f64>,
    rate: Vec<f64>,
    inverse: Vec<f64>,
    neighbours: Vec<u16>,
    push: Vec<f64>,
    change: Vec<Vector3<f64>>,
    pressure: Vec<f64>,
}

impl Fluid {
    /// No liquid yet, and no walls.
    ///
    /// # Errors
    /// A parameter out of its range.
    pub fn new(config: FluidConfig) -> Result<Self, FluidError> {
        parameter("spacing", config.spacing, 1e-5..=1.0, "1e-5 to 1 m")?;
        parameter("density", config.density, 1.0..=1e5, "1 to 1e5 kg/m³")?;
        parameter("viscosity", config.viscosity, 0.0..=1.0, "0 to 1 m²/s")?;
        config.gravity.iter().try_for_each(|g| parameter("gravity", *g, -1e3..=1e3, "-1000 to 1000 m/s²"))?;
        for axis in 0..3 {
            parameter("min", config.min[axis], -1e3..=1e3, "within 1000 m")?;
            parameter("max", config.max[axis], config.min[axis] + config.spacing..=1e3, "beyond min")?;
        }
        parameter("particles_max", config.particles_max as f64, 1.0..=1e6, "1 to 1,000,000")?;
        parameter("cfl", config.cfl, 0.05..=2.0, "0.05 to 2")?;
        parameter("parts_max", f64::from(config.parts_max), 1.0..=1e4, "1 to 10,000")?;
        parameter("compression", config.compression, 1e-8..=0.1, "1e-8 to 0.1")?;
        parameter("iterations_max", f64::from(config.iterations_max), 1.0..=1e4, "1 to 10,000")?;
        let kernel = Kernel::new(SUPPORT * config.spacing);
        let cells: f64 =
            (0..3).map(|axis| ((config.max[axis] - config.min[axis]) / kernel.support).ceil()).product();
        parameter("cells of the box", cells, 1.0..=CELLS_MAX as f64, "1 to 8,000,000")?;
        let grid = CellGrid::new(config.min, config.max, kernel.support);
        let mut wall_cells = CellStarts::default();
        wall_cells.sort(&grid, &[]);
        Ok(Self {
            kernel,
            grid,
            state: FluidState::default(),
            backup: FluidState::default(),
            cells: CellStarts::default(),
            wall_cells,
            walls: Vec::new(),
            wall_velocities: Vec::new(),
            wall_volumes: Vec::new(),
            wall_forces: Vec::new(),
            pairs: Vec::new(),
            wall_pairs: Vec::new(),
            compression: Vec::new(),
            rate: Vec::new(),
            inverse: Vec::new(),
            neighbours: Vec::new(),
            push: Vec::new(),
            change: Vec::new(),
            pressure: Vec::new(),
            config,
        })
    }

    /// Goes on from a state, bit for bit.
    ///
    /// # Errors
    /// Lists of different lengths, more particles than there may be, numbers that are not finite.
    pub fn restore(&mut self, state: &FluidState) -> Result<(), FluidError> {
        let count = state.positions.len();
        let lengths = [state.numbers.len(), state.velocities.len(), state.pushes.len()];
        if lengths.iter().any(|length| *length != count) || count > self.config.particles_max {
            return Err(FluidError::State { count, most: self.config.particles_max });
        }
        let is_finite = |index: &usize| {
            let mut numbers = state.positions[*index].iter().chain(state.velocities[*index].iter());
            numbers.all(|x| x.is_finite()) && state.pushes[*index].iter().all(|x| x.is_finite())
        };
        if let Some(particle) = (0..count).find(|index| !is_finite(index)) {
            return Err(FluidError::NotFinite { particle });
        }
        self.state.clone_from(state);
        Ok(())
    }

    /// The particles.
    #[must_use]
    pub fn state(&self) -> &FluidState {
        &self.state
    }

    /// What it is.
    #[must_use]
    pub fn config(&self) -> &FluidConfig {
        &self.config
    }

    /// What a particle stands for \[m³\].
    #[must_use]
    pub fn particle_volume(&self) -> f64 {
        self.config.spacing.powi(3)
    }

    /// Pressure of each particle in the last part of the last step \[Pa\], in the order of the state's lists.
    #[must_use]
    pub fn pressures(&self) -> &[f64] {
        &self.pressure
    }

    /// Samples of walls \[m\], at most a spacing apart, and how they move \[m/s\]; none of the old ones stay.
    ///
    /// # Errors
    /// Lists of different lengths, more than 1,000,000, numbers that are not finite.
    pub fn set_walls(
        &mut self,
        samples: &[Point3<f64>],
        velocities: &[Vector3<f64>],
    ) -> Result<(), FluidError> {
        if samples.len() != velocities.len() || samples.len() > 1_000_000 {
            return Err(FluidError::State { count: samples.len(), most: 1_000_000 });
        }
        for (particle, (sample, velocity)) in samples.iter().zip(velocities).enumerate() {
            if !sample.iter().chain(velocity.iter()).all(|x| x.is_finite()) {
                return Err(FluidError::NotFinite { particle });
            }
        }
        self.wall_cells.sort(&self.grid, samples);
        self.walls.clear();
        self.walls.extend(self.wall_cells.order.iter().map(|index| samples[*index as usize]));
        self.wall_velocities.clear();
        self.wall_velocities.extend(self.wall_cells.order.iter().map(|index| velocities[*index as usize]));
        self.wall_volumes.clear();
        for sample in &self.walls {
            let mut sum = 0.0;
            self.wall_cells.around(&self.grid, &self.walls, sample, self.kernel.support, |_, square| {
                sum += self.kernel.value_and_slope(square.sqrt()).0;
            });
            self.wall_volumes.push(1.0 / sum);
        }
        self.wall_forces.clear();
        self.wall_forces.resize(samples.len(), Vector3::zeros());
        Ok(())
    }

    /// Force of the liquid on each sample of the walls, as they were given, over the last step \[N\].
    #[must_use]
    pub fn wall_forces(&self) -> &[Vector3<f64>] {
        &self.wall_forces
    }

    /// Adds a particle; when there are too many, the oldest is absorbed. Its number, or none where it is not in the box or
    /// not finite.
    pub fn add(&mut self, position: Point3<f64>, velocity: Vector3<f64>) -> Option<u64> {
        if !self.is_inside(&position) || !velocity.iter().all(|v| v.is_finite()) {
            return None;
        }
        if self.state.numbers.len() >= self.config.particles_max {
            let oldest = (0..self.state.numbers.len()).min_by_key(|index| self.state.numbers[*index])?;
            self.absorb(oldest);
        }
        let number = self.state.next;
        self.state.next += 1;
        self.state.numbers.push(number);
        self.state.positions.push(position);
        self.state.velocities.push(velocity);
        self.state.pushes.push([0.0; 2]);
        Some(number)
    }

    /// Takes the particles within a ball away, as a sucker does; how many.
    pub fn suck(&mut self, centre: &Point3<f64>, radius: f64) -> u64 {
        let before = self.state.absorbed;
        for index in (0..self.state.numbers.len()).rev() {
            if (self.state.positions[index] - centre).norm() <= radius {
                self.absorb(index);
            }
        }
        self.state.absorbed - before
    }

    fn is_inside(&self, point: &Point3<f64>) -> bool {
        (0..3).all(|axis| (self.config.min[axis]..=self.config.max[axis]).contains(&point[axis]))
    }

    fn absorb(&mut self, index: usize) {
        self.state.numbers.swap_remove(index);
        self.state.positions.swap_remove(index);
        self.state.velocities.swap_remove(index);
        self.state.pushes.swap_remove(index);
        self.state.absorbed += 1;
    }

    /// Moves the liquid on by `dt` \[s\], in as many parts as its speed asks for.
    ///
    /// # Errors
    /// A step that is no time, or needs more parts than there may be; a particle that came to be nowhere. The liquid is as
    /// before.
    pub fn step(&mut self, dt: f64) -> Result<FluidReport, FluidStepError> {
        if !(1e-9..=1.0).contains(&dt) {
            return Err(FluidStepError::Time(dt));
        }
        self.backup.clone_from(&self.state);
        let result = self.try_step(dt);
        if result.is_err() {
            std::mem::swap(&mut self.state, &mut self.backup);
        }
        result
    }

    fn try_step(&mut self, dt: f64) -> Result<FluidReport, FluidStepError> {
        let mut report = FluidReport::default();
        let before = self.state.absorbed;
        self.wall_forces.fill(Vector3::zeros());
        let mut left = dt;
        while left > 0.0 {
            let part = self.part(left);
            report.parts += 1;
            if report.parts > self.config.parts_max {
                return Err(FluidStepError::TooFast { dt, left, most: self.config.parts_max });
            }
            self.sort();
            self.find_neighbours();
            // Compression in progress; at the first of all particles have no velocities that could be wrong.
            report.iterations += self.solve(part, false).0;
            self.accelerate(part);
            let (iterations, compression) = self.solve(part, true);
            report.iterations += iterations;
            report.compression = report.compression.max(compression);
            self.contain(part);
            for (position, velocity) in self.state.positions.iter_mut().zip(&self.state.velocities) {
                *position += velocity * part;
            }
            for (particle, position) in self.state.positions.iter().enumerate() {
                let velocity = &self.state.velocities[particle];
                if !position.iter().chain(velocity.iter()).all(|x| x.is_finite()) {
                    return Err(FluidStepError::NotFinite { number: self.state.numbers[particle] });
                }
            }
            left = if left - part < 1e-9 * dt { 0.0 } else { left - part };
        }
        for index in (0..self.state.numbers.len()).rev() {
            if !self.is_inside(&self.state.positions[index]) {
                self.absorb(index);
                // As the state's list: the last takes the place.
                if index < self.pressure.len() {
                    self.pressure.swap_remove(index);
                }
            }
        }
        self.wall_forces.iter_mut().for_each(|force| *force /= dt);
        report.absorbed = self.state.absorbed - before;
        Ok(report)
    }

    /// How long a part may be.
    fn part(&self, left: f64) -> f64 {
        let fastest = self.state.velocities.iter().map(Vector3::norm_squared).fold(0.0, f64::max).sqrt();
        let reach = self.config.cfl * self.config.spacing;
        // Of what gravity makes in it, too.
        let gravity = self.config.gravity.norm();
        let speed = fastest + (gravity * reach).sqrt().min(gravity * left);
        let viscous = 0.1 * self.kernel.support.powi(2) / self.config.viscosity.max(1e-12);
        let most = (reach / speed.max(1e-12)).min(viscous);
        if left <= most { left } else { left / (left / most).ceil() }
    }

    /// Brings the particles into the order of their cells.
    fn sort(&mut self) {
        let Self { cells, grid, state, backup: _, .. } = self;
        cells.sort(grid, &state.positions);
        // In place, by the cycles of the permutation, so that nothing is allocated.
        let order = &mut cells.order;
        for first in 0..order.len() {
            let mut to = first;
            while order[to] != u32::MAX {
                let from = order[to] as usize;
                order[to] = u32::MAX;
                if from == first {
                    break;
                }
                state.positions.swap(to, from);
                state.velocities.swap(to, from);
                state.numbers.swap(to, from);
                state.pushes.swap(to, from);
                to = from;
            }
        }
    }

    /// Pairs, compression and the solvers' diagonals of the positions.
    fn find_neighbours(&mut self) {
        let count = self.state.positions.len();
        let volume = self.particle_volume();
        let kernel = self.kernel;
        let resize = |list: &mut Vec<f64>, value| {
            list.clear();
            list.resize(count, value);
        };
        resize(&mut self.compression, volume * kernel.value_and_slope(0.0).0);
        resize(&mut self.inverse, 0.0);
        resize(&mut self.rate, 0.0);
        resize(&mut self.push, 0.0);
        resize(&mut self.pressure, 0.0);
        self.change.clear();
        self.change.resize(count, Vector3::zeros());
        self.neighbours.clear();
        self.neighbours.resize(count, 0);
        let (positions, pairs, wall_pairs) = (&self.state.positions, &mut self.pairs, &mut self.wall_pairs);
        pairs.clear();
        wall_pairs.clear();
        let (compression, inverse, gradient) = (&mut self.compression, &mut self.inverse, &mut self.change);
        let neighbours = &mut self.neighbours;
        self.cells.pairs(&self.grid, positions, kernel.support, |a, b, square| {
            let (value, slope) = kernel.value_and_slope(square.sqrt());
            pairs.push(Pair { a, b, slope });
            let (a, b) = (a as usize, b as usize);
            let along = (positions[a] - positions[b]) * (volume * slope);
            let squared = along.norm_squared();
            for (particle, along) in [(a, along), (b, -along)] {
                compression[particle] += volume * value;
                inverse[particle] += squared;
                gradient[particle] += along;
                neighbours[particle] = neighbours[particle].saturating_add(1);
            }
        });
        if !self.walls.is_empty() {
            for (a, position) in positions.iter().enumerate() {
                let (walls, volumes) = (&self.walls, &self.wall_volumes);
                self.wall_cells.around(&self.grid, walls, position, kernel.support, |b, square| {
                    let (value, slope) = kernel.value_and_slope(square.sqrt());
                    let volume = volumes[b as usize];
                    wall_pairs.push(Pair { a: a as u32, b, slope });
                    compression[a] += volume * value;
                    gradient[a] += (position - walls[b as usize]) * (volume * slope);
                    neighbours[a] = neighbours[a].saturating_add(1);
                });
            }
        }
        for particle in 0..count {
            let diagonal = inverse[particle] + gradient[particle].norm_squared();
            // A lonely particle cannot be compressed.
            inverse[particle] =
                if diagonal > 1e-6 / (kernel.support * kernel.support) { 1.0 / diagonal } else { 0.0 };
        }
    }

    /// Gravity and viscosity.
    fn accelerate(&mut self, dt: f64) {
        let volume = self.particle_volume();
        self.change.fill(self.config.gravity * dt);
        if self.config.viscosity > 0.0 {
            let (positions, velocities) = (&self.state.positions, &self.state.velocities);
            let softening = 0.01 * self.kernel.support.powi(2);
            let scale = 10.0 * self.config.viscosity * volume * dt;
            for Pair { a, b, slope } in &self.pairs {
                let (a, b) = (*a as usize, *b as usize);
                let apart = positions[a] - positions[b];
                let square = apart.norm_squared();
                let approach = (velocities[a] - velocities[b]).dot(&apart);
                let push = apart * (scale * slope * approach / (square + softening));
                self.change[a] += push;
                self.change[b] -= push;
            }
        }
        for (velocity, change) in self.state.velocities.iter_mut().zip(&self.change) {
            *velocity += change;
        }
    }

    /// One of the solvers: against compression at the end of the step, or against compression in progress. Iterations, and
    /// the mean of what is left, as a share.
    fn solve(&mut self, dt: f64, is_density: bool) -> (u32, f64) {
        let count = self.state.positions.len();
        if count == 0 {
            return (0, 0.0);
        }
        let which = usize::from(is_density);
        // What held them in the last step holds them in this one, mostly.
        for particle in 0..count {
            let push = &mut self.state.pushes[particle][which];
            let is_spray = self.neighbours[particle] < NEIGHBOURS_MIN;
            self.push[particle] = if is_spray || self.inverse[particle] == 0.0 { 0.0 } else { 0.5 * *push };
            *push = self.push[particle];
        }
        self.apply(dt);
        // Compression that is there already is let off slowly: at once it would be a spring, and an explosion where the
        // liquid was put down too close.
        let fall = (self.config.spacing / self.config.gravity.norm().max(1e-6)).sqrt();
        let relief = (dt / (RELIEF * fall)).min(RELIEF_MAX);
        let mut left = 0.0;
        for iteration in 1..=self.config.iterations_max {
            self.rates();
            let mut sum = 0.0;
            for particle in 0..count {
                let rate = self.rate[particle] * dt;
                let there = self.compression[particle] - 1.0;
                let mut excess = if !is_density {
                    rate
                } else if there > 0.0 {
                    there * relief + rate
                } else {
                    there + rate
                };
                if !is_density
                    && (self.neighbours[particle] < NEIGHBOURS_MIN || self.compression[particle] + rate < 1.0)
                {
                    // Where there is room it may come together.
                    excess = 0.0;
                }
                // A surface pushes, but does not pull: what was pushed too much is taken back, no more.
                let had = self.state.pushes[particle][which];
                let push = (0.5 * excess * self.inverse[particle] / (dt * dt)).max(-had);
                self.push[particle] = push;
                sum += excess.max(0.0);
            }
            left = sum / count as f64;
            if left <= self.config.compression && iteration > 1 {
                self.settle_pressure(which);
                return (iteration, left);
            }
            for (pushes, push) in self.state.pushes.iter_mut().zip(&self.push) {
                pushes[which] += push;
            }
            self.apply(dt);
        }
        self.settle_pressure(which);
        (self.config.iterations_max, left)
    }

    fn settle_pressure(&mut self, which: usize) {
        for (pressure, pushes) in self.pressure.iter_mut().zip(&self.state.pushes) {
            *pressure += self.config.density * pushes[which];
        }
    }

    /// How fast each is being compressed \[1/s\].
    fn rates(&mut self) {
        let volume = self.particle_volume();
        let (positions, velocities, rate) = (&self.state.positions, &self.state.velocities, &mut self.rate);
        rate.fill(0.0);
        for Pair { a, b, slope } in &self.pairs {
            let (a, b) = (*a as usize, *b as usize);
            let change = volume * slope * (velocities[a] - velocities[b]).dot(&(positions[a] - positions[b]));
            rate[a] += change;
            rate[b] += change;
        }
        for Pair { a, b, slope } in &self.wall_pairs {
            let (a, b) = (*a as usize, *b as usize);
            let towards = (velocities[a] - self.wall_velocities[b]).dot(&(positions[a] - self.walls[b]));
            rate[a] += self.wall_volumes[b] * slope * towards;
        }
    }

    /// Lets nothing through walls: what pushes there is compression, of which a surface has none where it meets a wall, nor a
    /// drop. Whoever is near to a sample comes no nearer.
    fn contain(&mut self, dt: f64) {
        let near = NEAREST * self.config.spacing;
        let mass = self.config.density * self.particle_volume();
        // In a corner the second sample may send back to the first.
        for _ in 0..2 {
            for Pair { a, b, .. } in &self.wall_pairs {
                let (a, b) = (*a as usize, *b as usize);
                let apart = self.state.positions[a] - self.walls[b];
                let distance = apart.norm();
                if distance == 0.0 {
                    continue;
                }
                let normal = apart / distance;
                let towards = (self.state.velocities[a] - self.wall_velocities[b]).dot(&normal);
                let most = ((distance - near) / dt).max(0.0);
                if towards < -most {
                    let change = normal * (towards + most);
                    self.state.velocities[a] -= change;
                    self.wall_forces[self.wall_cells.order[b] as usize] += change * mass;
                }
            }
        }
    }

    /// Changes velocities by what each pushes.
    fn apply(&mut self, dt: f64) {
        let volume = self.particle_volume();
        let (positions, velocities, push) = (&self.state.positions, &mut self.state.velocities, &self.push);
        for Pair { a, b, slope } in &self.pairs {
            let (a, b) = (*a as usize, *b as usize);
            let change = (positions[a] - positions[b]) * (dt * volume * slope * (push[a] + push[b]));
            velocities[a] -= change;
            velocities[b] += change;
        }
        let mass = self.config.density * volume;
        for Pair { a, b, slope } in &self.wall_pairs {
            let (a, b) = (*a as usize, *b as usize);
            let change = (positions[a] - self.walls[b]) * (dt * self.wall_volumes[b] * slope * push[a]);
            velocities[a] -= change;
            // As an impulse; divided by the step's time at its end.
            self.wall_forces[self.wall_cells.order[b] as usize] += change * mass;
        }
    }
}
