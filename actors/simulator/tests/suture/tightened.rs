//! Tightening a knot by hand: jaws take both ends of a sutured thread in a loose throw over a wound and tighten it
//! until the edges meet. When released, a single throw lets the wound open again. Three throws tightened at once lock
//! in place above a wound that stays open: only the first throw can be tightened down.

use std::sync::Arc;

use crate::support::stage::{Stage, scene};
use crate::support::suture::{stitch, wound};
use nalgebra::{Isometry3, Matrix3, Point3, Rotation3, Translation3, UnitQuaternion, Vector3};
use trocar_scene::{
    BuildContext, CollisionList, ControllerError, Frozen, JawState, Pose, TetMesh, VertexPositions,
};
use trocar_simulator::controller::{KnotState, SutureController, SutureMemory};

const HZ: f64 = 500.0;
/// Speed of a pulling hand \[m/s\].
const SPEED: f64 = 0.03;
/// Thread tension at which the hands stop \[N\].
const DRAWN: f64 = 2.0;
/// Distance to which the edges of the wound are brought \[m\].
const CLOSED: f64 = 3e-4;
/// Where hands grasp the ears, by distance from the middle of the wound \[m\].
const TAKEN: f64 = 0.010;

fn text(friction: f64) -> String {
    format!(
        r#"
[[entity]]
name = "hand.left"
instrument = {{ kind = "needle_driver", shaft_length = 0.1, jaw_length = 0.008, jaw_force_max = 8.0 }}
[[entity]]
name = "hand.right"
instrument = {{ kind = "needle_driver", shaft_length = 0.1, jaw_length = 0.008, jaw_force_max = 8.0 }}
[[entity]]
name = "skin"
mesh = {{ block = {{ size = [0.01, 0.01, 0.02], cells = [1, 1, 1] }} }}
sewn = {{ young_modulus = 5e5 }}
anchors = {{ regions = [{{ box = {{ min = [-1.0, -1.0, -1.0], max = [1.0, 1.0, -0.0099] }} }}] }}
[[entity]]
name = "needle"
mesh = {{ line = {{ length = 0.03, segments = 3, radius = 0.0003 }} }}
needle = {{ friction = {{ value = {friction}, source = "braided silk on itself: chosen" }}, thread_edge = 1e-3, knot_edge = 1.5 }}
"#
    )
}

fn build(context: &BuildContext<'_>) -> Result<SutureController, ControllerError> {
    SutureController::new(Vector3::zeros(), context)
}

/// Jaws across a thread that runs along x at `place`, closing vertically; the shaft comes from −y.
fn across(place: &Point3<f64>) -> Isometry3<f64> {
    let turn = Matrix3::from_columns(&[Vector3::z(), Vector3::x(), Vector3::y()]);
    let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(turn));
    Isometry3::from_parts(Translation3::from(place.coords + Vector3::y() * 0.004), rotation)
}

fn jaws(angle: f64) -> JawState {
    JawState { angle, rate: 0.0, pad_force: [0.0; 2] }
}

struct Closing {
    stage: Stage<SutureController>,
    hands: [(&'static str, Isometry3<f64>); 2],
}

impl Closing {
    fn new(half_turns: &[i32], friction: f64) -> Self {
        let mut stage = Stage::new(scene(&text(friction)), HZ, build);
        let (mesh, _) = wound();
        stage.put("skin", VertexPositions { positions: Arc::new(mesh.rest().to_vec()) });
        stage.put("skin", TetMesh { tets: Arc::new(mesh.tets().to_vec()) });
        let state = stitch(half_turns, friction).state().clone();
        let thread = state.thread.as_ref().expect("a thread");
        // The parts of the ears, the first and last part of the thread, at that distance.
        let count = thread.positions.len();
        let taken = [0..count / 4, 3 * count / 4..count].map(|nodes| {
            let off = |node: &usize| (thread.positions[*node].x.abs() - TAKEN).abs();
            let node = nodes.min_by(|a, b| off(a).total_cmp(&off(b))).expect("an ear");
            thread.positions[node]
        });
        let left = usize::from(taken[0].x > 0.0);
        let hands = [("hand.left", across(&taken[left])), ("hand.right", across(&taken[1 - left]))];
        stage.put("needle", SutureMemory { state: Some(state), ..SutureMemory::default() });
        for (name, at) in &hands {
            stage.put(name, Pose::from(*at));
            stage.put(name, jaws(0.0));
        }
        stage.rebuild(build);
        Self { stage, hands }
    }

    fn jaws(&mut self, angle: f64) {
        self.hands.iter().for_each(|(name, _)| self.stage.put(name, jaws(angle)));
    }

    /// Moves the hands apart by this much in this tick \[m\].
    fn tick(&mut self, apart: f64) {
        for ((name, at), side) in self.hands.iter_mut().zip([-1.0, 1.0]) {
            at.translation.vector.x += side * apart;
            self.stage.put(name, Pose::from(*at));
        }
        self.stage.tick();
        assert!(!self.stage.has::<Frozen>("needle"), "{:?}", self.stage.get::<Frozen>("needle"));
    }

    /// Distance between the edges of the wound, in the middle of their tops \[m\].
    fn gap(&self) -> f64 {
        let rest = wound().0.rest().to_vec();
        let positions = self.stage.get::<VertexPositions>("skin").positions;
        let at = |x: f64| {
            let is_there = |point: &Point3<f64>| (point - Point3::new(x, 0.0, 0.0)).norm() < 1e-6;
            positions[rest.iter().position(is_there).expect("a vertex")].x
        };
        at(1e-3) - at(-1e-3)
    }

    fn felt(&self) -> f64 {
        let who = self.stage.entity("hand.left");
        let lists = self.stage.store.view().iter::<CollisionList>();
        let own = lists.flat_map(|(_, list)| &list.collisions).filter(|collision| collision.a == who);
        own.map(|collision| collision.force_in_world.norm()).sum()
    }
}

/// Measurements.
#[derive(Debug)]
struct Seen {
    /// Distance between the edges of the wound: before, pulled together, and a while after release \[m\].
    gaps: [f64; 3],
    /// Largest force on the left hand \[N\].
    felt: f64,
    knot: KnotState,
}

fn drawn(half_turns: &[i32], friction: f64) -> Seen {
    let mut closing = Closing::new(half_turns, friction);
    let before = closing.gap();
    closing.tick(0.0);
    assert_eq!(closing.stage.measured("needle.held_by"), 2.0, "both hands hold the thread");
    let mut felt = 0.0_f64;
    for _ in 0..400 {
        closing.tick(SPEED / HZ);
        felt = felt.max(closing.felt());
        if closing.stage.measured("needle.thread_tension_n") > DRAWN || closing.gap() < CLOSED {
            break;
        }
    }
    (0..60).for_each(|_| closing.tick(0.0));
    let (drawn, knot) = (closing.gap(), closing.stage.get("needle"));
    closing.jaws(0.4);
    (0..150).for_each(|_| closing.tick(0.0));
    assert_eq!(closing.stage.measured("needle.held_by"), 0.0, "both have let go");
    Seen { gaps: [before, drawn, closing.gap()], felt, knot }
}

#[test]
fn hands_draw_a_throw_down_over_a_wound_until_its_edges_meet() {
    let Seen { gaps: [before, drawn, after], felt, knot } = drawn(&[3], 0.3);
    assert!((before - 2e-3).abs() < 1e-4, "{before} m before");
    assert!(drawn < 0.3 * before, "drawn together to {drawn} m");
    assert!((0.3..DRAWN).contains(&felt), "the hand felt {felt} N");
    assert_eq!((knot.code, &knot.throws[..]), (1.0, &[3][..]), "{knot:?}");
    // A single throw cannot bear the pull of the skin.
    assert!(after > 0.8 * before, "{after} m when the hands have let go");
}

#[test]
fn throws_that_are_drawn_all_at_once_lock_above_the_wound() {
    // Each throw transmits only a part of its tension: that is why surgeons tighten them one by one.
    let Seen { gaps: [before, drawn, _], felt, knot } = drawn(&[3, -3, 3], 0.3);
    assert!(drawn > 0.9 * before, "drawn together to {drawn} m");
    assert!(felt > 0.8 * DRAWN, "the hand felt {felt} N");
    assert_eq!((knot.code, knot.throws.len()), (6.0, 3), "{knot:?}");
}
