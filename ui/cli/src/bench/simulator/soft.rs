//! Benchmarks of mass-spring cloth and position-based bodies.

use std::hint::black_box;
use std::path::Path;

use nalgebra::Point3;
use trocar::summary::{BenchResult, Better};
use trocar_kernel::bench::median_and_spread;
use trocar_simulator::mass_spring::{
    Input, Integrator, LineMaterial, LinearSolver, MassSpring, Network, TooLarge,
};
use trocar_simulator::xpbd::{Body, Xpbd, XpbdConfig, XpbdInput, distances_of};

use super::bodies::{GRAVITY, cloth as gauze, position_based as beam};
use super::peers::{BulletCloth, PypbdBeam, SaggingBeam};
use super::roofline::{Work, share};
use super::{BLOCKS, at_least_hz, at_most, per_run, scaled, secs};
use crate::failure::Failure;

/// Implicit time step of the cloth \[s\].
const IMPLICIT_STEP: f64 = 1e-3;

/// An explicit cloth, and its time step: nine tenths of the stability limit.
pub fn explicit(n: u32) -> Result<(MassSpring, f64), Failure> {
    let cloth = gauze(n, Integrator::Explicit { too_large: TooLarge::Refuse })?;
    let dt = 0.9 * cloth.safe_step();
    Ok((cloth, dt))
}

/// An implicit cloth.
pub fn implicit(n: u32) -> Result<(MassSpring, f64), Failure> {
    let solver = LinearSolver::Warped { tolerance: 1e-4, iterations_max: 200 };
    Ok((gauze(n, Integrator::Implicit { solver, newton: 1 })?, IMPLICIT_STEP))
}

/// Median time of a step, once the cloth swings.
pub fn step_secs((mut cloth, dt): (MassSpring, f64), runs: usize) -> Result<(f64, f64), Failure> {
    let input = Input { gravity: GRAVITY, ..Input::default() };
    let mut failed = None;
    let mut step = || {
        if let Err(error) = cloth.step(dt, black_box(&input)) {
            failed = Some(error);
        }
    };
    (0..runs).for_each(|_| step());
    let figure = per_run(runs, step);
    failed.map_or(Ok(figure), |error| Err(Failure::internal(error)))
}

/// A gauze of 64 × 64 squares; a step of it beside one of Bullet's, in alternating blocks.
pub fn cloth(python: Option<&Path>) -> Result<Vec<BenchResult>, Failure> {
    let cloth = explicit(64)?;
    let network = cloth.0.network();
    // For each spring: the vector between its nodes and its rate of change, its length, the force, and its two ends.
    // For each node: its acceleration, velocity and position.
    let (springs, nodes) = (network.springs.len() as f64, network.masses.len() as f64);
    let work = Work {
        operations: 35.0 * springs + 18.0 * nodes,
        single: false,
        bytes: 24.0 * springs + 48.0 * nodes,
    };
    let figure = step_secs(cloth, 200)?;
    let mut rows =
        vec![at_least_hz("cloth_64_explicit", figure, 2_000.0), share("cloth_64_explicit", figure.0, work)];
    rows.extend(implicit_cloth()?);
    if let Some(python) = python {
        rows.push(beside_bullet(python)?);
    }
    Ok(rows)
}

/// Implicit steps, and the error of each against the exact solution of its system.
fn implicit_cloth() -> Result<Vec<BenchResult>, Failure> {
    const STEPS: usize = 10;
    let (mut cloth, dt) = implicit(64)?;
    let input = Input { gravity: GRAVITY, ..Input::default() };
    let (mut iterations, mut residual, mut failed) = (0, 0.0_f64, None);
    let mut step = || match cloth.step(dt, black_box(&input)) {
        Ok(report) => {
            iterations += report.iterations;
            residual = residual.max(report.residual);
        }
        Err(error) => failed = Some(error),
    };
    (0..STEPS).for_each(|_| step());
    let figure = per_run(STEPS, step);
    failed.map_or(Ok(()), |error| Err(Failure::internal(error)))?;
    let per_step = f64::from(iterations) / (STEPS * (BLOCKS + 1)) as f64;
    let network = cloth.network();
    let (springs, hinges, nodes) =
        (network.springs.len() as f64, network.hinges.len() as f64, network.masses.len() as f64);
    // An iteration does a forward and back substitution, two bytes an entry, and multiplies by the blocks of springs
    // and hinges; for each node it adds a dozen vectors.
    let entries = cloth.factor_entries() as f64;
    let work = Work {
        operations: per_step * (4.0 * entries + 20.0 * springs + 65.0 * hinges + 75.0 * nodes),
        single: true,
        bytes: per_step * (4.0 * entries + 48.0 * springs + 88.0 * hinges + 24.0 * 12.0 * nodes),
    };
    Ok(vec![
        at_most("cloth_64_implicit", "ms", scaled(figure, 1e3), 8.0),
        at_most("cloth_64_implicit_residual", "share", (residual, 0.0), 1e-4),
        share("cloth_64_implicit", figure.0, work),
    ])
}

/// An explicit step of a mass-spring sheet, ours and Bullet's.
fn beside_bullet(python: &Path) -> Result<BenchResult, Failure> {
    let mut peer = BulletCloth::start(python, 64)?;
    let (mut cloth, dt) = explicit(64)?;
    let input = Input { gravity: GRAVITY, ..Input::default() };
    let (mut ours, mut theirs, mut failed) = (Vec::new(), Vec::new(), None);
    for _ in 0..BLOCKS {
        let block = secs(|| {
            for _ in 0..200 {
                if let Err(error) = cloth.step(dt, black_box(&input)) {
                    failed = Some(error);
                }
            }
        });
        ours.push(block / 200.0 * 1e3);
        theirs.push(peer.steps(50)?);
    }
    failed.map_or(Ok(()), |error| Err(Failure::internal(error)))?;
    let (figure, floor) = (median_and_spread(&ours), median_and_spread(&theirs).0);
    let name = "simulator_cloth_64_explicit_bullet";
    Ok(BenchResult::on_ratio(name, "ms", figure, floor, Some(0.5), Better::Lower))
}

/// Median time of a step of 5 ms with five constraint sweeps, for a block of so many cells of 1 cm.
pub fn xpbd_secs(cells: [usize; 3], runs: usize) -> Result<(f64, f64), Failure> {
    let config = XpbdConfig { parts: 1, iterations: 5, damping: 1.0, ..XpbdConfig::default() };
    let mut body = beam(cells, cells.map(|count| 0.01 * count as f64), 1e5, config)?;
    let input = XpbdInput { gravity: GRAVITY, ..XpbdInput::default() };
    let mut failed = None;
    let figure = per_run(runs, || {
        if let Err(error) = body.step(5e-3, black_box(&input)) {
            failed = Some(error);
        }
    });
    failed.map_or(Ok(figure), |error| Err(Failure::internal(error)))
}

/// Median time of a step of 5 ms of a network whose springs and hinges are position-based constraints.
fn network_secs(network: &Network, rest: &[Point3<f64>], held: &[u32]) -> Result<(f64, f64), Failure> {
    let distances = distances_of(network);
    let (masses, bends) = (&network.masses, &network.hinges);
    let body = Body { rest, masses, distances: &distances, bends, ..Body::default() };
    let config = XpbdConfig { parts: 1, iterations: 5, damping: 1.0, ..XpbdConfig::default() };
    let mut body = Xpbd::new(&body, held, config).map_err(Failure::internal)?;
    let input = XpbdInput { gravity: GRAVITY, ..XpbdInput::default() };
    let mut failed = None;
    let figure = per_run(5, || {
        if let Err(error) = body.step(5e-3, black_box(&input)) {
            failed = Some(error);
        }
    });
    failed.map_or(Ok(figure), |error| Err(Failure::internal(error)))
}

/// The same for a gauze of `n` × `n` squares.
pub fn xpbd_cloth_secs(n: u32) -> Result<(f64, f64), Failure> {
    let (gauze, _) = explicit(n)?;
    network_secs(gauze.network(), &gauze.state().positions, &[0, n])
}

/// The same for a rod of so many edges.
pub fn xpbd_rod_secs(edges: u32) -> Result<(f64, f64), Failure> {
    let rest: Vec<_> = (0..=edges).map(|node| Point3::new(1e-3 * f64::from(node), 0.0, 0.0)).collect();
    let lines: Vec<_> = (0..edges).map(|edge| [edge, edge + 1]).collect();
    let material = LineMaterial { axial_stiffness: 100.0, bending_stiffness: 2e-5, density: 2e-3 };
    let network = Network::from_line(&rest, &lines, &material).map_err(Failure::internal)?;
    network_secs(&network, &rest, &[0, 1])
}

/// The sagging beam, for pypbd and for us: 2,520 tetrahedra.
const SAGGING: SaggingBeam = SaggingBeam {
    cells: [20, 7, 3],
    edge: 0.005,
    young: 1e6,
    poisson: 0.3,
    density: 1000.0,
    damping: 20.0,
    step_secs: 5e-3,
};
/// Constraint sweeps in a step.
const SWEEPS: u32 = 5;
/// Steps of a block: after all blocks the beam is at rest.
const STEPS: usize = 60;

/// Position-based bodies beside pypbd: the same beam, as many constraint sweeps in a step, in alternating blocks; and
/// the deflection error of each against linear elasticity.
pub fn position_based(python: Option<&Path>) -> Result<Vec<BenchResult>, Failure> {
    let SaggingBeam { cells, edge, young, damping, step_secs, .. } = SAGGING;
    let config = XpbdConfig { parts: SWEEPS, iterations: 1, damping, ..XpbdConfig::default() };
    let mut body = beam(cells, cells.map(|count| edge * count as f64), young, config)?;
    let rest = body.state().positions.clone();
    let mut peer = python.map(|python| PypbdBeam::start(python, &SAGGING, SWEEPS)).transpose()?;
    let input = XpbdInput { gravity: GRAVITY, ..XpbdInput::default() };
    let (mut ours, mut theirs, mut failed) = (Vec::new(), Vec::new(), None);
    for _ in 0..BLOCKS {
        let block = secs(|| {
            for _ in 0..STEPS {
                if let Err(error) = body.step(step_secs, black_box(&input)) {
                    failed = Some(error);
                }
            }
        });
        ours.push(block / STEPS as f64 * 1e3);
        if let Some(peer) = &mut peer {
            theirs.push(peer.steps(STEPS)?);
        }
    }
    if let Some(error) = failed {
        return Err(Failure::internal(error));
    }
    let figure = median_and_spread(&ours);
    let name = "simulator_xpbd_2520";
    // For each tetrahedron: its edges, F, two invariants and their gradients, the step of two constraints, the moves of
    // four nodes.
    let operations = 330.0 * f64::from(SWEEPS) * body.tets() as f64;
    let bytes = 64.0 * f64::from(SWEEPS) * body.tets() as f64;
    let share = share("xpbd_2520", figure.0 * 1e-3, Work { operations, single: true, bytes });
    let Some(peer) = peer else {
        let own = BenchResult::on_value(name, "ms (no peer)", figure, None, Better::Lower);
        return Ok(vec![own, share]);
    };
    let floor = median_and_spread(&theirs).0;
    let far = edge * cells[0] as f64 - 1e-9;
    let ends = rest.iter().zip(&body.state().positions).filter(|(rest, _)| rest.x > far);
    let drops: Vec<f64> = ends.map(|(rest, now)| rest.z - now.z).collect();
    let tip = drops.iter().sum::<f64>() / drops.len() as f64;
    let error = |tip: f64| (tip / peer.deflection_linear - 1.0).abs();
    // A diverged beam gives no error.
    let theirs = peer.tip().map(error);
    let own = BenchResult::on_value(
        "simulator_xpbd_2520_static_error",
        "share",
        (error(tip), 0.0),
        theirs,
        Better::Lower,
    );
    Ok(vec![BenchResult::on_ratio(name, "ms", figure, floor, Some(0.5), Better::Lower), share, own])
}
