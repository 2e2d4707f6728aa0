//! Incompressible SPH: pressures that prevent compression at the end of a substep are solved for implicitly (Ihmsen et
//! al., *Implicit incompressible SPH*, 2014); existing compression is released slowly in the same solve (Cornelis et
//! al., *An optimized source term formulation for incompressible SPH*, 2019).
//!
//! Walls are boundary particles weighted by the volume they represent (Akinci et al., *Versatile rigid-fluid coupling
//! for incompressible SPH*, 2012), scaled so that a flat wall continues the particle lattice next to it, with pressures
//! of their own, also solved for (Shao and Lo, *Incompressible SPH method for simulating Newtonian and non-Newtonian
//! flows with a free surface*, 2003): with mirrored particle pressures, the pressure on a floor would not equal the
//! weight of the column over its area. Walls push but do not hold. They are rough, and drag what slides along them as
//! viscosity has it (`viscosity.rs`), half a spacing from the samples, where the liquid ends; where sample normals are
//! given, they are smooth (`mirror_walls.rs`).
//!
//! Runs on the rayon pool, bit-identical for any number of threads. The interaction of two particles is computed
//! identically from both sides, so that momentum is conserved to rounding.

use nalgebra::{Point3, Vector3};

use super::config::{Ends, FluidReport};
use super::error::FluidStepError;
use super::liquid::{Fluid, seen_from};
use super::mirror_walls::{MirrorPlane, SmoothSamples};
use super::neighbour_clusters::{PressureForces, WALL_DRAG};
use super::neighbour_lists::{WallLink, Walls};
use super::viscosity::ViscousStep;

/// Particles with fewer neighbours are spray: they are not kept from separating.
const NEIGHBOURS_MIN: f32 = 8.0;
/// Least distance of a particle from a wall sample, in spacings: in the middle of a square of samples, 0.71 from each,
/// a particle would have passed through.
const NEAREST: f64 = 0.9;
/// Least distance from the plane of a smooth wall, which has no gaps.
const NEAREST_PLANE: f64 = 0.7;
/// Sum of kernels times volumes over the second lattice layer from a wall: its sum over the adjacent particles.
const NEXT_LAYER: f32 = 0.1499;
/// Longest substep in terms of the time in which a wave of the pressure passes a particle. Under pressure, particles
/// repel each other like springs: in longer substeps, these springs gain energy, and the liquid never comes to rest.
/// Rough walls, which drag, bear a longer one; measured, it is 1.1 and 0.8.
const STIFF: f64 = 1.0;
const STIFF_SMOOTH: f64 = 0.7;
/// Compression is released in this many times the time in which a particle falls, or moves, its own size,
const RELIEF: f64 = 2.0;
/// but at most this fraction of it per substep.
const RELIEF_MAX: f64 = 0.1;
/// One in this many particles may be faster than the limit.
const FEW: usize = 100;

impl Fluid {
    /// Advances the liquid by `dt` \[s\], in as many substeps as its speed requires.
    ///
    /// # Errors
    /// An invalid time step, or one that needs too many substeps; a particle with a non-finite position. The liquid is
    /// unchanged then.
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
            self.accelerate(part);
            let (iterations, compression) = self.press(part);
            report.iterations += iterations;
            report.compression = report.compression.max(compression);
            self.drag(part);
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
            self.go_on_at_ends();
            self.absorb_what_left();
            left = if left - part < 1e-9 * dt { 0.0 } else { left - part };
        }
        self.wall_forces.iter_mut().for_each(|force| *force /= dt);
        report.absorbed = self.state.absorbed - before;
        Ok(report)
    }

    /// What leaves at an end enters at the other one.
    fn go_on_at_ends(&mut self) {
        let Some(Ends { axis, .. }) = self.config.ends else { return };
        let (low, high) = (self.config.min[axis], self.config.max[axis]);
        for position in &mut self.state.positions {
            if !(low..=high).contains(&position[axis]) {
                position[axis] = low + (position[axis] - low).rem_euclid(high - low);
            }
        }
    }

    /// Images of the particles near the ends, beyond the other end.
    fn find_images(&mut self) {
        self.rows.images.clear();
        self.images.clear();
        let Some(Ends { axis, .. }) = self.config.ends else { return };
        let (low, high) = (self.config.min[axis], self.config.max[axis]);
        for (particle, position) in self.state.positions.iter().enumerate() {
            for (is_near, by) in [
                (position[axis] < low + self.kernel.support, high - low),
                (position[axis] > high - self.kernel.support, low - high),
            ] {
                if is_near {
                    let mut image = *position;
                    image[axis] += by;
                    self.images.push((particle as u32, image));
                }
            }
        }
        let places: Vec<Point3<f64>> = self.images.iter().map(|(_, place)| *place).collect();
        self.image_cells.sort(&self.grid, &places);
        let volume = self.config.spacing.powi(3) as f32;
        let min = self.config.min;
        let sorted = self.image_cells.order.iter().map(|index| self.images[*index as usize]);
        self.rows.images.extend(sorted.map(|(particle, place)| (particle, seen_from(&min, &place, volume))));
    }

    /// Removes particles that have left the box at once: a drop that flies out does not slow down the rest of the step.
    fn absorb_what_left(&mut self) {
        for index in (0..self.state.numbers.len()).rev() {
            if !self.is_inside(&self.state.positions[index]) {
                self.absorb(index);
                // As in the state's lists: the last one replaces it.
                if index < self.pressure.len() {
                    self.pressure.swap_remove(index);
                }
            }
        }
    }

    /// Length of the next substep. A few fast drops do not limit it: they may move by a spacing.
    fn part(&mut self, left: f64) -> f64 {
        self.speeds.clear();
        self.speeds.extend(self.state.velocities.iter().map(|velocity| velocity.norm_squared() as f32));
        let (mut fastest, mut most) = (0.0, 0.0);
        let place = self.speeds.len() - self.speeds.len().div_ceil(FEW);
        if place < self.speeds.len() {
            let (_, fast, faster) = self.speeds.select_nth_unstable_by(place, f32::total_cmp);
            most = f64::from(*fast).sqrt();
            fastest = f64::from(faster.iter().copied().fold(*fast, f32::max)).sqrt();
        }
        let reach = self.config.cfl * self.config.spacing;
        // Including the velocity that gravity adds.
        let gravity = self.driving().norm();
        let more = (gravity * reach).sqrt().min(gravity * left);
        // Under pressure the particles are stiff to each other. Twice the mean pressure is that at the bottom of a pool.
        let sum: f64 = self.state.pushes.iter().map(|push| f64::from(*push)).sum();
        let wave = (2.0 * sum / self.state.pushes.len().max(1) as f64).sqrt();
        let stiff = if self.wall_smooth.contains(&true) { STIFF_SMOOTH } else { STIFF };
        let longest = (reach / (most + more).max(1e-12))
            .min(stiff * self.config.spacing / wave.max(1e-12))
            .min(reach.max(self.config.spacing) / (fastest + more).max(1e-12));
        if left <= longest { left } else { left / (left / longest).ceil() }
    }

    /// Acceleration by gravity and by the pressure drop between ends \[m/s²\].
    fn driving(&self) -> Vector3<f64> {
        let mut driving = self.config.gravity;
        if let Some(Ends { axis, pressure_drop }) = self.config.ends {
            let length = self.config.max[axis] - self.config.min[axis];
            driving[axis] += pressure_drop / (self.config.density * length);
        }
        driving
    }

    /// Sorts the particles by cell.
    fn sort(&mut self) {
        let Self { cells, grid, state, backup: _, .. } = self;
        cells.sort(grid, &state.positions);
        // In place, by the cycles of the permutation, without allocation.
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

    /// Neighbours, compression and the solver's diagonal at these positions.
    fn find_neighbours(&mut self) {
        let min = self.config.min;
        let volume = self.particle_volume() as f32;
        self.rows.liquid.clear();
        let positions = self.state.positions.iter();
        self.rows.liquid.extend(positions.map(|position| seen_from(&min, position, volume)));
        self.find_images();
        let walls = Walls { cells: &self.wall_cells, places: &self.wall_places, smooth: &self.wall_smooth };
        self.rows.build(
            &self.grid,
            [&self.cells, &self.image_cells],
            &walls,
            &self.kernel,
            volume,
            NEXT_LAYER,
        );
        self.mirrors.clear();
        if self.wall_smooth.contains(&true) {
            let smooth = SmoothSamples {
                grid: &self.grid,
                cells: &self.wall_cells,
                places: &self.walls,
                velocities: &self.wall_velocities,
                normals: &self.wall_normals,
                volumes: &self.wall_places,
                volume: self.config.spacing.powi(3),
                spacing: self.config.spacing,
            };
            smooth.add_to(&mut self.rows, &self.state.positions, &mut self.near, &mut self.mirrors);
        }
    }

    /// Gravity, and the pressure drop between ends.
    fn accelerate(&mut self, dt: f64) {
        let gravity = self.driving() * dt;
        self.state.velocities.iter_mut().for_each(|velocity| *velocity += gravity);
    }

    /// Viscosity, after the pressures: what these leave unbalanced between neighbours does not move them.
    fn drag(&mut self, dt: f64) {
        self.solver.velocities.fill([0.0; 4]);
        self.set_row_velocities();
        let Self { rows, solver, state, config, .. } = self;
        let step = ViscousStep {
            support: self.kernel.support as f32,
            spread: config.viscosity * dt,
            spacing: config.spacing,
        };
        let change = self.viscosity.solve(rows, step, &mut solver.velocities);
        for (velocity, row) in state.velocities.iter_mut().zip(&rows.row_of) {
            *velocity += change[*row as usize];
        }
        // What rough walls hold back drags them along.
        let mass = config.density * config.spacing.powi(3);
        let scale = step.scale() * mass * f64::from(WALL_DRAG);
        for WallLink { particle, wall, factor } in &rows.wall_links {
            let (particle, wall) = (*particle as usize, *wall as usize);
            let [own, its] = [rows.row_of[particle], rows.row_of_wall[wall]].map(|row| {
                Vector3::from_fn(|axis, _| f64::from(self.viscosity.velocities[row as usize][axis]))
            });
            self.wall_forces[self.wall_cells.order[wall] as usize] +=
                (its - own) * (scale * f64::from(*factor));
        }
    }

    /// Copies the velocities of particles and walls to their rows.
    fn set_row_velocities(&mut self) {
        let Self { rows, solver, state, .. } = self;
        solver.set_velocities(rows, &state.velocities);
        for wall in &rows.wet {
            let velocity = self.wall_velocities[*wall as usize];
            solver.velocities[rows.row_of_wall[*wall as usize] as usize] =
                [velocity.x as f32, velocity.y as f32, velocity.z as f32, 0.0];
        }
        rows.copy_to_images(&mut solver.velocities);
    }

    /// Solves for the pressures of a substep and applies them. Returns iterations, and the mean remaining compression
    /// as a fraction.
    fn press(&mut self, dt: f64) -> (u32, f64) {
        self.solver.resize(self.rows.count());
        self.set_row_velocities();
        let Self { rows, solver, state, change, config, .. } = self;
        let (particles, count) = (rows.particles, rows.count());
        rows.compression_rate(&solver.velocities, &mut solver.wanted);
        for MirrorPlane { particle, normal, velocity, slope, .. } in &self.mirrors {
            let towards = normal.dot(&(state.velocities[*particle as usize] - velocity));
            solver.wanted[rows.row_of[*particle as usize] as usize] += slope * towards as f32;
        }
        // From here on these are changes, which are zero for walls.
        solver.velocities[particles..].fill([0.0; 4]);
        // Existing compression is released slowly: at once it would act as a spring, and explode where liquid was
        // placed too densely.
        let square: f64 = state.velocities.iter().map(Vector3::norm_squared).sum();
        let square = square / state.velocities.len().max(1) as f64;
        let fall = config.spacing / square.max(config.spacing * config.gravity.norm()).max(1e-12).sqrt();
        let relief = (dt / (RELIEF * fall)).min(RELIEF_MAX) as f32;
        let least = 1e-6 / (self.kernel.support * self.kernel.support) as f32;
        for row in 0..count {
            let there = rows.compression[row] - 1.0;
            // Below rest density it may contract.
            let share = if there > 0.0 { there * relief } else { there };
            solver.wanted[row] = solver.wanted[row] * dt as f32 + share;
            let is_spray = row < particles && rows.degree[row] < NEIGHBOURS_MIN;
            solver.is_active[row] = !is_spray && rows.diagonal[row] > least;
        }
        for (push, row) in state.pushes.iter().zip(&rows.row_of) {
            solver.pressures[*row as usize] = *push;
        }
        for wall in &rows.wet {
            solver.pressures[rows.row_of_wall[*wall as usize] as usize] =
                state.wall_pushes[self.wall_cells.order[*wall as usize] as usize];
        }
        let (iterations, left) = solver.solve(rows, dt as f32, config.compression, config.iterations_max);
        let pressures = &solver.pressures;
        for (push, row) in state.pushes.iter_mut().zip(&rows.row_of) {
            *push = pressures[*row as usize];
        }
        state.wall_pushes.fill(0.0);
        for wall in &rows.wet {
            state.wall_pushes[self.wall_cells.order[*wall as usize] as usize] =
                pressures[rows.row_of_wall[*wall as usize] as usize];
        }
        rows.copy_to_images(&mut solver.pressures);
        let pressures = &solver.pressures;
        sized(change, particles);
        rows.each(change, &PressureForces { pressures, scale: -dt });
        for (velocity, row) in state.velocities.iter_mut().zip(&rows.row_of) {
            *velocity += change[*row as usize];
        }
        let mass = config.density * config.spacing.powi(3);
        for WallLink { particle, wall, factor } in &rows.wall_links {
            let (particle, wall) = (*particle as usize, *wall as usize);
            let rows_of = [rows.row_of[particle], rows.row_of_wall[wall]];
            let [own, its] = rows_of.map(|row| pressures[row as usize]);
            let times = (own + its) * factor;
            let [x, y, z] = std::array::from_fn(|axis| {
                f64::from(times * (rows.liquid[particle][axis] - self.wall_places[wall][axis]))
            });
            // As an impulse; divided by the time step at its end.
            self.wall_forces[self.wall_cells.order[wall] as usize] += Vector3::new(x, y, z) * (dt * mass);
        }
        for MirrorPlane { particle, wall, normal, slope, .. } in &self.mirrors {
            let own = pressures[rows.row_of[*particle as usize] as usize];
            let push = normal * (f64::from(own * slope) * dt);
            state.velocities[*particle as usize] -= push;
            self.wall_forces[self.wall_cells.order[*wall as usize] as usize] += push * mass;
        }
        self.pressure.clear();
        self.pressure.extend(state.pushes.iter().map(|push| config.density * f64::from(*push)));
        if let Some(Ends { axis, pressure_drop }) = config.ends {
            let (low, high) = (config.min[axis], config.max[axis]);
            for (pressure, position) in self.pressure.iter_mut().zip(&state.positions) {
                *pressure += pressure_drop * (high - position[axis]) / (high - low);
            }
        }
        (iterations, left)
    }

    /// Keeps particles from passing through walls: pressure needs compression, which a surface at a wall or a drop does
    /// not have. No particle comes nearer to a sample than the limit.
    fn contain(&mut self, dt: f64) {
        let near = NEAREST * self.config.spacing;
        let near_plane = NEAREST_PLANE * self.config.spacing;
        let mass = self.config.density * self.particle_volume();
        // In a corner the second sample may push back towards the first; particles not pushed back keep their position.
        self.sent_back.clear();
        self.sent_back.resize(self.state.positions.len(), false);
        for is_first in [true, false] {
            for WallLink { particle, wall, .. } in &self.rows.wall_links {
                let (a, b) = (*particle as usize, *wall as usize);
                if !is_first && !self.sent_back[a] {
                    continue;
                }
                let apart = self.state.positions[a] - self.walls[b];
                // Particles too far to reach the wall are skipped: (n + w)² is at most 2 (n² + w²).
                let way = (self.state.velocities[a] - self.wall_velocities[b]).norm_squared() * dt * dt;
                if apart.norm_squared() > 2.0 * (near * near + way) {
                    continue;
                }
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
                    self.sent_back[a] = true;
                    self.wall_forces[self.wall_cells.order[b] as usize] += change * mass;
                }
            }
            for plane in self.mirrors.iter().filter(|plane| plane.is_before) {
                let MirrorPlane { particle, wall, normal, distance, velocity, .. } = plane;
                let a = *particle as usize;
                let towards = (self.state.velocities[a] - velocity).dot(normal);
                let most = ((distance - near_plane) / dt).max(0.0);
                if towards < -most {
                    let change = normal * (towards + most);
                    self.state.velocities[a] -= change;
                    self.sent_back[a] = true;
                    self.wall_forces[self.wall_cells.order[*wall as usize] as usize] += change * mass;
                }
            }
        }
    }
}

/// Resizes a list; its contents are unspecified.
fn sized(list: &mut Vec<Vector3<f64>>, count: usize) {
    list.resize(count, Vector3::zeros());
}
