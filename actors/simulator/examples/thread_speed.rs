//! Many steps of a thread, to be timed or profiled from outside: `thread_speed SCENE EDGES STEPS [SETTLING]`. What a step
//! takes is told as well, its median and the 99th percentile.
//!
//! | Scene | |
//! |---|---|
//! | `free` | hanging from both ends |
//! | `coil` | turns on a table, touching each other |
//! | `raised` | 100 edges of it in turns, the others up to a hand |
//! | `lying` | 100 edges of it in turns, the others on the table |
//! | `knot` | a square knot tied, pulled tight with 6 N, then loaded with 2 N; EDGES does not count |

use std::time::Instant;

use nalgebra::{Isometry3, Point3, Vector3};
use trocar_simulator::suture_thread::{
    Hold, Obstacle, Shape, Surroundings, Thread, ThreadMaterial, ThreadReport,
};

#[path = "../tests/support/thread.rs"]
mod thread_support;

/// Edges that lie in turns where the others do not.
const COILED: usize = 100;

/// What many steps took.
#[derive(Default)]
struct Seen {
    seconds: Vec<f64>,
    iterations: usize,
    sweeps: usize,
    contacts: usize,
    parts: usize,
    penetration: f64,
}

impl Seen {
    fn step(&mut self, seconds: f64, report: &ThreadReport) {
        self.seconds.push(seconds);
        self.iterations += report.iterations;
        self.sweeps += report.sweeps;
        self.contacts += report.contacts;
        self.parts += report.parts;
        self.penetration = self.penetration.max(report.penetration_max);
    }

    fn tell(&mut self, what: &str) {
        self.seconds.sort_by(f64::total_cmp);
        let count = self.seconds.len();
        let at = |part: f64| 1e3 * self.seconds[((count - 1) as f64 * part) as usize];
        let mean = |sum: usize| sum as f64 / count as f64;
        println!(
            "{what}: {:.3} ms, p99 {:.3} ms, mean {:.3} ms; per step {:.2} parts, {:.2} iterations, {:.1} sweeps, \
             {:.1} contacts; at most {:.2} µm deep",
            at(0.5),
            at(0.99),
            1e3 * self.seconds.iter().sum::<f64>() / count as f64,
            mean(self.parts),
            mean(self.iterations),
            mean(self.sweeps),
            mean(self.contacts),
            1e6 * self.penetration
        );
    }
}

fn points(scene: &str, edges: usize) -> Vec<Point3<f64>> {
    let on_coil = |turn: f64| Point3::new(3e-3 * turn.cos(), 3e-3 * turn.sin(), 4.9e-5 * turn);
    let coiled = if scene == "coil" { edges } else { COILED };
    let last = 0.15 * coiled as f64;
    let slope = if scene == "raised" { 0.5 } else { 0.0 };
    let onwards = Vector3::new(-last.sin(), last.cos(), slope).normalize() * (3e-3 * 0.15);
    (0..=edges)
        .map(|i| match scene {
            "free" => Point3::new(4.5e-4 * i as f64, 1e-5 * (i as f64).sin(), 0.0),
            _ => on_coil(0.15 * i.min(coiled) as f64) + onwards * i.saturating_sub(coiled) as f64,
        })
        .collect()
}

fn knot() {
    let material = ThreadMaterial { friction: 0.3, ..ThreadMaterial::silk_2_0() };
    let points = thread_support::loose_knot(&[3, -3], material.radius, 1.5 * material.diameter());
    let mut bend = thread_support::Bend::new(Thread::new(material, &points).expect("a thread"));
    let dt = 5e-4;
    for (what, force) in [("tying", [6.0, 6.0]), ("loaded", [2.0, 0.0])] {
        let mut seen = Seen::default();
        let mut begun = Instant::now();
        let (ramp, span) = (0.15, bend.span());
        let pull = |time: f64| match what {
            "tying" => force.map(|of: f64| of * (time / ramp).min(1.0).powi(2)),
            _ => [force[0], (1.0 - time / 0.05).max(0.0) * force[0]],
        };
        bend.steps(0.25, dt, pull, |_, _, report| {
            seen.step(begun.elapsed().as_secs_f64(), report);
            begun = Instant::now();
        });
        seen.tell(what);
        println!("{what}: the loop grew by {:.6} mm", 1e3 * (bend.span() - span));
    }
}

fn main() {
    let words: Vec<_> = std::env::args().collect();
    let number = |k: usize, other: usize| words.get(k).and_then(|word| word.parse().ok()).unwrap_or(other);
    let scene = words.get(1).map_or("free", String::as_str);
    let (edges, steps, settling) = (number(2, 100), number(3, 5000), number(4, 0));
    if scene == "knot" {
        return knot();
    }
    let points = points(scene, edges);
    let mut thread = Thread::new(ThreadMaterial::silk_2_0(), &points).expect("a thread");
    let ground = Shape::HalfSpace { normal: Vector3::z() };
    let obstacles = [Obstacle::fixed(ground, Isometry3::translation(0.0, 0.0, -4e-4), 0.3)];
    let holds = [Hold::fixed(0, points[0]), Hold::fixed(edges, points[edges])];
    let around = Surroundings {
        gravity: Vector3::new(0.0, 0.0, -9.81),
        holds: &holds,
        obstacles: &obstacles[..usize::from(scene != "free")],
        ..Surroundings::default()
    };
    let mut seen = Seen::default();
    for step in 0..settling + steps {
        let begun = Instant::now();
        let report = thread.step(1e-3, &around).expect("a step");
        if step >= settling {
            seen.step(begun.elapsed().as_secs_f64(), &report);
        }
    }
    seen.tell(scene);
    let middle = thread.positions()[edges / 2];
    println!("the middle is at {:.9} {:.9} {:.9}", middle.x, middle.y, middle.z);
}
