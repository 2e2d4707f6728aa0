//! Cutting of dynamic finite elements: no tick waits for the ordering, symbolic and numeric factorisation of the new
//! mesh. These run in a job while the former factor is reused, and nothing jumps when the new factor takes over.

use std::sync::Arc;

use crate::support::stage::{Stage, scene};
use nalgebra::{Isometry3, Point3, UnitQuaternion, Vector3};
use trocar_dynamics::elasticity::Elastic;
use trocar_dynamics::tet_mesh::{BoxCells, MeshRules, NodeOrigin, TetMesh, box_cells};
use trocar_scene::{
    BuildContext, ControllerError, Frozen, JawState, Pose, VertexPositions, VertexVelocities,
};
use trocar_simulator::controller::{DynamicFemController, RemovedElements};
use trocar_simulator::dynamic_fem::{Config, DynamicFem, Inputs};

const GRAVITY: Vector3<f64> = Vector3::new(0.0, 0.0, -9.81);
const DT: f64 = 1e-3;

/// A bar of 4,860 elements held at one end, and the same bar with a slit across its upper half; the births of its
/// nodes.
struct Bar {
    whole: TetMesh,
    slit: TetMesh,
    born: Vec<NodeOrigin>,
    fixed: Vec<u32>,
    elastic: Elastic,
}

impl Bar {
    fn new() -> Self {
        let grid =
            BoxCells { cells: [18, 9, 5], size: Vector3::new(0.1, 0.05, 0.03), origin: Point3::origin() };
        let (rest, tets) = box_cells(&grid);
        assert_eq!(tets.len(), 4860);
        let fixed = (0..rest.len() as u32).filter(|&node| rest[node as usize].x < 1e-6).collect();
        let whole = TetMesh::new(&rest, &tets, &MeshRules::default()).expect("a mesh");
        // Seven cells from where it is held, to the middle of its height.
        let plane = 7.0 * 0.1 / 18.0;
        let (mut rest, mut tets) = (rest, whole.tets().to_vec());
        let lips: Vec<u32> = (0..rest.len() as u32)
            .filter(|&node| (rest[node as usize].x - plane).abs() < 1e-6 && rest[node as usize].z > 0.0125)
            .collect();
        let first = rest.len() as u32;
        let own = rest.clone();
        for tet in &mut tets {
            let middle = tet.iter().map(|&node| own[node as usize].x).sum::<f64>() / 4.0;
            for node in tet.iter_mut().filter(|_| middle > plane) {
                if let Some(at) = lips.iter().position(|lip| lip == node) {
                    *node = first + at as u32;
                }
            }
        }
        rest.extend(lips.iter().map(|&node| own[node as usize]));
        let born = lips.iter().map(|&node| NodeOrigin { of: [node; 2], share: 0.0 }).collect();
        let rules = MeshRules { coincident_within: None, ..MeshRules::default() };
        let slit = TetMesh::new(&rest, &tets, &rules).expect("a mesh");
        let elastic = Elastic::new(2e4, 0.4).expect("a material");
        Self { whole, slit, born, fixed, elastic }
    }

    /// The whole bar, under its weight for a tenth of a second.
    fn hanging(&self, config: &Config) -> DynamicFem {
        let mut body =
            DynamicFem::new(self.whole.clone(), &self.elastic, config, &self.fixed).expect("a body");
        (0..100).for_each(|_| {
            body.step(DT, &inputs()).expect("a step");
        });
        body
    }

    fn cut(&self, body: &mut DynamicFem) {
        body.split_nodes(self.slit.clone(), &self.fixed, &self.born, |_| {}).expect("it comes apart");
    }
}

fn inputs() -> Inputs<'static> {
    Inputs { acceleration: GRAVITY, ..Inputs::default() }
}

/// Reactions of a body, by node, in newtons.
fn held(body: &DynamicFem) -> Vec<Vector3<f64>> {
    body.reactions().iter().map(|(_, force)| *force).collect()
}

fn jump(one: &[Vector3<f64>], other: &[Vector3<f64>]) -> f64 {
    let size = |all: &mut dyn Iterator<Item = Vector3<f64>>| all.map(|force| force.norm()).sum::<f64>();
    size(&mut one.iter().zip(other).map(|(one, other)| one - other)) / size(&mut one.iter().copied())
}

#[test]
fn a_factor_that_is_lent_bears_a_cut_and_nothing_jumps_when_another_takes_over() {
    let bar = Bar::new();
    let config = Config { mass_damping: 2.0, stiffness_damping: 1e-3, ..Config::default() };
    let (mut lent, mut at_once) = (bar.hanging(&config), bar.hanging(&config));
    bar.cut(&mut lent);
    assert!(lent.has_stale_factor() && lent.has_factor());
    // The control has its own factor from the first step on.
    bar.cut(&mut at_once);
    let own = |body: &DynamicFem| {
        let mut fresh = DynamicFem::new(bar.slit.clone(), &bar.elastic, &config, &bar.fixed).expect("a body");
        fresh.factor_at(body.positions(), DT, &[]).expect("a factor");
        fresh.into_analysis()
    };
    let analysis = own(&at_once);
    at_once.take_over(analysis, &[]).expect("room");
    assert!(!at_once.has_stale_factor());
    let (mut most, mut first) = (0.0_f64, [0; 2]);
    for step in 0..60 {
        let (mut swapped, is_swap) = (None, step % 10 == 3);
        if is_swap {
            // An identical body, apart from the factor.
            let mut twin = bar.hanging(&config);
            bar.cut(&mut twin);
            twin.resume(&lent.state());
            let analysis = own(&twin);
            twin.take_over(analysis, &[]).expect("room");
            swapped = Some(twin);
        }
        let report = lent.step(DT, &inputs()).expect("a step");
        assert!(report.solved, "step {step}: {}", report.residual);
        assert_eq!(report.factorisations, 0, "step {step}");
        let own = at_once.step(DT, &inputs()).expect("a step");
        if step < 20 {
            // As long as a factorisation takes.
            first = [first[0] + report.iterations, first[1] + own.iterations];
        }
        if let Some(mut twin) = swapped {
            twin.step(DT, &inputs()).expect("a step");
            most = most.max(jump(&held(&lent), &held(&twin)));
        }
    }
    assert!(most < 0.05, "the force jumps by {most}");
    assert!(first[0] < 3 * first[1], "{first:?} iterations");
    assert_eq!(lent.analysed(), 0);
    let apart = lent.positions().iter().zip(at_once.positions());
    let apart = apart.map(|(one, other)| (one - other).norm()).fold(0.0, f64::max);
    let lips = bar.born.iter().enumerate().map(|(at, birth)| {
        let first = bar.whole.rest().len();
        (lent.positions()[first + at] - lent.positions()[birth.of[0] as usize]).norm()
    });
    let opened = lips.fold(0.0, f64::max);
    assert!(opened > 3e-4 && apart < 0.02 * opened, "opened by {opened} m, {apart} m apart");
}

#[test]
fn a_step_that_a_lent_factor_does_not_finish_does_jump() {
    let bar = Bar::new();
    let config = Config { iterations_max: 1, ..Config::default() };
    let (mut lent, mut twin) = (bar.hanging(&config), bar.hanging(&config));
    bar.cut(&mut lent);
    bar.cut(&mut twin);
    let mut fresh = DynamicFem::new(bar.slit.clone(), &bar.elastic, &config, &bar.fixed).expect("a body");
    fresh.factor_at(twin.positions(), DT, &[]).expect("a factor");
    twin.take_over(fresh.into_analysis(), &[]).expect("room");
    let mut most = 0.0_f64;
    for _ in 0..20 {
        lent.step(DT, &inputs()).expect("a step");
        twin.step(DT, &inputs()).expect("a step");
        most = most.max(jump(&held(&lent), &held(&twin)));
    }
    assert!(most > 0.05, "{most}");
}

fn fem(context: &BuildContext<'_>) -> Result<DynamicFemController, ControllerError> {
    DynamicFemController::new(GRAVITY, context)
}

/// A hanging block of 4,860 elements, and closed blades beside it.
fn block() -> String {
    "[[entity]]\nname = \"tool\"\npose = { translation = [0.2, 0.0, 0.0] }\n\
     instrument = { kind = \"scissors\", shaft_length = 0.1, shaft_radius = 0.002, jaw_length = 0.04, jaws = 2 }\n\
     [[entity]]\nname = \"block\"\ncauterised = {}\n\
     mesh = { block = { size = [0.03, 0.02, 0.05], cells = [9, 6, 15] } }\n\
     dynamic_fem = { young_modulus = 2e4, poisson_ratio = 0.3, density = 1000.0, mass_damping = 5.0, cut = true }\n\
     anchors = { regions = [{ box = { min = [-1.0, -1.0, 0.0249], max = [1.0, 1.0, 1.0] } }] }\n"
        .to_owned()
}

type State = (Arc<Vec<Point3<f64>>>, Arc<Vec<Vector3<f64>>>);

/// Cuts into the block, restarts the controller after these ticks, and removes elements after that one.
fn cuts(kills: &[u32], burns: Option<u32>) -> (State, Vec<[f64; 2]>) {
    let mut stage = Stage::new(scene(&block()), 200.0, fem);
    let turned = UnitQuaternion::rotation_between(&Vector3::z(), &Vector3::y()).expect("a quarter of a turn");
    let tool = |x: f64| Pose::from(Isometry3::from_parts(Vector3::new(x, 0.02, -0.0035).into(), turned));
    stage.put("tool", JawState { angle: 0.0, rate: 0.0, pad_force: [0.0; 2] });
    stage.put("tool", tool(-0.02));
    (0..20).for_each(|_| stage.tick());
    let mut seen = Vec::new();
    for tick in 0..60_u32 {
        // For 30 ticks, to beyond the middle.
        stage.put("tool", tool(-0.02 + 0.024 * f64::from(tick.min(30)) / 30.0));
        if burns == Some(tick) {
            stage.put("block", RemovedElements { elements: Arc::new(vec![0, 1, 2]) });
        }
        stage.tick();
        if kills.contains(&tick) {
            stage.rebuild(fem);
        }
        assert!(!stage.has::<Frozen>("block"), "{}", stage.get::<Frozen>("block").reason);
        seen.push(["block.lent_factor", "block.analysed_in_ticks"].map(|what| stage.measured(what)));
        assert_eq!(stage.measured("block.unsolved_steps"), 0.0);
    }
    let state =
        (stage.get::<VertexPositions>("block").positions, stage.get::<VertexVelocities>("block").velocities);
    (state, seen)
}

#[test]
fn no_tick_of_a_cut_waits_for_an_analysis_and_another_life_goes_on_to_the_bit() {
    let (state, seen) = cuts(&[], None);
    assert!(state.0.len() > 10 * 7 * 16 + 20, "it is cut: {} vertices", state.0.len());
    assert!(seen.iter().all(|[_, analysed]| *analysed == 0.0), "{seen:?}");
    let lent = seen.iter().filter(|[lent, _]| *lent == 1.0).count();
    let first = seen.iter().position(|[lent, _]| *lent == 1.0).expect("a factor is lent");
    assert!(lent >= 20 && seen[59][0] == 0.0, "{seen:?}");
    // Restarts at the beginning of the cut, in between, and as the last factor takes over.
    let last = seen.iter().rposition(|[lent, _]| *lent == 1.0).expect("a factor is lent") as u32;
    let first = first as u32;
    for kills in [vec![first], vec![first + 2, first + 3, first + 9], vec![last - 1, last, last + 1]] {
        assert_eq!(cuts(&kills, None).0, state, "killed after {kills:?}");
    }
    // The control: elements burned in between require a new factor at once.
    let (_, burned) = cuts(&[], Some(first + 2));
    assert!(burned.iter().any(|[_, analysed]| *analysed > 0.0), "{burned:?}");
}
