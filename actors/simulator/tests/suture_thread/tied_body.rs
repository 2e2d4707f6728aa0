//! A thread on a scene around an elastic body: pulled, it presses the body, which deforms in the scene; a restart
//! continues both.

use crate::support::stage::{Stage, scene};
use nalgebra::{Isometry3, UnitQuaternion, Vector3};
use trocar_scene::{BuildContext, CollisionList, ControllerError, Frozen, JawState, Pose, VertexPositions};
use trocar_simulator::controller::{ThreadController, ThreadMemory};

const HZ: f64 = 500.0;

/// A tube along y with its top a tenth of a millimetre under the thread; the thread is held at its left end, leads over
/// the tube, and lies between closed jaws at the right.
const SCENE: &str = r#"
[[entity]]
name = "tube"
mesh = { tube = { radius = 0.004, length = 0.016, cells = [20, 10], wall = 0.0015, layers = 1 } }
tied = { young_modulus = 2e6, poisson_ratio = 0.4, friction = 0.1, mark = { place = [0.0, 0.0, 0.0], across = [0.0, 0.0, 1.0] } }
anchors = { regions = [
    { box = { min = [-1.0, -1.0, -1.0], max = [1.0, 1.0, -0.0079] } },
    { box = { min = [-1.0, -1.0, 0.0079], max = [1.0, 1.0, 1.0] } },
] }
[entity.pose]
translation = [0.0, 0.0, -0.00425]
rotation = [-0.7071067811865476, 0.0, 0.0, 0.7071067811865476]

[[entity]]
name = "thread"
mesh = { line = { length = 0.04, segments = 50, radius = 0.00015 } }
thread = { suture = "silk2_0", tied_around = "tube", step = 1e-3 }
anchors = { regions = [{ box = { min = [-0.0201, -1.0, -1.0], max = [-0.0185, 1.0, 1.0] } }] }

[[entity]]
name = "grasper"
pose = { translation = [0.015, 0.004, 0.0], rotation = [-0.5, 0.5, 0.5, 0.5] }
[entity.instrument]
kind = "needle_driver"
shaft_length = 0.1
jaw_force_max = 5.0
coupling_stiffness = 1000.0
"#;

fn build(context: &BuildContext<'_>) -> Result<ThreadController, ControllerError> {
    ThreadController::new(Vector3::zeros(), None, context)
}

/// Closed jaws around the right end, moved out and down by a fraction of the whole way.
fn lead(stage: &mut Stage<ThreadController>, share: f64) {
    let rotation = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), -std::f64::consts::FRAC_PI_2)
        * UnitQuaternion::from_axis_angle(&Vector3::z_axis(), std::f64::consts::FRAC_PI_2);
    let place = Vector3::new(0.015 + 0.0015 * share, 0.004, -0.003 * share);
    stage.put("grasper", Pose::from(Isometry3::from_parts(place.into(), rotation)));
    stage.put("grasper", JawState::default());
    stage.tick();
}

fn pulled(ticks: u32, mut between: impl FnMut(&mut Stage<ThreadController>)) -> Stage<ThreadController> {
    let mut stage = Stage::new(scene(SCENE), HZ, build);
    (0..4).for_each(|_| lead(&mut stage, 0.0));
    for tick in 1..=ticks {
        if tick == ticks / 2 {
            between(&mut stage);
        }
        lead(&mut stage, f64::from(tick) / f64::from(ticks));
    }
    (0..50).for_each(|_| lead(&mut stage, 1.0));
    stage
}

#[test]
fn a_body_gives_way_to_the_thread_that_is_pulled_over_it() {
    let stage = pulled(200, |_| {});
    assert!(!stage.has::<Frozen>("thread"));
    let tension = stage.measured("thread.tension_n");
    let pressed = stage.measured("tube.pressed_n");
    assert!(tension > 0.3 && pressed > 0.1 * tension, "{pressed} N at {tension} N");
    // The tension is that of the other end, except for friction over a small angle.
    let over = stage.measured("tube.loop_tension_n");
    assert!((over / tension - 1.0).abs() < 0.1, "{over} N of {tension} N");
    // In its middle, where the line is.
    assert!(stage.measured("tube.line_off_m") < 2e-4, "{} m", stage.measured("tube.line_off_m"));
    assert_eq!(stage.measured("tube.precomputed_share"), 1.0);
    assert_eq!(stage.measured("tube.beyond_linear"), 0.0);
    // Its top has moved down, in the scene as well, and nothing else is displaced as much.
    let tube = stage.get::<VertexPositions>("tube");
    let rest = stage.get::<trocar_scene::RestPositions>("tube");
    let moved = tube.positions.iter().zip(rest.positions.iter()).map(|(now, rest)| now - rest);
    let furthest = moved.max_by(|a, b| a.norm().total_cmp(&b.norm())).expect("vertices");
    assert!((furthest.norm() - stage.measured("tube.displacement_max_m")).abs() < 1e-12);
    // The tube's y is the world's −z.
    assert!(furthest.norm() > 1e-6 && furthest.y > 0.7 * furthest.norm(), "{furthest:?}");
    // The force on it is published.
    let (on, by) = (stage.entity("tube"), stage.entity("thread"));
    let lists = stage.store.view().iter::<CollisionList>();
    let told: Vec<_> = lists.flat_map(|(_, list)| list.collisions.clone()).collect();
    let found = told.iter().find(|found| found.a == on && found.b == by).expect("a collision");
    assert!(found.force_in_world.z > 0.9 * pressed && found.depth > 0.0, "{found:?}");
}

#[test]
fn another_life_goes_on_to_the_bit() {
    let whole = pulled(100, |_| {});
    let one = pulled(100, |stage| {
        stage.rebuild(build);
        // It recomputes its inverse, and is at rest meanwhile.
        lead(stage, 0.49);
    });
    for name in ["thread", "tube"] {
        assert_eq!(whole.get::<VertexPositions>(name), one.get::<VertexPositions>(name), "{name}");
    }
    let state = |stage: &Stage<ThreadController>| stage.get::<ThreadMemory>("thread");
    assert_eq!(state(&whole), state(&one));
    assert!(!state(&whole).presses.is_empty());
}

#[test]
fn what_it_cannot_be_tied_around_is_named() {
    let told = |scenario: &str| {
        let store = scene(scenario);
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
    let absent = told(&SCENE.replace("tied_around = \"tube\"", "tied_around = \"hose\""));
    assert!(
        absent.contains("'thread'") && absent.contains("'hose'") && absent.contains("valid: tube"),
        "{absent}"
    );
    let hollow = told(&SCENE.replace(", wall = 0.0015, layers = 1", ""));
    assert!(hollow.contains("'tube'") && hollow.contains("tetrahedra"), "{hollow}");
    let second = SCENE.replace("\n[[entity]]\nname = \"grasper\"", "\n[[entity]]\nname = \"other\"\nmesh = { line = { length = 0.04, segments = 50, radius = 0.00015 } }\nthread = { tied_around = \"tube\" }\n\n[[entity]]\nname = \"grasper\"");
    let twice = told(&second);
    assert!(twice.contains("another thread"), "{twice}");
}

#[test]
fn a_body_that_is_moved_stops_its_thread_and_says_why() {
    let mut stage = pulled(50, |_| {});
    stage.put("tube", Pose::from(Isometry3::translation(0.0, 0.0, -0.005)));
    lead(&mut stage, 1.0);
    let frozen = stage.get::<Frozen>("thread");
    assert!(frozen.reason.contains("stay in its place"), "{}", frozen.reason);
}
