//! A bleeding vessel on a scene: clamping, coagulation and cutting, the effect on liquid, smoke and patient, and the
//! scenario `bleeding` with its failing controls.

use std::path::Path;
use std::sync::Arc;

use crate::support::stage::{Stage, scene};
use nalgebra::{UnitQuaternion, Vector3};
use trocar_dynamics::tet_mesh::NodeOrigin;
use trocar_scene::{
    Access, Activation, BuildContext, Commands, Controller, ControllerError, Entity, EntityAllocator, Events,
    Frozen, JawState, Jobs, Measured, ParticleKind, Particles, Pose, RestPositions, SimTime, Store, TetMesh,
    Tick, VertexPositions, VitalSigns, WriterRules,
};
use trocar_simulator::controller::{
    BleedingController, ElectrosurgeryController, FluidController, RemovedElements, SmokeController,
    VesselState, VitalSignsController, VolumeCuts,
};

const GRAVITY: Vector3<f64> = Vector3::new(0.0, 0.0, -9.81);

fn down(x: f64, y: f64, z: f64) -> Pose {
    Pose {
        translation: Vector3::new(x, y, z),
        rotation: UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI),
    }
}

fn jaws(angle: f64) -> JawState {
    JawState { angle, ..JawState::default() }
}

/// An artery along y from −15 to 15 mm, whose hole is at 10 mm.
fn artery(injury: f64, tool: &str) -> Store {
    scene(&format!(
        "[[entity]]\nname = \"artery\"\nmesh = {{ line = {{ length = 0.03, segments = 12, radius = 0.001 }} }}\n\
         vessel = {{ injury = {injury}, hole = 0.8333333333 }}\n\
         pose = {{ rotation = [0.0, 0.0, 0.7071067811865476, 0.7071067811865476] }}\n\
         [[entity]]\nname = \"tool\"\npose = {{ translation = [0.0, 0.0, 0.05], rotation = [1.0, 0.0, 0.0, 0.0] }}\n\
         instrument = {{ kind = \"{tool}\", shaft_length = 0.1, jaw_length = 0.012 }}\n"
    ))
}

#[test]
fn a_vessel_bleeds_while_jaws_do_not_close_it_before_its_hole_and_another_life_goes_on() {
    let mut stage = Stage::new(artery(0.5, "grasper"), 100.0, BleedingController::new);
    let rate = |stage: &Stage<BleedingController>| stage.measured("artery.rate_m3_per_s");
    stage.put("tool", jaws(0.5));
    stage.tick();
    let free = rate(&stage);
    assert!((1e-6..1e-5).contains(&free), "{free} m³/s");
    // Open jaws around it, closed ones behind the hole, closed ones above it.
    for (pose, angle) in
        [(down(0.0, 0.0, -0.003), 0.5), (down(0.0, 0.013, -0.003), 0.0), (down(0.0, 0.0, 0.02), 0.0)]
    {
        stage.put("tool", pose);
        stage.put("tool", jaws(angle));
        stage.tick();
        assert_eq!(rate(&stage), free, "{pose:?} {angle}");
    }
    stage.put("tool", down(0.0, 0.0, -0.003));
    let mut before = free;
    for angle in [0.18, 0.12, 0.08, 0.0] {
        stage.put("tool", jaws(angle));
        stage.tick();
        assert!(rate(&stage) < before, "{angle}: {} m³/s", rate(&stage));
        before = rate(&stage);
    }
    assert_eq!((before, stage.measured("artery.clamped_share")), (0.0, 1.0));
    let lost = stage.measured("artery.lost_m3");
    for _ in 0..50 {
        stage.tick();
    }
    assert_eq!(stage.measured("artery.lost_m3"), lost);
    // After a restart, and released.
    stage.rebuild(BleedingController::new);
    stage.put("tool", jaws(0.5));
    for _ in 0..100 {
        stage.tick();
    }
    assert_eq!(rate(&stage), free);
    assert!((stage.measured("artery.lost_m3") - lost - free).abs() < 1e-12);
    let state = stage.get::<VesselState>("artery");
    let place = stage.store.view().world_pose(stage.entity("artery")) * state.place;
    assert!((place.coords - Vector3::new(0.0, 0.01, 0.0)).norm() < 1e-9, "{place}");
}

#[test]
fn closed_scissors_that_sweep_through_a_vessel_cut_it_through_and_open_ones_do_not() {
    let mut stage = Stage::new(artery(0.0, "scissors"), 100.0, BleedingController::new);
    let sweep = |stage: &mut Stage<BleedingController>, y: f64, angle: f64| {
        stage.put("tool", jaws(angle));
        for step in 0..20 {
            stage.put("tool", down(-0.005 + 0.0005 * f64::from(step), y, -0.004));
            stage.tick();
        }
        stage.put("tool", down(0.02, y, 0.05));
        stage.put("tool", jaws(0.5));
        stage.tick();
    };
    sweep(&mut stage, 0.002, 0.5);
    assert_eq!((stage.measured("artery.damage_share"), stage.measured("artery.lost_m3")), (0.0, 0.0));
    sweep(&mut stage, 0.005, 0.0);
    assert_eq!(stage.measured("artery.damage_share"), 1.0);
    assert!(stage.measured("artery.lost_m3") > 0.0);
    let hole = |stage: &Stage<BleedingController>| stage.get::<VesselState>("artery").hole;
    assert!((hole(&stage) - 20.0 / 30.0).abs() < 1e-9, "{}", hole(&stage));
    // Upstream of it, once more; downstream there is no blood to lose.
    sweep(&mut stage, 0.012, 0.0);
    assert!((hole(&stage) - 20.0 / 30.0).abs() < 1e-9, "{}", hole(&stage));
    sweep(&mut stage, -0.005, 0.0);
    assert!((hole(&stage) - 10.0 / 30.0).abs() < 1e-9, "{}", hole(&stage));
    let began = stage.store.view().events().since(0).filter(|(_, event)| event.name == "bleeding_began");
    assert_eq!(began.count(), 1);
}

/// An artery along y through the middle of a block of tissue.
fn buried() -> Stage<BleedingController> {
    let text = "[[entity]]\nname = \"liver\"\ncauterised = {}\n\
        mesh = { block = { size = [0.012, 0.030, 0.012], cells = [12, 30, 12] } }\n\
        [[entity]]\nname = \"artery\"\nmesh = { line = { length = 0.03, segments = 12, radius = 0.001 } }\n\
        vessel = { radius = 0.001, wall = 0.0003, tissue = \"liver\" }\n\
        pose = { rotation = [0.0, 0.0, 0.7071067811865476, 0.7071067811865476] }\n";
    Stage::new(scene(text), 100.0, BleedingController::new)
}

#[test]
fn who_burns_the_tissue_about_a_vessel_burns_the_vessel_and_what_was_cut_counts_as_it_was() {
    let mut stage = buried();
    let tets = stage.get::<TetMesh>("liver").tets;
    let rest = stage.get::<VertexPositions>("liver").positions;
    let middle = |tet: &[u32; 4]| tet.iter().map(|&n| rest[n as usize].coords).sum::<Vector3<f64>>() / 4.0;
    // At y = 6 mm: elements next to the vessel, and those farther away than its wall.
    let ring = |tet: &[u32; 4], low: f64, high: f64| {
        let at = middle(tet);
        (at.y - 0.006).abs() < 0.001 && (low..high).contains(&at.x.hypot(at.z))
    };
    let of = |low: f64, high: f64| -> Vec<u32> {
        (0..tets.len() as u32).filter(|&tet| ring(&tets[tet as usize], low, high)).collect()
    };
    let (near, far) = (of(0.0, 0.0013), of(0.0014, 0.004));
    assert!(near.len() > 4 && far.len() > 8, "{} and {}", near.len(), far.len());
    let burned = |stage: &mut Stage<BleedingController>, gone: &[u32]| {
        stage.put("liver", RemovedElements { elements: Arc::new(gone.to_vec()) });
        (0..5).for_each(|_| stage.tick());
        stage.measured("artery.damage_share")
    };
    assert_eq!(burned(&mut stage, &far), 0.0, "too far off");
    let one = burned(&mut stage, &[&far[..], &near[..1]].concat());
    // An element of a sixth of 1 mm³, against the section.
    let ball = std::f64::consts::PI * (0.75e-9 / 6.0 / std::f64::consts::PI).powf(2.0 / 3.0);
    let section = std::f64::consts::PI * 1e-6;
    assert!((one - ball / section).abs() < 1e-9, "{one}");
    assert!(stage.measured("artery.rate_m3_per_s") > 0.0 && stage.measured("artery.lost_m3") > 0.0);
    let hole = stage.get::<VesselState>("artery").place;
    let hole = stage.store.view().world_pose(stage.entity("artery")) * hole;
    assert!((hole.y - 0.006).abs() < 0.0011 && hole.x.abs() < 1e-9, "{hole}");
    // A restart does not count it again.
    stage.rebuild(BleedingController::new);
    assert_eq!(burned(&mut stage, &[&far[..], &near[..1]].concat()), one);
    let all = burned(&mut stage, &[&far[..], &near[..]].concat());
    assert!((all - (near.len() as f64 * one).min(1.0)).abs() < 1e-9, "{all}");
    // The scene's mesh has two parts of an element halved by blades; the whole original element burned.
    let mut cut = buried();
    let (mut halves, mut positions) = (tets.to_vec(), rest.to_vec());
    let [a, b, c, d] = halves[near[0] as usize];
    let half = positions.len() as u32;
    positions.push(nalgebra::center(&rest[a as usize], &rest[b as usize]));
    halves[near[0] as usize] = [half, b, c, d];
    halves.push([a, half, c, d]);
    cut.put("liver", TetMesh { tets: Arc::new(halves) });
    cut.put("liver", RestPositions { positions: Arc::new(positions) });
    let births = Arc::new(vec![NodeOrigin { of: [a, b], share: 0.5 }]);
    let parts_of = Arc::new(vec![near[0]]);
    cut.put("liver", VolumeCuts { births, parts_of, first: tets, ..VolumeCuts::default() });
    assert_eq!(burned(&mut cut, &near[..1]), one);
}

#[test]
fn scissors_that_close_on_a_vessel_cut_it_through_and_those_that_open_or_close_beside_it_do_not() {
    let closes = |x: f64, from: f64, to: f64| {
        let mut stage = Stage::new(artery(0.0, "scissors"), 100.0, BleedingController::new);
        for step in 0..=20 {
            stage.put("tool", down(x, 0.005, -0.004));
            stage.put("tool", jaws(from + (to - from) * f64::from(step) / 20.0));
            stage.tick();
        }
        (stage.measured("artery.damage_share"), stage.get::<VesselState>("artery").hole)
    };
    let (damage, hole) = closes(0.0, 0.5, 0.0);
    assert_eq!(damage, 1.0);
    assert!((hole - 20.0 / 30.0).abs() < 1e-9, "{hole}");
    assert_eq!(closes(0.012, 0.5, 0.0).0, 0.0, "beside it");
    assert_eq!(closes(0.0, 0.0, 0.5).0, 0.0, "opening");
}

#[test]
fn a_vessel_is_a_line() {
    let store = scene(
        "[[entity]]\nname = \"artery\"\nmesh = { sheet = { size = [0.02, 0.02], cells = [2, 2] } }\nvessel = {}\n",
    );
    let context = BuildContext {
        scene: store.view(),
        time: SimTime::ZERO,
        period: SimTime::from_millis(1),
        name: "vessels",
        me: Entity::of_writer(0, 7),
        epoch: 1,
        seed: 1,
    };
    let error = BleedingController::new(&context).err().expect("no line").to_string();
    assert!(error.contains("'artery'") && error.contains("line"), "{error}");
    for (what, error) in [
        ("liquid", FluidController::new(GRAVITY, &context).err()),
        ("smoke", SmokeController::new(GRAVITY, &context).err()),
        ("patient", VitalSignsController::new(&context).err()),
    ] {
        assert!(error.expect("there is none").to_string().contains(what));
    }
}

struct Actor {
    controller: Box<dyn Controller>,
    me: Entity,
    rules: WriterRules,
    commands: Commands,
    every: u64,
}

type Build = fn(&BuildContext<'_>) -> Result<Box<dyn Controller>, ControllerError>;

const CAST: [(Build, u64); 5] = [
    (|context| Ok(Box::new(ElectrosurgeryController::new(context)?)), 2),
    (|context| Ok(Box::new(BleedingController::new(context)?)), 2),
    (|context| Ok(Box::new(VitalSignsController::new(context)?)), 10),
    (|context| Ok(Box::new(FluidController::new(GRAVITY, context)?)), 4),
    (|context| Ok(Box::new(SmokeController::new(GRAVITY, context)?)), 4),
];

/// Several controllers on one scene, each at its rate, with scripted hands; 200 ticks a second.
struct Play {
    store: Store,
    actors: Vec<Actor>,
    hand: Commands,
    ticks: u64,
}

impl Play {
    fn new(store: Store, cast: &[(Build, u64)]) -> Self {
        let registry = store.view().registry().clone();
        let hand = Commands::new(registry, EntityAllocator::new(0, 0));
        let mut play = Self { store, actors: Vec::new(), hand, ticks: 0 };
        play.engage(cast);
        play
    }

    /// Starts all controllers, from the scene alone.
    fn engage(&mut self, cast: &[(Build, u64)]) {
        self.actors.clear();
        let registry = self.store.view().registry().clone();
        for (number, (build, every)) in (20..).zip(cast) {
            let me = Entity::of_writer(0, number);
            let (time, period) = (SimTime(self.ticks * 5_000_000), SimTime(5_000_000 * *every));
            let context =
                BuildContext { scene: self.store.view(), time, period, name: "actor", me, epoch: 1, seed: 1 };
            let controller = build(&context).unwrap_or_else(|error| panic!("{error}"));
            let access: Access = controller.access();
            let rules = WriterRules::compile(&access, &registry, me).expect("its access is right");
            let commands = Commands::new(registry.clone(), EntityAllocator::new(0, number));
            self.actors.push(Actor { controller, me, rules, commands, every: *every });
        }
    }

    fn tick(&mut self, hand: impl FnOnce(f64, &mut Commands, &dyn Fn(&str) -> Entity)) {
        self.ticks += 1;
        let now = SimTime(self.ticks * 5_000_000);
        let scene = self.store.snapshot();
        hand(now.as_secs_f64(), &mut self.hand, &|name| scene.find(name).expect("it is in the scene"));
        self.hand.seal();
        assert_eq!(self.hand.error(), None);
        self.store.apply(&mut self.hand, now);
        self.hand.clear();
        for actor in self.actors.iter_mut().filter(|actor| self.ticks.is_multiple_of(actor.every)) {
            let scene = self.store.snapshot();
            let jobs = Jobs::default();
            let tick = Tick {
                time: now,
                period: SimTime(actor.every * 5_000_000),
                number: self.ticks / actor.every,
                me: actor.me,
                epoch: 1,
                events: Events::new(scene.events(), 0),
                jobs: &jobs,
            };
            actor.controller.tick(&tick, &scene, &mut actor.commands).expect("a step");
            actor.commands.seal();
            assert_eq!(actor.commands.error(), None);
            self.store.validate(&actor.commands, &actor.rules).expect("what it declared");
            self.store.apply(&mut actor.commands, now);
            actor.commands.clear();
        }
    }

    fn measured(&self, what: &str) -> f64 {
        let all = self.store.view().iter::<Measured>();
        let found = all.filter_map(|(_, measured)| measured.values.get(what).copied()).next();
        found.unwrap_or_else(|| panic!("no '{what}'"))
    }

    fn get<T: trocar_scene::Component>(&self, name: &str) -> T {
        let scene = self.store.view();
        scene.find(name).and_then(|entity| scene.get::<T>(entity)).cloned().expect("it has one")
    }
}

/// The entities of the scenario file.
fn scenario() -> Store {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../scenarios/bleeding.toml");
    let text = std::fs::read_to_string(path).expect("the scenario");
    let entities = text.split("# ---- Who acts").next().unwrap_or_default();
    let from = entities.find("# ---- The patient").expect("its entities");
    let to = entities.find("# ---- What is expected").expect("their end");
    scene(&entities[from..to])
}

/// Finds entities by name.
type Find<'a> = dyn Fn(&str) -> Entity + 'a;

/// The two hands of the scenario, shortened: the clamp closes at 0.6 s, the hook burns from 0.8 to 2.6 s, the clamp
/// opens at 3 s.
fn hands(clamps: bool, burns: bool) -> impl FnMut(f64, &mut Commands, &Find<'_>) {
    move |secs, out, find| {
        let closed = clamps && (0.6..3.0).contains(&secs);
        let (grasper, hook) = (find("grasper.left"), find("hook.right"));
        let there = (0.5..3.4).contains(&secs);
        out.put(grasper, if there { down(0.0, -0.003, -0.0015) } else { down(-0.02, -0.003, 0.05) });
        out.put(grasper, jaws(if closed { 0.0 } else { 0.5 }));
        let on = burns && (0.8..2.6).contains(&secs);
        out.put(hook, if on { down(0.0, 0.010, 0.0004) } else { down(0.02, 0.015, 0.05) });
        out.put(hook, Activation { level: f64::from(u8::from(on)), ..Activation::default() });
    }
}

fn play(secs: f64, clamps: bool, burns: bool) -> Play {
    let mut play = Play::new(scenario(), &CAST[..4]);
    let mut act = hands(clamps, burns);
    for _ in 0..(secs * 200.0) as u64 {
        play.tick(&mut act);
    }
    play
}

#[test]
fn who_clamps_and_coagulates_stops_the_bleeding_and_who_does_only_one_of_both_does_not() {
    let good = play(3.6, true, true);
    assert_eq!(good.measured("artery.rate_m3_per_s"), 0.0);
    assert!(good.measured("artery.coagulated_share") > 0.999);
    let lost = good.measured("artery.lost_m3");
    assert!((1e-6..6e-6).contains(&lost), "{lost} m³ lost");
    // The lost volume is in the liquid, and missing in the patient; none was lost after the clamp.
    let seen = good.measured("blood.emitted_share");
    assert!((0.98..=1.0).contains(&seen), "{seen} of it seen");
    assert!((good.measured("piglet.blood_lost_m3") - lost).abs() < 1e-12);
    let blood = good.get::<Particles>("blood");
    let visible = blood.densities.iter().filter(|density| **density > 0.0).count() as f64;
    assert_eq!((blood.kind, visible), (ParticleKind::Fluid, good.measured("blood.particles")));
    assert!(good.store.view().iter::<Frozen>().next().is_none());
    // Without the clamp, the blood keeps the hole cool.
    let open = play(3.6, false, true);
    assert!(open.measured("artery.coagulated_share") < 0.01);
    assert!(open.measured("artery.rate_m3_per_s") > 1e-6 && open.measured("artery.lost_m3") > 2.0 * lost);
    // Without coagulation, it bleeds again when unclamped.
    let loose = play(3.6, true, false);
    assert!(
        loose.measured("artery.rate_m3_per_s") > 1e-6 && loose.measured("artery.coagulated_share") == 0.0
    );
    // The patient's vital signs respond.
    let signs = [&good, &open].map(|play| play.get::<VitalSigns>("piglet"));
    assert!(signs[1].heart_rate > signs[0].heart_rate && signs[0].heart_rate > 109.9, "{signs:?}");
    assert!(signs[1].arterial_pressure < signs[0].arterial_pressure, "{signs:?}");
    assert_eq!(signs[0].blood_loss, good.measured("piglet.blood_lost_m3"));
}

#[test]
fn other_lives_of_all_controllers_go_on_to_the_bit() {
    let mut act = hands(true, true);
    let mut whole = Play::new(scenario(), &CAST[1..4]);
    let mut parts = Play::new(scenario(), &CAST[1..4]);
    for tick in 0..300 {
        if tick % 100 == 60 {
            parts.engage(&CAST[1..4]);
        }
        whole.tick(&mut act);
        parts.tick(&mut act);
    }
    assert!(whole.measured("blood.particles") > 50.0);
    let [a, b] = [&whole, &parts].map(|play| play.get::<Particles>("blood"));
    assert_eq!(a, b);
    let [a, b] = [&whole, &parts].map(|play| play.get::<VitalSigns>("piglet"));
    assert_eq!(a, b);
    assert_eq!(whole.measured("artery.lost_m3"), parts.measured("artery.lost_m3"));
}

#[test]
fn what_burns_gives_off_smoke_that_rises_and_goes() {
    let store = scene(
        "[[entity]]\nname = \"fold\"\nmesh = { sheet = { size = [0.02, 0.02], cells = [20, 20] } }\n\
         cauterised = { thickness = 0.001 }\n\
         [[entity]]\nname = \"smoke\"\nsmoke = { lifetime = 1.0 }\n\
         [[entity]]\nname = \"hook\"\nelectrode = { power = 30.0, contact_area = 1e-6 }\n\
         pose = { translation = [0.0, 0.0, 0.0005], rotation = [1.0, 0.0, 0.0, 0.0] }\n\
         instrument = { kind = \"hook_cautery\", jaws = 0 }\n",
    );
    let mut play = Play::new(store, &[CAST[0], CAST[4]]);
    let act = |secs: f64, out: &mut Commands, find: &dyn Fn(&str) -> Entity| {
        let level = if (0.5..2.0).contains(&secs) { 1.0 } else { 0.0 };
        out.put(find("hook"), Activation { level, ..Activation::default() });
    };
    for _ in 0..90 {
        play.tick(act);
    }
    assert_eq!(play.measured("smoke.puffs"), 0.0, "it is off");
    let mut most: f64 = 0.0;
    for tick in 0..320 {
        if tick == 200 {
            play.engage(&[CAST[0], CAST[4]]);
        }
        play.tick(act);
        most = most.max(play.measured("smoke.highest_m"));
    }
    assert!(play.measured("smoke.puffs") > 5.0 && most > 0.005, "{} {most} m", play.measured("smoke.puffs"));
    // It contains a tenth of the dry mass removed.
    let dry = play.measured("fold.removed_volume_m3") * 1079.0 * 0.3 * 0.1;
    let emitted = play.measured("smoke.emitted_kg");
    assert!(
        (emitted / dry - 1.0).abs() < 1e-6 && emitted == play.measured("fold.smoke_kg"),
        "{emitted} {dry}"
    );
    let puffs = play.get::<Particles>("smoke");
    assert_eq!(puffs.ages.len(), puffs.positions.len());
    for _ in 0..300 {
        play.tick(act);
    }
    assert_eq!(play.measured("smoke.puffs"), 0.0, "it has gone");
    assert!(play.get::<Particles>("smoke").positions.is_empty());
}

#[test]
fn an_irrigator_brings_liquid_and_a_sucker_takes_it_while_they_are_switched_on() {
    let tube = |name: &str, kind: &str, x: f64| {
        format!(
            "[[entity]]\nname = \"{name}\"\npose = {{ translation = [{x}, 0.0, 0.03], rotation = [1.0, 0.0, 0.0, 0.0] }}\n\
             instrument = {{ kind = \"probe\", shaft_length = 0.1, shaft_radius = 0.002, jaw_length = 0.004, jaws = 0 }}\n{kind}\n"
        )
    };
    let text = |sucker: &str| {
        format!(
            "{}{}[[entity]]\nname = \"pool\"\nliquid = {{ spacing = 0.003, min = [-0.05, -0.05, 0.0], max = [0.05, 0.05, 0.1] }}\n\
             particles = {{}}\n\
             [[entity]]\nname = \"floor\"\nmesh = {{ sheet = {{ size = [0.1, 0.1], cells = [4, 4] }} }}\nliquid_wall = {{}}\n",
            tube("rinse", "irrigator = { rate = 1e-5, area = 2e-5 }", 0.0),
            tube("drain", sucker, 0.0)
        )
    };
    let build = |context: &BuildContext<'_>| FluidController::new(GRAVITY, context);
    let mut stage = Stage::new(scene(&text("sucker = { rate = 2e-5, reach = 0.02 }")), 100.0, build);
    let switch = |stage: &mut Stage<FluidController>, name: &str, level: f64| {
        let since = stage.now();
        stage.put(name, Activation { level, since, mode: None });
    };
    (0..5).for_each(|_| stage.tick());
    assert_eq!(stage.measured("pool.emitted_m3"), 0.0, "it is off");
    switch(&mut stage, "rinse", 0.5);
    (0..100).for_each(|_| stage.tick());
    stage.rebuild(build);
    (0..100).for_each(|_| stage.tick());
    switch(&mut stage, "rinse", 0.0);
    (0..50).for_each(|_| stage.tick());
    // Two seconds at half of 10 ml/s.
    let emitted = stage.measured("pool.emitted_m3");
    assert!((emitted / 1e-5 - 1.0).abs() < 0.02, "{emitted} m³");
    assert_eq!(stage.measured("pool.sucked_m3"), 0.0);
    let there = stage.measured("pool.volume_m3");
    assert!(there > 0.5 * emitted, "{there} m³");
    let on_floor = down(0.0, 0.0, 0.003);
    stage.put("drain", on_floor);
    switch(&mut stage, "drain", 1.0);
    (0..20).for_each(|_| stage.tick());
    let early = stage.measured("pool.sucked_m3");
    assert!(early > 1e-6 && early <= 2e-5 * 0.2 * 1.01, "{early} m³ of what its rate allows");
    (0..100).for_each(|_| stage.tick());
    switch(&mut stage, "drain", 0.0);
    let sucked = stage.measured("pool.sucked_m3");
    assert!(sucked > early, "{sucked} m³");
    (0..20).for_each(|_| stage.tick());
    assert_eq!(stage.measured("pool.sucked_m3"), sucked);
    let [emitted, volume, absorbed] =
        ["emitted_m3", "volume_m3", "absorbed_m3"].map(|what| stage.measured(&format!("pool.{what}")));
    assert!((emitted - volume - absorbed).abs() < 1e-12 && sucked <= absorbed, "nothing is lost");
    // One switch for two hooks is ambiguous.
    let both = scene(&text("sucker = {}\nirrigator = {}"));
    let snapshot = both.snapshot();
    let me = trocar_scene::Entity::of_writer(0, 7);
    let context = BuildContext {
        scene: &snapshot,
        time: SimTime::ZERO,
        period: SimTime::from_millis(1),
        name: "liquid",
        me,
        epoch: 1,
        seed: 1,
    };
    let Err(error) = build(&context) else { panic!("one switch for both") };
    assert!(error.to_string().contains("'drain'"), "{error}");
}
