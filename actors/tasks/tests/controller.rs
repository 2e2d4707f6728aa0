//! The referee in a scene: what it finds, what it writes, what it refuses, and how it goes on after a restart.

use std::sync::Arc;

use nalgebra::{UnitQuaternion, Vector3};
use trocar_scene::{
    BuildContext, Camera, Collision, CollisionList, Commands, Controller, Detection, Entity, EntityAllocator,
    Events, Grasp, Hand, Instrument, Jobs, Motion, Pose, Primitive, Registry, RegistryBuilder, RigidBody,
    Shape, Side, SimTime, Store, TaskState, Tick, Velocity, WriterRules,
};
use trocar_tasks::peg_transfer_controller::mirrored_start;
use trocar_tasks::{PegTransferConfig, PegTransferController};

const BOARDS: [Entity; 2] = [Entity::new(0, 0, 1), Entity::new(0, 0, 2)];
const RINGS: [Entity; 2] = [Entity::new(0, 0, 3), Entity::new(0, 0, 4)];
const GRASPERS: [Entity; 2] = [Entity::new(0, 0, 5), Entity::new(0, 0, 6)];
const HANDS: [Entity; 2] = [Entity::new(0, 0, 7), Entity::new(0, 0, 8)];
const CAMERA: Entity = Entity::new(0, 0, 9);
const ENGINE: Entity = Entity::of_writer(0, 3);
const REFEREE: Entity = Entity::of_writer(0, 4);

fn registry() -> Arc<Registry> {
    let mut builder = RegistryBuilder::new();
    trocar_scene::components::register(&mut builder).unwrap();
    trocar_tasks::register(&mut builder).unwrap();
    builder.build()
}

/// Two boards of two pegs, two rings on the left one.
struct Bench {
    store: Store,
    millis: u64,
}

impl Bench {
    fn new() -> Self {
        let mut bench = Self { store: Store::new(registry()), millis: 0 };
        bench.change(|out| {
            while out.spawn() != CAMERA {}
            for (board, x) in BOARDS.into_iter().zip([-0.04, 0.04]) {
                out.put(board, Pose::at(x, 0.0, 0.0));
                out.put(
                    board,
                    Shape::PegBoard {
                        half_extents: [0.03, 0.02],
                        thickness: 0.01,
                        pegs: vec![[-0.015, 0.0], [0.015, 0.0]],
                        peg_radius: 0.001,
                        peg_height: 0.02,
                    },
                );
            }
            for (ring, x) in RINGS.into_iter().zip([-0.055, -0.025]) {
                out.put(ring, Pose::at(x, 0.0, 0.0015));
                out.put(ring, Shape::Torus { ring_radius: 0.008, tube_radius: 0.0015 });
                out.put(ring, RigidBody { motion: Motion::Dynamic, ..RigidBody::default() });
            }
            for (index, side) in [Side::Left, Side::Right].into_iter().enumerate() {
                out.put(GRASPERS[index], Instrument::default());
                out.put(GRASPERS[index], Pose::at(0.0, 0.0, 0.1));
                let world_from_device = Pose::default();
                out.put(
                    HANDS[index],
                    Hand { side, instrument: GRASPERS[index], world_from_device, scale: 1.0 },
                );
            }
            let down = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
            out.put(CAMERA, Pose::new(Vector3::new(0.0, 0.0, 0.3), down));
            out.put(CAMERA, Camera::default());
        });
        bench
    }

    fn change(&mut self, change: impl FnOnce(&mut Commands)) {
        let allocator = EntityAllocator::new(0, 0);
        let mut commands = Commands::new(self.store.view().registry().clone(), allocator);
        change(&mut commands);
        commands.seal();
        self.store.apply(&mut commands, SimTime::from_millis(self.millis));
    }

    fn referee(&self, config: &PegTransferConfig) -> Result<PegTransferController, String> {
        let scene = self.store.snapshot();
        let time = SimTime::from_millis(self.millis);
        let period = SimTime::from_millis(10);
        let context =
            BuildContext { scene: &scene, time, period, name: "task", me: REFEREE, epoch: 1, seed: 0 };
        PegTransferController::new(config, &context).map_err(|error| error.to_string())
    }

    /// Ticks of 10 ms, through the same checks as in a session.
    fn tick(&mut self, referee: &mut PegTransferController, ticks: usize) {
        let registry = self.store.view().registry().clone();
        let rules = WriterRules::compile(&referee.access(), &registry, REFEREE).unwrap();
        for _ in 0..ticks {
            self.millis += 10;
            let scene = self.store.snapshot();
            let jobs = Jobs::default();
            let time = SimTime::from_millis(self.millis);
            let tick = Tick {
                time,
                period: SimTime::from_millis(10),
                number: self.millis / 10,
                me: REFEREE,
                epoch: 1,
                events: Events::new(scene.events(), 0),
                jobs: &jobs,
            };
            let mut commands = Commands::new(registry.clone(), EntityAllocator::new(0, 4));
            commands.begin(time);
            referee.tick(&tick, &scene, &mut commands).unwrap();
            commands.seal();
            self.store.validate(&commands, &rules).unwrap();
            self.store.apply(&mut commands, time);
        }
    }

    fn hold(&mut self, hand: usize, ring: Option<Entity>) {
        self.change(|out| match ring {
            Some(held) => {
                let since = SimTime::ZERO;
                out.put(GRASPERS[hand], Grasp { held, anchor: Pose::default(), since, assisted: false });
            }
            None => out.remove::<Grasp>(GRASPERS[hand]),
        });
    }

    fn put_ring(&mut self, ring: Entity, x: f64, z: f64) {
        self.change(|out| out.put(ring, Pose::at(x, 0.0, z)));
    }

    /// A faultless transfer of a ring to `x`.
    fn transfer(&mut self, referee: &mut PegTransferController, ring: Entity, giver: usize, x: f64) {
        self.hold(giver, Some(ring));
        self.put_ring(ring, 0.0, 0.05);
        self.tick(referee, 10);
        self.hold(1 - giver, Some(ring));
        self.tick(referee, 10);
        self.hold(giver, None);
        self.tick(referee, 10);
        self.put_ring(ring, x, 0.0015);
        self.hold(1 - giver, None);
        self.tick(referee, 30);
    }

    fn task(&self) -> TaskState {
        self.store.view().get::<TaskState>(REFEREE).cloned().unwrap_or_default()
    }
    fn events(&self) -> Vec<String> {
        self.store.view().events().since(0).map(|(_, event)| event.name.to_string()).collect()
    }
}

#[test]
fn the_referee_follows_an_exercise_through_the_scene() {
    let mut bench = Bench::new();
    let mut referee = bench.referee(&PegTransferConfig::default()).unwrap();
    bench.tick(&mut referee, 100);
    assert_eq!((bench.task().phase.as_str(), bench.task().seconds), ("waiting", 0.0));
    bench.transfer(&mut referee, RINGS[0], 0, 0.025);
    bench.transfer(&mut referee, RINGS[1], 0, 0.055);
    assert_eq!((bench.task().done, bench.task().phase.as_str()), (2, "back.lift"));
    bench.transfer(&mut referee, RINGS[0], 1, -0.055);
    bench.transfer(&mut referee, RINGS[1], 1, -0.025);
    let task = bench.task();
    assert!(task.completed && !task.cut_off && task.errors.is_empty(), "{task:?}");
    assert_eq!((task.task.as_str(), task.done, task.steps), ("peg-transfer", 4, 4));
    assert!(task.score.is_some_and(|score| score > 95.0));
    assert!(task.metrics["left"]["time_secs"] > 0.0 && task.metrics.contains_key("right"));
    let events = bench.events();
    let count = |name: &str| events.iter().filter(|event| *event == name).count();
    assert_eq!([count("task_started"), count("ring_lifted"), count("ring_handed_over")], [1, 4, 4]);
    assert_eq!([count("ring_placed"), count("rings_return"), count("task_finished")], [4, 1, 1]);
}

#[test]
fn a_touch_in_the_collision_list_starts_the_clock() {
    let mut bench = Bench::new();
    let mut referee = bench.referee(&PegTransferConfig::default()).unwrap();
    let touch = |depth| CollisionList {
        collisions: vec![Collision {
            a: RINGS[1],
            primitive_a: Primitive::Shape(0),
            b: GRASPERS[1],
            primitive_b: Primitive::Jaw(0),
            points_in_world: [nalgebra::Point3::origin(); 2],
            normal_in_world: Vector3::z(),
            depth,
            force_in_world: Vector3::zeros(),
            velocity_constraint: 0.0,
            method: Detection::Engine,
            detected_at: SimTime::ZERO,
        }],
        ..CollisionList::default()
    };
    bench.change(|out| out.put(ENGINE, touch(-0.0001)));
    bench.tick(&mut referee, 20);
    assert_eq!(bench.task().phase, "waiting", "near is not touched");
    bench.change(|out| out.put(ENGINE, touch(0.00001)));
    bench.tick(&mut referee, 51);
    assert_eq!(bench.task().phase, "over.lift");
    assert!((bench.task().seconds - 0.5).abs() < 0.11, "{}", bench.task().seconds);
}

#[test]
fn a_ring_that_still_rolls_is_not_judged() {
    let mut bench = Bench::new();
    let mut referee = bench.referee(&PegTransferConfig::default()).unwrap();
    bench.hold(0, Some(RINGS[0]));
    bench.put_ring(RINGS[0], 0.0, 0.05);
    bench.tick(&mut referee, 10);
    bench.hold(0, None);
    let rolling = Velocity { linear: Vector3::new(0.1, 0.0, 0.0), angular: Vector3::zeros() };
    bench.change(|out| out.put(RINGS[0], rolling));
    bench.put_ring(RINGS[0], 0.0, 0.0015);
    bench.tick(&mut referee, 50);
    assert!(bench.task().errors.is_empty());
    bench.change(|out| out.put(RINGS[0], Velocity::default()));
    bench.tick(&mut referee, 30);
    let errors = bench.task().errors;
    assert_eq!((errors.len(), errors[0].kind.as_str()), (1, "drop_in_view"));
    assert_eq!(errors[0].entity, Some(RINGS[0]));
}

#[test]
fn a_referee_rebuilt_from_the_scene_judges_on_as_if_nothing_had_happened() {
    let (mut whole, mut broken) = (Bench::new(), Bench::new());
    let config = PegTransferConfig::default();
    let (mut one, mut other) = (whole.referee(&config).unwrap(), broken.referee(&config).unwrap());
    for (ring, x) in RINGS.into_iter().zip([0.025, 0.055]) {
        whole.transfer(&mut one, ring, 0, x);
        broken.hold(0, Some(ring));
        broken.put_ring(ring, 0.0, 0.05);
        broken.tick(&mut other, 10);
        broken.hold(1, Some(ring));
        // In the middle of the hand-over; rings are no longer where they started.
        broken.tick(&mut other, 5);
        other = broken.referee(&config).unwrap();
        broken.tick(&mut other, 5);
        broken.hold(0, None);
        broken.tick(&mut other, 10);
        broken.put_ring(ring, x, 0.0015);
        broken.hold(1, None);
        broken.tick(&mut other, 30);
    }
    assert_eq!(whole.task(), broken.task());
    assert_eq!(whole.events(), broken.events());
    assert_eq!(whole.task().done, 2);
}

#[test]
fn what_the_scene_lacks_is_named() {
    let refused = |change: &dyn Fn(&mut Commands)| {
        let mut bench = Bench::new();
        bench.change(|out| change(out));
        bench.referee(&PegTransferConfig::default()).err().expect("refused")
    };
    assert!(refused(&|out| out.remove::<Shape>(BOARDS[1])).contains("1 peg_board"));
    assert!(refused(&|out| RINGS.iter().for_each(|ring| out.remove::<Shape>(*ring))).contains("torus"));
    assert!(refused(&|out| out.remove::<Hand>(HANDS[1])).contains("no right hand"));
    assert!(refused(&|out| out.remove::<Camera>(CAMERA)).contains("view_box or a camera"));
    assert!(refused(&|out| out.put(RINGS[0], Pose::at(0.025, 0.0, 0.0015))).contains("one board"));
    let odd = Shape::Torus { ring_radius: 0.009, tube_radius: 0.0015 };
    assert!(refused(&|out| out.put(RINGS[1], odd.clone())).contains("differs in size"));
}

#[test]
fn what_the_configuration_gets_wrong_is_named() {
    let bench = Bench::new();
    let mut config = PegTransferConfig::default();
    config.weights.secs_per_error.insert("drop".into(), 5.0);
    let text = bench.referee(&config).err().expect("refused");
    assert!(text.contains("'drop'") && text.contains("drop_in_view"), "{text}");
    let mut config = PegTransferConfig::default();
    config.weights.cutoff_secs = 0.0;
    assert!(bench.referee(&config).err().expect("refused").contains("cutoff_secs"));
    let view_box = Some([[0.0; 3], [1.0, 1.0, 0.0]]);
    let config = PegTransferConfig { view_box, ..PegTransferConfig::default() };
    assert!(bench.referee(&config).err().expect("refused").contains("view_box"));
}

#[test]
fn a_left_handed_start_mirrors_the_rings() {
    let mut bench = Bench::new();
    let mirrored = mirrored_start(&bench.store.snapshot());
    assert_eq!(mirrored.len(), 2);
    for ((ring, pose), x) in mirrored.iter().zip([0.055, 0.025]) {
        assert!((pose.translation - Vector3::new(x, 0.0, 0.0015)).norm() < 1e-12);
        bench.put_ring(*ring, pose.translation.x, pose.translation.z);
    }
    let config = PegTransferConfig { left_handed: true, ..PegTransferConfig::default() };
    let mut referee = bench.referee(&config).unwrap();
    bench.transfer(&mut referee, RINGS[0], 1, -0.055);
    assert_eq!((bench.task().done, bench.task().errors.len()), (1, 0));
    // And with the left hand first, a left-hander's right-hand rings are lifted by the wrong hand.
    bench.hold(0, Some(RINGS[1]));
    bench.put_ring(RINGS[1], 0.0, 0.05);
    bench.tick(&mut referee, 10);
    assert_eq!(bench.task().errors[0].kind, "wrong_hand");
}
