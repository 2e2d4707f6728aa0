//! Groups of threads with mutual contact: two loops hooked into each other transmit the pull of a hand; ungrouped
//! threads pass through each other.

use crate::support::stage::{Stage, scene};
use nalgebra::{Isometry3, UnitQuaternion, Vector3};
use trocar_scene::{BuildContext, ControllerError, Frozen, JawState, LineMesh, Pose, VertexPositions};
use trocar_simulator::controller::{ThreadController, ThreadMemory};

const HZ: f64 = 500.0;

/// A loop held at both of its ends, to the left; a second one around its bend, held at its lower end, with its upper
/// end between the jaws. `MORE` stands for additional parameters of the second.
const SCENE: &str = r#"
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
[[entity]]
name = "held"
mesh = { line = { length = 0.04, segments = 40, radius = 0.00015 } }
anchors = { regions = [{ box = { min = [-0.0201, -1.0, -1.0], max = [-0.0185, 1.0, 1.0] } }] }
[entity.thread]
adaptive = ADAPTIVE
[entity.thread.laid.through]
places = [[-0.019, -0.002, -0.001], [0.0, -0.002, -0.001], [0.0, 0.002, -0.001], [-0.019, 0.002, -0.001]]
[[entity]]
name = "drawn"
mesh = { line = { length = 0.04, segments = 40, radius = 0.00015 } }
anchors = { regions = [{ box = { min = [0.0112, -1.0, -1.0], max = [0.0122, 1.0, -0.0015] } }] }
[entity.thread]
adaptive = ADAPTIVE
MORE
[entity.thread.laid.through]
places = [[0.018, 0.0, 0.0], [-0.001, 0.0, 0.0], [-0.001, 0.0, -0.002], [0.012, 0.0, -0.002]]
"#;

const TOGETHER: &str = "together_with = [\"held\"]";

fn text(more: &str, adaptive: bool) -> String {
    SCENE.replace("MORE", more).replace("ADAPTIVE", if adaptive { "true" } else { "false" })
}

fn build(context: &BuildContext<'_>) -> Result<ThreadController, ControllerError> {
    ThreadController::new(Vector3::zeros(), None, context)
}

/// Shaft along y, jaws closing along z, tip at a place.
fn grasper(x: f64) -> Pose {
    let turn = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), -std::f64::consts::FRAC_PI_2);
    let closing = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), std::f64::consts::FRAC_PI_2);
    Isometry3::from_parts(Vector3::new(x, 0.006, 0.0).into(), turn * closing).into()
}

/// Jaws hold the upper end, and pull it to the right by a centimetre, with a restart on the way if `ends`.
fn drawn(text: &str, ends: bool) -> Stage<ThreadController> {
    let mut stage = Stage::new(scene(text), HZ, build);
    for tick in 0..360 {
        let x = 0.015 + 0.010 * ((f64::from(tick) - 60.0) / 250.0).clamp(0.0, 1.0);
        stage.put("grasper", grasper(x));
        stage.put("grasper", JawState::default());
        if ends && tick == 200 {
            stage.rebuild(build);
        }
        stage.tick();
    }
    stage
}

#[test]
fn hooked_loops_carry_the_pull_and_pass_each_other_when_they_are_not_told() {
    for adaptive in [false, true] {
        let stage = drawn(&text(TOGETHER, adaptive), false);
        assert!(!stage.has::<Frozen>("held") && !stage.has::<Frozen>("drawn"));
        assert!(stage.measured("drawn.held_nodes") >= 2.0);
        let [held, drawn] = ["held", "drawn"].map(|name| stage.measured(&format!("{name}.tension_n")));
        assert!(drawn > 0.5, "{drawn} N");
        // Either leg of the one balances either leg of the other, except for friction around its bend and their
        // inclination.
        assert!((0.6..1.4).contains(&(held / drawn)), "{held} N of {drawn} N");
        for name in ["held", "drawn"] {
            let nodes = stage.get::<VertexPositions>(name).positions.len();
            assert_eq!(stage.get::<LineMesh>(name).segments.len() + 1, nodes, "{name}");
        }
        assert!(stage.measured("drawn.penetration_m") < 5e-5, "{} m", stage.measured("drawn.penetration_m"));
    }
    let apart = drawn(&text("", false), false);
    let held = apart.measured("held.tension_n");
    assert!(held < 0.02, "{held} N though nothing pulls");
}

#[test]
fn another_life_goes_on_to_the_bit_with_several_threads() {
    let [whole, other] = [false, true].map(|ends| drawn(&text(TOGETHER, true), ends));
    for name in ["held", "drawn"] {
        assert_eq!(whole.get::<VertexPositions>(name), other.get::<VertexPositions>(name), "{name}");
    }
    assert_eq!(whole.get::<ThreadMemory>("drawn"), other.get::<ThreadMemory>("drawn"));
}

#[test]
fn what_cannot_go_together_is_refused_by_name() {
    let refused = |text: &str| {
        let store = scene(text);
        let context = BuildContext {
            scene: store.view(),
            time: trocar_scene::SimTime::ZERO,
            period: trocar_scene::SimTime::from_millis(1),
            name: "thread",
            me: trocar_scene::Entity::of_writer(0, 7),
            epoch: 1,
            seed: 1,
        };
        build(&context).err().expect("refused").to_string()
    };
    let unknown = refused(&text("together_with = [\"other\"]", false));
    assert!(unknown.contains("'other' is no other thread; valid: held"), "{unknown}");
    let twice = refused(&text("together_with = [\"held\", \"held\"]", false));
    assert!(twice.contains("'held'") && twice.contains("several"), "{twice}");
    let material = refused(&text(&format!("{TOGETHER}\nsuture = \"silk2\""), false));
    assert!(material.contains("'held' is of another material"), "{material}");
    let moved = text(TOGETHER, false)
        .replace("name = \"held\"\n", "name = \"held\"\npose = { translation = [0.0, 0.0, 1e-3] }\n");
    assert!(refused(&moved).contains("'held' is at another pose"), "{}", refused(&moved));
}
