//! How costs grow with the number of elements.

use std::hint::black_box;

use trocar::summary::{BenchResult, Better};
use trocar_simulator::dynamic_fem::{Constitution, Inputs};

use super::bodies::GRAVITY;
use super::{fem, flows, per_run, rigid, scaled, secs, soft, surgery, told};
use crate::failure::Failure;

/// Median times of steps by size, as rows of a plot \[µs\].
pub fn growth() -> Result<Vec<BenchResult>, Failure> {
    let mut rows = Vec::new();
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
            let mut failed = None;
            let figure = per_run(10, || {
                if let Err(error) = body.step(1e-3, black_box(&inputs)) {
                    failed = Some(error);
                }
            });
            if let Some(error) = failed {
                return Err(Failure::internal(error));
            }
            row(what, body.mesh().tets().len(), scaled(figure, 1e6));
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
        row("xpbd_cloth", 2 * (n * n) as usize, scaled(soft::xpbd_cloth_secs(n)?, 1e6));
        row("cut", 2 * (n * n) as usize, scaled(surgery::cut_secs(n)?, 1e6));
    }
    for edges in [30, 100, 300, 1_000] {
        row("xpbd_rod", edges as usize, scaled(soft::xpbd_rod_secs(edges)?, 1e6));
    }
    for cells in [[4, 3, 2], [8, 6, 4], [12, 10, 6]] {
        let (nodes, figure) = surgery::sew_secs(cells)?;
        row("suture", nodes, scaled(figure, 1e6));
    }
    for nodes in [10, 30, 100, 300, 1_000] {
        row("coupling", nodes as usize, scaled(surgery::couple_secs(nodes)?, 1e6));
    }
    for puffs in [300, 2_000, 10_000, 50_000] {
        row("smoke", puffs, scaled(surgery::smoke_secs(puffs)?, 1e6));
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
    Ok(rows)
}
