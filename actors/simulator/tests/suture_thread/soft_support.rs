//! A thread on soft tissue moved by another controller: pulled over it, it presses it in, and action and reaction are
//! equal.

use std::sync::Arc;

use crate::support::stage::{Stage, scene};
use nalgebra::{Isometry3, Point3, UnitQuaternion, Vector3};
use trocar_dynamics::coupling::external_nodes::{GhostNode, PredictedPath};
use trocar_dynamics::instrument::deflection::InstrumentYields;
use trocar_dynamics::soft_body::Deformable;
use trocar_dynamics::soft_body::coupling::{CouplingGiven, CouplingTaken};
use trocar_scene::{
    Access, BuildContext, CollisionList, Commands, Controller, ControllerError, EntitySet, Frozen, JawState,
    LineMesh, Measured, Pose, RestPositions, Snapshot, Tick, VertexPositions,
};
use trocar_simulator::controller::{
    DynamicFemController, DynamicFemMemory, KnotState, ThreadController, ThreadMemory,
};
use trocar_simulator::suture_thread::soft_support::SoftSurface;
use trocar_simulator::suture_thread::{Obstacle, Shape, Surroundings, Thread, ThreadMaterial, ThreadState};

/// Ticks of the thread for one of the tissue.
const RATE: u64 = 5;

/// A block with a thread over its top, held at its left end, its right end between jaws.
const SCENE: &str = r#"
[[entity]]
name = "grasper"
[entity.instrument]
kind = "needle_driver"
shaft_length = 0.15
jaw_force_max = 5.0
[[entity]]
name = "block"
mesh = { block = { size = [0.016, 0.016, 0.016], cells = [4, 4, 4] } }
dynamic_fem = { young_modulus = 2e5, poisson_ratio = 0.4, density = 1000.0 }
anchors = { regions = [{ box = { min = [-1.0, -1.0, -1.0], max = [1.0, 1.0, -0.0079] } }] }
[[entity]]
name = "thread"
mesh = { line = { length = 0.04, segments = 40, radius = 0.00015 } }
anchors = { regions = [{ box = { min = [-0.0201, -1.0, -1.0], max = [-0.0195, 1.0, 1.0] } }] }
[entity.thread]
MORE
[entity.thread.laid.through]
places = [[-0.020, 0.0003, 0.000], [-0.0083, 0.0003, 0.0083], [0.0083, 0.0003, 0.0083], [0.016, 0.0003, 0.003], [0.028, 0.0003, 0.003]]
"#;

/// Two controllers on one scene, the second at a fifth of the rate.
struct Both {
    thread: ThreadController,
    tissue: DynamicFemController,
    bodies: Vec<trocar_scene::Entity>,
}

impl Both {
    fn new(context: &BuildContext<'_>) -> Result<Self, ControllerError> {
        Ok(Self {
            thread: ThreadController::new(Vector3::zeros(), None, context)?,
            tissue: DynamicFemController::new(Vector3::zeros(), context)?,
            bodies: context.scene.iter::<VertexPositions>().map(|(entity, _)| entity).collect(),
        })
    }
}

impl Controller for Both {
    fn access(&self) -> Access {
        let all = || EntitySet::Of(self.bodies.clone());
        Deformable::access(&self.bodies)
            .writes::<CouplingGiven>(all())
            .writes::<CouplingTaken>(all())
            .writes::<DynamicFemMemory>(all())
            .writes::<LineMesh>(all())
            .writes::<ThreadMemory>(all())
            .writes::<KnotState>(all())
            .writes::<InstrumentYields>(all())
            .writes::<Measured>(EntitySet::Own)
            .contributes::<CollisionList>()
    }

    fn tick(&mut self, tick: &Tick<'_>, scene: &Snapshot, out: &mut Commands) -> Result<(), ControllerError> {
        if tick.number.is_multiple_of(RATE) {
            let period = trocar_scene::SimTime(tick.period.0 * RATE);
            return self.tissue.tick(&Tick { period, ..*tick }, scene, out);
        }
        self.thread.tick(tick, scene, out)
    }
}

/// Shaft along y, jaws closing along z, tip at a place.
fn grasper(x: f64) -> Pose {
    let turn = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), -std::f64::consts::FRAC_PI_2);
    let closing = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), std::f64::consts::FRAC_PI_2);
    Isometry3::from_parts(Vector3::new(x, 0.0063, 0.003).into(), turn * closing).into()
}

/// The hand pulls the thread over the block by this much, and holds it there, with a restart on the way if `ends`.
fn drawn(more: &str, way: f64, ends: bool) -> Stage<Both> {
    let mut stage = {
        let mut stage = Stage::new(scene(&SCENE.replace("MORE", more)), 1000.0, Both::new);
        stage.put("grasper", grasper(0.024));
        stage.put("grasper", JawState { angle: 0.0, ..JawState::default() });
        stage
    };
    for tick in 0..600_u32 {
        let share = (f64::from(tick) / 400.0).min(1.0);
        stage.put("grasper", grasper(0.024 + way * share));
        if ends && tick == 303 {
            stage.rebuild(Both::new);
        }
        stage.tick();
    }
    for name in ["thread", "block"] {
        assert!(!stage.has::<Frozen>(name), "{:?}", stage.get::<Frozen>(name));
    }
    stage
}

/// Largest displacement of a vertex \[m\].
fn pressed(stage: &Stage<Both>) -> f64 {
    let now = stage.get::<VertexPositions>("block").positions;
    let rest = stage.get::<RestPositions>("block").positions;
    now.iter().zip(rest.iter()).map(|(now, rest)| (now - rest).norm()).fold(0.0, f64::max)
}

const LIES: &str = "lies_on = { body = \"block\", friction = 0.2 }";

#[test]
fn a_thread_drawn_over_a_block_presses_it_in_and_gives_it_what_it_takes() {
    let mut stage = drawn(LIES, 0.002, false);
    let by = pressed(&stage);
    assert!(by > 2e-4, "pressed in by {by} m");
    // The tissue has received all of the thread's impulses, once it has stepped.
    while !stage.ticks.is_multiple_of(RATE) {
        stage.tick();
    }
    let sums = |stage: &Stage<Both>| -> [Vector3<f64>; 2] {
        let given = stage.get::<CouplingGiven>("thread");
        let taken = stage.get::<CouplingTaken>("block");
        [given.to[0].ghosts.given().iter().sum(), taken.from[0].taken.iter().sum()]
    };
    let [given, taken] = sums(&stage);
    assert!(given.norm() > 0.0 && (given - taken).norm() <= 1e-12 * given.norm(), "{given:?} {taken:?} N·s");
    // Within a tick it is the force of the thread, as its own contacts report: four of five ticks are the thread's.
    stage.tick();
    let felt = stage.measured("thread.lying_force_n");
    let [then, _] = sums(&stage);
    let force = (then - given).norm() / 1e-3;
    assert!((force - felt).abs() < 1e-6 * felt, "{force} N given, {felt} N felt");
    assert!(felt > 0.1, "{felt} N");
    // No part of the thread has sunk into the block.
    assert!(stage.measured("thread.penetration_m") < 3e-5, "{} m", stage.measured("thread.penetration_m"));
    assert!(stage.measured("thread.tension_n") > 0.2);
}

#[test]
fn a_thread_that_is_not_told_of_the_block_passes_it_by() {
    let stage = drawn("", 0.004, false);
    assert_eq!(
        stage.get::<VertexPositions>("block").positions,
        stage.get::<RestPositions>("block").positions
    );
    let inside = |point: &&Point3<f64>| point.z < 0.007 && point.x.abs() < 0.007;
    let thread = stage.get::<VertexPositions>("thread").positions;
    assert!(thread.iter().filter(inside).count() > 5, "it lies where the block is");
}

#[test]
fn another_life_goes_on_to_the_bit() {
    let [whole, other] = [false, true].map(|ends| drawn(LIES, 0.001, ends));
    for name in ["thread", "block"] {
        assert_eq!(whole.get::<VertexPositions>(name), other.get::<VertexPositions>(name), "{name}");
    }
}

#[test]
fn what_cannot_be_lain_on_is_refused_by_name() {
    let refused = |more: &str| {
        let store = scene(&SCENE.replace("MORE", more));
        let context = BuildContext {
            scene: store.view(),
            time: trocar_scene::SimTime::ZERO,
            period: trocar_scene::SimTime::from_millis(1),
            name: "thread",
            me: trocar_scene::Entity::of_writer(0, 7),
            epoch: 1,
            seed: 1,
        };
        Both::new(&context).err().expect("refused").to_string()
    };
    let nobody = refused("lies_on = { body = \"liver\" }");
    assert!(
        nobody.contains("'thread'") && nobody.contains("'liver'") && nobody.contains("no such"),
        "{nobody}"
    );
    let hard = refused("lies_on = { body = \"grasper\" }");
    assert!(hard.contains("'grasper'") && hard.contains("dynamic_fem"), "{hard}");
}

/// A plate of free mass points, and a thread that falls on it: the plate gains the momentum that the thread loses.
#[test]
fn a_thread_that_falls_on_free_masses_gives_them_the_momentum_that_it_loses() {
    let material = ThreadMaterial { drag: 0.0, ..ThreadMaterial::silk_2_0() };
    let points: Vec<Point3<f64>> =
        (0..21).map(|k| Point3::new(0.0005 * f64::from(k - 10), 1e-4, 4e-4)).collect();
    let mut state = ThreadState::at_rest(&points);
    state.velocities.fill(Vector3::new(0.1, 0.0, -0.5));
    let nodes: Vec<Point3<f64>> = (0..49)
        .map(|k| Point3::new(0.003 * f64::from(k % 7 - 3), 0.003 * f64::from(k / 7 - 3), 0.0))
        .collect();
    let triangles: Arc<Vec<[u32; 3]>> = Arc::new(
        (0..36_u32)
            .flat_map(|cell| {
                let at = cell / 6 * 7 + cell % 6;
                [[at, at + 1, at + 8], [at, at + 8, at + 7]]
            })
            .collect(),
    );
    let mass = 2e-6;
    let mut ghost_nodes: Vec<GhostNode> = nodes
        .iter()
        .map(|position| GhostNode {
            position: *position,
            mobility: 1.0 / mass,
            path: PredictedPath { position: *position, ..PredictedPath::default() },
            ..GhostNode::default()
        })
        .collect();
    let of_thread = |state: &ThreadState| -> Vector3<f64> {
        let half =
            |edge: Option<usize>| edge.and_then(|edge| state.rest_lengths.get(edge)).copied().unwrap_or(0.0);
        (0..state.positions.len())
            .map(|node| {
                let length = 0.5 * (half(node.checked_sub(1)) + half(Some(node)));
                state.velocities[node] * (length * material.mass_per_length)
            })
            .sum()
    };
    let mut thread = Thread::restore(material, state).expect("a thread");
    let before = of_thread(thread.state());
    let mut surface = SoftSurface::default();
    for _ in 0..40 {
        let positions: Vec<Point3<f64>> = ghost_nodes.iter().map(|ghost_node| ghost_node.position).collect();
        surface.begin(ghost_nodes.iter().copied(), std::iter::empty(), &triangles);
        let shape = Shape::Mesh { from: &positions, to: &positions, triangles: &triangles, radius: 0.0 };
        let obstacles = [Obstacle::fixed(shape, Isometry3::identity(), 0.3)];
        let around = Surroundings { obstacles: &obstacles, ..Surroundings::default() };
        thread.step_on(5e-4, &around, 0, &mut surface).expect("a step");
        for (ghost_node, moved) in ghost_nodes.iter_mut().zip(surface.moved()) {
            (ghost_node.position, ghost_node.velocity, ghost_node.path) =
                (moved.position, moved.velocity, moved.path);
        }
    }
    let after = of_thread(thread.state());
    let has: Vector3<f64> = ghost_nodes.iter().map(|ghost_node| ghost_node.velocity * mass).sum();
    let lost = before - after;
    assert!(has.norm() > 0.3 * before.norm(), "{has:?} of {before:?} kg·m/s");
    // Friction has dragged it along as well.
    assert!(has.x > 0.05 * before.x, "{has:?} of {before:?} kg·m/s");
    assert!((has - lost).norm() <= 1e-6 * has.norm(), "{has:?} for {lost:?} kg·m/s");
    // Together they have no more energy than the thread had.
    let energy = |velocity: &Vector3<f64>| 0.5 * mass * velocity.norm_squared();
    let sum: f64 = ghost_nodes.iter().map(|ghost_node| energy(&ghost_node.velocity)).sum();
    let had = 0.5 * 0.01 * material.mass_per_length * 0.26;
    assert!(sum < had, "{sum} J of {had} J");
}
