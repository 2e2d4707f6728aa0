//! Benchmarks of finite elements: the precomputed linear ones against haptic rates, the corotational ones beside
//! MuJoCo.

use std::hint::black_box;
use std::path::Path;

use nalgebra::Vector3;
use trocar::summary::{BenchResult, Better};
use trocar_dynamics::elasticity::Elastic;
use trocar_kernel::bench::median_and_spread;
use trocar_simulator::dynamic_fem::{Config, Constitution, DynamicFem, Inputs};
use trocar_simulator::linear_fem::{Attachment, Hold, Limits, LinearFem, Load};

use super::bodies::{GRAVITY, block};
use super::peers::MujocoBeam;
use super::roofline::{Work, share};
use super::{BLOCKS, at_most, per_run, scaled, secs};
use crate::failure::Failure;

/// Young's modulus \[Pa\] and Poisson's ratio of a soft organ.
const ORGAN: (f64, f64) = (1e4, 0.4);

/// A precomputed block, clamped at x = 0.
pub fn precomputed(cells: [usize; 3], size: [f64; 3]) -> Result<LinearFem, Failure> {
    let (mesh, wall) = block(cells, size)?;
    let material = Elastic::new(ORGAN.0, ORGAN.1).map_err(Failure::internal)?;
    LinearFem::new(mesh, &material, &wall, &Limits::default(), &mut |_| true).map_err(Failure::internal)
}

/// Median time of a contact solve for so many held nodes that all move.
fn contact_of(body: &mut LinearFem, held: usize) -> Result<(f64, f64), Failure> {
    let free = body.compliance().nodes().to_vec();
    let start = free.len() / 2;
    let handles: Result<Vec<_>, _> =
        (0..held).map(|i| body.hold(Attachment::node(free[start + i], Hold::Point))).collect();
    let handles = handles.map_err(Failure::internal)?;
    let mut phase = 0.0_f64;
    Ok(per_run(500, || {
        phase += 0.01;
        for handle in &handles {
            let target = Vector3::new(0.0, 1e-3 * phase.sin(), 0.0);
            black_box(body.set_target(*handle, target).is_ok());
        }
        black_box(body.solve(&[]).map(|solution| solution.reactions[0]).is_ok());
    }))
}

/// The same for a block of its own.
pub fn contact_secs(held: usize) -> Result<(f64, f64), Failure> {
    contact_of(&mut precomputed([8, 8, 8], [0.1; 3])?, held)
}

/// Surface nodes of a block that is held at ten nodes, and the median time of reading all their positions.
pub fn surface_secs(cells: [usize; 3]) -> Result<(usize, (f64, f64)), Failure> {
    let mut body = precomputed(cells, [0.1; 3])?;
    contact_of(&mut body, 10)?;
    let mut out = Vec::new();
    let figure = per_run(50, || body.surface_displacements(black_box(&mut out)));
    Ok((body.compliance().nodes().len(), figure))
}

/// Linear finite elements with a precomputed inverse.
pub fn linear() -> Result<Vec<BenchResult>, Failure> {
    let mut rows = Vec::new();
    let (cells, size) = ([15, 14, 14], [0.1; 3]);
    let mut body = precomputed(cells, size)?;
    let mut times = Vec::new();
    for _ in 0..3 {
        let mut made = Ok(());
        times.push(secs(|| made = precomputed(cells, size).map(drop)));
        made?;
    }
    let precompute = median_and_spread(&times);
    rows.push(at_most("linear_fem_precompute_1009_nodes", "s", precompute, 1.0));
    // Lower bound of the bytes written: the inverse at the surface nodes. The sparse solves before it come on top.
    let freedoms = body.compliance().row(0, 0).len() as f64;
    let work = Work { bytes: 4.0 * freedoms.powi(2), ..Work::default() };
    rows.push(share("linear_fem_precompute_1009_nodes", precompute.0, work));

    let contact = contact_of(&mut body, 10)?;
    rows.push(at_most("linear_fem_contact_10_nodes", "µs", scaled(contact, 1e6), 20.0));
    // Forward and back substitution with the factor of the held nodes' compliance.
    let work = Work { operations: 2.0 * 900.0, single: false, bytes: 2.0 * 8.0 * 450.0 };
    rows.push(share("linear_fem_contact_10_nodes", contact.0, work));
    let mut out = Vec::new();
    let surface = per_run(200, || body.surface_displacements(black_box(&mut out)));
    rows.push(at_most("linear_fem_surface_1009_nodes", "µs", scaled(surface, 1e6), 100.0));
    // For each of the ten held nodes and each axis, it reads and accumulates one row of the inverse.
    let numbers = (30 * body.compliance().row(0, 0).len()) as f64;
    let work = Work { operations: 2.0 * numbers, single: true, bytes: 4.0 * numbers };
    rows.push(share("linear_fem_surface_1009_nodes", surface.0, work));

    // The bar of SOFA's benchmark: 320 nodes.
    let mut bar = precomputed([19, 3, 3], [0.19, 0.03, 0.03])?;
    let free = bar.compliance().nodes().to_vec();
    let end = Attachment::node(free[free.len() - 1], Hold::Point);
    let end = bar.hold(end).map_err(Failure::internal)?;
    let mut phase = 0.0_f64;
    let load = [(free[free.len() / 2], 1.0)];
    let step = per_run(500, || {
        phase += 0.01;
        black_box(bar.set_target(end, Vector3::new(0.0, 0.0, 1e-3 * phase.sin())).is_ok());
        let force = Vector3::new(0.0, 1e-3, 0.0);
        black_box(bar.solve(&[Load { weights: &load, force }]).is_ok());
        bar.surface_displacements(black_box(&mut out));
    });
    rows.push(at_most("linear_fem_bar_320_nodes", "ms", scaled(step, 1e3), 0.2));
    // Rows of the held node and of the loaded node, three axes each.
    let numbers = (6 * bar.compliance().row(0, 0).len()) as f64;
    let work = Work { operations: 2.0 * numbers, single: true, bytes: 4.0 * numbers };
    rows.push(share("linear_fem_bar_320_nodes", step.0, work));
    Ok(rows)
}

/// Stiffness damping of the beams \[s\]: their oscillation has decayed by the end of the blocks.
const DAMPING: f64 = 2e-2;

/// A corotational beam that sags under gravity.
pub fn beam(cells: [usize; 3]) -> Result<DynamicFem, Failure> {
    beam_of(Constitution::Corotational, cells)
}

/// A beam of this constitution.
pub fn beam_of(constitution: Constitution, cells: [usize; 3]) -> Result<DynamicFem, Failure> {
    let (mesh, wall) = block(cells, [0.1, 0.02, 0.02])?;
    let elastic = Elastic::new(1e5, 0.3).map_err(Failure::internal)?;
    let config = Config { constitution, stiffness_damping: DAMPING, ..Config::default() };
    DynamicFem::new(mesh, &elastic, &config, &wall).map_err(Failure::internal)
}

/// Steps of a block.
const STEPS: usize = 200;

/// Implicit corotational finite elements at 1 ms, beside MuJoCo's implicit flexible body: the same beam and steps, in
/// alternating blocks; and whether both come to rest at the same deflection.
pub fn dynamic(python: Option<&Path>) -> Result<Vec<BenchResult>, Failure> {
    let mut rows = Vec::new();
    for cells in [[20, 3, 3], [32, 5, 5]] {
        let mut body = beam(cells)?;
        let mut peer = python.map(|python| MujocoBeam::start(python, cells, DAMPING)).transpose()?;
        let tets = body.mesh().tets().len();
        let inputs = Inputs { acceleration: GRAVITY, ..Inputs::default() };
        let (mut ours, mut theirs, mut residual) = (Vec::new(), Vec::new(), 0.0_f64);
        let (mut solves, mut evaluations) = (0, 0);
        let mut failed = None;
        for _ in 0..BLOCKS {
            let block = secs(|| {
                for _ in 0..STEPS {
                    match body.step(1e-3, black_box(&inputs)) {
                        Ok(report) => {
                            residual = residual.max(report.residual);
                            solves += report.iterations;
                            evaluations += report.evaluations;
                        }
                        Err(error) => failed = Some(error),
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
        let name = format!("simulator_corotational_{tets}");
        let figure = median_and_spread(&ours);
        rows.push(match &mut peer {
            Some(_) => {
                let floor = median_and_spread(&theirs).0;
                BenchResult::on_ratio(&name, "ms", figure, floor, Some(0.6), Better::Lower)
            }
            None => BenchResult::on_value(&name, "ms (no peer)", figure, None, Better::Lower),
        });
        // A solve reads the factor twice. For each element: deformation gradient, polar decomposition, stress, four
        // forces.
        let per_step = |count: u32| f64::from(count) / (BLOCKS * STEPS) as f64;
        let (entries, elements) = (body.factor_entries() as f64, tets as f64);
        let work = Work {
            operations: per_step(solves) * 4.0 * entries + per_step(evaluations) * 500.0 * elements,
            single: false,
            bytes: per_step(solves) * 16.0 * entries + per_step(evaluations) * 200.0 * elements,
        };
        rows.push(share(&format!("corotational_{tets}"), figure.0 * 1e-3, work));
        rows.push(at_most(&format!("corotational_{tets}_residual"), "share", (residual, 0.0), 1e-4));
        if let Some(peer) = &mut peer {
            // Both are at rest by now.
            let ends =
                body.mesh().rest().iter().zip(body.positions()).filter(|(rest, _)| rest.x > 0.1 - 1e-9);
            let drops: Vec<f64> = ends.map(|(rest, now)| rest.z - now.z).collect();
            let ours = drops.iter().sum::<f64>() / drops.len() as f64;
            let apart = (ours / peer.tip() - 1.0).abs();
            rows.push(at_most(&format!("corotational_{tets}_tip_apart"), "share", (apart, 0.0), 0.02));
        }
    }
    Ok(rows)
}
