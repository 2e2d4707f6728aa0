//! Prints what each step of a shaft and of a proxy costs on organs of several sizes, at rest and heaving at 100 Hz, the
//! refits included: `cargo run --release -p trocar-collision --example line_speed`.

#[path = "../tests/support/mod.rs"]
mod support;

use std::time::Instant;

use support::organ::Organ;
use support::organ::rounds::{devices, organ as organ_of, shafts};
use trocar_collision::Surface;
use trocar_collision::aabb_tree::AabbTree;
use trocar_collision::dynamic_point::{DynamicPoint, LineConfig};
use trocar_collision::finger_proxy::{FingerProxy, ProxyConfig};
use trocar_collision::moving_surface::MovingSurface;

const STEPS: usize = 20_000;

/// Steps of 1 ms between two updates of a surface that heaves.
const FRAME: usize = 10;

/// One organ, asked over and over.
struct Bed {
    mesh: MovingSurface,
    frames: Vec<Vec<nalgebra::Point3<f64>>>,
    triangles: Vec<[u32; 3]>,
    heaves: bool,
}

impl Bed {
    /// Updates the surface when its time has come.
    fn advance(&mut self, step: usize) {
        if self.heaves && step.is_multiple_of(FRAME) {
            let turn = step / FRAME % (2 * self.frames.len());
            let frame = turn.min(2 * self.frames.len() - 1 - turn);
            let now = Surface::new(&self.frames[frame], &self.triangles).expect("a surface");
            self.mesh.update(&now, 0.001 * FRAME as f64).expect("a time");
        }
    }
}

fn micros(mut times: Vec<f64>) -> String {
    times.sort_unstable_by(f64::total_cmp);
    let at = |share: f64| times[((times.len() - 1) as f64 * share) as usize];
    let mean = times.iter().sum::<f64>() / times.len() as f64;
    format!("p50 {:6.2}  mean {:6.2}  p99 {:6.2}  p99.9 {:7.2} us", at(0.5), mean, at(0.99), at(0.999))
}

fn main() {
    let floor: Vec<f64> = (0..STEPS)
        .map(|_| {
            let start = Instant::now();
            start.elapsed().as_secs_f64() * 1e6
        })
        .collect();
    println!("the clock itself                      {}", micros(floor));
    for size in [8_000, 70_000] {
        let shape = Organ::with_triangles(size);
        let mesh = organ_of(size);
        let (shafts, devices) = (shafts(&mesh, 4_000, 0.04), devices(&mesh, 4_000));
        let frames: Vec<_> = (0..20).map(|frame| shape.vertices(0.01 * f64::from(frame))).collect();
        let triangles = shape.triangles();
        let mut tree = AabbTree::new(&mesh.surface());
        let refits: Vec<f64> = (0..400)
            .map(|_| {
                let start = Instant::now();
                tree.refit(&mesh.surface()).expect("the same triangles");
                start.elapsed().as_secs_f64() * 1e6
            })
            .collect();
        let least = refits.iter().copied().fold(f64::INFINITY, f64::min);
        println!("{size:6} refit                       {}  least {least:.1} us", micros(refits));
        for heaves in [false, true] {
            let mut bed =
                Bed { mesh: organ_of(size), frames: frames.clone(), triangles: triangles.clone(), heaves };
            let kind = if heaves { "heaves" } else { "rests " };
            let config = LineConfig { segments: 1, radius: 0.0025, margin: 0.0 };
            let mut line = DynamicPoint::new(config).expect("a valid line");
            let mut times = Vec::with_capacity(STEPS);
            let mut touching = 0;
            for step in 0..STEPS {
                let turn = step % (2 * shafts.len());
                let shaft = &shafts[turn.min(2 * shafts.len() - 1 - turn)];
                let start = Instant::now();
                bed.advance(step);
                let contact = line.update(&bed.mesh, shaft).expect("a finite shaft")[0];
                let micros = start.elapsed().as_secs_f64() * 1e6;
                line.record_micros(micros);
                if contact.is_some() {
                    touching += 1;
                    times.push(micros);
                }
            }
            let statistics = line.statistics();
            println!(
                "{size:6} {kind} segment in contact    {}  fell back {:.2} %, {:.1} tests, {:.1} nodes, {:.1} hops \
                 (per 1,000), in contact {:.0} %",
                micros(times),
                100.0 * statistics.fallback_rate(),
                statistics.triangle_tests as f64 / statistics.segment_updates as f64,
                statistics.nodes as f64 / statistics.segment_updates as f64,
                1000.0 * statistics.hops as f64 / statistics.segment_updates as f64,
                100.0 * f64::from(touching) / STEPS as f64,
            );
            let mut finger = FingerProxy::new(ProxyConfig::default()).expect("a valid proxy");
            let mut times = Vec::with_capacity(STEPS);
            let mut touching = 0;
            for step in 0..STEPS {
                let turn = step % (2 * devices.len());
                let device = &devices[turn.min(2 * devices.len() - 1 - turn)];
                let start = Instant::now();
                bed.advance(step);
                finger.step(&bed.mesh, device, 0.001).expect("a finite device");
                let micros = start.elapsed().as_secs_f64() * 1e6;
                if finger.contacts().next().is_some() {
                    touching += 1;
                    times.push(micros);
                }
            }
            let statistics = finger.statistics();
            println!(
                "{size:6} {kind} proxy in contact      {}  {:.2} moves, gathered {:.2} %, in contact {:.0} %, squeezed {}",
                micros(times),
                statistics.moves as f64 / statistics.steps as f64,
                100.0 * statistics.gathered as f64 / statistics.steps as f64,
                100.0 * f64::from(touching) / STEPS as f64,
                statistics.squeezed,
            );
        }
    }
}
