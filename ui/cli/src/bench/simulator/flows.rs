//! Benchmarks of thread, heat and liquid.

use std::f64::consts::PI;
use std::hint::black_box;
use std::path::Path;

use nalgebra::{Isometry3, Point3, Vector3};
use trocar::summary::{BenchResult, Better};
use trocar_kernel::bench::median_and_spread;
use trocar_simulator::electrosurgery::{Electrode, Electrosurgery, Mode};
use trocar_simulator::suture_thread::{Hold, Obstacle, Shape, Surroundings, Thread, ThreadMaterial};

use super::bodies::{GRAVITY, basin, coil, membrane};
use super::peers::{ElasticaRod, SaggingRod};
use super::roofline::{Work, share};
use super::{BLOCKS, at_least_hz, at_most, per_run, scaled, secs};
use crate::failure::Failure;

/// Median time of a simulated millisecond of a coil of thread on a table.
pub fn thread_secs(edges: usize, lying: bool) -> Result<(f64, f64), Failure> {
    let (mut thread, ends) = coil(edges, lying)?;
    let table = Shape::HalfSpace { normal: Vector3::z() };
    let obstacles = [Obstacle::fixed(table, Isometry3::translation(0.0, 0.0, -4e-4), 0.3)];
    let holds = [Hold::fixed(0, ends[0]), Hold::fixed(edges, ends[1])];
    let around =
        Surroundings { gravity: GRAVITY, holds: &holds, obstacles: &obstacles, ..Surroundings::default() };
    let mut failed = None;
    let mut step = || {
        if let Err(error) = thread.step(1e-3, black_box(&around)) {
            failed = Some(error);
        }
    };
    (0..100).for_each(|_| step());
    let figure = per_run(50, step);
    failed.map_or(Ok(figure), |error| Err(Failure::internal(error)))
}

/// Lower bound on the operations and bytes of a step of a thread. For each edge: its strain, bend and twist with their
/// derivatives, the band factor (eleven entries to either side of four unknowns), and one forward and back
/// substitution; contacts are not counted.
pub fn thread_work(edges: usize) -> (f64, f64) {
    let edges = edges as f64;
    (edges * (400.0 + 4.0 * 11.0 * 11.0 + 4.0 * 4.0 * 11.0), edges * 8.0 * 4.0 * 12.0 * 3.0)
}

/// Thread with contacts among its turns, and a rod compared with PyElastica.
pub fn thread(python: Option<&Path>) -> Result<Vec<BenchResult>, Failure> {
    let mut rows = Vec::new();
    for (name, edges, lying, bar) in [
        ("thread_100", 100, false, 0.3),
        ("thread_300", 300, false, 1.0),
        ("thread_300_lying", 300, true, 1.0),
    ] {
        let figure = thread_secs(edges, lying)?;
        rows.push(at_most(name, "ms", scaled(figure, 1e3), bar));
        let (operations, bytes) = thread_work(edges);
        rows.push(share(name, figure.0, Work { operations, single: false, bytes }));
    }
    if let Some(python) = python {
        rows.extend(beside_elastica(python)?);
    }
    Ok(rows)
}

/// The sagging rod, for PyElastica and for us.
const SAGGING: SaggingRod =
    SaggingRod { edges: 100, length: 0.05, radius: 1e-3, density: 1100.0, young: 1e7, damping: 40.0 };
/// Longest stable explicit step of PyElastica \[s\]; ours is five hundred times as long.
const ELASTICA_STEP: f64 = 2e-6;
/// Simulated time of a block \[s\]: after all blocks the rod is at rest.
const STRETCH: f64 = 0.06;

/// A simulated millisecond of a sagging rod, ours and PyElastica's; and the deflection error of each against beam
/// theory.
fn beside_elastica(python: &Path) -> Result<Vec<BenchResult>, Failure> {
    let SaggingRod { edges, length, radius, density, young, damping } = SAGGING;
    let (area, bending) = (PI * radius.powi(2), 0.25 * PI * radius.powi(4));
    let material = ThreadMaterial {
        radius,
        mass_per_length: density * area,
        axial_stiffness: young * area,
        bending_stiffness: young * bending,
        twisting_stiffness: young / 1.3 * bending,
        damping: 0.0,
        drag: damping,
        ..ThreadMaterial::silk_2_0()
    };
    // Our clamp is in the middle of the first edge.
    let edge = length / (edges as f64 - 0.5);
    let points: Vec<_> = (0..=edges).map(|node| Point3::new((node as f64 - 0.5) * edge, 0.0, 0.0)).collect();
    let mut rod = Thread::new(material, &points).map_err(Failure::internal)?;
    let holds = [Hold::fixed(0, points[0]), Hold::fixed(1, points[1])];
    let around = Surroundings { gravity: GRAVITY, holds: &holds, ..Surroundings::default() };
    let mut peer = ElasticaRod::start(python, &SAGGING, ELASTICA_STEP)?;
    let (mut ours, mut theirs, mut failed) = (Vec::new(), Vec::new(), None);
    let steps = (STRETCH * 1e3).round() as usize;
    for _ in 0..BLOCKS {
        let block = secs(|| {
            for _ in 0..steps {
                if let Err(error) = rod.step(1e-3, black_box(&around)) {
                    failed = Some(error);
                }
            }
        });
        ours.push(block / steps as f64 * 1e3);
        theirs.push(peer.stretch(STRETCH)?);
    }
    failed.map_or(Ok(()), |error| Err(Failure::internal(error)))?;
    let error = |tip: f64| ((tip / peer.deflection_linear - 1.0).abs(), 0.0);
    let (figure, floor) = (median_and_spread(&ours), median_and_spread(&theirs).0);
    let name = "simulator_rod_100_elastica";
    let own = error(-rod.positions()[edges].z);
    Ok(vec![
        BenchResult::on_ratio(name, "ms", figure, floor, Some(0.5), Better::Lower),
        // A diverged rod gives no error, and the theory of small deflections is itself only accurate to a few per cent.
        BenchResult::on_value(
            format!("{name}_static_error"),
            "share",
            own,
            peer.tip().map(|tip| error(tip).0.max(0.03)),
            Better::Lower,
        ),
    ])
}

/// One step of 10 ms of an electrode that cuts at 5 mm/s.
fn cut(heat: &mut Electrosurgery, step: u32, extent: f64) -> Result<(), Failure> {
    let along = f64::from(step) * 0.01 * 5e-3;
    let (row, x) = ((along / extent).floor(), along % extent);
    let tip_in_rest = Point3::new(x, (2e-3 * (row + 1.0)) % extent, 0.0);
    let tip = Electrode { tip_in_rest, power: 30.0, mode: Mode::Cut, contact_area: 1e-6 };
    heat.step(0.01, &[tip]).map(drop).map_err(Failure::internal)
}

/// Median time of a step of a membrane of `n` × `n` squares that is being cut, after one second.
pub fn heat_secs(n: u32) -> Result<(f64, f64), Failure> {
    let mut heat = membrane(n)?;
    let extent = 1e-3 * f64::from(n - 1);
    let (mut step, mut result) = (0, Ok(()));
    let mut next = || {
        let done = cut(&mut heat, step, extent);
        step += 1;
        if done.is_err() {
            result = done;
        }
    };
    (0..100).for_each(|_| next());
    let figure = per_run(50, next);
    result.map(|()| figure)
}

/// A membrane of 10,082 triangles under an electrode.
pub fn heat() -> Result<Vec<BenchResult>, Failure> {
    let figure = heat_secs(71)?;
    // For each element: flux over three sides, its temperature, blood and damage.
    let elements = 10_082.0;
    let work = Work { operations: 30.0 * elements, single: false, bytes: 72.0 * elements };
    Ok(vec![at_least_hz("heat_10k", figure, 100.0), share("heat_10k", figure.0, work)])
}

/// Median time of a step of 4 ms of a basin of so many particles.
pub fn liquid_secs(particles: usize, runs: usize) -> Result<(f64, f64), Failure> {
    let mut fluid = basin(particles)?;
    let mut failed = None;
    let mut step = || {
        if let Err(error) = fluid.step(4e-3) {
            failed = Some(error);
        }
    };
    (0..20).for_each(|_| step());
    let figure = per_run(runs, step);
    failed.map_or(Ok(figure), |error| Err(Failure::internal(error)))
}

/// A basin of 20,000 particles.
pub fn liquid() -> Result<Vec<BenchResult>, Failure> {
    let figure = liquid_secs(20_000, 4)?;
    // Eight adjacent rows share a neighbour list: 3,250 lists of 72 neighbours each, out of 300 candidates. A step
    // applies the operator about nine times, in two sweeps: for each neighbour one 16-bit factor for each of the eight
    // rows, times four numbers; its index and the four numbers are read.
    let (lists, lanes) = (3_250.0, 8.0);
    let links = 72.0 * lists;
    let operations = lanes * (8.0 * 300.0 * lists + 30.0 * links + 9.0 * 2.0 * 8.0 * links);
    let work = Work { operations, single: true, bytes: 9.0 * 2.0 * (2.0 * lanes + 4.0 + 16.0) * links };
    Ok(vec![at_least_hz("fluid_20000", figure, 60.0), share("fluid_20000", figure.0, work)])
}
