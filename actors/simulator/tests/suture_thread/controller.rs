//! A thread on a scene: grasped by jaws, pulled, released, hit by rods, laid in a knot, and restarted.

use crate::support::stage::{Stage, scene};
use nalgebra::{Isometry3, UnitQuaternion, Vector3};
use trocar_scene::{
    BuildContext, Collision, CollisionList, ControllerError, Frozen, JawState, Pose, VertexPositions,
};
use trocar_simulator::controller::{KnotState, ThreadController, ThreadMemory};

const HZ: f64 = 500.0;

const GRASPER: &str = r#"
[[entity]]
name = "grasper"
[entity.pose]
translation = [0.015, 0.006, 0.0]
rotation = [-0.7071067811865476, 0.0, 0.0, 0.7071067811865476]
[entity.instrument]
kind = "needle_driver"
shaft_length = 0.15
jaw_force_max = 5.0
jaw_friction = 0.6
coupling_stiffness = 1000.0
"#;

/// Held at its left end, along x.
const THREAD: &str = r#"
[[entity]]
name = "thread"
mesh = { line = { length = 0.04, segments = 40, radius = 0.00015 } }
thread = { suture = "silk2_0" }
anchors = { regions = [{ box = { min = [-0.0201, -1.0, -1.0], max = [-0.0185, 1.0, 1.0] } }] }
"#;

fn build(context: &BuildContext<'_>) -> Result<ThreadController, ControllerError> {
    ThreadController::new(Vector3::zeros(), None, context)
}

/// Shaft along y, jaws closing along z, tip at a place.
fn grasper(x: f64, y: f64, z: f64) -> Pose {
    let turn = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), -std::f64::consts::FRAC_PI_2);
    let closing = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), std::f64::consts::FRAC_PI_2);
    Isometry3::from_parts(Vector3::new(x, y, z).into(), turn * closing).into()
}

fn lead(stage: &mut Stage<ThreadController>, at: [f64; 3], angle: f64, rate: f64) {
    stage.put("grasper", grasper(at[0], at[1], at[2]));
    stage.put("grasper", JawState { angle, rate, ..JawState::default() });
    stage.tick();
}

/// Jaws close on the right end in a quarter of a second, and pull to the right by `way`.
fn pull(
    stage: &mut Stage<ThreadController>,
    way: f64,
    ticks: u32,
    mut between: impl FnMut(&mut Stage<ThreadController>),
) {
    for tick in 0..125 {
        lead(stage, [0.015, 0.006, 0.0], 0.4 * (1.0 - f64::from(tick) / 125.0), -1.6);
    }
    for tick in 1..=ticks {
        if tick == ticks / 2 {
            between(stage);
        }
        lead(stage, [0.015 + way * f64::from(tick) / f64::from(ticks), 0.006, 0.0], 0.0, 0.0);
    }
    for _ in 0..50 {
        lead(stage, [0.015 + way, 0.006, 0.0], 0.0, 0.0);
    }
}

fn collisions(stage: &Stage<ThreadController>) -> Vec<Collision> {
    let lists = stage.store.view().iter::<CollisionList>();
    lists.flat_map(|(_, list)| list.collisions.clone()).collect()
}

#[test]
fn jaws_take_a_thread_feel_its_pull_and_let_it_go() {
    let mut stage = Stage::new(scene(&format!("{GRASPER}{THREAD}")), HZ, build);
    pull(&mut stage, 0.002, 100, |_| {});
    assert!(!stage.has::<Frozen>("thread"));
    assert!(stage.measured("thread.held_nodes") >= 2.0);
    // Two millimetres of a coupling of 1,000 N/m, minus the elongation of the thread: 2 N · 35 mm / 3.5 kN.
    let tension = stage.measured("thread.tension_n");
    assert!((tension / 2.0 - 1.0).abs() < 0.05, "{tension} N");
    let grasper = stage.entity("grasper");
    let felt: Vector3<f64> =
        collisions(&stage).iter().filter(|c| c.a == grasper).map(|c| -c.force_in_world).sum();
    assert!((felt.x + tension).abs() < 0.02 * tension, "the hand is pulled by {felt:?} N");
    // Opened, it holds nothing and feels nothing.
    for tick in 0..100 {
        lead(&mut stage, [0.017, 0.006, 0.0], 0.008 * f64::from(tick), 4.0);
    }
    assert_eq!(stage.measured("thread.held_nodes"), 0.0);
    assert!(stage.measured("thread.tension_n") < 0.05, "{} N", stage.measured("thread.tension_n"));
}

#[test]
fn what_pulls_harder_than_the_pads_hold_slips_out_of_the_jaws() {
    let weak = GRASPER.replace("jaw_force_max = 5.0", "jaw_force_max = 0.5");
    let mut stage = Stage::new(scene(&format!("{weak}{THREAD}")), HZ, build);
    pull(&mut stage, 0.002, 60, |_| {});
    // Two pads of 0.5 N with friction 0.6; those of the other test hold 2 N at the same displacement.
    let tension = stage.measured("thread.tension_n");
    assert!((0.5..0.6 * 1.05).contains(&tension), "{tension} N");
}

#[test]
fn jaws_of_which_nobody_has_told_hold_what_they_are_closed_on() {
    let mut stage = Stage::new(scene(&format!("{GRASPER}{THREAD}")), HZ, build);
    let before = stage.get::<VertexPositions>("thread");
    stage.tick();
    assert!(!stage.has::<JawState>("grasper") && stage.measured("thread.held_nodes") >= 2.0);
    // Closed jaws that hold nothing would squeeze it out, with a force that depends on their stiffness.
    let contact = stage.measured("thread.contact_force_n");
    assert!(contact < 0.1, "they squeeze it with {contact} N");
    let after = stage.get::<VertexPositions>("thread");
    let moved = before.positions.iter().zip(after.positions.iter()).map(|(a, b)| (b - a).norm());
    assert!(moved.fold(0.0, f64::max) < 1e-5);
    // When the input says open, they release.
    lead(&mut stage, [0.015, 0.006, 0.0], 0.4, 0.0);
    assert_eq!(stage.measured("thread.held_nodes"), 0.0);
}

#[test]
fn jaws_that_have_closed_on_nothing_take_no_thread_that_they_are_pushed_onto() {
    let text = format!("{GRASPER}{THREAD}");
    // Closed beside the thread, then pushed onto it: they act as a blunt rod.
    let pushed = |between: &dyn Fn(&mut Stage<ThreadController>)| {
        let mut stage = Stage::new(scene(&text), HZ, build);
        for _ in 0..5 {
            lead(&mut stage, [0.015, -0.010, 0.0], 0.0, 0.0);
        }
        between(&mut stage);
        for _ in 0..5 {
            lead(&mut stage, [0.015, 0.006, 0.0], 0.0, 0.0);
        }
        stage
    };
    assert_eq!(pushed(&|_| {}).measured("thread.held_nodes"), 0.0);
    // After a restart they still hold nothing.
    assert_eq!(pushed(&|stage| stage.rebuild(build)).measured("thread.held_nodes"), 0.0);
    // The control: jaws without that history have closed there just now.
    let unknown = pushed(&|stage| {
        let memory = stage.get::<ThreadMemory>("thread");
        assert_eq!(memory.grips.len(), 1, "they are known to be shut");
        stage.put("thread", ThreadMemory { grips: Vec::new(), ..memory });
        lead(stage, [0.015, -0.010, 0.0], 0.4, 0.0);
        stage.put("grasper", grasper(0.015, 0.006, 0.0));
        stage.rebuild(build);
    });
    assert!(unknown.measured("thread.held_nodes") >= 2.0);
    // Opened and closed on it, they grasp it.
    let mut stage = pushed(&|_| {});
    for _ in 0..5 {
        lead(&mut stage, [0.015, -0.010, 0.0], 0.4, 0.0);
    }
    pull(&mut stage, 0.001, 10, |_| {});
    assert!(stage.measured("thread.held_nodes") >= 2.0);
}

#[test]
fn another_life_goes_on_to_the_bit() {
    let text = format!("{GRASPER}{THREAD}");
    let mut whole = Stage::new(scene(&text), HZ, build);
    pull(&mut whole, 0.003, 100, |_| {});
    let mut one = Stage::new(scene(&text), HZ, build);
    pull(&mut one, 0.003, 100, |stage| stage.rebuild(build));
    assert_eq!(whole.get::<VertexPositions>("thread"), one.get::<VertexPositions>("thread"));
    assert_eq!(whole.get::<ThreadMemory>("thread"), one.get::<ThreadMemory>("thread"));
}

#[test]
fn a_rod_that_is_moved_against_a_thread_drags_it_along_and_is_pushed_back() {
    let probe = r#"
[[entity]]
name = "probe"
pose = { translation = [0.0, 0.0, 0.003] }
instrument = { kind = "probe", shaft_length = 0.05, shaft_radius = 0.002, jaw_length = 0.004, jaws = 0 }
"#;
    let both = THREAD.replace(
        "max = [-0.0185, 1.0, 1.0] } }]",
        "max = [-0.0185, 1.0, 1.0] } }, { box = { min = [0.0185, -1.0, -1.0], max = [0.0201, 1.0, 1.0] } }]",
    );
    let slack = both.replace("thread = {", "pose = { translation = [0.0, 0.0, 0.0] }\nthread = {");
    let mut stage = Stage::new(scene(&format!("{probe}{slack}")), HZ, build);
    for tick in 0..100 {
        // Its shaft is along z, through y = 3 mm, and moves towards the thread by 1.1 mm: 0.25 mm into it.
        let y = 0.003 - 1.1e-3 * f64::from(tick) / 100.0;
        stage.put("probe", Pose::from(Isometry3::translation(0.0, y, 0.02)));
        stage.tick();
    }
    assert!(!stage.has::<Frozen>("thread"));
    let points = stage.get::<VertexPositions>("thread");
    let lowest = points.positions.iter().map(|p| p.y).fold(0.0, f64::min);
    assert!((lowest + 0.24e-3).abs() < 0.04e-3, "pushed to {lowest} m");
    let probe = stage.entity("probe");
    let on_thread: Vector3<f64> =
        collisions(&stage).iter().filter(|c| c.a == probe).map(|c| c.force_in_world).sum();
    // 2 T sin α of the thread's tension.
    let tension = stage.measured("thread.tension_n");
    let wanted = -2.0 * tension * 0.25 / 18.5;
    assert!(tension > 0.1 && (on_thread.y / wanted - 1.0).abs() < 0.3, "{on_thread:?} N at {tension} N");
}

#[test]
fn a_thread_is_laid_tied_and_told_which_knot_it_is() {
    for (half_turns, code) in [("[3]", 1.0), ("[3, -3]", 3.0), ("[3, 3]", 4.0), ("[5, -3]", 5.0)] {
        let laid = format!(
            "{THREAD}[entity.thread.laid.throws]\nhalf_turns = {half_turns}\narm = 0.005\near = 0.01\n\
             around = [[-0.004, 0.0, -0.006], [0.004, 0.0, -0.006]]\n"
        )
        .replace("thread = { suture = \"silk2_0\" }\n", "")
        .replace("anchors = { regions = [{ box = { min = [-0.0201, -1.0, -1.0], max = [-0.0185, 1.0, 1.0] } }] }\n", "");
        let mut stage = Stage::new(scene(&laid), HZ, build);
        stage.tick();
        // A look is not part of the tick that starts it.
        assert_eq!(stage.measured("thread.knot"), 0.0, "{half_turns}");
        stage.tick();
        assert_eq!(stage.measured("thread.knot"), code, "{half_turns}");
        assert!(stage.get::<VertexPositions>("thread").positions.len() > 50);
    }
    // Throws far from each other are the same knot, at the same height.
    let apart = format!(
        "{THREAD}[entity.thread.laid.throws]\nhalf_turns = [5, -3]\napart = 0.02\narm = 0.005\near = 0.01\n\
         around = [[-0.004, 0.0, -0.006], [0.004, 0.0, -0.006]]\n"
    )
    .replace("thread = { suture = \"silk2_0\" }\n", "")
    .replace(
        "anchors = { regions = [{ box = { min = [-0.0201, -1.0, -1.0], max = [-0.0185, 1.0, 1.0] } }] }\n",
        "",
    );
    let mut stage = Stage::new(scene(&apart), HZ, build);
    stage.tick();
    let points = stage.get::<VertexPositions>("thread").positions;
    stage.tick();
    assert_eq!(stage.measured("thread.knot"), 5.0);
    let top = points.iter().map(|point| point.z).fold(0.0, f64::max);
    assert!((top - 0.02).abs() < 1e-3, "{top} m");
}

/// A thread laid in throws and held in place, after this many ticks, with a restart after `between`.
fn told(half_turns: &[i32], ticks: u32, between: u32) -> Stage<ThreadController> {
    let laid = format!(
        "[[entity]]\nname = \"thread\"\nmesh = {{ line = {{ length = 0.04, segments = 40, radius = 0.00015 }} }}\n\
         anchors = {{ regions = [{{ box = {{ min = [-1.0, -1.0, -1.0], max = [1.0, 1.0, 1.0] }} }}] }}\n\
         [entity.thread]\nstep = 2e-3\n[entity.thread.laid.throws]\nhalf_turns = {half_turns:?}\narm = 0.001\near = 0.004\n\
         around = [[-0.004, 0.0, -0.006], [0.004, 0.0, -0.006]]\n"
    );
    let mut stage = Stage::new(scene(&laid), HZ, build);
    for tick in 0..ticks {
        if tick == between {
            stage.rebuild(build);
        }
        stage.tick();
    }
    stage
}

#[test]
fn throws_are_told_in_their_order_and_with_their_hands() {
    for (half_turns, alternates, notation, signature) in [
        (&[3, -3, 3][..], 1.0, "1=1=1", -2),
        (&[-3, 3, -3], 1.0, "1=1=1", 2),
        (&[3, 3, 3], 0.0, "1x1x1", -6),
        (&[3, 3, -3], 0.0, "1x1=1", -2),
        (&[-5, 3], 1.0, "2=1", 2),
    ] {
        let stage = told(half_turns, 400, 90);
        let knot = stage.get::<KnotState>("thread");
        assert!(knot.in_order && knot.reading.is_none(), "{half_turns:?}: {knot:?}");
        assert_eq!((&knot.throws[..], &knot.notation[..]), (half_turns, notation), "{knot:?}");
        assert_eq!(knot.signature, signature, "{half_turns:?}: {knot:?}");
        // The code cannot distinguish them, which is why there are more measures.
        let measured = |what: &str| stage.measured(&format!("thread.{what}"));
        assert_eq!(measured("knot"), if half_turns.len() == 3 { 6.0 } else { 5.0 });
        assert_eq!(measured("knot_throws"), half_turns.len() as f64);
        assert_eq!(measured("knot_alternates"), alternates, "{half_turns:?}");
        assert_eq!(measured("knot_hand"), f64::from(half_turns[0].signum()), "{half_turns:?}");
        assert_eq!(measured("knot_signature"), f64::from(signature), "{half_turns:?}");
    }
    // A restart while they are read continues where it was.
    let [whole, other] = [u32::MAX, 90].map(|between| told(&[3, 3, -3], 150, between));
    assert_eq!(whole.get::<KnotState>("thread"), other.get::<KnotState>("thread"));
}

#[test]
fn a_mesh_that_is_no_thread_is_refused_by_name() {
    let none = "[[entity]]\nname = \"pad\"\nmesh = { sheet = { size = [0.01, 0.01], cells = [2, 2] } }\nthread = {}\n";
    let store = scene(none);
    let context = BuildContext {
        scene: store.view(),
        time: trocar_scene::SimTime::ZERO,
        period: trocar_scene::SimTime::from_millis(1),
        name: "thread",
        me: trocar_scene::Entity::of_writer(0, 7),
        epoch: 1,
        seed: 1,
    };
    let told = build(&context).err().expect("refused").to_string();
    assert!(told.contains("'pad'") && told.contains("line"), "{told}");
}

#[test]
fn edges_that_adapt_keep_what_is_held_and_another_life_goes_on_to_the_bit() {
    let laid = "thread = { suture = \"silk2_0\", adaptive = true, edges = [1.5, 3e-3] }";
    let text = format!("{GRASPER}{}", THREAD.replace("thread = { suture = \"silk2_0\" }", laid));
    let go = |between: fn(&mut Stage<ThreadController>)| {
        let mut stage = Stage::new(scene(&text), HZ, build);
        pull(&mut stage, 0.002, 100, between);
        stage
    };
    let (whole, one) = (go(|_| {}), go(|stage| stage.rebuild(build)));
    // When straight, it needs a third of its edges; the force is that with all of them.
    let points = whole.get::<VertexPositions>("thread").positions.len();
    assert!((10..25).contains(&points), "{points} nodes");
    assert!(whole.measured("thread.held_nodes") >= 2.0);
    let tension = whole.measured("thread.tension_n");
    assert!((tension / 2.0 - 1.0).abs() < 0.05, "{tension} N");
    let line = whole.get::<trocar_scene::LineMesh>("thread");
    assert_eq!(line.segments.len() + 1, points);
    assert_eq!(whole.get::<VertexPositions>("thread"), one.get::<VertexPositions>("thread"));
    assert_eq!(whole.get::<ThreadMemory>("thread"), one.get::<ThreadMemory>("thread"));
}
