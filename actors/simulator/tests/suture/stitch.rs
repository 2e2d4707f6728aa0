//! A stitch: a thread passes through both edges of a wound and is tied over it. Its knot holds exactly when the same
//! knot without tissue does.

use crate::support::suture::*;
use nalgebra::Vector3;
use trocar_simulator::suture::{StepInputs, Suture};
use trocar_simulator::suture_thread::knot::throws;
use trocar_simulator::suture_thread::{Hold, ThreadMaterial};

const DT: f64 = 1e-3;
/// Steps until the knot is tied, and in all.
const TIED: i32 = 250;
const STEPS: i32 = 500;
/// Speed of an unloaded hand \[m/s\].
const SPEED: f64 = 0.1;

/// The hand's force decreases linearly with its speed: full at rest, zero at its free speed.
fn hand(suture: &Suture, node: usize, side: f64, force: f64) -> Hold {
    let thread = suture.state().thread.as_ref().expect("a thread");
    Hold {
        node,
        to: thread.positions[node] + Vector3::x() * (side * SPEED * DT),
        stiffness: (force / (SPEED * DT)).max(1e-9),
        force_max: f64::INFINITY,
    }
}

/// Ties a stitch with six newtons at all four ends of its knot, releases its ends and pulls its loop with two; returns
/// the growth of the loop after a while \[m\], and whether the knot still is one.
fn slip(half_turns: &[i32], friction: f64) -> (f64, bool) {
    let mut suture = stitch(half_turns, friction);
    let thread = suture.state().thread.as_ref().expect("a thread");
    let last = thread.rest_lengths.len();
    // The loop is the coarse part between the fine strands of the knot.
    let coarse = |edge: &usize| thread.rest_lengths[*edge] > 0.9e-3;
    let knot: Vec<usize> = (0..last).filter(|edge| !coarse(edge)).collect();
    let slack: Vec<usize> = (knot[0]..knot[knot.len() - 1]).filter(coarse).collect();
    let arms = [slack[0], slack[slack.len() - 1] + 1];
    let at = |suture: &Suture, node: usize| suture.state().thread.as_ref().expect("a thread").positions[node];
    let span = |suture: &Suture| (at(suture, arms[1]) - at(suture, arms[0])).norm();
    let mut begin = 0.0;
    for step in 0..STEPS {
        let time = f64::from(step + 1) * DT;
        let tight = 6.0 * (time / 0.15).min(1.0).powi(2);
        let [arm, ear] = if step < TIED {
            [tight; 2]
        } else {
            [2.0, 2.0 * (1.0 - (time - f64::from(TIED) * DT) / 0.05).clamp(0.0, 1.0)]
        };
        if step == TIED {
            begin = span(&suture);
        }
        let ends = [(arms[0], -1.0, arm), (arms[1], 1.0, arm)];
        // The needle follows its end of the thread.
        let ears = [2, last].map(|node| (node, at(&suture, node).x.signum(), ear));
        let pulled = ends.into_iter().chain(ears).filter(|(.., force)| *force > 0.0);
        let holds: Vec<Hold> = pulled.map(|(node, side, force)| hand(&suture, node, side, force)).collect();
        let around = StepInputs { holds: &holds, ..StepInputs::default() };
        let report = suture.step(DT, &around).unwrap_or_else(|why| panic!("step {step}: {why}"));
        let most = 0.1 * ThreadMaterial::silk_2_0().diameter();
        assert!(report.penetration_max < most, "step {step}: {} m deep", report.penetration_max);
    }
    let thread = suture.state().thread.as_ref().expect("a thread");
    let found = throws(&thread.positions).map(|found| found.len());
    (span(&suture) - begin, found == Ok(half_turns.len()))
}

#[test]
fn a_knot_tied_in_a_sewn_thread_holds_as_one_that_is_not_sewn() {
    let (slip, is_tied) = slip(&[3, -3, 3], 0.3);
    assert!(is_tied && slip < 5e-4, "three throws slip by {slip} m");
}

#[test]
fn a_single_throw_and_a_smooth_thread_come_undone() {
    for (what, half_turns, friction) in [("a single throw", &[3][..], 0.3), ("no friction", &[3, -3, 3], 0.0)]
    {
        let (slip, is_tied) = slip(half_turns, friction);
        assert!(!is_tied && slip > 5e-3, "{what}: {slip} m");
    }
}
