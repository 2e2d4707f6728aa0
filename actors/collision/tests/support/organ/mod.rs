//! A folded organ for tests, benches and examples: a gut of closed meanders whose strands nearly touch, with haustra, that
//! heaves. Closed, manifold, outward, without poles.

pub mod line_trial;
pub mod rounds;
pub mod shapes;

use nalgebra::{Point3, Vector3};
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64;

/// Its shape; lengths \[m\].
#[derive(Clone, Copy, Debug)]
pub struct Organ {
    /// Rings along it.
    pub rings: usize,
    /// Vertices of a ring.
    pub around: usize,
    /// Meanders.
    pub folds: usize,
}

/// Mean radius of the loop, and how far the meanders reach in and out of it \[m\].
const LOOP: f64 = 0.05;
const MEANDER: f64 = 0.02;
/// Mean radius of the tube: where meanders come nearest to each other, half a millimetre is left between them \[m\].
const TUBE: f64 = 0.0054;

impl Organ {
    /// About so many triangles.
    pub fn with_triangles(triangles: usize) -> Self {
        let around = ((triangles as f64 / 2.0 / 8.0).sqrt().round() as usize).max(6);
        Self { rings: triangles / 2 / around, around, folds: 6 }
    }

    pub fn triangles(&self) -> Vec<[u32; 3]> {
        let at = |ring: usize, place: usize| ((ring % self.rings) * self.around + place % self.around) as u32;
        let mut triangles = Vec::with_capacity(2 * self.rings * self.around);
        for ring in 0..self.rings {
            for place in 0..self.around {
                let corners =
                    [at(ring, place), at(ring + 1, place), at(ring + 1, place + 1), at(ring, place + 1)];
                // Diagonals in turn, so that edges run every way.
                if (ring + place) % 2 == 0 {
                    triangles.push([corners[0], corners[1], corners[2]]);
                    triangles.push([corners[0], corners[2], corners[3]]);
                } else {
                    triangles.push([corners[0], corners[1], corners[3]]);
                    triangles.push([corners[1], corners[2], corners[3]]);
                }
            }
        }
        triangles
    }

    fn middle(&self, turn: f64, time: f64) -> Point3<f64> {
        let folds = self.folds as f64;
        let reach = LOOP + (MEANDER + 0.003 * (1.3 * time).sin()) * (folds * turn).cos();
        let lift = 0.006 * (2.0 * folds * turn + 0.9 * time).sin() + 0.004 * (3.0 * turn - 0.7 * time).cos();
        Point3::new(reach * turn.cos(), reach * turn.sin(), lift)
    }

    /// Where its vertices are at a time \[s\]: at most about 20 mm/s.
    pub fn vertices(&self, time: f64) -> Vec<Point3<f64>> {
        let mut vertices = Vec::with_capacity(self.rings * self.around);
        for ring in 0..self.rings {
            let turn = ring as f64 / self.rings as f64 * std::f64::consts::TAU;
            let middle = self.middle(turn, time);
            let along = (self.middle(turn + 1e-4, time) - self.middle(turn - 1e-4, time)).normalize();
            let side = along.cross(&Vector3::z()).normalize();
            let up = side.cross(&along);
            for place in 0..self.around {
                let angle = place as f64 / self.around as f64 * std::f64::consts::TAU;
                let haustra = 1.0
                    + 0.18 * (40.0 * turn - 1.1 * time).sin().powi(3)
                    + 0.08 * (3.0 * angle + 5.0 * turn).cos();
                vertices.push(middle + (side * angle.cos() + up * angle.sin()) * (TUBE * haustra));
            }
        }
        vertices
    }
}

/// Six times the volume that triangles enclose; positive where they are outward \[m³\].
pub fn volume(vertices: &[Point3<f64>], triangles: &[[u32; 3]]) -> f64 {
    triangles
        .iter()
        .map(|corners| {
            let [a, b, c] = corners.map(|vertex| vertices[vertex as usize].coords);
            a.dot(&b.cross(&c))
        })
        .sum()
}

/// A hand that wanders about the organ with a long instrument: slides along and across, turns, pauses, leaps.
pub struct Wanderer {
    random: Pcg64,
    tip: Point3<f64>,
    handle: Point3<f64>,
    goal: Point3<f64>,
    /// Distance of a step \[m\].
    pub step: f64,
    /// Of how many steps one is a leap; 0 for none.
    pub leaps: u32,
}

impl Wanderer {
    pub fn new(seed: u64, step: f64) -> Self {
        Self {
            random: Pcg64::seed_from_u64(seed),
            tip: Point3::new(0.05, 0.0, 0.02),
            handle: Point3::new(0.2, 0.1, 0.25),
            goal: Point3::new(0.05, 0.0, 0.0),
            step,
            leaps: 2000,
        }
    }

    /// The shaft at the next step: from the handle's side to the tip.
    pub fn shaft(&mut self) -> [Point3<f64>; 2] {
        if self.leaps > 0 && self.random.random_range(0..self.leaps) == 0 {
            self.tip = self.somewhere(0.09);
            self.handle = self.somewhere(0.3);
        }
        if (self.goal - self.tip).norm() < self.step || self.random.random_range(0..400) == 0 {
            self.goal = self.somewhere(0.075);
        }
        if self.random.random_range(0..50) != 0 {
            self.tip += (self.goal - self.tip).normalize() * self.step;
            let sway = self.somewhere(1.0).coords.normalize() * self.step;
            self.handle += sway;
        }
        let along = (self.tip - self.handle).normalize();
        [self.tip - along * 0.12, self.tip]
    }

    fn somewhere(&mut self, reach: f64) -> Point3<f64> {
        let turn = self.random.random_range(0.0..std::f64::consts::TAU);
        let out = reach * self.random.random_range(0.2..1.0_f64);
        Point3::new(out * turn.cos(), out * turn.sin(), self.random.random_range(-0.2..0.3) * reach)
    }
}
