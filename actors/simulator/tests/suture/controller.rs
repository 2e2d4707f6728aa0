//! The suture controller on a scene: a needle driver drives a needle along its arc through a pad, a second instrument
//! grasps the tip and draws the thread through.

use crate::support::stage::{Stage, scene};
use nalgebra::{Isometry3, Point3, Rotation3, Translation3, UnitQuaternion, Vector3};
use trocar_scene::{
    BuildContext, CollisionList, Component, ControllerError, Frozen, JawState, OutOfValidity, Pose,
    VertexPositions,
};
use trocar_simulator::controller::{SewnTissue, SutureController, SutureNeedle};
use trocar_simulator::suture::needle::Solid;

const HZ: f64 = 500.0;
/// Rotation of the needle about the centre of its arc per tick \[rad\].
const TURN: f64 = 4e-3;
/// Height of that centre over the pad \[m\].
const HEIGHT: f64 = 3e-3;

/// Text of the scene; the needle's tip is a tenth of a millimetre above the pad.
fn text(sewn: &str) -> String {
    let radius = 0.026 / std::f64::consts::PI;
    let sin = (1e-4 - HEIGHT) / radius;
    let cos = (1.0 - sin * sin).sqrt();
    let exit = -(radius * radius - HEIGHT * HEIGHT).sqrt();
    format!(
        r#"
[[entity]]
name = "driver"
instrument = {{ kind = "needle_driver", shaft_length = 0.1, jaw_length = 0.008 }}
[[entity]]
name = "grasper"
pose = {{ translation = [0.0, 0.0, 0.5] }}
instrument = {{ kind = "grasper", shaft_length = 0.1, jaw_length = 0.008 }}
[[entity]]
name = "pad"
pose = {{ translation = [0.0, 0.0, -0.006] }}
mesh = {{ block = {{ size = [0.024, 0.020, 0.012], cells = [8, 6, 4] }} }}
sewn = {{ {sewn} }}
anchors = {{ regions = [{{ box = {{ min = [-1.0, -1.0, -1.0], max = [1.0, 1.0, -0.0059] }} }}] }}
[[entity]]
name = "needle"
mesh = {{ line = {{ length = 0.03, segments = 3, radius = 0.0003 }} }}
needle = {{ tip = [{}, 0.0003, 0.0001], ahead = [{sin}, 0.0, {}], planned_exit = [{exit}, 0.0003, 0.0], thread_length = 0.03, thread_to = [-1.0, 0.0, 0.3] }}
"#,
        radius * cos,
        -cos,
    )
}

const SEWN: &str =
    "puncture_force = 0.3, exit_force = 0.2, cutting_force = 0.1, needle_grip = 5.0, thread_grip = 8.0";

fn build(context: &BuildContext<'_>) -> Result<SutureController, ControllerError> {
    SutureController::new(Vector3::new(0.0, 0.0, -9.81), context)
}

/// The needle at the beginning of the scene.
fn needle(stage: &Stage<SutureController>) -> (Solid, Isometry3<f64>) {
    let kind: SutureNeedle = stage.get("needle");
    (kind.shape().solid().expect("a needle"), kind.pose().expect("a pose"))
}

/// A rotation of the world about the centre of the arc, which advances the needle.
fn turned(angle: f64) -> Isometry3<f64> {
    let center = Vector3::new(0.0, 0.3e-3, HEIGHT);
    let turn = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), angle);
    Isometry3::from_parts(Translation3::from(center - turn * center), turn)
}

/// An instrument perpendicular to the plane of the arc, with a point of the needle between its jaws before the needle
/// rotates.
fn across(stage: &Stage<SutureController>, along: f64) -> Isometry3<f64> {
    let (solid, pose) = needle(stage);
    let at = pose * solid.point(along);
    // The shaft comes from −y.
    let rotation = UnitQuaternion::from_rotation_matrix(
        &Rotation3::rotation_between(&Vector3::z(), &Vector3::y()).expect("a turn"),
    );
    let tip = at + Vector3::y() * 0.004;
    Isometry3::from_parts(Translation3::from(tip.coords), rotation)
}

fn jaws(angle: f64) -> JawState {
    JawState { angle, rate: 0.0, pad_force: [0.0; 2] }
}

/// A stage with the driver's jaws around the needle's tail.
fn set(sewn: &str, angle: f64) -> (Stage<SutureController>, Isometry3<f64>) {
    let mut stage = Stage::new(scene(&text(sewn)), HZ, build);
    let hold = across(&stage, 0.05 * 0.026);
    stage.put("driver", Pose::from(hold));
    stage.put("driver", jaws(angle));
    stage.put("grasper", jaws(0.6));
    (stage, hold)
}

fn drive(
    stage: &mut Stage<SutureController>,
    name: &str,
    hold: &Isometry3<f64>,
    from: f64,
    ticks: u32,
) -> f64 {
    for tick in 1..=ticks {
        stage.put(name, Pose::from(turned(from + TURN * f64::from(tick)) * hold));
        stage.tick();
    }
    from + TURN * f64::from(ticks)
}

fn felt(stage: &Stage<SutureController>, name: &str) -> f64 {
    let who = stage.entity(name);
    let lists = stage.store.view().iter::<CollisionList>();
    let own = lists.flat_map(|(_, list)| &list.collisions).filter(|collision| collision.a == who);
    own.map(|collision| collision.force_in_world.norm()).sum()
}

#[test]
fn a_needle_is_driven_through_and_its_thread_drawn_after_it() {
    let (mut stage, hold) = set(SEWN, 0.0);
    let mut largest = 0.0_f64;
    let mut at = 0.0;
    for _ in 0..27 {
        at = drive(&mut stage, "driver", &hold, at, 25);
        largest = largest.max(felt(&stage, "driver"));
    }
    assert!(!stage.has::<Frozen>("needle"));
    assert_eq!((stage.measured("needle.entries"), stage.measured("needle.exits")), (1.0, 1.0));
    assert_eq!(stage.measured("needle.knot"), 0.0);
    assert!((stage.measured("needle.punctured_at_n") - 0.3).abs() < 1e-9);
    let off = stage.measured("needle.exit_off_plan_m");
    assert!(off < 1.5e-3, "comes out {off} m from where it was to");
    // The hand feels the tissue's force.
    assert!((0.1..3.0).contains(&largest), "{largest} N");

    // The other one grasps the tip, the driver releases, and the thread follows the needle.
    let take = turned(at) * across(&stage, 0.95 * 0.026);
    stage.put("grasper", Pose::from(take));
    stage.tick();
    stage.put("grasper", jaws(0.0));
    stage.tick();
    assert_eq!(stage.measured("needle.held_by"), 2.0);
    stage.put("driver", jaws(0.6));
    stage.tick();
    assert_eq!(stage.measured("needle.held_by"), 1.0);
    let back = turned(at).inverse() * take;
    let at = drive(&mut stage, "grasper", &back, at, 650);
    // And up.
    let mut drag = 0.0_f64;
    for tick in 1..=200 {
        let up = Translation3::new(0.0, 0.0, 6e-5 * f64::from(tick));
        stage.put("grasper", Pose::from(up * turned(at) * back));
        stage.tick();
        drag = drag.max(stage.measured("needle.drag_n"));
    }
    assert!(!stage.has::<Frozen>("needle"));
    let through = stage.measured("needle.thread_through_m");
    assert!(through > 2e-3, "{through} m of thread are through");
    assert!(drag > 0.05 && drag < 0.5, "{drag} N");
    let line: VertexPositions = stage.get("needle");
    assert!(line.positions.iter().all(|point| (point - Point3::origin()).norm() < 0.2));
}

#[test]
fn scissors_cut_the_thread_behind_the_tissue_and_the_needle_draws_it_no_longer() {
    let run = |cuts: bool| {
        let scissors = "[[entity]]\nname = \"scissors\"\npose = { translation = [0.0, 0.0, 0.5] }\n\
             instrument = { kind = \"scissors\", shaft_length = 0.1, jaw_length = 0.012 }\n";
        let mut stage = Stage::new(scene(&format!("{scissors}{}", text(SEWN))), HZ, build);
        let hold = across(&stage, 0.05 * 0.026);
        stage.put("driver", Pose::from(hold));
        stage.put("driver", jaws(0.0));
        stage.put("grasper", jaws(0.6));
        stage.put("scissors", Pose::from(Isometry3::translation(0.0, -0.3, 0.0)));
        let mut at = drive(&mut stage, "driver", &hold, 0.0, 675);
        let take = turned(at) * across(&stage, 0.95 * 0.026);
        stage.put("grasper", Pose::from(take));
        stage.tick();
        stage.put("grasper", jaws(0.0));
        stage.put("driver", jaws(0.6));
        stage.tick();
        stage.put("driver", Pose::from(Isometry3::translation(0.0, 0.0, 0.3)));
        let back = turned(at).inverse() * take;
        at = drive(&mut stage, "grasper", &back, at, 650);
        let up = |stage: &mut Stage<SutureController>, from: u32, ticks: u32| {
            for tick in from..from + ticks {
                let by = Translation3::new(0.0, 0.0, 6e-5 * f64::from(tick));
                stage.put("grasper", Pose::from(by * turned(at) * back));
                stage.tick();
            }
        };
        up(&mut stage, 0, 200);
        // The middle of the thread between swage and exit, vertical; blades along y on either side of it.
        let line = stage.get::<VertexPositions>("needle").positions;
        let out = line[24..].iter().position(|point| point.z < 2e-4).expect("it goes in");
        let middle = line[24 + out / 2];
        let turn = UnitQuaternion::from_basis_unchecked(&[Vector3::x(), -Vector3::z(), Vector3::y()]);
        let tip = Isometry3::from_parts((middle.coords + Vector3::y() * 0.006).into(), turn);
        if cuts {
            for tick in 0..=40 {
                let back = Translation3::new(0.0, -1e-3 * f64::from(40 - tick), 0.0);
                stage.put("scissors", Pose::from(back * tip));
                stage.put("scissors", jaws(0.6));
                stage.tick();
            }
            for tick in 0..=20 {
                stage.put("scissors", Pose::from(tip));
                stage.put("scissors", jaws(0.6 * (1.0 - f64::from(tick) / 20.0)));
                stage.tick();
            }
            for tick in 0..=40 {
                let back = Translation3::new(0.0, -1e-3 * f64::from(tick), 0.0);
                stage.put("scissors", Pose::from(back * tip));
                stage.tick();
            }
        }
        let through = stage.measured("needle.thread_through_m");
        stage.rebuild(build);
        up(&mut stage, 200, 150);
        assert!(!stage.has::<Frozen>("needle"));
        let drawn = stage.measured("needle.thread_through_m") - through;
        (stage.measured("needle.pieces"), drawn, stage.measured("needle.tissue_force_n"))
    };
    let (pieces, drawn, pull) = run(true);
    assert_eq!(pieces, 2.0);
    assert!(drawn.abs() < 2e-4 && pull < 0.02, "{drawn} m with {pull} N");
    let (pieces, drawn, pull) = run(false);
    assert_eq!(pieces, 1.0);
    assert!(drawn > 5e-3 && pull > 0.05, "{drawn} m with {pull} N");
}

#[test]
fn open_jaws_and_a_skin_that_does_not_give_let_nothing_in() {
    let (mut open, hold) = set(SEWN, 0.6);
    drive(&mut open, "driver", &hold, 0.0, 100);
    assert_eq!((open.measured("needle.entries"), open.measured("needle.held_by")), (0.0, 0.0));
    let (mut hard, hold) = set("puncture_force = 1e3", 0.0);
    drive(&mut hard, "driver", &hold, 0.0, 100);
    assert_eq!((hard.measured("needle.entries"), hard.measured("needle.held_by")), (0.0, 1.0));
    assert!(felt(&hard, "driver") > 0.3, "{} N", felt(&hard, "driver"));
    // At this depth, an element exceeds the rotation or strain limit of linear elasticity: that is reported, once.
    assert!(!open.has::<OutOfValidity>("pad") && open.measured("needle.tissue_strain_max") < 1e-3);
    let doubt = hard.get::<OutOfValidity>("pad");
    assert!(doubt.reason.contains("linear elasticity misleads"), "{}", doubt.reason);
    drive(&mut hard, "driver", &hold, 100.0 * TURN, 40);
    assert_eq!(hard.get::<OutOfValidity>("pad").since, doubt.since);
}

#[test]
fn a_shaft_that_is_moved_against_the_thread_takes_it_along_and_feels_it() {
    let (mut stage, _) = set(SEWN, 0.0);
    let beside = |y: f64| Pose::from(Isometry3::translation(-0.02, y, 0.03));
    stage.put("grasper", beside(0.008));
    stage.tick();
    let nearest = |stage: &Stage<SutureController>| {
        let line = stage.get::<VertexPositions>("needle");
        let off = |point: &&Point3<f64>| (point.x + 0.02).abs();
        *line.positions.iter().min_by(|a, b| off(a).total_cmp(&off(b))).expect("a line")
    };
    let (begin, mut most) = (nearest(&stage).y, 0.0_f64);
    for tick in 1..=500 {
        stage.put("grasper", beside(0.008 - 2.5e-5 * f64::from(tick)));
        stage.tick();
        most = most.max(felt(&stage, "grasper"));
    }
    let end = nearest(&stage).y;
    assert!(!stage.has::<Frozen>("needle"));
    assert!(begin.abs() < 3e-3 && end < -4e-3, "the thread went from {begin} to {end} m");
    assert!(most > 1e-4, "{most} N");
}

#[test]
fn another_life_goes_on_to_the_bit() {
    let run = |ends: bool| {
        let (mut stage, hold) = set(SEWN, 0.0);
        let at = drive(&mut stage, "driver", &hold, 0.0, 150);
        if ends {
            stage.rebuild(build);
        }
        drive(&mut stage, "driver", &hold, at, 60);
        let [needle, pad] = ["needle", "pad"].map(|name| stage.get::<VertexPositions>(name).positions);
        assert!(stage.measured("needle.inside_m") > 2e-3);
        (needle, pad)
    };
    assert_eq!(run(true), run(false));
}

#[test]
fn a_scene_without_tissue_is_refused() {
    let without = text(SEWN).replace(&format!("sewn = {{ {SEWN} }}"), "");
    let store = scene(&without);
    let context = BuildContext {
        scene: store.view(),
        time: trocar_scene::SimTime::ZERO,
        period: trocar_scene::SimTime::from_millis(1),
        name: "suture",
        me: trocar_scene::Entity::of_writer(0, 7),
        epoch: 1,
        seed: 1,
    };
    let error = build(&context).err().expect("refused");
    assert!(error.to_string().contains("0 with 'sewn'"), "{error}");
    assert_eq!(SewnTissue::NAME, "sewn");
}
