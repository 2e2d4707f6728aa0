//! A liquid in a box: its particles and walls, what is added and removed. `sph.rs` moves it.

use nalgebra::{Point3, Vector3};

use super::cell_grid::{CellGrid, CellStarts};
use super::config::{FluidConfig, FluidState};
use super::error::{FluidError, parameter};
use super::kernel::Kernel;
use super::mirror_walls::MirrorPlane;
use super::neighbour_lists::Rows;
use super::pressure::Solver;
use super::viscosity::ViscositySolver;

/// Support radius of the kernel in particle spacings.
const SUPPORT: f64 = 2.0;
/// Sum of kernels times volumes over one lattice layer: a flat wall's sum over its own samples.
const LAYER: f64 = 0.7006;
/// How far particles are added beside their positions, in spacings.
const OFF_LATTICE: f64 = 0.1;
const CELLS_MAX: usize = 8_000_000;
const CELLS_ALONG: usize = 4_096;

/// A liquid.
#[derive(Clone, Debug)]
pub struct Fluid {
    pub(super) config: FluidConfig,
    pub(super) kernel: Kernel,
    pub(super) grid: CellGrid,
    pub(super) state: FluidState,
    pub(super) backup: FluidState,
    pub(super) cells: CellStarts,
    pub(super) image_cells: CellStarts,
    pub(super) images: Vec<(u32, Point3<f64>)>,
    pub(super) wall_cells: CellStarts,
    pub(super) walls: Vec<Point3<f64>>,
    pub(super) wall_velocities: Vec<Vector3<f64>>,
    /// Normal of each wall sample; zero where not given.
    pub(super) wall_normals: Vec<Vector3<f64>>,
    /// Forces on the samples, in the order given.
    pub(super) wall_forces: Vec<Vector3<f64>>,
    /// Positions relative to the corner of the box \[m\], and volumes represented \[m³\], in the order of their cells.
    pub(super) wall_places: Vec<[f32; 4]>,
    /// Whether each is smooth, in that order.
    pub(super) wall_smooth: Vec<bool>,
    /// Smooth walls near particles, and a buffer.
    pub(super) mirrors: Vec<MirrorPlane>,
    pub(super) near: Vec<(u32, f64)>,
    pub(super) rows: Rows,
    pub(super) solver: Solver,
    pub(super) viscosity: ViscositySolver,
    /// Velocity change of each row.
    pub(super) change: Vec<Vector3<f64>>,
    pub(super) pressure: Vec<f64>,
    pub(super) speeds: Vec<f32>,
    /// Particles pushed back by walls.
    pub(super) sent_back: Vec<bool>,
}

impl Fluid {
    /// An empty box without walls.
    ///
    /// # Errors
    /// A parameter out of range.
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
        if let Some(ends) = config.ends {
            parameter("axis of the ends", ends.axis as f64, 0.0..=2.0, "0, 1 or 2")?;
            parameter("pressure_drop", ends.pressure_drop, -1e7..=1e7, "-1e7 to 1e7 Pa")?;
            let length = (config.max[ends.axis] - config.min[ends.axis]) / config.spacing;
            parameter("length between the ends in spacings", length, 2.0 * SUPPORT..=1e5, "4 to 100,000")?;
        }
        let kernel = Kernel::new(SUPPORT * config.spacing);
        let cells: f64 =
            (0..3).map(|axis| ((config.max[axis] - config.min[axis]) / kernel.support).ceil()).product();
        parameter("cells of the box", cells, 1.0..=CELLS_MAX as f64, "1 to 8,000,000")?;
        let grid = CellGrid::new(config.min, config.max, kernel.support);
        // Positions are stored in single precision, relative to a corner.
        let longest = grid.size.iter().copied().max().unwrap_or(0);
        parameter("cells of the box along an axis", longest as f64, 1.0..=CELLS_ALONG as f64, "1 to 4,096")?;
        let mut wall_cells = CellStarts::default();
        wall_cells.sort(&grid, &[]);
        Ok(Self {
            kernel,
            grid,
            state: FluidState::default(),
            backup: FluidState::default(),
            cells: CellStarts::default(),
            image_cells: CellStarts::default(),
            images: Vec::new(),
            wall_cells,
            walls: Vec::new(),
            wall_velocities: Vec::new(),
            wall_normals: Vec::new(),
            wall_forces: Vec::new(),
            wall_places: Vec::new(),
            wall_smooth: Vec::new(),
            mirrors: Vec::new(),
            near: Vec::new(),
            rows: Rows::default(),
            solver: Solver::default(),
            viscosity: ViscositySolver::default(),
            change: Vec::new(),
            pressure: Vec::new(),
            speeds: Vec::new(),
            sent_back: Vec::new(),
            config,
        })
    }

    /// Continues from a state, bit for bit.
    ///
    /// # Errors
    /// Lists of different lengths, too many particles, non-finite numbers.
    pub fn restore(&mut self, state: &FluidState) -> Result<(), FluidError> {
        let count = state.positions.len();
        let lengths = [state.numbers.len(), state.velocities.len(), state.pushes.len()];
        if lengths.iter().any(|length| *length != count) || count > self.config.particles_max {
            return Err(FluidError::State { count, most: self.config.particles_max });
        }
        let is_finite = |index: &usize| {
            let mut numbers = state.positions[*index].iter().chain(state.velocities[*index].iter());
            numbers.all(|x| x.is_finite()) && state.pushes[*index].is_finite()
        };
        if let Some(particle) = (0..count).find(|index| !is_finite(index)) {
            return Err(FluidError::NotFinite { particle });
        }
        if let Some(particle) = state.wall_pushes.iter().position(|push| !push.is_finite()) {
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

    /// Its settings.
    #[must_use]
    pub fn config(&self) -> &FluidConfig {
        &self.config
    }

    /// Changes gravity \[m/s²\], as where the box rotates; a non-finite value is ignored.
    pub fn set_gravity(&mut self, gravity: Vector3<f64>) {
        if gravity.iter().all(|g| g.abs() <= 1e3) {
            self.config.gravity = gravity;
        }
    }

    /// Volume of a particle \[m³\].
    #[must_use]
    pub fn particle_volume(&self) -> f64 {
        self.config.spacing.powi(3)
    }

    /// The smallest kinematic viscosity that particles of this spacing \[m\] carry in a flow of this speed \[m/s\], to within
    /// a factor of 1.5: as particles make way for each other, they exchange momentum as a viscosity of a third to a half of
    /// the spacing times the speed would \[m²/s\].
    #[must_use]
    pub fn viscosity_min(spacing: f64, speed: f64) -> f64 {
        spacing * speed
    }

    /// Pressure of each particle in the last substep of the last step \[Pa\], in the order of the state's lists.
    #[must_use]
    pub fn pressures(&self) -> &[f64] {
        &self.pressure
    }

    /// Replaces the wall samples, which are half a spacing beyond the end of the liquid: positions \[m\], at most a spacing
    /// apart, and velocities \[m/s\]. With an unchanged number, they are taken to be the same samples, moved.
    ///
    /// # Errors
    /// Lists of different lengths, more than 1,000,000, non-finite numbers.
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
        if self.state.wall_pushes.len() != samples.len() {
            self.state.wall_pushes.clear();
            self.state.wall_pushes.resize(samples.len(), 0.0);
        }
        self.walls.clear();
        self.walls.extend(self.wall_cells.order.iter().map(|index| samples[*index as usize]));
        self.wall_velocities.clear();
        self.wall_velocities.extend(self.wall_cells.order.iter().map(|index| velocities[*index as usize]));
        self.wall_normals.clear();
        self.wall_normals.resize(samples.len(), Vector3::zeros());
        let min = self.config.min;
        self.wall_places.clear();
        for sample in &self.walls {
            let mut sum = 0.0;
            self.wall_cells.around(&self.grid, &self.walls, sample, self.kernel.support, |_, square| {
                sum += self.kernel.value_and_slope(square.sqrt()).0;
            });
            self.wall_places.push(seen_from(&min, sample, (LAYER / sum) as f32));
        }
        self.wall_smooth.clear();
        self.wall_smooth.resize(samples.len(), false);
        self.wall_forces.clear();
        self.wall_forces.resize(samples.len(), Vector3::zeros());
        Ok(())
    }

    /// Sets the wall normals at the samples last given, of any length and either sign. There the wall is smooth: nothing
    /// holds the liquid along it. A zero normal means unknown, as do all before the first call.
    ///
    /// # Errors
    /// A number of normals other than that of samples, non-finite numbers.
    pub fn set_wall_normals(&mut self, normals: &[Vector3<f64>]) -> Result<(), FluidError> {
        if normals.len() != self.walls.len() {
            return Err(FluidError::State { count: normals.len(), most: self.walls.len() });
        }
        if let Some(particle) = normals.iter().position(|normal| !normal.iter().all(|x| x.is_finite())) {
            return Err(FluidError::NotFinite { particle });
        }
        for (to, from) in self.wall_normals.iter_mut().zip(&self.wall_cells.order) {
            *to = normals[*from as usize].try_normalize(0.0).unwrap_or_else(Vector3::zeros);
        }
        for (to, normal) in self.wall_smooth.iter_mut().zip(&self.wall_normals) {
            *to = *normal != Vector3::zeros();
        }
        Ok(())
    }

    /// Force of the liquid on each wall sample in the order given, over the last step \[N\].
    #[must_use]
    pub fn wall_forces(&self) -> &[Vector3<f64>] {
        &self.wall_forces
    }

    /// Adds a particle, up to a tenth of a spacing beside its position along each axis, by its number: on an exact lattice,
    /// particles lock as in a crystal, and hold a flow up until they have left it. Beyond the limit, the oldest is removed.
    /// Returns its number; `None` outside of the box or for non-finite values.
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
        self.state.positions.push(self.off_lattice(position, number));
        self.state.velocities.push(velocity);
        self.state.pushes.push(0.0);
        Some(number)
    }

    /// A position for a particle of this number.
    fn off_lattice(&self, position: Point3<f64>, number: u64) -> Point3<f64> {
        // The generalised golden ratio in three dimensions: evenly spread (Roberts 2018).
        const STEPS: [f64; 3] = [0.819_172_513_396_164_4, 0.671_043_606_703_789_2, 0.549_700_477_901_970_2];
        let by = |axis: usize| {
            let share = ((number as f64 + 0.5) * STEPS[axis]).fract();
            (2.0 * share - 1.0) * OFF_LATTICE * self.config.spacing
        };
        Point3::from(std::array::from_fn::<f64, 3, _>(|axis| {
            (position[axis] + by(axis)).clamp(self.config.min[axis], self.config.max[axis])
        }))
    }

    /// Removes at most this many particles within a ball, the nearest first, as a suction device does; returns how
    /// many.
    pub fn remove_within(&mut self, centre: &Point3<f64>, radius: f64, most: u64) -> u64 {
        if most == 0 {
            return 0;
        }
        let distances = self.state.positions.iter().map(|position| (position - centre).norm());
        let mut near: Vec<(f64, usize)> = distances
            .enumerate()
            .filter(|(_, far)| *far <= radius)
            .map(|(index, far)| (far, index))
            .collect();
        near.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        near.truncate(usize::try_from(most).unwrap_or(usize::MAX));
        // From the end, since the last one replaces each that is removed.
        near.sort_by_key(|(_, index)| std::cmp::Reverse(*index));
        near.iter().for_each(|(_, index)| self.absorb(*index));
        near.len() as u64
    }

    pub(super) fn is_inside(&self, point: &Point3<f64>) -> bool {
        (0..3).all(|axis| (self.config.min[axis]..=self.config.max[axis]).contains(&point[axis]))
    }

    pub(super) fn absorb(&mut self, index: usize) {
        self.state.numbers.swap_remove(index);
        self.state.positions.swap_remove(index);
        self.state.velocities.swap_remove(index);
        self.state.pushes.swap_remove(index);
        self.state.absorbed += 1;
    }
}

/// A point relative to a corner in single precision, with its volume.
pub(super) fn seen_from(corner: &Point3<f64>, point: &Point3<f64>, volume: f32) -> [f32; 4] {
    let apart = point - corner;
    [apart.x as f32, apart.y as f32, apart.z as f32, volume]
}
