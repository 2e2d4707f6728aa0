//! Knots of square throws of two turns and more, tied, tightened and loaded.

use super::thread::{Bend, loose_knot, nearest_strands};
use trocar_simulator::suture_thread::{Thread, ThreadMaterial};
use trocar_test_support::thorough;

/// Least distance of centre lines of strands while the loop is pulled, in diameters.
const NEAREST: f64 = 0.85;
/// Tightening force at all four ends \[N\].
const TIGHT: f64 = 12.0;
/// Load at the loop \[N\].
const PULL: f64 = 2.0;
/// Half turns of square throws of two turns each.
pub const DOUBLE: [i32; 4] = [5, -5, 5, -5];
/// For low friction: more throws, of three turns each.
const TRIPLE: [i32; 6] = [7, -7, 7, -7, 7, -7];

/// A knot, its thread, and how long and how finely it is loaded.
#[derive(Clone, Copy)]
pub struct Trial {
    /// Half turns of each throw.
    pub turns: &'static [i32],
    pub friction: f64,
    /// Length of an edge, in diameters.
    pub segment: f64,
    pub dt: f64,
    /// Duration of the load, once the ears are free \[s\].
    pub seconds: f64,
    /// Steps under load \[s\].
    pub loaded_dt: f64,
}

pub const TRIAL: Trial =
    Trial { turns: &DOUBLE, friction: 0.2, segment: 1.5, dt: 1e-3, seconds: 6.0, loaded_dt: 2e-3 };
/// At a friction of a tenth.
pub const SLIPPERY: Trial = Trial { turns: &TRIPLE, friction: 0.1, ..TRIAL };

/// Initial time under load that counts as slip, not creep \[s\].
const BEDDED: f64 = 1.0;

/// Growth of the loop \[m\] since all four ends were pulled with the load: after the initial settling and at the end.
/// Checks that strands do not penetrate each other.
pub fn tried(trial: &Trial) -> [f64; 2] {
    let material = ThreadMaterial { friction: trial.friction, ..ThreadMaterial::silk_2_0() };
    let points = loose_knot(trial.turns, material.radius, trial.segment * material.diameter());
    let mut bend = Bend::new(Thread::new(material, &points).expect("a thread"));
    bend.tighten(TIGHT, 0.6, trial.dt);
    let eased = |time: f64| [TIGHT + (PULL - TIGHT) * (time / 0.06).min(1.0); 2];
    bend.steps(0.1, trial.dt, eased, |_, _, _| {});
    let begin = bend.span();
    bend.steps(0.1, trial.dt, |time| [PULL, PULL * (1.0 - time / 0.05).max(0.0)], |_, _, _| {});
    let (mut bedded, mut nearest, mut count) = (None, f64::INFINITY, 0);
    let bedded_by = (0.5 * trial.seconds).min(BEDDED);
    bend.steps(
        trial.seconds,
        trial.loaded_dt,
        |_| [PULL, 0.0],
        |time, bend, _| {
            if time >= bedded_by && bedded.is_none() {
                bedded = Some(bend.span() - begin);
            }
            count += 1;
            if count % 50 == 0 {
                nearest = f64::min(nearest, nearest_strands(bend.thread.positions(), material.radius).0);
            }
        },
    );
    assert!(nearest > NEAREST * material.diameter(), "strands came as near as {nearest} m");
    [bedded.expect("a time"), bend.span() - begin]
}

/// Panics unless the knot holds: it neither slips nor creeps.
pub fn holds(what: &str, trial: &Trial) {
    let seconds = if thorough() { 60.0 } else { trial.seconds };
    let [bedded, end] = tried(&Trial { seconds, ..*trial });
    let creep = (end - bedded).abs();
    eprintln!("{what}: slipped by {end:.3e} m, of which {creep:.3e} m after the first second");
    assert!(end.abs() <= 0.5e-3, "{what}: it slipped by {end} m");
    assert!(creep <= 0.1e-3, "{what}: it creeps by {creep} m");
}
