//! A hand on a surface that the physics engine does not know: its force comes from the finger proxy alone.

use nalgebra::{Point3, Vector3};
use trocar::prelude::*;

const MS: SimTime = SimTime::from_millis(1);
/// Distance of the proxy's centre from a surface \[m\]: its radius, and its skin.
const HOLD: f64 = 0.00201;
/// Contact stiffness of the organ \[N/m\].
const STIFFNESS: f64 = 150.0;

/// A probe that points down with its tip at z = 10 mm, and below it an organ that the engine does not know.
fn scene(organ: &str) -> String {
    format!(
        r#"
schema = 1
name = "touch"
title = "Touch"
description = "A hand presses an organ."
gravity = [0.0, 0.0, -9.81]

[[entity]]
name = "organ"
{organ}

[[entity]]
name = "probe.right"
[entity.pose]
translation = [0.0, 0.0, 0.010]
rotation = [1.0, 0.0, 0.0, 0.0]
[entity.instrument]
kind = "probe"
shaft_length = 0.10
jaws = 0

[[entity]]
name = "hand.right"
[entity.hand]
side = "right"
instrument = "probe.right"
[entity.hand.world_from_device]
translation = [0.0, 0.0, 0.110]
rotation = [1.0, 0.0, 0.0, 0.0]

[[controller]]
name = "haptics.right"
kind = "haptics"
rate_hz = 1000
params = {{ hand = "right" }}

[[controller]]
name = "touch"
kind = "finger-proxy"
rate_hz = 1000
params = {{ instruments = ["probe.right"], surfaces = ["organ"], stiffness = {STIFFNESS} }}

[[controller]]
name = "engine"
kind = "rapier"
rate_hz = 500
params = {{ contact_models_by_others = ["probe.right"], floor_height = -0.3 }}

[[hand]]
name = "right"
entity = "hand.right"
device = "virtual"
renderer = {{ kind = "proxy" }}
"#
    )
}

/// Its top is z = 0, its bottom z = -20 mm.
const SLAB: &str = "pose = { translation = [0.0, 0.0, -0.010] }\n\
                    mesh = { shape = { box = { half_extents = [0.030, 0.030, 0.010] } } }";

struct Bench {
    session: Session,
    hand: Entity,
    probe: Entity,
}

impl Bench {
    fn new(text: &str, app: &App, builder: trocar::open::SessionBuilder<'_>) -> Self {
        let scenario = app.scenario_from("touch.toml".as_ref(), text).expect("a valid scenario");
        let mut session = builder.open_scenario(&scenario).expect("opens");
        let scene = session.snapshot();
        let find = |name: &str| scene.find(name).expect("a name of the scenario");
        Self { hand: find("hand.right"), probe: find("probe.right"), session }
    }

    /// Moves the arm's target to this height of the tip \[m\].
    fn aim(&mut self, z: f64) {
        // The device's z axis points down.
        let target = HandTarget { handle_in_device: Pose::at(0.0, 0.0, 0.010 - z), gripper: 0.0 };
        let hand = self.hand;
        self.session.apply(|out| out.put(hand, target)).expect("a valid target");
    }

    fn tip(&mut self) -> Vector3<f64> {
        let scene = self.session.snapshot();
        scene.get::<InstrumentTarget>(self.probe).expect("a target").tip_in_world.translation
    }

    /// Position of the proxy; `None` without a contact model.
    fn proxy(&mut self) -> Option<Vector3<f64>> {
        let scene = self.session.snapshot();
        scene.get::<LocalContactModel>(self.probe).map(|model| model.proxy_in_world.translation)
    }

    /// Commanded force, before the driver's passivity damping, in world \[N\].
    fn rendered(&mut self) -> Vector3<f64> {
        let scene = self.session.snapshot();
        let in_device = scene.get::<DeviceForce>(self.hand).expect("a force").force;
        Vector3::new(in_device.x, -in_device.y, -in_device.z)
    }

    /// Force of the motors, in world \[N\].
    fn force(&mut self) -> Vector3<f64> {
        let scene = self.session.snapshot();
        let in_device = scene.get::<DeviceState>(self.hand).expect("a device").applied_force;
        // Half a turn about x.
        Vector3::new(in_device.x, -in_device.y, -in_device.z)
    }
}

#[test]
fn a_hand_feels_stiffness_times_depth_of_an_organ_that_the_engine_does_not_know() {
    let app = App::new();
    let mut bench = Bench::new(&scene(SLAB), &app, Session::builder().app(&app));
    let mut felt = Vec::new();
    for aim in [-0.004, -0.008, -0.012] {
        bench.aim(aim);
        bench.session.step(SimTime::from_millis(800));
        let (force, depth) = (bench.force(), HOLD - bench.tip().z);
        assert!(depth > 0.003, "{aim}: {depth}");
        assert!(
            (force.z - STIFFNESS * depth).abs() < 0.01 * STIFFNESS * depth,
            "{aim}: {force:?} at {depth} m"
        );
        assert!(force.xy().norm() < 1e-3 * force.z, "{force:?}");
        let proxy = bench.proxy().expect("a model");
        assert!((proxy.z - HOLD).abs() < 1e-6, "{proxy:?}");
        felt.push(force.z);
        // The visible instrument stays on the organ too.
        let seen = bench.session.snapshot().world_pose(bench.probe).translation.z;
        assert!((seen - HOLD).abs() < 3e-4, "{seen}");
    }
    assert!(felt[2] > felt[0] + 0.5, "{felt:?}");
    // The contact is in the collision list, with the same force.
    let now = bench.session.snapshot();
    let found: Vec<Collision> =
        now.iter::<CollisionList>().flat_map(|(_, list)| list.collisions.clone()).collect();
    let [contact] = found[..] else { panic!("one contact: {found:?}") };
    assert_eq!((contact.method, contact.a), (Detection::Proxy, bench.probe));
    assert!((contact.force_in_world.z + felt[2]).abs() < 0.01 * felt[2], "{contact:?}");

    // Without the controller the same hand feels nothing.
    let mut without = Bench::new(&scene(SLAB), &app, Session::builder().app(&app).without("touch"));
    without.aim(-0.012);
    without.session.step(SimTime::from_millis(800));
    assert!(without.tip().z < -0.008, "{:?}", without.tip());
    assert!(without.force().norm() < 1e-9, "{:?}", without.force());
    assert_eq!(without.proxy(), None);
}

#[test]
fn an_engine_that_was_not_told_to_leave_the_model_is_refused_by_name() {
    let app = App::new();
    let text = scene(SLAB).replace("contact_models_by_others = [\"probe.right\"], ", "");
    let scenario = app.scenario_from("touch.toml".as_ref(), &text).expect("a valid scenario");
    let error = Session::builder().app(&app).open_scenario(&scenario).err().expect("two writers").to_string();
    for named in ["touch", "engine", "local_contact_model"] {
        assert!(error.contains(named), "{error}");
    }
    let text = scene(SLAB)
        .replace("contact_models_by_others = [\"probe.right\"]", "contact_models_by_others = [\"x\"]");
    let scenario = app.scenario_from("touch.toml".as_ref(), &text).expect("a valid scenario");
    let error =
        Session::builder().app(&app).open_scenario(&scenario).err().expect("no such name").to_string();
    assert!(error.contains("'x'") && error.contains("probe.right"), "{error}");
}

#[test]
fn no_stroke_however_fast_pops_through() {
    let app = App::new();
    let mut bench = Bench::new(&scene(SLAB), &app, Session::builder().app(&app));
    bench.session.step(SimTime::from_millis(100));
    let (mut lowest, mut fastest) = (f64::INFINITY, 0.0_f64);
    // Far beyond the bottom, and back, at the arm's full speed.
    for stroke in 0..6 {
        bench.aim(if stroke % 2 == 0 { -0.060 } else { 0.010 });
        for _ in 0..250 {
            let before = bench.tip();
            bench.session.step(MS);
            let (tip, force) = (bench.tip(), bench.rendered());
            let proxy = bench.proxy().expect("a model");
            assert!(proxy.z > HOLD - 1e-5, "stroke {stroke}: the proxy is at {proxy:?}, the hand at {tip:?}");
            assert!(force.z > -1e-9, "stroke {stroke}: {force:?} pulls in at {tip:?}");
            lowest = lowest.min(tip.z);
            fastest = fastest.max((tip - before).norm() * 1e3);
        }
    }
    assert!(lowest < -0.010 && fastest > 0.3, "it was pressed hard: {lowest} m, {fastest} m/s");
}

/// Largest acceptable jump of the commanded force within a tick when an actor dies \[N\]: as for the engine.
const JUMP_MAX: f64 = 0.5;

#[test]
fn killed_in_mid_contact_it_goes_on_on_its_side_and_no_hand_feels_a_jump() {
    let app = App::new();
    let run = |aim: f64, plan: Option<FaultPlan>| {
        let mut builder = Session::builder().app(&app);
        if let Some(plan) = plan {
            builder = builder.faults(plan);
        }
        let mut bench = Bench::new(&scene(SLAB), &app, builder);
        bench.aim(aim);
        bench.session.step(SimTime::from_millis(900));
        assert!(bench.tip().z < HOLD - 0.003, "{aim}: {:?}", bench.tip());
        let before = bench.force();
        let (mut last, mut jump) = (bench.rendered(), 0.0_f64);
        for _ in 0..600 {
            bench.session.step(MS);
            let proxy = bench.proxy().expect("a model stays");
            assert!((proxy.z - HOLD).abs() < 1e-5, "{aim}: {proxy:?}");
            let now = bench.rendered();
            jump = jump.max((now - last).norm());
            last = now;
        }
        let restarts = bench.session.reports().iter().find(|row| row.name == "touch").map(|row| row.restarts);
        (before, bench.force(), restarts, jump)
    };
    // Shallow; and deeper than the middle, where a new proxy would leave on the other side.
    for (aim, least) in [(-0.004, 0.5), (-0.021, 2.0)] {
        let (before, undisturbed, restarts, calm) = run(aim, None);
        assert_eq!(restarts, Some(0));
        assert!(before.z > least, "{aim}: a force that could jump: {before:?}");
        for at in [1.0, 1.0137, 1.2502] {
            let (before, after, restarts, jump) =
                run(aim, Some(FaultPlan::new(3).at(secs(at)).kill("touch")));
            println!("{aim} m, killed at {at} s: the force jumps by {jump:.4} N, by {calm:.4} N without");
            assert_eq!(restarts, Some(1));
            assert!(jump <= JUMP_MAX, "{aim}: {jump} N");
            assert!((after - before).norm() < 0.01 * before.norm(), "{before:?} {after:?}");
            assert!((after - undisturbed).norm() < 0.01 * undisturbed.norm(), "{after:?} {undisturbed:?}");
        }
    }
}

/// Lets the organ breathe: its vertices move out and in by a twentieth.
struct Breath {
    organ: Entity,
    rest: Vec<Point3<f64>>,
}

impl Breath {
    fn swell(time: SimTime) -> f64 {
        1.0 + 0.05 * (std::f64::consts::TAU * time.as_secs_f64()).sin()
    }
}

impl Controller for Breath {
    fn access(&self) -> Access {
        Access::new().writes::<VertexPositions>(EntitySet::Of(vec![self.organ]))
    }
    fn tick(&mut self, tick: &Tick<'_>, _: &Snapshot, out: &mut Commands) -> Result<(), ControllerError> {
        let swell = Self::swell(tick.time);
        let positions = self.rest.iter().map(|vertex| vertex * swell).collect::<Vec<_>>().into();
        out.put(self.organ, VertexPositions { positions });
        Ok(())
    }
}

#[test]
fn an_organ_that_breathes_is_felt_as_it_is_now() {
    let app = App::new().controller_with("breath", |(): &(), context: &BuildContext<'_>| {
        let organ = context.scene.find("organ").expect("the scenario's");
        let rest = context.scene.get::<VertexPositions>(organ).expect("a mesh").positions.to_vec();
        Ok(Breath { organ, rest })
    });
    // Its top is z = 0 when it is at rest.
    let ball = "pose = { translation = [0.0, 0.0, -0.030] }\n\
                mesh = { shape = { sphere = { radius = 0.030 } }, segments = 32 }";
    let breath = "[[controller]]\nname = \"breath\"\nkind = \"breath\"\nrate_hz = 200\n\n[[controller]]\nname = \"touch\"";
    let text = scene(ball).replace("[[controller]]\nname = \"touch\"", breath);
    let mut bench = Bench::new(&text, &app, Session::builder().app(&app));
    bench.aim(-0.008);
    bench.session.step(SimTime::from_millis(600));
    let (mut least, mut most) = (f64::INFINITY, 0.0_f64);
    for _ in 0..1_000 {
        bench.session.step(MS);
        let (tip, force, proxy) = (bench.tip(), bench.force(), bench.proxy().expect("a model"));
        // Delay of 200 Hz and a haptic tick, at 10 mm/s at most: 60 µm.
        let top = 0.030 * Breath::swell(bench.session.now()) - 0.030;
        assert!((proxy.z - top - HOLD).abs() < 1e-4, "at {top} the proxy is at {proxy:?}");
        let expected = STIFFNESS * (top + HOLD - tip.z);
        // Contact damping at that speed is added.
        assert!((force.z - expected).abs() < 0.03 + 0.02 * expected, "{force:?}, expected {expected}");
        (least, most) = (least.min(force.z), most.max(force.z));
    }
    assert!(most > least + 0.1, "it is felt to breathe: {least} to {most} N");
}
