//! The suite `collision`: queries of two surfaces beside coal and FCL, a shaft against an organ, a haptic proxy,
//! detectors in live sessions, and the growth of all costs with the number of triangles.

mod live;
mod meshes;
mod peers;

use std::collections::BTreeMap;
use std::hint::black_box;
use std::path::Path;
use std::time::Instant;

use nalgebra::{Isometry3, Point3, Vector3};
use trocar::summary::{BenchResult, Better};
use trocar_collision::Surface;
use trocar_collision::dynamic_point::{DynamicPoint, LineConfig};
use trocar_collision::finger_proxy::{FingerProxy, ProxyConfig};
use trocar_collision::moving_surface::MovingSurface;
use trocar_collision::obb_tree::{ObbTree, TreeQuery};
use trocar_kernel::bench::median_and_spread;

use crate::failure::Failure;
pub use live::live;
use meshes::{Mesh, RADIUS, poses};
use peers::Peers;

/// Triangles of the surfaces that are compared with the peers.
const SIZES: [usize; 2] = [980, 9_680];
const POSES: usize = 200;
/// Alternating blocks; the minimum over the blocks counts for each pose, since disturbances only add time.
const ROUNDS: usize = 7;
const QUERIES: [&str; 3] = ["first", "all", "distance"];
/// Triangle counts for the growth curves.
const GROWTH: [usize; 6] = [1_000, 3_000, 10_000, 30_000, 100_000, 300_000];
const GROWTH_POSES: usize = 40;
/// Steps of a hand at 1 kHz.
const STEPS: usize = 4_000;

fn microseconds(work: impl FnOnce()) -> f64 {
    let start = Instant::now();
    work();
    start.elapsed().as_secs_f64() * 1e6
}

/// Keeps the elementwise minimum.
fn keep_least(kept: &mut Vec<f64>, times: Vec<f64>) {
    if kept.is_empty() {
        *kept = times;
    } else {
        kept.iter_mut().zip(times).for_each(|(kept, time)| *kept = kept.min(time));
    }
}

fn mean(times: &[f64]) -> f64 {
    times.iter().sum::<f64>() / times.len() as f64
}

fn quantile(times: &[f64], share: f64) -> f64 {
    let mut sorted = times.to_vec();
    sorted.sort_by(f64::total_cmp);
    let index = ((sorted.len() as f64 * share).ceil() as usize).clamp(1, sorted.len());
    sorted[index - 1]
}

struct Subject {
    mesh: Mesh,
    tree: ObbTree,
    room: TreeQuery,
}

impl Subject {
    fn new(triangles: usize) -> Result<Self, Failure> {
        let mesh = Mesh::bumpy(triangles)?;
        let tree = ObbTree::build(&surface(&mesh)?);
        Ok(Self { mesh, tree, room: TreeQuery::new() })
    }

    fn ask(&mut self, query: &str, pose: &Isometry3<f64>) {
        let (tree, room) = (&self.tree, &mut self.room);
        match query {
            "first" => drop(black_box(room.first_contact(tree, tree, pose, None))),
            "all" => drop(black_box(room.all_contacts(tree, tree, pose).len())),
            _ => drop(black_box(room.distance(tree, tree, pose, None))),
        }
    }

    /// One block: a time for each pose \[µs\].
    fn block(&mut self, query: &str, poses: &[Isometry3<f64>]) -> Vec<f64> {
        let mut times = Vec::with_capacity(poses.len());
        for pose in poses {
            times.push(microseconds(|| self.ask(query, black_box(pose))));
        }
        times
    }
}

fn surface(mesh: &Mesh) -> Result<Surface<'_>, Failure> {
    Surface::new(&mesh.vertices, &mesh.triangles).map_err(Failure::internal)
}

/// Queries, builds and refits, beside those of the peers where a Python has them.
pub fn queries(python: Option<&Path>) -> Result<Vec<BenchResult>, Failure> {
    let mut peers = python.map(Peers::start).transpose()?;
    let poses = poses(POSES);
    let mut rows = Vec::new();
    for triangles in SIZES {
        let mut subject = Subject::new(triangles)?;
        if let Some(peers) = &mut peers {
            peers.prepare(&subject.mesh, &poses)?;
        }
        for query in QUERIES {
            let mut ours = Vec::new();
            let mut theirs: BTreeMap<String, Vec<f64>> = BTreeMap::new();
            for _ in 0..ROUNDS {
                keep_least(&mut ours, subject.block(query, &poses));
                for (name, times) in peers.as_mut().map_or(Ok(Vec::new()), |peers| peers.block(query))? {
                    keep_least(theirs.entry(name).or_default(), times);
                }
            }
            let best =
                |of: &dyn Fn(&[f64]) -> f64| theirs.values().map(|times| of(times)).min_by(f64::total_cmp);
            let name = format!("collision_{query}_{triangles}");
            let p99 = |times: &[f64]| quantile(times, 0.99);
            rows.push(beside(&format!("{name}_mean"), mean(&ours), best(&mean), 0.6));
            rows.push(beside(&format!("{name}_p99"), p99(&ours), best(&p99), 1.0));
        }
        let mut ours = f64::INFINITY;
        let mut theirs: Option<f64> = None;
        let surface = surface(&subject.mesh)?;
        for _ in 0..ROUNDS {
            ours = ours.min(microseconds(|| drop(black_box(ObbTree::build(black_box(&surface))))));
            for (_, times) in peers.as_mut().map_or(Ok(Vec::new()), |peers| peers.block("build"))? {
                theirs = times.first().copied().into_iter().chain(theirs).min_by(f64::total_cmp);
            }
        }
        rows.push(beside(&format!("collision_build_{triangles}"), ours, theirs, 0.5));
        rows.push(refit(triangles)?);
    }
    Ok(rows)
}

/// A row in microseconds beside the faster peer; without peers the row has no bar.
fn beside(name: &str, ours: f64, theirs: Option<f64>, bar: f64) -> BenchResult {
    match theirs {
        Some(theirs) => BenchResult::on_ratio(name, "µs", (ours, 0.0), theirs, Some(bar), Better::Lower),
        None => BenchResult::on_value(name, "µs (no peer)", (ours, 0.0), None, Better::Lower),
    }
}

/// Refit of an OBB tree to a deforming surface.
fn refit(triangles: usize) -> Result<BenchResult, Failure> {
    let mut subject = Subject::new(triangles)?;
    let round = Mesh::bumpy(triangles)?.vertices;
    let mut blocks = Vec::with_capacity(10 * ROUNDS);
    for step in 0..10 * ROUNDS {
        subject.mesh.heave(&round, 0.01 * step as f64);
        let vertices = &subject.mesh.vertices;
        let tree = &mut subject.tree;
        let mut refitted = Ok(());
        blocks.push(microseconds(|| refitted = tree.refit(black_box(vertices))) * 1e-3);
        refitted.map_err(Failure::internal)?;
    }
    let bar = (triangles == SIZES[1]).then_some(0.3);
    let (name, figure) = (format!("collision_refit_{triangles}"), median_and_spread(&blocks));
    Ok(BenchResult::on_value(name, "ms", figure, bar, Better::Lower))
}

/// A shaft that slides over a surface 0.1 mm per step, and a proxy behind a hand that presses on it.
pub fn touch() -> Result<Vec<BenchResult>, Failure> {
    let (small, fallback) = shaft(8_000, false)?;
    let (large, _) = shaft(70_000, false)?;
    let (breathing, _) = shaft(8_000, true)?;
    let median = quantile(&small, 0.5);
    let proxy = proxy(8_000)?;
    let on_value = |name: &str, value: f64, bar: f64| {
        BenchResult::on_value(name, "µs", (value, 0.0), Some(bar), Better::Lower)
    };
    Ok(vec![
        on_value("collision_dynamic_point_8k_median", median, 3.0),
        BenchResult::on_ratio(
            "collision_dynamic_point_70k_median",
            "µs",
            (quantile(&large, 0.5), 0.0),
            median,
            Some(1.5),
            Better::Lower,
        ),
        BenchResult::on_value(
            "collision_dynamic_point_8k_p99",
            "µs",
            (quantile(&small, 0.99), 0.0),
            None,
            Better::Lower,
        ),
        // How often the certificate failed, and the time of a step after every vertex has moved.
        BenchResult::on_value(
            "collision_dynamic_point_8k_fallback_rate",
            "share",
            (fallback, 0.0),
            None,
            Better::Lower,
        ),
        BenchResult::on_value(
            "collision_dynamic_point_8k_p99_with_refit",
            "µs",
            (quantile(&breathing, 0.99), 0.0),
            None,
            Better::Lower,
        ),
        on_value("collision_proxy_8k_median", quantile(&proxy, 0.5), 2.3),
        on_value("collision_proxy_8k_p99", quantile(&proxy, 0.99), 13.0),
    ])
}

/// Position of a hand that circles a ball, 0.1 mm per step, at a depth of so many mean radii.
fn round_the_ball(step: usize, deep: f64) -> Point3<f64> {
    let turn = step as f64 * 1e-4 / RADIUS;
    let tilt = 0.3 * (0.37 * turn).sin();
    let direction = Vector3::new(turn.cos() * tilt.cos(), turn.sin() * tilt.cos(), tilt.sin());
    Point3::from(direction * (RADIUS * (1.0 - deep)))
}

/// Times of a shaft of one segment in contact \[µs\], and how often it fell back on the tree. The times include the
/// refit to a breathing organ.
fn shaft(triangles: usize, breathes: bool) -> Result<(Vec<f64>, f64), Failure> {
    let mut mesh = Mesh::bumpy(triangles)?;
    let rest = mesh.vertices.clone();
    let mut moving = MovingSurface::new(&surface(&mesh)?);
    let line = LineConfig { segments: 1, radius: 0.0025, margin: 0.0 };
    let mut point = DynamicPoint::new(line).map_err(Failure::internal)?;
    let steps = if breathes { STEPS / 10 } else { STEPS };
    let mut times = Vec::with_capacity(steps);
    for step in 0..steps {
        if breathes {
            let size = 1.0 + 0.002 * (0.01 * step as f64).sin();
            mesh.vertices.iter_mut().zip(&rest).for_each(|(vertex, rest)| *vertex = rest * size);
        }
        let now = if breathes { Some(surface(&mesh)?) } else { None };
        // Its tip is in the tissue, the rest of it outside.
        let tip = round_the_ball(step, 0.02);
        let line = [tip, tip + tip.coords.normalize() * 0.2];
        let mut done = Ok(false);
        let time = microseconds(|| {
            if let Some(now) = &now {
                moving.follow(black_box(now));
            }
            done =
                point.update(&moving, black_box(&line)).map(|contacts| contacts.iter().any(Option::is_some));
        });
        if done.map_err(Failure::internal)? {
            times.push(time);
        }
    }
    Ok((in_contact(times, steps)?, point.statistics().fallback_rate()))
}

/// Times of a proxy in contact \[µs\].
fn proxy(triangles: usize) -> Result<Vec<f64>, Failure> {
    let mesh = Mesh::bumpy(triangles)?;
    let moving = MovingSurface::new(&surface(&mesh)?);
    let mut proxy = FingerProxy::new(ProxyConfig::default()).map_err(Failure::internal)?;
    let mut times = Vec::with_capacity(STEPS);
    for step in 0..STEPS {
        // It approaches from outside.
        let device = round_the_ball(step, if step < 100 { -0.4 } else { 0.0 });
        let mut done = Ok(());
        let time = microseconds(|| done = proxy.step(&moving, black_box(&device), 1e-3).map(drop));
        done.map_err(Failure::internal)?;
        if proxy.contacts().next().is_some() {
            times.push(time);
        }
    }
    in_contact(times, STEPS)
}

fn in_contact(times: Vec<f64>, steps: usize) -> Result<Vec<f64>, Failure> {
    if times.len() < steps / 4 {
        return Err(Failure::internal(format!("only {} of {steps} steps were in contact", times.len())));
    }
    Ok(times)
}

/// Growth of the costs with the number of triangles.
pub fn growth() -> Result<Vec<BenchResult>, Failure> {
    let poses = poses(GROWTH_POSES);
    let mut rows = Vec::new();
    for triangles in GROWTH {
        let begun = Instant::now();
        let mut subject = Subject::new(triangles)?;
        let build = begun.elapsed().as_secs_f64() * 1e6;
        let mut row = |what: &str, time: f64| {
            let name = format!("collision_growth_{what}_{triangles}");
            rows.push(BenchResult::on_value(name, "µs", (time, 0.0), None, Better::Lower));
        };
        row("build", build);
        for query in QUERIES {
            let mut times = Vec::new();
            (0..3).for_each(|_| keep_least(&mut times, subject.block(query, &poses)));
            row(query, mean(&times));
        }
    }
    Ok(rows)
}
