//! Liquid in an open box.
#![allow(dead_code)] // every test uses another part

use nalgebra::{Point3, Vector3};
use trocar_simulator::fluid::{Fluid, FluidConfig};

/// Samples of the inner walls of an open box of this many particles, half a spacing beyond them, and their normals; the
/// floor's samples extend under the other walls.
pub fn walls(size: [i32; 3], spacing: f64) -> (Vec<Point3<f64>>, Vec<Vector3<f64>>) {
    let [nx, ny, nz] = size;
    let mut samples = Vec::new();
    for (i, j, k) in (-1..=nx).flat_map(|i| (-1..=ny).flat_map(move |j| (-1..=nz).map(move |k| (i, j, k)))) {
        let facing = if k == -1 {
            Vector3::z()
        } else if i == -1 || i == nx {
            Vector3::x()
        } else if j == -1 || j == ny {
            Vector3::y()
        } else {
            continue;
        };
        samples.push((Point3::from([i, j, k].map(|index| (f64::from(index) + 0.5) * spacing)), facing));
    }
    samples.into_iter().unzip()
}

/// Puts a block of this many particles into a corner.
pub fn fill(fluid: &mut Fluid, size: [i32; 3], spacing: f64) {
    let [nx, ny, nz] = size;
    for (i, j, k) in (0..nx).flat_map(|i| (0..ny).flat_map(move |j| (0..nz).map(move |k| (i, j, k)))) {
        let position = Point3::from([i, j, k].map(|index| (f64::from(index) + 0.5) * spacing));
        fluid.add(position, Vector3::zeros()).expect("in the box");
    }
}

/// The same, in such a tank.
pub fn tank(size: [i32; 3], liquid: [i32; 3], spacing: f64, config: FluidConfig) -> Fluid {
    let margin = Vector3::repeat(4.0 * spacing);
    let max = Point3::from(size.map(|count| f64::from(count) * spacing)) + margin;
    let config = FluidConfig { spacing, min: Point3::origin() - margin, max, ..config };
    let mut fluid = Fluid::new(config).expect("a liquid");
    let (walls, _) = walls(size, spacing);
    fluid.set_walls(&walls, &vec![Vector3::zeros(); walls.len()]).expect("walls");
    fill(&mut fluid, liquid, spacing);
    fluid
}

/// A tank with frictionless walls.
pub fn smooth_tank(size: [i32; 3], liquid: [i32; 3], spacing: f64, config: FluidConfig) -> Fluid {
    let mut fluid = tank(size, liquid, spacing, config);
    fluid.set_wall_normals(&walls(size, spacing).1).expect("one for each");
    fluid
}
