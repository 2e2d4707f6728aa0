//! Smooth walls of a liquid: planes that mirror it.
//!
//! The density and the pressure at a smooth wall are those of the mirrored liquid beyond it, averaged along the wall,
//! half a spacing in front of the samples: a function of the distance alone, so that nothing holds the liquid along the
//! wall, and no unevenness of the samples lifts or drops it. (Samples that act by the kernel each are bumps of a
//! hundredth of the density, which lift a particle that slides over them, and let it fall again: a pool that never
//! comes to rest.)

use nalgebra::{Point3, Vector3};

use super::cell_grid::{CellGrid, CellStarts};
use super::neighbour_lists::Rows;

/// Largest number of planes at a particle.
const PLANES: usize = 3;
/// Samples whose normals differ by less than the angle of this cosine form one plane.
const ALIKE: f64 = 0.8;
/// Sum of the weights of the samples over a plane.
const WHOLE: f64 = 2.2;

/// A smooth wall near a particle.
#[derive(Clone, Copy, Debug)]
pub(super) struct MirrorPlane {
    pub particle: u32,
    /// The nearest sample, in the order of the samples' cells.
    pub wall: u32,
    /// Towards the particle.
    pub normal: Vector3<f64>,
    /// Distance from the plane of the samples \[m\].
    pub distance: f64,
    /// Velocity of the wall \[m/s\].
    pub velocity: Vector3<f64>,
    /// Gradient of the compression along the normal \[1/m\].
    pub slope: f32,
    /// Whether the particle is before the wall, not beside it.
    pub is_before: bool,
}

/// Smooth wall samples, sorted by cell.
pub(super) struct SmoothSamples<'a> {
    pub grid: &'a CellGrid,
    pub cells: &'a CellStarts,
    pub places: &'a [Point3<f64>],
    pub velocities: &'a [Vector3<f64>],
    /// Normals; zero at rough samples.
    pub normals: &'a [Vector3<f64>],
    /// Volumes represented, in particles.
    pub volumes: &'a [[f32; 4]],
    /// Volume of a particle \[m³\].
    pub volume: f64,
    /// Particle spacing, half of the kernel's support \[m\].
    pub spacing: f64,
}

/// Compression by a layer of particles at a distance, and its derivative, averaged along the layer; both in spacings.
fn layer(distance: f64) -> (f64, f64) {
    let q = 0.5 * distance;
    if q >= 1.0 {
        return (0.0, 0.0);
    }
    let rest = 1.0 - q;
    // The integral of the kernel over the plane.
    if q >= 0.5 {
        (8.0 * rest.powi(4) * (0.5 - 0.4 * rest), -8.0 * rest.powi(3) * q)
    } else {
        let square = q * q;
        let value = 0.0875 - square * (0.5 - square * (1.5 - 1.2 * q));
        (8.0 * value, -4.0 * q * (1.0 - square * (6.0 - 6.0 * q)))
    }
}

/// Compression by the mirrored liquid for a particle at a distance from the samples, and its derivative; in spacings.
pub(super) fn mirrored(distance: f64) -> (f64, f64) {
    let beyond = 2.0 * (distance - 0.5).max(0.0);
    let (first, second) = (layer(beyond), layer(beyond + 1.0));
    (first.0 + second.0, 2.0 * (first.1 + second.1))
}

/// Weight of a sample at this distance along the wall, in spacings: on a square lattice of samples, the sum is the same
/// everywhere to 0.3 %.
fn weight(along: f64) -> f64 {
    let q = 0.5 * along;
    if q >= 1.0 {
        0.0
    } else if q >= 0.5 {
        2.0 * (1.0 - q).powi(3)
    } else {
        1.0 - 6.0 * q * q * (1.0 - q)
    }
}

impl SmoothSamples<'_> {
    /// Finds the planes near each particle and adds them to the compression and to the gradients of its row.
    pub(super) fn add_to(
        &self,
        rows: &mut Rows,
        particles: &[Point3<f64>],
        near: &mut Vec<(u32, f64)>,
        planes: &mut Vec<MirrorPlane>,
    ) {
        planes.clear();
        let reach = 2.0 * self.spacing;
        for (particle, place) in particles.iter().enumerate() {
            near.clear();
            let cell = self.grid.index(self.grid.place(place));
            for (from, to) in self.grid.rows_about(cell) {
                for wall in self.cells.range(from, to) {
                    let apart = place - self.places[wall];
                    if self.normals[wall] != Vector3::zeros() && apart.norm_squared() < 2.0 * reach * reach {
                        let across = apart.dot(&self.normals[wall]).abs();
                        if across < reach {
                            near.push((wall as u32, across));
                        }
                    }
                }
            }
            for _ in 0..PLANES {
                let Some(plane) = self.next_plane(particle as u32, place, near) else { break };
                let row = rows.row_of[particle] as usize;
                let (value, slope) = mirrored(plane.distance / self.spacing);
                let share = f64::from(plane.slope);
                rows.compression[row] += (share * value) as f32;
                let slope = (share * slope / self.spacing) as f32;
                rows.pull(row, std::array::from_fn(|axis| slope * plane.normal[axis] as f32));
                planes.push(MirrorPlane { slope, ..plane });
            }
        }
    }

    /// The plane of the nearest samples, which are removed from the list; its `slope` is the share of it that is there.
    fn next_plane(
        &self,
        particle: u32,
        place: &Point3<f64>,
        near: &mut Vec<(u32, f64)>,
    ) -> Option<MirrorPlane> {
        loop {
            let first = near.iter().min_by(|a, b| {
                let size = |at: &(u32, f64)| (place - self.places[at.0 as usize]).norm_squared();
                size(a).total_cmp(&size(b)).then(a.0.cmp(&b.0))
            })?;
            let nearest = first.0;
            let facing = self.normals[nearest as usize];
            let way = (place - self.places[nearest as usize]).dot(&facing);
            let facing = if way < 0.0 { -facing } else { facing };
            let (mut whole, mut distance) = (0.0, 0.0);
            let (mut normal, mut velocity) = (Vector3::zeros(), Vector3::zeros());
            near.retain(|(wall, _)| {
                let wall = *wall as usize;
                let own = self.normals[wall];
                let alike = own.dot(&facing);
                if alike.abs() < ALIKE {
                    return true;
                }
                let own = if alike < 0.0 { -own } else { own };
                let apart = place - self.places[wall];
                let across = apart.dot(&own);
                let along = (apart - own * across).norm() / self.spacing;
                let weight = weight(along) * f64::from(self.volumes[wall][3]) / self.volume;
                whole += weight;
                distance += weight * across;
                normal += own * weight;
                velocity += self.velocities[wall] * weight;
                false
            });
            // Sharper than the weights, which are half of the whole before an edge, so that a hole is open up to its rim, and
            // a seam between walls is closed.
            let share = (2.5 * whole / WHOLE - 0.5).clamp(0.0, 1.0);
            // Beside the wall, or beyond it.
            if share == 0.0 || distance <= 0.0 {
                continue;
            }
            return Some(MirrorPlane {
                particle,
                wall: nearest,
                normal: normal.normalize(),
                distance: distance / whole,
                velocity: velocity / whole,
                slope: share as f32,
                is_before: share >= 0.375,
            });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_mirrored_liquid_goes_on_as_the_lattice_and_its_slope_is_its_derivative() {
        // The layers of a lattice: 0.7006 for its own one, 0.15 for the next.
        assert!((layer(0.0).0 - 0.7).abs() < 1e-9 && (layer(1.0).0 - 0.15).abs() < 1e-9);
        assert!((mirrored(1.0).0 - 0.15).abs() < 1e-9);
        for step in 0..40 {
            let distance = 0.55 + 0.04 * f64::from(step);
            let (value, slope) = (|at| mirrored(at).0, mirrored(distance).1);
            let derivative = (value(distance + 1e-6) - value(distance - 1e-6)) / 2e-6;
            assert!((slope - derivative).abs() < 1e-5, "{distance}: {slope} {derivative}");
        }
    }

    #[test]
    fn the_weights_of_a_lattice_of_samples_add_up_to_the_same_everywhere() {
        for (x, y) in (0..10).flat_map(|x| (0..10).map(move |y| (0.1 * f64::from(x), 0.1 * f64::from(y)))) {
            let lattice = (-3..=3).flat_map(|i| (-3..=3).map(move |j| (f64::from(i), f64::from(j))));
            let sum: f64 = lattice.map(|(i, j)| weight((x - i).hypot(y - j))).sum();
            assert!((sum / WHOLE - 1.0).abs() < 0.005, "{x} {y}: {sum}");
        }
    }
}
