//! Cloth of masses and springs, and position-based bodies.

use std::hint::black_box;
use std::path::Path;

use trocar::summary::{BenchResult, Better};
use trocar_simulator::mass_spring::{Input, Integrator, LinearSolver, MassSpring, TooLarge};
use trocar_simulator::xpbd::{XpbdConfig, XpbdInput};

use super::bodies::{GRAVITY, cloth as gauze, position_based as beam};
use super::{at_least_hz, at_most, per_run, scaled, told};
use crate::failure::Failure;

/// How the cloth is stepped implicitly \[s\].
const IMPLICIT_STEP: f64 = 0.01;

/// An explicit cloth, and the largest share of its safe step that is taken.
pub fn explicit(n: u32) -> Result<(MassSpring, f64), Failure> {
    let cloth = gauze(n, Integrator::Explicit { too_large: TooLarge::Refuse })?;
    let dt = 0.9 * cloth.safe_step();
    Ok((cloth, dt))
}

/// An implicit cloth.
pub fn implicit(n: u32) -> Result<(MassSpring, f64), Failure> {
    let solver = LinearSolver::ConjugateGradients { tolerance: 1e-4, iterations_max: 500 };
    Ok((gauze(n, Integrator::Implicit { solver, newton: 1 })?, IMPLICIT_STEP))
}

/// Median time of a step, after as many as it takes to swing.
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

/// A gauze of 64 × 64 squares.
pub fn cloth() -> Result<Vec<BenchResult>, Failure> {
    Ok(vec![
        at_least_hz("cloth_64_explicit", step_secs(explicit(64)?, 200)?, 2_000.0),
        at_most("cloth_64_implicit", "ms", scaled(step_secs(implicit(64)?, 10)?, 1e3), 8.0),
    ])
}

/// Median time of a step of 5 ms with five rounds of constraints, of a block of so many cells of 1 cm.
pub fn xpbd_secs(cells: [usize; 3], runs: usize) -> Result<(f64, f64), Failure> {
    let config = XpbdConfig { parts: 1, iterations: 5, damping: 1.0, ..XpbdConfig::default() };
    let mut body = beam(cells, cells.map(|count| 0.01 * count as f64), config)?;
    let input = XpbdInput { gravity: GRAVITY, ..XpbdInput::default() };
    let mut failed = None;
    let figure = per_run(runs, || {
        if let Err(error) = body.step(5e-3, black_box(&input)) {
            failed = Some(error);
        }
    });
    failed.map_or(Ok(figure), |error| Err(Failure::internal(error)))
}

/// Position-based bodies beside pypbd's.
pub fn position_based(_python: Option<&Path>) -> Result<Vec<BenchResult>, Failure> {
    let (value, _) = scaled(xpbd_secs([30, 7, 2], 50)?, 1e3);
    Ok(vec![told("xpbd_2520", "ms", value, Better::Lower)])
}
