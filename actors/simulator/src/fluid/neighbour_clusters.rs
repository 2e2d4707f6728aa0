//! Sums over the common neighbours of eight adjacent rows: the pressure operator, and the pair forces between
//! particles.

use nalgebra::Vector3;

use super::neighbour_lists::Rows;
use super::neighbour_search::{LANES, Lanes, Packed};
use crate::simd::f32x8::{Eight, ForEight, with_eight};

/// Regularises viscosity where particles meet, as a fraction of the squared support (Monaghan 2005).
const SOFT: f32 = 0.01;

/// Drag of a rough wall in terms of the viscous forces between particles. Next to a flat wall it makes the velocity of
/// the liquid that of the wall half a spacing from the samples, where the liquid ends: with a linear profile the first
/// layer, half a spacing from there, is dragged by the wall as much as by the second layer. The factors of a sample and
/// the lattice of its neighbours then add up to 0.51 over the square of a spacing, so that this is 2 / 0.51, over the
/// factor 12.8 of the forces.
pub(super) const WALL_DRAG: f32 = 0.306;

/// Neighbours of eight consecutive rows: each neighbour of one is in the common list, with a factor of 0 for the other
/// rows.
#[derive(Clone, Copy)]
pub(super) struct Links<'a> {
    /// The first row.
    pub row: usize,
    /// Positions of the rows, relative to the corner of the box \[m\].
    pub axes: &'a [Lanes; 3],
    /// Positions of all rows.
    pub places: &'a [[f32; 4]],
    /// Rows of the neighbours: particles first, then walls.
    pub others: &'a [u32],
    /// Factors of the pair gradients, multiplying the vectors from each neighbour to the rows, in units.
    pub factors: &'a [Packed],
    /// The unit of factors \[1/m²\].
    pub unit: f32,
    /// Number of particles.
    pub liquid: usize,
}

impl<'a> Links<'a> {
    /// The particles among the neighbours, with their factors.
    #[inline(always)]
    fn liquid(self) -> impl Iterator<Item = (&'a u32, &'a Packed)> {
        self.others[..self.liquid].iter().zip(self.factors)
    }

    /// The wall samples among the neighbours, with their factors.
    #[inline(always)]
    fn walls(self) -> impl Iterator<Item = (&'a u32, &'a Packed)> {
        self.others[self.liquid..].iter().zip(&self.factors[self.liquid..])
    }

    /// Sums the neighbours' values times the factors.
    #[inline(always)]
    fn weighted<E: Eight>(self, eight: E, of: &[[f32; 4]]) -> [E::Numbers; 4] {
        let [mut x, mut y, mut z, mut w] = [eight.all(0.0); 4];
        for (other, factor) in self.others.iter().zip(self.factors) {
            let (its, factor) = (&of[*other as usize], eight.unpack(&factor.0));
            x = eight.add(x, eight.mul(factor, eight.all(its[0])));
            y = eight.add(y, eight.mul(factor, eight.all(its[1])));
            z = eight.add(z, eight.mul(factor, eight.all(its[2])));
            w = eight.add(w, eight.mul(factor, eight.all(its[3])));
        }
        let unit = eight.all(self.unit);
        [eight.mul(x, unit), eight.mul(y, unit), eight.mul(z, unit), eight.mul(w, unit)]
    }

    /// Positions of the rows.
    #[inline(always)]
    fn own<E: Eight>(self, eight: E) -> [E::Numbers; 3] {
        vector(eight, self.axes)
    }

    /// The rows' values in a list of vectors.
    #[inline(always)]
    fn of_own<E: Eight>(self, eight: E, of: &[[f32; 4]]) -> [E::Numbers; 4] {
        eight.columns(&eight_of(of, self.row))
    }
}

/// One vector for each.
#[inline(always)]
fn vector<E: Eight>(eight: E, [x, y, z]: &[Lanes; 3]) -> [E::Numbers; 3] {
    // Written out: a closure here would be called through memory.
    [eight.load(&x.0), eight.load(&y.0), eight.load(&z.0)]
}

/// The first three.
#[inline(always)]
fn three<T>([x, y, z, _]: [T; 4]) -> [T; 3] {
    [x, y, z]
}

/// The vectors from a point.
#[inline(always)]
fn ways<E: Eight>(eight: E, own: [E::Numbers; 3], from: &[f32; 4]) -> [E::Numbers; 3] {
    let [x, y, z] = own;
    [eight.sub(x, eight.all(from[0])), eight.sub(y, eight.all(from[1])), eight.sub(z, eight.all(from[2]))]
}

/// Eight items of a list from an index on.
#[inline(always)]
fn eight_of<T: Copy + Default>(list: &[T], from: usize) -> [T; LANES] {
    let mut eight = [T::default(); LANES];
    eight.copy_from_slice(&list[from..from + LANES]);
    eight
}

/// Writes scaled sums of eight rows.
#[inline(always)]
fn write<E: Eight>(eight: E, out: &mut [Vector3<f64>], sums: [E::Sums; 3], scale: f64) {
    let [x, y, z] = sums;
    let sums = [eight.sums(x), eight.sums(y), eight.sums(z)];
    for (k, out) in out.iter_mut().enumerate() {
        *out = Vector3::new(sums[0][k], sums[1][k], sums[2][k]) * scale;
    }
}

/// A computation of row values from their links.
pub(super) trait Sweep<T> {
    /// For eight rows; everything that it calls has to be inlined.
    fn sweep<E: Eight>(&self, eight: E, links: Links<'_>, out: &mut [T]);
}

/// Pressure forces times `scale`: the sum of both pressures times the gradient. In double precision, so that action and
/// reaction cancel: each term is identical from both sides except for its sign, and sums are accurate enough.
pub(super) struct PressureForces<'a> {
    pub pressures: &'a [f32],
    pub scale: f64,
}

impl Sweep<Vector3<f64>> for PressureForces<'_> {
    #[inline(always)]
    fn sweep<E: Eight>(&self, eight: E, links: Links<'_>, out: &mut [Vector3<f64>]) {
        let (own, place) = (eight.load(&eight_of(self.pressures, links.row)), links.own(eight));
        let [mut x, mut y, mut z] = [eight.nothing(); 3];
        for (other, factor) in links.others.iter().zip(links.factors) {
            let its = eight.all(self.pressures[*other as usize]);
            let times = eight.mul(eight.add(own, its), eight.unpack(&factor.0));
            let way = ways(eight, place, &links.places[*other as usize]);
            x = eight.add_to(x, eight.mul(times, way[0]));
            y = eight.add_to(y, eight.mul(times, way[1]));
            z = eight.add_to(z, eight.mul(times, way[2]));
        }
        write(eight, out, [x, y, z], self.scale * f64::from(links.unit));
    }
}

/// Viscous velocity change times `scale`: the sum over particles of the approach velocity along the connecting vector
/// (Monaghan, *Smoothed particle hydrodynamics*, 2005), except for ten times the viscosity \[1/s/m²\].
pub(super) struct ViscousForces<'a> {
    pub velocities: &'a [[f32; 4]],
    pub support: f32,
    pub scale: f64,
    /// Whether rough walls drag.
    pub walls: bool,
}

impl ViscousForces<'_> {
    /// The sums over the particles, and over all.
    #[inline(always)]
    fn sums<E: Eight>(&self, eight: E, links: Links<'_>) -> [[E::Sums; 3]; 2] {
        let soft = eight.all(SOFT * self.support * self.support);
        let (own, place) = (three(links.of_own(eight, self.velocities)), links.own(eight));
        let [mut x, mut y, mut z] = [eight.nothing(); 3];
        for (other, factor) in links.liquid() {
            let way = ways(eight, place, &links.places[*other as usize]);
            let apart = ways(eight, own, &self.velocities[*other as usize]);
            let drag = eight.div(eight.unpack(&factor.0), eight.add(eight.dot(way, way), soft));
            let push = eight.mul(drag, eight.dot(apart, way));
            x = eight.add_to(x, eight.mul(push, way[0]));
            y = eight.add_to(y, eight.mul(push, way[1]));
            z = eight.add_to(z, eight.mul(push, way[2]));
        }
        let between = [x, y, z];
        let walls = if self.walls { usize::MAX } else { 0 };
        for (other, factor) in links.walls().take(walls) {
            let apart = ways(eight, own, &self.velocities[*other as usize]);
            let drag = eight.mul(eight.unpack(&factor.0), eight.all(WALL_DRAG));
            x = eight.add_to(x, eight.mul(drag, apart[0]));
            y = eight.add_to(y, eight.mul(drag, apart[1]));
            z = eight.add_to(z, eight.mul(drag, apart[2]));
        }
        [between, [x, y, z]]
    }
}

impl Sweep<Vector3<f64>> for ViscousForces<'_> {
    #[inline(always)]
    fn sweep<E: Eight>(&self, eight: E, links: Links<'_>, out: &mut [Vector3<f64>]) {
        let [_, sums] = self.sums(eight, links);
        write(eight, out, sums, self.scale * f64::from(links.unit));
    }
}

/// The viscous forces, and those between particles alone times a scale of their own.
pub(super) struct ForcesAndNoise<'a> {
    pub forces: ViscousForces<'a>,
    pub noise: f64,
}

impl Sweep<(Vector3<f64>, [f32; 4])> for ForcesAndNoise<'_> {
    #[inline(always)]
    fn sweep<E: Eight>(&self, eight: E, links: Links<'_>, out: &mut [(Vector3<f64>, [f32; 4])]) {
        let [between, sums] = self.forces.sums(eight, links);
        let (scale, noise) = (self.forces.scale * f64::from(links.unit), self.noise * f64::from(links.unit));
        let [x, y, z] = sums;
        let sums = [eight.sums(x), eight.sums(y), eight.sums(z)];
        let [x, y, z] = between;
        let between = [eight.sums(x), eight.sums(y), eight.sums(z)];
        for (k, out) in out.iter_mut().enumerate() {
            let small = |axis: usize| (between[axis][k] * noise) as f32;
            *out = (
                Vector3::new(sums[0][k], sums[1][k], sums[2][k]) * scale,
                [small(0), small(1), small(2), 0.0],
            );
        }
    }
}

/// Compression rate of the rows by velocities \[1/s\].
struct CompressionRate<'a>(&'a [[f32; 4]]);

impl Sweep<f32> for CompressionRate<'_> {
    #[inline(always)]
    fn sweep<E: Eight>(&self, eight: E, links: Links<'_>, out: &mut [f32]) {
        let (own, place) = (three(links.of_own(eight, self.0)), links.own(eight));
        let mut sum = eight.all(0.0);
        for (other, factor) in links.others.iter().zip(links.factors) {
            let way = ways(eight, place, &links.places[*other as usize]);
            let apart = ways(eight, own, &self.0[*other as usize]);
            sum = eight.add(sum, eight.mul(eight.unpack(&factor.0), eight.dot(apart, way)));
        }
        out.copy_from_slice(&eight.store(eight.mul(sum, eight.all(links.unit))));
    }
}

/// Velocity change by pressures in a second, as differences of sums: of each row the pressure times its position, and
/// the pressure. The fourth number is the velocity times the position.
struct Gradient<'a> {
    rows: &'a Rows,
    lifted: &'a [[f32; 4]],
}

impl Sweep<[f32; 4]> for Gradient<'_> {
    #[inline(always)]
    fn sweep<E: Eight>(&self, eight: E, links: Links<'_>, out: &mut [[f32; 4]]) {
        let sums = links.weighted(eight, self.lifted);
        let cluster = links.row / LANES;
        let at = vector(eight, &self.rows.centred[cluster]);
        let pull = vector(eight, &self.rows.pulls[cluster]);
        let [.., own] = links.of_own(eight, self.lifted);
        let along = |at, pull, sum| {
            let change = eight.sub(eight.mul(at, sums[3]), sum);
            eight.add(eight.mul(pull, own), change)
        };
        let [x, y, z] =
            [along(at[0], pull[0], sums[0]), along(at[1], pull[1], sums[1]), along(at[2], pull[2], sums[2])];
        let velocity = [x, y, z];
        out.copy_from_slice(&eight.rows([x, y, z, eight.dot(velocity, at)]));
    }
}

/// Compression rate by velocities, as differences of sums, times `factor` and `scale`.
struct Divergence<'a> {
    rows: &'a Rows,
    velocities: &'a [[f32; 4]],
    scale: &'a [f32],
    factor: f32,
}

impl Sweep<f32> for Divergence<'_> {
    #[inline(always)]
    fn sweep<E: Eight>(&self, eight: E, links: Links<'_>, out: &mut [f32]) {
        let sums = links.weighted(eight, self.velocities);
        let cluster = links.row / LANES;
        let at = vector(eight, &self.rows.centred[cluster]);
        let pull = vector(eight, &self.rows.pulls[cluster]);
        let own = eight.dot(pull, three(links.of_own(eight, self.velocities)));
        let its = eight.dot(at, [sums[0], sums[1], sums[2]]);
        let rate = eight.add(sums[3], eight.sub(own, its));
        let scale = eight.load(&eight_of(self.scale, links.row));
        out.copy_from_slice(&eight.store(eight.mul3(eight.all(self.factor), scale, rate)));
    }
}

impl Rows {
    /// The pressure operator, scaled symmetrically: the divergence of the gradient, each the transpose of the other,
    /// with walls at rest. `image` is the compression rate of each row \[1/s\], times `factor` and `scale`, due to the
    /// velocities produced in a second by pressures over density of `scale` times `of` \[m²/s²\]. `velocities` is a
    /// buffer.
    ///
    /// With the positions x, the factors f and R for the sum of f (xᵢ - xⱼ) over j, the sum of f (pᵢ + pⱼ) (xᵢ - xⱼ) is
    /// R pᵢ + xᵢ Σ f pⱼ - Σ f pⱼ xⱼ, and that of f (xᵢ - xⱼ)·(vᵢ - vⱼ) is R·vᵢ - xᵢ·Σ f vⱼ + Σ f xⱼ·vⱼ: only four
    /// numbers per neighbour are needed. The cancellation error is harmless in a solver; the motion of particles is
    /// computed directly.
    pub(super) fn product(
        &mut self,
        (scale, factor): (&[f32], f32),
        of: &[f32],
        velocities: &mut [[f32; 4]],
        image: &mut [f32],
    ) {
        let Self { centred, lifted, .. } = &mut *self;
        with_eight(WeightedPositions { centred, lifted, pressures: [of, scale] });
        let mut lifted = std::mem::take(&mut self.lifted);
        self.lift_images(&mut lifted, true);
        self.lifted = lifted;
        let rows = &*self;
        rows.each(&mut velocities[..rows.particles], &Gradient { rows, lifted: &rows.lifted });
        velocities[rows.particles..].fill([0.0; 4]);
        rows.lift_images(velocities, false);
        rows.each(image, &Divergence { rows, velocities, scale, factor });
    }

    /// Compression rate of each row by velocities \[1/s\].
    pub(super) fn compression_rate(&self, velocities: &[[f32; 4]], out: &mut [f32]) {
        self.each(out, &CompressionRate(velocities));
    }
}

/// Computes positions times pressures of rows; the pressures are themselves products.
struct WeightedPositions<'a> {
    centred: &'a [[Lanes; 3]],
    lifted: &'a mut Vec<[f32; 4]>,
    pressures: [&'a [f32]; 2],
}

impl ForEight for WeightedPositions<'_> {
    type Output = ();

    #[inline(always)]
    fn run<E: Eight>(self, eight: E) {
        let Self { centred, lifted, pressures } = self;
        lifted.resize(centred.len() * LANES, [0.0; 4]);
        for (cluster, (at, out)) in centred.iter().zip(lifted.chunks_exact_mut(LANES)).enumerate() {
            let [of, scale] = pressures;
            let [of, scale] = [eight_of(of, cluster * LANES), eight_of(scale, cluster * LANES)];
            let pressure = eight.mul(eight.load(&of), eight.load(&scale));
            let [x, y, z] = vector(eight, at);
            let [x, y, z] = [eight.mul(x, pressure), eight.mul(y, pressure), eight.mul(z, pressure)];
            out.copy_from_slice(&eight.rows([x, y, z, pressure]));
        }
    }
}
