//! Benchmarks of surgical actions by size: cutting, suturing, coupling, and smoke of electrosurgery.

use std::hint::black_box;

use nalgebra::{Isometry3, Point3, Rotation3, UnitQuaternion, Vector3};
use trocar_dynamics::coupling::external_nodes::{ExternalNodes, Tie};
use trocar_dynamics::coupling::{GhostNodes, SlowBodyReport};
use trocar_dynamics::elasticity::{Alteration, Elastic};
use trocar_dynamics::particles::State;
use trocar_dynamics::tet_mesh::Sweep;
use trocar_simulator::cutting::Sheet;
use trocar_simulator::fluid::smoke::{Smoke, SmokeConfig};
use trocar_simulator::mass_spring::{ChangedMesh, Integrator, TooLarge};
use trocar_simulator::suture::needle::{NeedleShape, NeedleState};
use trocar_simulator::suture::{Grip, Resistance, StepInputs, Suture, SutureState, Tissue};
use trocar_simulator::suture_thread::{ThreadMaterial, ThreadState};
use trocar_simulator::xpbd::{Body, Xpbd, XpbdConfig, XpbdInput};

use super::bodies::{self, CLOTH, GRAVITY, block, cloth};
use super::per_run;
use crate::failure::Failure;

/// Median time of a snip of 1 mm into a gauze of `n` × `n` squares: the mesh is cut and its springs are updated.
pub fn cut_secs(n: u32) -> Result<(f64, f64), Failure> {
    let mut springs = cloth(n, Integrator::Explicit { too_large: TooLarge::Accept })?;
    let (positions, triangles) = bodies::sheet(n);
    let mut sheet = Sheet::new(positions, triangles).map_err(Failure::internal)?;
    let (mut snips, mut failed) = (0, None);
    let mut snip = || {
        // Rows of snips 1 mm apart that do not meet.
        let (row, along) = (snips / 80, f64::from(snips % 80) * 1e-3);
        snips += 1;
        let [y, x] = [0.011 + 2e-3 * f64::from(row), 0.01 + along];
        let edge = |x: f64| [Point3::new(x, y, -0.02), Point3::new(x, y, 0.02)];
        let sweep = Sweep { before: edge(x), after: edge(x + 1e-3) };
        let done =
            sheet.cut(&springs.state().positions, &[sweep]).map_err(Failure::internal).and_then(|change| {
                let mut pinned = springs.pinned().to_vec();
                change.carry_members(&mut pinned, springs.state().positions.len());
                let patch = ChangedMesh {
                    rest: sheet.rest(),
                    elements: sheet.triangles(),
                    altered: &|_| Alteration::NONE,
                    about: &|vertex| sheet.about(vertex),
                    stale: &change.stale,
                };
                let carry = |state: &mut State| {
                    change.carry(&mut state.positions, |a, b, share| a + (b - a) * share);
                    change.carry(&mut state.velocities, |a, b, share| a + (b - a) * share);
                };
                springs
                    .follow(
                        &patch,
                        |node| pinned.contains(&node),
                        carry,
                        |network, patch| network.follow_surface(patch, &CLOTH),
                    )
                    .map_err(Failure::internal)
            });
        if let Err(error) = done {
            failed = Some(error);
        }
    };
    let figure = per_run(20, &mut snip);
    failed.map_or(Ok(figure), Err)
}

/// Sizes of a suture.
pub struct Sewn {
    /// Nodes of the tissue, and how many of them the needle and thread hold.
    pub nodes: usize,
    pub held: usize,
    /// Edges of the thread.
    pub edges: usize,
}

/// A block of so many cells of tissue, and the median time of a simulated millisecond of a needle with its thread that
/// is pushed through it.
pub fn sew_secs(cells: [usize; 3]) -> Result<(Sewn, (f64, f64)), Failure> {
    let edges = 60;
    let size = [0.024, 0.020, 0.012];
    let (mesh, _) = block(cells, size)?;
    let nodes = mesh.rest().len();
    let below: Vec<u32> = (0..nodes as u32).filter(|&node| mesh.rest()[node as usize].z < 1e-9).collect();
    // Skin: softer tissue is pushed down by millimetres before a tip punctures it.
    let elastic = Elastic::new(5e5, 0.4).map_err(Failure::internal)?;
    let tissue = Tissue::new(mesh, &elastic, &below).map_err(Failure::internal)?;
    // An almost straight needle of 40 mm, its tip above the middle of the block and pointing down.
    let shape = NeedleShape { radius: 5.0, angle: 0.008, wire_radius: 3e-4, taper: 5e-3, density: 7900.0 };
    let solid = shape.solid().map_err(Failure::internal)?;
    let (ahead, length) = (-Vector3::z(), shape.length());
    let turn = UnitQuaternion::rotation_between(&solid.tangent(length), &ahead)
        .unwrap_or_else(|| UnitQuaternion::from_rotation_matrix(&Rotation3::identity()));
    let tip = Point3::new(0.5 * size[0], 0.5 * size[1], size[2] + 5e-4);
    let mut at = Isometry3::from_parts((tip - turn * solid.point(length)).into(), turn);
    let (tail, back) = (at * solid.point(0.0), at * -solid.tangent(0.0));
    let thread: Vec<_> = (0..=edges).map(|node| tail + back * (1e-3 * node as f64)).collect();
    let state = SutureState::new(NeedleState::at_rest(&at), Some(ThreadState::at_rest(&thread)));
    let material = Some(ThreadMaterial::silk_2_0());
    let mut suture =
        Suture::new(&shape, material, Resistance::default(), tissue, state).map_err(Failure::internal)?;
    suture.swage();
    let mut failed = None;
    let mut step = || {
        let from = at;
        at.translation.vector += ahead * 2e-5;
        let grip = Grip {
            point: solid.point(0.3 * length),
            from,
            to: at,
            stiffness: 1e5,
            turning_stiffness: 20.0,
            force_max: f64::INFINITY,
            torque_max: f64::INFINITY,
        };
        let around = StepInputs { gravity: GRAVITY, grips: &[grip], ..StepInputs::default() };
        if let Err(error) = suture.step(1e-3, black_box(&around)) {
            failed = Some(error);
        }
    };
    (0..250).for_each(|_| step());
    let figure = per_run(15, &mut step);
    if let Some(error) = failed {
        return Err(Failure::internal(error));
    }
    if suture.state().channel.is_empty() {
        return Err(Failure::internal("the needle has not gone in"));
    }
    Ok((Sewn { nodes, held: suture.tissue().forces().len(), edges }, figure))
}

/// Median time of a step that couples so many loose nodes with as many of another body at a tenth of the rate.
pub fn couple_secs(nodes: u32) -> Result<(f64, f64), Failure> {
    const RATE: usize = 10;
    let places: Vec<_> = (0..nodes).map(|node| Point3::new(1e-3 * f64::from(node), 0.0, 0.0)).collect();
    let count = places.len();
    let masses = vec![1e-5; count];
    let body = Body { rest: &places, masses: &masses, ..Body::default() };
    let config = XpbdConfig { parts: 1, ..XpbdConfig::default() };
    let mut body = Xpbd::new(&body, &[], config).map_err(Failure::internal)?;
    let mut ghosts = GhostNodes::new(&places).map_err(Failure::internal)?;
    let tie = |node: u32| Tie {
        node,
        ghost_nodes: [(node, 1.0), (node, 0.0), (node, 0.0), (node, 0.0)],
        stiffness: 10.0,
        damping: 1e-3,
    };
    let ties: Vec<Tie> = (0..nodes).map(tie).collect();
    let still = vec![Vector3::zeros(); count];
    let light = vec![1e3; count];
    let (mut ghost_nodes, mut steps, mut failed) = (Vec::new(), 0, None);
    let mut step = || {
        if steps % RATE == 0 {
            let news = SlowBodyReport {
                positions: &places,
                velocities: &still,
                expected: &still,
                mobilities: &light,
                masses_inverse: &light,
                last: &still,
                given_work: ghosts.work(),
                received: 0.0,
                steps: ghosts.steps(),
                step: 1e-3 * RATE as f64,
            };
            failed = ghosts.receive(&news).map_err(Failure::internal).err();
        }
        steps += 1;
        let external_nodes = ExternalNodes { ghost_nodes: &[], ties: &ties, presses: &[] };
        ghost_nodes.clear();
        ghosts.begin_step(&external_nodes, &body.state().positions, &mut ghost_nodes);
        let external_nodes = ExternalNodes { ghost_nodes: &ghost_nodes, ..external_nodes };
        if let Err(error) =
            body.step(1e-3, &XpbdInput { gravity: GRAVITY, external_nodes, ..XpbdInput::default() })
        {
            failed = Some(Failure::internal(error));
        }
        let lost = body.external_nodes().ties.iter().map(|tied| tied.lost).sum();
        ghosts.end_step(1e-3, &body.external_nodes().ghost_nodes, lost);
    };
    (0..2 * RATE).for_each(|_| step());
    let figure = per_run(2 * RATE, &mut step);
    failed.map_or(Ok(figure), Err)
}

/// Median time of a step of so many puffs of smoke.
pub fn smoke_secs(puffs: usize) -> Result<(f64, f64), Failure> {
    let config = SmokeConfig { puffs_max: puffs, lifetime: 1e4, ..SmokeConfig::default() };
    let all = config.puff * (puffs as f64 + 0.5);
    let mut smoke = Smoke::new(config).map_err(Failure::internal)?;
    let mut failed = smoke.step(0.01, &[(Point3::origin(), all)], &Vector3::zeros()).err();
    let figure = per_run(20, || {
        if let Err(error) = smoke.step(0.01, black_box(&[]), &Vector3::zeros()) {
            failed = Some(error);
        }
    });
    failed.map_or(Ok(figure), |error| Err(Failure::internal(error)))
}
