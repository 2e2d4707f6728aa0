//! Growth of the costs with the number of elements.

use std::hint::black_box;

use trocar::summary::{BenchResult, Better};
use trocar_simulator::dynamic_fem::{Constitution, Inputs};

use super::bodies::GRAVITY;
use super::roofline::{Work, share};
use super::{fem, flows, per_run, rigid, scaled, secs, soft, surgery, told};
use crate::failure::Failure;

/// Median times of steps by size, as rows of a plot \[µs\].
pub fn growth() -> Result<Vec<BenchResult>, Failure> {
    let (mut rows, mut shares) = (Vec::new(), Vec::new());
    let mut of_peak = |name: &str, (secs, _): (f64, f64), operations: f64, bytes: f64| {
        shares.push(share(name, secs, Work { operations, single: false, bytes }));
    };
    let mut row = |what: &str, size: usize, (value, _): (f64, f64)| {
        rows.push(told(&format!("growth_{what}_{size}"), "µs", value, Better::Lower));
    };
    for n in [4, 6, 8, 11, 14] {
        let mut made = Ok(());
        let time = secs(|| made = fem::precomputed([n; 3], [0.1; 3]).map(drop));
        made?;
        row("fem_precompute", 6 * n * n * n, (time * 1e6, 0.0));
    }
    for cells in [[4; 3], [7; 3], [10; 3], [14; 3]] {
        let (nodes, figure) = fem::surface_secs(cells)?;
        row("fem_surface", nodes, scaled(figure, 1e6));
    }
    for (what, constitution) in
        [("fem_corotational", Constitution::Corotational), ("fem_neo_hookean", Constitution::NeoHookean)]
    {
        for cells in [[10, 2, 2], [20, 3, 3], [32, 5, 5], [48, 8, 8]] {
            let mut body = fem::beam_of(constitution, cells)?;
            let inputs = Inputs { acceleration: GRAVITY, ..Inputs::default() };
            let (mut failed, mut steps, mut solves, mut evaluations) = (None, 0.0, 0.0, 0.0);
            let figure = per_run(10, || match body.step(1e-3, black_box(&inputs)) {
                Ok(report) => {
                    steps += 1.0;
                    solves += f64::from(report.iterations);
                    evaluations += f64::from(report.evaluations);
                }
                Err(error) => failed = Some(error),
            });
            if let Some(error) = failed {
                return Err(Failure::internal(error));
            }
            let tets = body.mesh().tets().len();
            row(what, tets, scaled(figure, 1e6));
            if constitution == Constitution::NeoHookean && tets == 4_800 {
                // As for the corotational beam in the table, but without the decomposition.
                let (entries, elements) = (body.factor_entries() as f64, tets as f64);
                let operations = (solves * 4.0 * entries + evaluations * 350.0 * elements) / steps;
                let bytes = (solves * 16.0 * entries + evaluations * 200.0 * elements) / steps;
                of_peak("neo_hookean_4800", figure, operations, bytes);
            }
        }
    }
    for held in [5, 10, 20, 40, 80] {
        row("fem_contact", held, scaled(fem::contact_secs(held)?, 1e6));
    }
    for bodies in [10, 30, 100, 300] {
        row("rigid", bodies, scaled(rigid::pile_secs(bodies)?, 1e6));
    }
    for n in [16, 32, 64, 128] {
        let triangles = 2 * (n * n) as usize;
        row("cloth_explicit", triangles, scaled(soft::step_secs(soft::explicit(n)?, 20)?, 1e6));
        row("cloth_implicit", triangles, scaled(soft::step_secs(soft::implicit(n)?, 3)?, 1e6));
    }
    for cells in [[10, 3, 2], [30, 7, 2], [40, 10, 10]] {
        let tets = 6 * cells.iter().product::<usize>();
        row("xpbd", tets, scaled(soft::xpbd_secs(cells, 5)?, 1e6));
    }
    for n in [16, 32, 64, 128] {
        let figure = soft::xpbd_cloth_secs(n)?;
        row("xpbd_cloth", 2 * (n * n) as usize, scaled(figure, 1e6));
        if n == 64 {
            // Five sweeps over three edges and three hinges per square: for each edge its vector and length, the step,
            // the moves of two nodes; for each hinge the same for four.
            let squares = f64::from(n * n);
            of_peak(
                "xpbd_cloth_8192",
                figure,
                5.0 * 3.0 * (35.0 + 75.0) * squares,
                5.0 * 3.0 * 300.0 * squares,
            );
        }
        let (squares, figure) = (f64::from(n * n), surgery::cut_secs(n)?);
        row("cut", 2 * (n * n) as usize, scaled(figure, 1e6));
        if n == 128 {
            // The triangles that a blade passes: for each vertex its position and side, for each triangle its corners.
            of_peak("cut_32768", figure, 20.0 * squares, (24.0 + 2.0 * 12.0) * squares);
        }
    }
    for edges in [30, 100, 300, 1_000] {
        let figure = soft::xpbd_rod_secs(edges)?;
        row("xpbd_rod", edges as usize, scaled(figure, 1e6));
        if edges == 1_000 {
            of_peak("xpbd_rod_1000", figure, 5.0 * (35.0 + 75.0) * f64::from(edges), 0.0);
        }
    }
    for cells in [[4, 3, 2], [8, 6, 4], [12, 10, 6]] {
        let (sewn, figure) = surgery::sew_secs(cells)?;
        row("suture", sewn.nodes, scaled(figure, 1e6));
        if cells == [12, 10, 6] {
            // Three columns of the tissue for each held node, over all of its nodes; and the thread's own work, as for
            // any thread.
            let entries = 9.0 * (sewn.held * sewn.nodes) as f64;
            let (operations, bytes) = flows::thread_work(sewn.edges);
            of_peak("suture_1001", figure, operations + 2.0 * entries, bytes + 8.0 * entries);
        }
    }
    for nodes in [10, 30, 100, 300, 1_000] {
        let figure = surgery::couple_secs(nodes)?;
        row("coupling", nodes as usize, scaled(figure, 1e6));
        if nodes == 1_000 {
            // For a node of either side: its predicted position, its tie, the impulse on both, and its step.
            of_peak("coupling_1000", figure, 150.0 * f64::from(nodes), 400.0 * f64::from(nodes));
        }
    }
    for puffs in [300, 2_000, 10_000, 50_000] {
        let figure = surgery::smoke_secs(puffs)?;
        row("smoke", puffs, scaled(figure, 1e6));
        if puffs == 50_000 {
            // For a puff: lift, wind and drag, and diffusion; its eight numbers, read and written.
            of_peak("smoke_50000", figure, 100.0 * puffs as f64, 128.0 * puffs as f64);
        }
    }
    for edges in [30, 100, 300] {
        row("thread", edges, scaled(flows::thread_secs(edges, false)?, 1e6));
    }
    for n in [22, 71, 158] {
        row("heat", 2 * (n * n) as usize, scaled(flows::heat_secs(n)?, 1e6));
    }
    for particles in [1_000, 5_000, 20_000, 50_000] {
        row("fluid", particles, scaled(flows::liquid_secs(particles, 1)?, 1e6));
    }
    rows.extend(shares);
    Ok(rows)
}
