//! What a knot is for: a square knot tightened by hand holds its loop at 2 N by friction alone, its ears free; what has
//! less of a grip does not. The long run is `examples/thread_trial.rs`.

mod thread_support;

use thread_support::{Bend, loose_knot};
use trocar_simulator::thread::knot::{KnotKind, identify};
use trocar_simulator::thread::{Thread, ThreadMaterial};

/// Ties throws of so many half turns and pulls all ends with 6 N; then the loop alone with 2 N, for `seconds`. How far
/// the loop has grown at 0.15 s, when the knot has bedded in, and at the end \[m\].
fn pulled(turns: &[i32], friction: f64, seconds: f64) -> (f64, f64) {
    let material = ThreadMaterial { friction, ..ThreadMaterial::silk_2_0() };
    let points = loose_knot(turns, material.radius, 1.5 * material.diameter());
    let thread = Thread::new(material, &points).expect("a thread");
    let mut bend = Bend::new(thread);
    let dt = 5e-4;
    bend.tighten(6.0, 0.25, dt);
    let begin = bend.span();
    let mut bedded = 0.0;
    bend.steps(
        seconds,
        dt,
        |time| [2.0, (1.0 - time / 0.05).max(0.0) * 2.0],
        |time, bend, _| {
            if time <= 0.15 {
                bedded = bend.span() - begin;
            }
        },
    );
    let end = bend.span() - begin;
    (bedded, end)
}

#[test]
fn a_square_knot_holds() {
    let radius = ThreadMaterial::silk_2_0().radius;
    let knot = identify(&loose_knot(&[3, -3], radius, 3.0 * radius)).expect("a knot");
    assert_eq!((knot.kind, knot.signature, knot.determinant), (KnotKind::Square, 0, 9));
    let (bedded, end) = pulled(&[3, -3], 0.3, 0.4);
    assert!(end <= 0.5e-3, "it slipped by {end} m");
    assert!((end - bedded).abs() <= 2e-6, "it creeps: {bedded} m, then {end} m");
}

#[test]
fn a_granny_a_single_throw_and_a_knot_without_friction_slip() {
    for (what, turns, friction) in
        [("granny", &[3, 3][..], 0.3), ("single throw", &[3], 0.3), ("smooth square", &[3, -3], 0.0)]
    {
        let (_, end) = pulled(turns, friction, 0.1);
        assert!(end > 2e-3, "a {what} slipped by {end} m only");
    }
}
