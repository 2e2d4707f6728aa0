//! Threads cut by scissors, or broken: the tension vanishes, knots with cut ears hold as before, and a restart
//! continues with the pieces.

use crate::support::stage::{Stage, scene};
use crate::support::thread::{Bend, loose_knot};
use nalgebra::{Isometry3, UnitQuaternion, Vector3};
use trocar_scene::{BuildContext, ControllerError, Frozen, JawState, LineMesh, Pose, VertexPositions};
use trocar_simulator::controller::{KnotState, ThreadController, ThreadMemory};
use trocar_simulator::suture_thread::knot::{KnotKind, identify};
use trocar_simulator::suture_thread::{CutAt, Thread, ThreadMaterial};

const HZ: f64 = 500.0;
const OPEN: f64 = 0.6;

const TOOLS: &str = r#"
[[entity]]
name = "grasper"
instrument = { kind = "needle_driver", shaft_length = 0.15, jaw_force_max = 5.0, jaw_friction = 0.6, coupling_stiffness = 1000.0 }
[[entity]]
name = "scissors"
pose = { translation = [0.0, -0.2, 0.0], rotation = [0.5, 0.5, 0.5, 0.5] }
instrument = { kind = "scissors", shaft_length = 0.1, shaft_radius = 0.002, jaw_length = 0.018, jaws = 2 }
"#;

/// Held at its left end, along x.
const THREAD: &str = r#"
[[entity]]
name = "thread"
mesh = { line = { length = 0.04, segments = 40, radius = 0.00015 } }
anchors = { regions = [{ box = { min = [-0.0201, -1.0, -1.0], max = [-0.0185, 1.0, 1.0] } }] }
"#;

fn build(context: &BuildContext<'_>) -> Result<ThreadController, ControllerError> {
    ThreadController::new(Vector3::zeros(), None, context)
}

/// Jaws that close along z, their tip at a place of the thread.
fn grasp(stage: &mut Stage<ThreadController>, x: f64, angle: f64, rate: f64) {
    let turn = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), -std::f64::consts::FRAC_PI_2);
    let closing = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), std::f64::consts::FRAC_PI_2);
    stage.put(
        "grasper",
        Pose::from(Isometry3::from_parts(Vector3::new(x, 0.006, 0.0).into(), turn * closing)),
    );
    stage.put("grasper", JawState { angle, rate, ..JawState::default() });
}

/// Along y, one blade above the thread and one below; where the tip is.
fn scissors(stage: &mut Stage<ThreadController>, at: [f64; 3], angle: f64) {
    let turned = UnitQuaternion::from_basis_unchecked(&[Vector3::z(), Vector3::x(), Vector3::y()]);
    stage.put("scissors", Pose::from(Isometry3::from_parts(Vector3::from(at).into(), turned)));
    stage.put("scissors", JawState { angle, ..JawState::default() });
}

/// Open, along their shaft to where the tip is to be.
fn approach(stage: &mut Stage<ThreadController>, at: [f64; 3]) {
    for tick in 0..=20 {
        scissors(stage, [at[0], at[1] - 0.03 * (1.0 - f64::from(tick) / 20.0), at[2]], OPEN);
        stage.tick();
    }
}

fn turn(stage: &mut Stage<ThreadController>, at: [f64; 3], from: f64, to: f64) {
    for tick in 0..=20_u32 {
        scissors(stage, at, from + (to - from) * f64::from(tick) / 20.0);
        stage.tick();
    }
    assert!(!stage.has::<Frozen>("thread"), "{}", stage.get::<Frozen>("thread").reason);
}

/// The thread grasped by jaws and pulled by two millimetres: two newtons.
fn taut(thread: &str) -> Stage<ThreadController> {
    let mut stage = Stage::new(scene(&format!("{TOOLS}{THREAD}thread = {{ {thread} }}\n")), HZ, build);
    for tick in 0..125 {
        grasp(&mut stage, 0.015, 0.4 * (1.0 - f64::from(tick) / 125.0), -1.6);
        stage.tick();
    }
    for tick in 1..=100 {
        grasp(&mut stage, 0.015 + 2e-5 * f64::from(tick), 0.0, 0.0);
        stage.tick();
    }
    stage
}

#[test]
fn scissors_that_close_on_a_thread_cut_it_and_nothing_pulls_any_longer() {
    let mut stage = taut("suture = \"silk2_0\"");
    let before = stage.measured("thread.tension_n");
    assert!((before / 2.0 - 1.0).abs() < 0.05, "{before} N");
    // Open, opening, or closing beside it, they do nothing.
    let (at, beside) = ([0.0023, 0.008, 0.0], [0.0023, -0.003, 0.0]);
    approach(&mut stage, at);
    turn(&mut stage, at, 0.5 * OPEN, OPEN);
    turn(&mut stage, beside, OPEN, 0.0);
    turn(&mut stage, beside, 0.0, OPEN);
    assert_eq!(stage.measured("thread.pieces"), 1.0);
    assert!((stage.measured("thread.tension_n") - before).abs() < 0.02 * before);

    turn(&mut stage, at, OPEN, 0.0);
    assert_eq!(stage.measured("thread.pieces"), 2.0);
    for _ in 0..50 {
        stage.tick();
    }
    assert!(!stage.has::<Frozen>("thread"), "{}", stage.get::<Frozen>("thread").reason);
    let after = stage.measured("thread.tension_n");
    assert!(after < 0.02, "{after} N after the cut");
    // The jaws keep their grasp.
    assert!(stage.measured("thread.held_nodes") >= 2.0);
    assert!(stage.measured("thread.held_force_n") < 0.02);
    // One piece on either side of the blades, with its length unchanged: nodes are a millimetre apart.
    let (line, points) = (stage.get::<LineMesh>("thread"), stage.get::<VertexPositions>("thread").positions);
    assert_eq!(line.segments.len() + 2, points.len());
    let gap = line.segments.windows(2).position(|pair| pair[0][1] != pair[1][0]).expect("a gap") + 1;
    let length = |nodes: &[nalgebra::Point3<f64>]| {
        nodes.windows(2).map(|pair| (pair[1] - pair[0]).norm()).sum::<f64>()
    };
    let lengths = [length(&points[..=gap]), length(&points[gap + 1..])];
    // It was stretched by 2 N / 3.5 kN, and a diameter was removed.
    assert!((lengths[0] - 0.0223).abs() < 3e-4, "{lengths:?}");
    assert!((lengths[0] + lengths[1] - 0.0397).abs() < 1e-4, "{lengths:?}");
}

/// A long loop whose near side is anchored on both sides of the blades; its seam is in the middle of that side.
#[test]
fn scissors_open_a_closed_thread_at_its_seam_and_then_cut_it_in_two() {
    let text = format!(
        "{TOOLS}[[entity]]\nname = \"thread\"\nmesh = {{ line = {{ length = 0.1, segments = 10, radius = 0.00015 }} }}\n\
         anchors = {{ regions = [{{ box = {{ min = [-0.0201, -0.001, -1.0], max = [-0.004, 0.001, 1.0] }} }}, \
         {{ box = {{ min = [0.004, -0.001, -1.0], max = [0.0201, 0.001, 1.0] }} }}] }}\n\
         thread = {{ closed = true, edges = [3.0, 0.002], laid = {{ through = {{ places = [[0.0, 0.0, 0.0], \
         [0.02, 0.0, 0.0], [0.02, 0.05, 0.0], [-0.02, 0.05, 0.0], [-0.02, 0.0, 0.0]] }} }} }}\n"
    );
    let mut stage = Stage::new(scene(&text), HZ, build);
    stage.tick();
    let (line, nodes) =
        (stage.get::<LineMesh>("thread"), stage.get::<VertexPositions>("thread").positions.len());
    assert_eq!(line.segments.len(), nodes);
    // The last edge, that leads back to the first node, lies from -0.9 mm to 0.
    let at = [-4e-4, 0.008, 0.0];
    approach(&mut stage, at);
    assert_eq!(stage.get::<LineMesh>("thread").segments.len(), nodes, "open blades do nothing");
    turn(&mut stage, at, OPEN, 0.0);
    let is_open = |stage: &Stage<ThreadController>, pieces: usize| {
        let line = stage.get::<LineMesh>("thread");
        let nodes = stage.get::<VertexPositions>("thread").positions.len();
        assert_eq!(line.segments.len() + pieces, nodes, "open lines");
        assert!(line.segments.iter().all(|ends| ends[1] == ends[0] + 1));
        assert_eq!(stage.measured("thread.pieces"), pieces as f64);
    };
    is_open(&stage, 1);
    stage.rebuild(build);
    turn(&mut stage, at, 0.0, OPEN);
    // What is cut again falls apart.
    let beside = [2e-3, 0.008, 0.0];
    approach(&mut stage, beside);
    turn(&mut stage, beside, OPEN, 0.0);
    is_open(&stage, 2);
    // The anchored parts have not moved.
    let points = stage.get::<VertexPositions>("thread").positions;
    let held = points.iter().filter(|at| at.x.abs() > 5e-3 && at.y.abs() < 1e-6 && at.z.abs() < 1e-6);
    assert!(held.count() > 20);
}

#[test]
fn it_is_cut_piece_by_piece_and_another_life_goes_on_to_the_bit() {
    let run = |kill: bool| {
        let mut stage = taut("adaptive = true");
        for (cut, x) in [-0.011, 0.0, 0.008].into_iter().enumerate() {
            approach(&mut stage, [x, 0.008, 0.0]);
            for tick in 0..=20_u32 {
                scissors(&mut stage, [x, 0.008, 0.0], OPEN * (1.0 - f64::from(tick) / 20.0));
                stage.tick();
                if kill && tick % 7 == 3 {
                    stage.rebuild(build);
                }
            }
            assert_eq!(stage.measured("thread.pieces"), 2.0 + cut as f64);
            for tick in 0..=20 {
                scissors(&mut stage, [x, 0.008 - 1e-3 * f64::from(tick), 0.0], 0.0);
                stage.tick();
            }
        }
        assert!(!stage.has::<Frozen>("thread"));
        (stage.get::<VertexPositions>("thread"), stage.get::<ThreadMemory>("thread"))
    };
    assert_eq!(run(true), run(false));
}

#[test]
fn a_thread_breaks_where_it_is_pulled_harder_than_it_bears_and_not_before() {
    let with = |value: f64| taut(&format!("breaks_at = {{ value = {value}, source = \"chosen\" }}"));
    let whole = with(2.5);
    assert_eq!(whole.measured("thread.pieces"), 1.0);
    assert!(whole.measured("thread.tension_n") > 1.9);
    let broken = with(1.5);
    assert_eq!(broken.measured("thread.pieces"), 2.0);
    assert!(!broken.has::<Frozen>("thread"));
    assert!(broken.measured("thread.tension_n") < 0.1, "{} N", broken.measured("thread.tension_n"));
}

/// A square knot tightened with 6 N, and node numbers of its features.
fn square() -> Bend {
    let material = ThreadMaterial { friction: 0.3, ..ThreadMaterial::silk_2_0() };
    let points = loose_knot(&[3, -3], material.radius, 1.5 * material.diameter());
    let mut bend = Bend::new(Thread::new(material, &points).expect("a thread"));
    bend.tighten(6.0, 0.25, 5e-4);
    bend
}

/// Cuts the thread at a length from one of its ends; everything is renumbered.
fn cut_at(bend: &mut Bend, from_end: f64, of_last: bool) {
    let spans: Vec<_> = bend.thread.state().spans().collect();
    let total = spans.last().expect("edges").1[1];
    let arc = if of_last { total - from_end } else { from_end };
    let (edge, [begin, end]) =
        *spans.iter().find(|(_, [begin, end])| (*begin..*end).contains(&arc)).expect("an edge");
    let share = (arc - begin) / (end - begin);
    let parted = bend.thread.cut(CutAt { edge, share }).expect("sound").expect("a cut");
    bend.renumber(|node| parted.nodes[node].expect("not where it was cut") as usize);
}

/// Growth of the loop in a time under 2 N with the ears free.
fn slips(bend: &mut Bend, seconds: f64) -> f64 {
    let begin = bend.span();
    bend.steps(seconds, 5e-4, |_| [2.0, 0.0], |_, _, _| {});
    bend.span() - begin
}

#[test]
fn a_knot_whose_ears_are_cut_off_holds_as_before_and_one_whose_strand_is_cut_does_not() {
    let mut bend = square();
    // Ears of 5 mm, part of which was pulled through the knot.
    cut_at(&mut bend, 2e-3, true);
    cut_at(&mut bend, 2e-3, false);
    assert_eq!(bend.thread.state().threads().count(), 3);
    let slip = slips(&mut bend, 0.4);
    assert!(slip < 0.5e-3, "it slips by {slip} m");
    let tangled = bend.thread.state().tangled();
    let [[first, last]] = tangled[..] else { panic!("{tangled:?}") };
    let knot = identify(&bend.thread.positions()[first..=last]).expect("a knot");
    assert_eq!(knot.kind, KnotKind::Square);

    // Between the knot and where its loop is pulled.
    let mut loose = square();
    let arm = loose.arms[0];
    let before = loose.thread.state().spans().nth(arm).expect("an edge").1[0];
    cut_at(&mut loose, before - 2e-3, false);
    let slip = slips(&mut loose, 0.2);
    assert!(slip > 3e-3, "it holds what it has no part in: {slip} m");
}

#[test]
fn the_knot_of_a_thread_whose_ear_is_cut_off_is_told_as_before() {
    let laid = format!(
        "{TOOLS}[[entity]]\nname = \"thread\"\nmesh = {{ line = {{ length = 0.04, segments = 40, radius = 0.00015 }} }}\n\
         anchors = {{ regions = [{{ box = {{ min = [-1.0, -1.0, -1.0], max = [0.003, 1.0, 1.0] }} }}, \
         {{ box = {{ min = [-1.0, -1.0, -1.0], max = [1.0, 1.0, -0.0005] }} }}] }}\n\
         [entity.thread]\nstep = 2e-3\n[entity.thread.laid.throws]\nhalf_turns = [5, -3]\narm = 0.001\near = 0.006\n\
         around = [[-0.004, 0.0, -0.006], [0.004, 0.0, -0.006]]\n"
    );
    let mut stage = Stage::new(scene(&laid), HZ, build);
    for _ in 0..150 {
        stage.tick();
    }
    assert_eq!((stage.measured("thread.knot"), stage.measured("thread.pieces")), (5.0, 1.0));
    let points = stage.get::<VertexPositions>("thread").positions;
    let end = points.iter().max_by(|a, b| (a.x + a.z).total_cmp(&(b.x + b.z))).expect("an ear");
    let at = [end.x - 2e-3, end.y + 0.008, end.z];
    approach(&mut stage, at);
    turn(&mut stage, at, OPEN, 0.0);
    assert_eq!(stage.measured("thread.pieces"), 2.0);
    for _ in 0..150 {
        stage.tick();
    }
    let knot = stage.get::<KnotState>("thread");
    assert_eq!((stage.measured("thread.knot"), knot.notation.as_str()), (5.0, "2=1"));
}
