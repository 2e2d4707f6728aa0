//! A stitch on a scene: a sutured thread with throws over a wound is refined there, its knot is classified, and it
//! continues after a restart.

use std::sync::Arc;

use crate::support::stage::{Stage, scene};
use crate::support::suture::{stitch, wound};
use nalgebra::Vector3;
use trocar_scene::{BuildContext, ControllerError, Frozen, LineMesh, TetMesh, VertexPositions};
use trocar_simulator::controller::{KnotState, SutureController, SutureMemory, SutureNeedle};
use trocar_simulator::suture_thread::{ThreadMaterial, ThreadState};

const HZ: f64 = 500.0;
const SCENE: &str = r#"
[[entity]]
name = "skin"
mesh = { block = { size = [0.01, 0.01, 0.02], cells = [1, 1, 1] } }
sewn = { young_modulus = 5e5 }
anchors = { regions = [{ box = { min = [-1.0, -1.0, -1.0], max = [1.0, 1.0, -0.0099] } }] }
[[entity]]
name = "needle"
mesh = { line = { length = 0.03, segments = 3, radius = 0.0003 } }
needle = { friction = { value = 0.3, source = "braided silk on itself: chosen" }, thread_edge = 1e-3, knot_edge = 1.0 }
"#;

fn build(context: &BuildContext<'_>) -> Result<SutureController, ControllerError> {
    SutureController::new(Vector3::zeros(), context)
}

/// A wound with a stitch of these throws.
fn begun(half_turns: &[i32]) -> Stage<SutureController> {
    let mut stage = Stage::new(scene(SCENE), HZ, build);
    let (mesh, _) = wound();
    stage.put("skin", VertexPositions { positions: Arc::new(mesh.rest().to_vec()) });
    stage.put("skin", TetMesh { tets: Arc::new(mesh.tets().to_vec()) });
    let state = Some(stitch(half_turns, 0.3).state().clone());
    stage.put("needle", SutureMemory { state, ..SutureMemory::default() });
    stage.rebuild(build);
    stage
}

/// After this many ticks, with a restart after `between`.
fn gone_on(between: u32) -> Stage<SutureController> {
    let mut stage = begun(&[3, -3, 3]);
    for tick in 0..25 {
        if tick == between {
            stage.rebuild(build);
        }
        stage.tick();
    }
    assert!(!stage.has::<Frozen>("needle"), "{:?}", stage.get::<Frozen>("needle"));
    stage
}

/// State of the thread.
fn thread(stage: &Stage<SutureController>) -> ThreadState {
    let state = stage.get::<SutureMemory>("needle").state.expect("a state");
    state.thread.expect("a thread")
}

#[test]
fn a_sewn_thread_has_short_edges_where_it_is_tied_and_its_knot_is_told() {
    let before = thread(&begun(&[3, -3, 3])).rest_lengths;
    let stage = gone_on(u32::MAX);
    let after = thread(&stage);
    let diameter = ThreadMaterial::silk_2_0().diameter();
    let touching: Vec<f64> = after
        .contacts
        .iter()
        .filter(|contact| contact.key.with == 0)
        .flat_map(|contact| [contact.key.edge, contact.key.feature])
        .map(|edge| after.rest_lengths[edge as usize])
        .collect();
    // It was laid with edges of 1.5 diameters.
    let longest = touching.iter().copied().fold(0.0, f64::max);
    assert!(!touching.is_empty() && longest <= 1.0001 * diameter, "{longest} m where strands touch");
    assert!(
        before.len() < after.rest_lengths.len(),
        "{} edges of {}",
        after.rest_lengths.len(),
        before.len()
    );
    let [before, now] = [&before, &after.rest_lengths].map(|lengths| lengths.iter().sum::<f64>());
    assert!((now - before).abs() < 1e-12, "{before} m became {now} m");
    let line = stage.get::<LineMesh>("needle").segments.len() + 1;
    assert_eq!(line, stage.get::<VertexPositions>("needle").positions.len());
    assert_eq!((stage.measured("needle.knot"), stage.measured("needle.knot_throws")), (6.0, 3.0));
    assert_eq!(stage.get::<KnotState>("needle").signature, -2);
    assert_eq!(stage.get::<SutureNeedle>("needle").material().friction, 0.3);
}

#[test]
fn another_life_goes_on_to_the_bit_with_edges_that_adapt() {
    let [whole, other] = [u32::MAX, 12].map(gone_on);
    assert_eq!(whole.get::<SutureMemory>("needle"), other.get::<SutureMemory>("needle"));
    assert_eq!(whole.get::<VertexPositions>("needle"), other.get::<VertexPositions>("needle"));
    assert_eq!(whole.get::<KnotState>("needle"), other.get::<KnotState>("needle"));
}
