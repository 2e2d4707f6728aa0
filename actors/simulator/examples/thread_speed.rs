//! Many steps of a thread, to be timed or profiled from outside: `thread_speed free|coil EDGES STEPS`.

use nalgebra::{Isometry3, Point3, Vector3};
use trocar_simulator::thread::{Hold, Obstacle, Shape, Surroundings, Thread, ThreadMaterial};

fn main() {
    let words: Vec<_> = std::env::args().collect();
    let number = |k: usize, other: usize| words.get(k).and_then(|word| word.parse().ok()).unwrap_or(other);
    let (edges, steps) = (number(2, 100), number(3, 5000));
    let coil = words.get(1).is_some_and(|word| word == "coil");
    let points: Vec<_> = (0..=edges)
        .map(|i| {
            let t = i as f64 * 0.15;
            if coil {
                Point3::new(3e-3 * t.cos(), 3e-3 * t.sin(), 4.9e-5 * t)
            } else {
                Point3::new(4.5e-4 * i as f64, 1e-5 * (i as f64).sin(), 0.0)
            }
        })
        .collect();
    let mut thread = Thread::new(ThreadMaterial::silk_2_0(), &points).expect("a thread");
    let ground = Shape::HalfSpace { normal: Vector3::z() };
    let obstacles = [Obstacle::fixed(ground, Isometry3::translation(0.0, 0.0, -4e-4), 0.3)];
    let holds = [Hold::fixed(0, points[0]), Hold::fixed(edges, points[edges])];
    let around = Surroundings {
        gravity: Vector3::new(0.0, 0.0, -9.81),
        holds: &holds,
        obstacles: &obstacles[..usize::from(coil)],
        ..Surroundings::default()
    };
    let (mut iterations, mut sweeps, mut contacts) = (0, 0, 0);
    for _ in 0..steps {
        let report = thread.step(1e-3, &around).expect("a step");
        iterations += report.iterations;
        sweeps += report.sweeps;
        contacts += report.contacts;
    }
    let mean = |sum: usize| sum as f64 / steps as f64;
    println!(
        "per step: {} iterations, {} sweeps, {} contacts",
        mean(iterations),
        mean(sweeps),
        mean(contacts)
    );
}
