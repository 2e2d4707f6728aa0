//! The engine as a controller on a store: what it picks up, what it writes, and that another life of it goes on
//! where the last one stood.

use std::sync::Arc;

use super::common::{
    LEFT, RIGHT, RING_MASS, RING_RADIUS, TUBE_RADIUS, minimum_jerk, pointing_down, ring_body, ring_shape,
};
use nalgebra::Vector3;
use trocar_dynamics::rigid_bodies::RigidBodiesController;
use trocar_dynamics::rigid_world::World;
use trocar_scene::components::{
    CollisionList, Frozen, Grasp, Instrument, InstrumentForce, InstrumentTarget, JawState, LocalContactModel,
    Pose, RigidBody, SurfaceMesh, Velocity, VertexPositions,
};
use trocar_scene::{
    BuildContext, Commands, Component, Controller, Entity, EntityAllocator, Events, Jobs, Registry,
    RegistryBuilder, SimTime, Snapshot, Store, Tick, WriterRules,
};

use super::W;

type Settings = <W as World>::Settings;

const BOARD: Entity = Entity::new(0, 0, 3);
const RING: Entity = Entity::new(0, 0, 10);
const ME: u16 = 7;

fn registry() -> Arc<Registry> {
    let mut builder = RegistryBuilder::new();
    trocar_scene::components::register(&mut builder).unwrap();
    trocar_simulator::controller::register(&mut builder).unwrap();
    builder.build()
}

/// A store with an engine on it, and hands that write targets at 1 kHz.
struct Bench {
    store: Store,
    engine: RigidBodiesController<W>,
    rules: WriterRules,
    commands: Commands,
    hands: Commands,
    period_ms: u64,
    millis: u64,
    ticks: u64,
}

fn build(scene: &Snapshot, time: SimTime, epoch: u32, settings: Settings) -> RigidBodiesController<W> {
    let me = Entity::of_writer(0, ME);
    let period = SimTime::from_millis(1);
    let context = BuildContext { scene, time, period, name: "engine", me, epoch, seed: 1 };
    RigidBodiesController::new(&context, settings).unwrap()
}

fn put<T: Component>(store: &mut Store, entity: Entity, value: T) {
    change(store, |commands| commands.put(entity, value));
}

fn change(store: &mut Store, what: impl FnOnce(&mut Commands)) {
    let registry = store.view().registry().clone();
    let mut commands = Commands::new(registry, EntityAllocator::new(0, 0));
    what(&mut commands);
    commands.seal();
    assert_eq!(commands.error(), None);
    store.apply(&mut commands, SimTime::ZERO);
}

impl Bench {
    /// A board without pegs and a ring flat on it at the origin.
    fn new(period_ms: u64, instruments: &[(Entity, Instrument)]) -> Self {
        Self::with(period_ms, instruments, Settings::default())
    }

    fn with(period_ms: u64, instruments: &[(Entity, Instrument)], settings: Settings) -> Self {
        let registry = registry();
        let mut store = Store::new(registry.clone());
        let mut commands = Commands::new(registry.clone(), EntityAllocator::new(0, 0));
        // The allocator hands out 1, 2, 3 ...: the constants above.
        let entities: Vec<Entity> = (0..20).map(|_| commands.spawn()).collect();
        assert!([LEFT, RIGHT, BOARD, RING].iter().all(|entity| entities.contains(entity)));
        let board = trocar_scene::components::Shape::Box { half_extents: [0.1, 0.1, 0.01] };
        commands.put(BOARD, board);
        commands.put(BOARD, RigidBody { friction: 0.4, ..RigidBody::default() });
        commands.put(BOARD, Pose::at(0.0, 0.0, -0.01));
        commands.put(RING, ring_shape());
        commands.put(RING, ring_body(0.5));
        commands.put(RING, Pose::at(0.0, 0.0, TUBE_RADIUS));
        for (entity, instrument) in instruments {
            commands.put(*entity, instrument.clone());
        }
        commands.seal();
        store.apply(&mut commands, SimTime::ZERO);
        let engine = build(store.view(), SimTime::ZERO, 1, settings);
        let rules = WriterRules::compile(&engine.access(), &registry, Entity::of_writer(0, ME)).unwrap();
        Self {
            store,
            engine,
            rules,
            commands: Commands::new(registry.clone(), EntityAllocator::new(0, ME)),
            hands: Commands::new(registry, EntityAllocator::new(0, 0)),
            period_ms,
            millis: 0,
            ticks: 0,
        }
    }

    fn now(&self) -> SimTime {
        SimTime::from_millis(self.millis)
    }

    /// One millisecond: hands first, then the engine if it is due.
    fn step(&mut self, targets: &[(Entity, InstrumentTarget)]) {
        self.millis += 1;
        for (entity, target) in targets {
            self.hands.put(*entity, InstrumentTarget { sampled_at: self.now(), ..*target });
        }
        self.hands.seal();
        let now = self.now();
        self.store.apply(&mut self.hands, now);
        self.hands.clear();
        if self.millis.is_multiple_of(self.period_ms) {
            self.tick();
        }
    }

    fn tick(&mut self) {
        let scene = self.store.snapshot();
        self.ticks += 1;
        let jobs = Jobs::default();
        let tick = Tick {
            time: self.now(),
            period: SimTime::from_millis(self.period_ms),
            number: self.ticks,
            me: Entity::of_writer(0, ME),
            epoch: 1,
            events: Events::new(scene.events(), 0),
            jobs: &jobs,
        };
        self.engine.tick(&tick, &scene, &mut self.commands).unwrap();
        self.commands.seal();
        self.store.validate(&self.commands, &self.rules).unwrap();
        let now = self.now();
        self.store.apply(&mut self.commands, now);
        self.commands.clear();
    }

    /// Another life of the engine, from nothing but the scene.
    fn rebuild(&mut self) {
        let scene = self.store.snapshot();
        self.engine = build(&scene, self.now(), 2, Settings::default());
        self.rules =
            WriterRules::compile(&self.engine.access(), scene.registry(), Entity::of_writer(0, ME)).unwrap();
    }

    fn get<T: Component>(&self, entity: Entity) -> T {
        self.store.view().get::<T>(entity).cloned().unwrap_or_else(|| panic!("{entity} has no {}", T::NAME))
    }
}

fn target(x: f64, z: f64, jaw_angle: f64) -> InstrumentTarget {
    InstrumentTarget {
        tip_in_world: pointing_down(x, 0.0, z).into(),
        jaw_angle,
        ..InstrumentTarget::default()
    }
}

fn instrument() -> Instrument {
    Instrument { jaw_force_max: 1.0, ..Instrument::default() }
}

/// Both hands grasp the ring at its sides and lift it by 30 mm within 1.2 s, pulling apart by `pull` \[m\].
fn handover(bench: &mut Bench, pull: f64, until_ms: u64) {
    while bench.millis < until_ms {
        let t = bench.millis as f64 * 1e-3;
        bench.step(&hands_at(t, pull));
    }
}

fn hands_at(t: f64, pull: f64) -> [(Entity, InstrumentTarget); 2] {
    let jaw = if t < 0.1 { 0.5 } else { 0.0 };
    let z = |t: f64| 0.0005 + 0.03 * minimum_jerk(t - 0.6, 0.6);
    let x = RING_RADIUS + pull * minimum_jerk(t - 0.6, 0.6);
    let velocity = Vector3::new(0.0, 0.0, (z(t + 5e-4) - z(t - 5e-4)) / 1e-3);
    [(LEFT, -x), (RIGHT, x)].map(|(entity, x)| {
        let velocity_in_world = Velocity { linear: velocity, angular: Vector3::zeros() };
        (entity, InstrumentTarget { velocity_in_world, ..target(x, z(t), jaw) })
    })
}

#[test]
fn lifts_a_ring_at_every_rate() {
    for period_ms in [1, 2, 10, 100] {
        let mut bench = Bench::new(period_ms, &[(LEFT, instrument())]);
        for k in 0..1500 {
            bench.step(&hands_at(f64::from(k) * 1e-3, 0.0)[..1]);
        }
        let ring = bench.get::<Pose>(RING);
        let force = bench.get::<InstrumentForce>(LEFT);
        println!(
            "{} Hz: ring at {:.2} mm, felt {:.4} N",
            1000 / period_ms,
            ring.translation.z * 1e3,
            force.force.z
        );
        assert!((ring.translation.z - 0.0305).abs() < 0.002);
        assert_eq!(bench.get::<Grasp>(LEFT).held, RING);
        assert_eq!(force.at, SimTime::from_millis(1500));
        assert!((force.force.z + RING_MASS * 9.81).abs() < 0.005);
        let jaws = bench.get::<JawState>(LEFT);
        assert!(
            jaws.angle > 0.1 && jaws.pad_force.iter().all(|force| (0.8..1.6).contains(force)),
            "{jaws:?}"
        );
        let model = bench.get::<LocalContactModel>(LEFT);
        let off = (model.base_force + Vector3::new(0.0, 0.0, RING_MASS * 9.81)).norm();
        assert!(off < 1e-3, "the ring's weight and nothing else: {:?}", model.base_force);
        assert!(model.planes.iter().all(Option::is_none), "{:?}", model.planes);
        let list = bench.get::<CollisionList>(Entity::of_writer(0, ME));
        assert!(list.penetration_max < 1e-4 && !list.collisions.is_empty());
        assert!(list.collisions.iter().all(|hit| hit.a == LEFT && hit.b == RING));
    }
}

#[test]
fn a_pressed_board_becomes_a_plane_at_the_tip() {
    let mut bench = Bench::new(10, &[(LEFT, instrument())]);
    for k in 0..600 {
        let z = 0.01 - 0.012 * minimum_jerk(f64::from(k) * 1e-3, 0.4);
        bench.step(&[(LEFT, target(0.05, z, 0.0))]);
    }
    let model = bench.get::<LocalContactModel>(LEFT);
    let plane = model.planes[0].unwrap();
    println!("{plane:?}");
    assert!(plane.normal_in_world.z > 0.999 && model.planes[1].is_none());
    // The closed tip touches at the corners of its blades, a little off its origin.
    assert!(plane.point_in_world.z.abs() < 2e-4);
    assert!((plane.stiffness - 1000.0).abs() < 1.0);
    assert!(model.base_force.norm() < 1e-9);
    assert!(model.at == bench.now());
    let felt = bench.get::<InstrumentForce>(LEFT).force.z;
    // What haptics make of the plane is what the engine feels.
    let rendered = plane.stiffness * (plane.point_in_world.z - (-0.002));
    println!("felt {felt:.3} N, from the local model {rendered:.3} N");
    assert!((felt - rendered).abs() < 0.05 * felt);
}

#[test]
fn a_slow_engine_tells_of_a_board_before_it_is_reached() {
    let mut bench = Bench::new(100, &[(LEFT, instrument())]);
    let speed = 0.1;
    let at = |t: f64| InstrumentTarget {
        velocity_in_world: Velocity { linear: Vector3::new(0.0, 0.0, -speed), angular: Vector3::zeros() },
        ..target(0.05, 0.03 - speed * t, 0.0)
    };
    let mut told_at = None;
    for k in 1..=400 {
        let t = f64::from(k) * 1e-3;
        bench.step(&[(LEFT, at(t))]);
        let plane = bench.store.view().get::<LocalContactModel>(LEFT).and_then(|model| model.planes[0]);
        if let Some(plane) = plane.filter(|_| told_at.is_none()) {
            println!("at {t} s and {:.1} mm: {plane:?}", (0.03 - speed * t) * 1e3);
            assert!(plane.normal_in_world.z > 0.999 && plane.point_in_world.z.abs() < 3e-4);
            told_at = Some(t);
        }
    }
    assert!(told_at.is_some_and(|t| t <= 0.03 / speed), "known before it is reached: {told_at:?}");
}

#[test]
fn another_life_goes_on_in_the_middle_of_a_hand_over() {
    let (mut pose_worst, mut force_worst, mut restarts): (f64, f64, u32) = (0.0, 0.0, 0);
    for seed in 0..10u64 {
        let build = Instrument { grasp_assist: seed % 2 == 1, ..instrument() };
        // Up to 0.5 N of tension between the hands.
        let pull = 0.00025 * (seed % 3) as f64;
        let mut bench = Bench::new(2, &[(LEFT, build.clone()), (RIGHT, build)]);
        // Five times at odd moments of the hold, the lift and the rest after it, at 500 Hz.
        for life in 0..5 {
            let at_ms = 500 + 180 * life + 2 * ((seed * 7919 + life * 104_729) % 50);
            handover(&mut bench, pull, at_ms);
            let before = [LEFT, RIGHT].map(|hand| bench.get::<InstrumentForce>(hand).force);
            let mut expected = bench.get::<Pose>(RING).translation;
            assert_eq!([LEFT, RIGHT].map(|hand| bench.get::<Grasp>(hand).held), [RING; 2]);
            bench.rebuild();
            restarts += 1;
            for _ in 0..10 {
                let t = bench.millis as f64 * 1e-3;
                let until = bench.millis + 2;
                handover(&mut bench, pull, until);
                expected.z += hands_at(t + 0.001, 0.0)[0].1.velocity_in_world.linear.z * 0.002;
                pose_worst = pose_worst.max((bench.get::<Pose>(RING).translation - expected).norm());
                for (hand, before) in [LEFT, RIGHT].iter().zip(before) {
                    force_worst =
                        force_worst.max((bench.get::<InstrumentForce>(*hand).force - before).norm());
                }
            }
        }
        assert_eq!([LEFT, RIGHT].map(|hand| bench.get::<Grasp>(hand).held), [RING; 2], "still held");
        assert!(bench.get::<Pose>(RING).translation.z > 0.025);
    }
    println!("{restarts} restarts: pose jump {:.3} mm, force jump {:.3} N", pose_worst * 1e3, force_worst);
    assert!(pose_worst < 1e-3 && force_worst < 0.5);
}

#[test]
fn what_changes_in_the_scene_is_picked_up() {
    let mut bench = Bench::new(2, &[(LEFT, instrument())]);
    (0..600).for_each(|_| bench.step(&[]));
    assert_eq!(bench.store.view().get::<JawState>(LEFT), None, "nobody holds the instrument yet");
    let resting = bench.get::<Pose>(RING);
    assert!((resting.translation.z - TUBE_RADIUS).abs() < 1e-5);

    // A teleport, as an instructor might do it: the ring falls from there.
    put(&mut bench.store, RING, Pose::at(0.0, 0.0, 0.05));
    (0..40).for_each(|_| bench.step(&[]));
    let falling = bench.get::<Pose>(RING).translation.z;
    assert!((0.035..0.05).contains(&falling), "{falling}");

    // The board gone: the ring falls to the floor. Gone itself, it is not written any more.
    change(&mut bench.store, |commands| commands.remove::<RigidBody>(BOARD));
    (0..500).for_each(|_| bench.step(&[]));
    assert!(bench.get::<Pose>(RING).translation.z < -0.04);
    change(&mut bench.store, |commands| commands.despawn(RING));
    (0..10).for_each(|_| bench.step(&[]));
    assert_eq!(bench.store.view().get::<Pose>(RING), None);
}

#[test]
fn bodies_spawned_at_run_time_are_written_if_the_engine_claims_all_poses() {
    for claims_all_poses in [false, true] {
        let settings = Settings { claims_all_poses, ..Settings::default() };
        let mut bench = Bench::with(2, &[], settings);
        (0..10).for_each(|_| bench.step(&[]));
        let extra = Entity::new(0, 0, 15);
        change(&mut bench.store, |commands| {
            commands.put(extra, ring_shape());
            commands.put(extra, ring_body(0.5));
            commands.put(extra, Pose::at(0.04, 0.0, 0.02));
        });
        (0..500).for_each(|_| bench.step(&[]));
        let fell = bench.get::<Pose>(extra).translation.z < 0.002;
        assert_eq!(fell, claims_all_poses);
    }
}

#[test]
fn friction_and_instrument_can_change_while_a_ring_is_held() {
    let mut bench = Bench::new(2, &[(LEFT, instrument())]);
    for k in 0..1500 {
        bench.step(&hands_at(f64::from(k) * 1e-3, 0.0)[..1]);
    }
    let held = bench.get::<Pose>(RING);
    put(&mut bench.store, LEFT, Instrument { coupling_stiffness: 500.0, ..instrument() });
    for k in 1500..1700 {
        bench.step(&hands_at(f64::from(k) * 1e-3, 0.0)[..1]);
    }
    assert!(
        (bench.get::<Pose>(RING).translation - held.translation).norm() < 1e-3,
        "a softer hand, the same hold"
    );
    put(&mut bench.store, LEFT, Instrument { jaw_friction: 0.0, ..instrument() });
    for k in 1700..2200 {
        bench.step(&hands_at(f64::from(k) * 1e-3, 0.0)[..1]);
    }
    assert!(bench.get::<Pose>(RING).translation.z < 0.01, "slippery jaws lose the ring");
    assert_eq!(bench.store.view().get::<Grasp>(LEFT), None);
}

#[test]
fn what_rests_is_not_written() {
    let mut bench = Bench::new(2, &[]);
    (0..1000).for_each(|_| bench.step(&[]));
    let revision = bench.store.view().changed::<Pose>(RING);
    assert_eq!(bench.get::<Velocity>(RING), Velocity::default());
    (0..1000).for_each(|_| bench.step(&[]));
    assert_eq!(bench.store.view().changed::<Pose>(RING), revision);
}

#[test]
fn two_runs_give_the_same_scene() {
    let play = || {
        let mut bench = Bench::new(2, &[(LEFT, instrument()), (RIGHT, instrument())]);
        handover(&mut bench, 0.0005, 900);
        let mut bytes = Vec::new();
        bench.store.view().encode(&mut bytes).unwrap();
        bytes
    };
    assert_eq!(play(), play());
}

#[test]
fn a_body_without_a_future_is_stopped_alone_and_stays_so_in_another_life() {
    let mut bench = Bench::new(1, &[(LEFT, instrument())]);
    const MAD: Entity = Entity::new(0, 0, 5);
    const FALLING: Entity = Entity::new(0, 0, 6);
    let there = Pose::at(0.05, 0.0, 0.05);
    change(&mut bench.store, |commands| {
        for (entity, x) in [(MAD, 0.05), (FALLING, -0.05)] {
            commands.put(entity, ring_shape());
            commands.put(entity, ring_body(0.5));
            commands.put(entity, Pose::at(x, 0.0, 0.05));
        }
        // No number holds the square of it.
        let angular = Vector3::new(1e200, 0.0, 1e200);
        commands.put(MAD, Velocity { angular, ..Velocity::default() });
    });
    bench.rebuild();
    for _ in 0..20 {
        bench.step(&[(LEFT, target(0.0, 0.05, 0.3))]);
    }
    let frozen = bench.get::<Frozen>(MAD);
    assert!(frozen.reason.contains("not finite"), "{}", frozen.reason);
    assert_eq!(bench.get::<Pose>(MAD), there, "it is where it was last good");
    assert_eq!(bench.get::<Velocity>(MAD), Velocity::default());
    assert!(bench.store.view().get::<Frozen>(FALLING).is_none());
    let height = |bench: &Bench| bench.get::<Pose>(FALLING).translation.z;
    let (before, expected) = (height(&bench), 0.05 - 0.5 * 9.81 * 0.02 * 0.02);
    assert!((before - expected).abs() < 3e-4, "the other falls on: {before} for {expected}");
    bench.rebuild();
    for _ in 0..20 {
        bench.step(&[(LEFT, target(0.0, 0.05, 0.3))]);
    }
    assert_eq!(bench.get::<Pose>(MAD), there);
    assert!(height(&bench) < before);
}

#[test]
fn a_dynamic_surface_that_encloses_nothing_stops_itself_and_nobody_else() {
    let mut bench = Bench::new(1, &[]);
    const FLAT: Entity = Entity::new(0, 0, 5);
    let there = Pose::at(0.05, 0.0, 0.05);
    change(&mut bench.store, |commands| {
        let corners = [[0.0, 0.0, 0.0], [0.01, 0.0, 0.0], [0.0, 0.01, 0.0]].map(nalgebra::Point3::from);
        commands.put(FLAT, VertexPositions { positions: Arc::new(corners.to_vec()) });
        commands.put(FLAT, SurfaceMesh { triangles: Arc::new(vec![[0, 1, 2]]) });
        commands.put(FLAT, ring_body(0.5));
        commands.put(FLAT, there);
        commands.put(RING, Pose::at(0.0, 0.0, 0.05));
    });
    bench.rebuild();
    for _ in 0..20 {
        bench.step(&[]);
    }
    assert!(bench.get::<Frozen>(FLAT).reason.contains("encloses no volume"));
    assert_eq!(bench.get::<Pose>(FLAT), there);
    assert!(bench.get::<Pose>(RING).translation.z < 0.0485);
}
