//! Several threads in one problem: they contact each other as strands of one thread do. Two threads tied together by a
//! reef knot bear two newtons by friction alone; frictionless ones come apart. Threads without contact do not influence
//! each other.

use crate::support::thread::loose_knot;
use nalgebra::{Point3, Vector3};
use trocar_simulator::suture_thread::knot::{KnotKind, identify_joined};
use trocar_simulator::suture_thread::{
    Fineness, Hold, Surroundings, Thread, ThreadError, ThreadMaterial, ThreadState, ThreadStepError,
    TwistHold, nearest_edges,
};

/// Speed of an unloaded hand \[m/s\].
const SPEED: f64 = 0.05;

/// The throws of a loose knot as two threads, without the slack loop. Also returns the last node of the first one.
fn two_tied(turns: &[i32], friction: f64) -> (Thread, usize) {
    let material = ThreadMaterial { friction, ..ThreadMaterial::silk_2_0() };
    let all = loose_knot(turns, material.radius, 1.5 * material.diameter());
    let long = |pair: &[Point3<f64>]| (pair[1] - pair[0]).norm() > 1.2e-3;
    let middle = all.len() / 2;
    let first = all[..middle].windows(2).position(long).expect("a slack loop");
    let second = middle + all[middle..].windows(2).rposition(long).expect("a slack loop") + 1;
    let thread = Thread::several(material, &[&all[..=first], &all[second..]]).expect("two threads");
    (thread, first)
}

/// Advances; `pull` gives the forces at the standing ends and at the short ones \[N\].
fn pulled(thread: &mut Thread, first: usize, seconds: f64, dt: f64, pull: impl Fn(f64) -> [f64; 2]) {
    let last = thread.positions().len() - 1;
    for step in 0..(seconds / dt).round() as usize {
        let [standing, short] = pull(dt * (step + 1) as f64);
        let side = |node: usize| thread.positions()[node].x.signum();
        let ends = [
            (first, -1.0, standing),
            (first + 1, 1.0, standing),
            (0, side(0), short),
            (last, side(last), short),
        ];
        // The hand's force decreases linearly with its speed: full at rest, zero at its free speed.
        let holds = ends.map(|(node, side, force)| Hold {
            node,
            to: thread.positions()[node] + Vector3::x() * (side * SPEED * dt),
            stiffness: (force / (SPEED * dt)).max(1e-9),
            force_max: f64::INFINITY,
        });
        thread.step(dt, &Surroundings { holds: &holds, ..Surroundings::default() }).expect("a step");
    }
}

fn span(thread: &Thread, first: usize) -> f64 {
    (thread.positions()[first + 1] - thread.positions()[first]).norm()
}

/// Tightened at all four ends, then pulled at the standing ends alone with 2 N: how far these have moved apart \[m\].
fn slip(turns: &[i32], friction: f64, dt: f64) -> (f64, Thread) {
    let (mut thread, first) = two_tied(turns, friction);
    pulled(&mut thread, first, 0.25, dt, |time| [6.0 * (time / 0.15).min(1.0).powi(2); 2]);
    let begin = span(&thread, first);
    pulled(&mut thread, first, 0.3, dt, |time| [2.0, (1.0 - time / 0.05).max(0.0) * 2.0]);
    (span(&thread, first) - begin, thread)
}

#[test]
fn two_threads_tied_together_bear_two_newtons_by_friction_and_come_apart_without() {
    let diameter = ThreadMaterial::silk_2_0().diameter();
    for dt in [1e-3, 5e-4] {
        let (by, thread) = slip(&[3, -3], 0.3, dt);
        assert!(by <= 0.5e-3, "steps of {dt} s: they came apart by {by} m");
        assert!(
            nearest_edges(&thread) > 0.85 * diameter,
            "strands came as near as {} m",
            nearest_edges(&thread)
        );
        // With their standing ends joined, it is the knot that was tied.
        let first = thread.state().threads().next().expect("a thread")[1];
        let (one, other) = thread.positions().split_at(first + 1);
        assert_eq!(identify_joined(&[one, other]).expect("a knot").kind, KnotKind::Square);
        let first = first as u32;
        let between = |key: &trocar_simulator::suture_thread::ContactKey| {
            key.with == 0 && key.edge < first && key.feature > first
        };
        let touching = thread.state().contacts.iter().filter(|contact| between(&contact.key)).count();
        assert!(touching > 6, "{touching} contacts of one with the other");
    }
    for (what, turns, friction) in [("smooth ones", &[3, -3][..], 0.0), ("a single throw", &[3], 0.3)] {
        let (by, _) = slip(turns, friction, 1e-3);
        assert!(by > 2e-3, "{what}: they came apart by {by} m only");
    }
}

#[test]
fn threads_that_do_not_meet_go_as_each_alone() {
    let material = ThreadMaterial::silk_2_0();
    let line = |at: f64| -> Vec<Point3<f64>> {
        (0..30)
            .map(|k| Point3::new(0.001 * f64::from(k), at, 0.3 * at * (0.3 * f64::from(k)).sin()))
            .collect()
    };
    let (a, b) = (line(0.0), line(0.01));
    let mut both = Thread::several(material, &[&a, &b]).expect("threads");
    let mut alone = [&a, &b].map(|line| Thread::new(material, line).expect("a thread"));
    let gravity = Vector3::new(0.0, 0.0, -9.81);
    let hold = |node: usize, to: Point3<f64>| [Hold::fixed(node, to)];
    for _ in 0..50 {
        let holds = [hold(0, a[0]), hold(30, b[0])].concat();
        let around = Surroundings { gravity, holds: &holds, ..Surroundings::default() };
        both.step(1e-3, &around).expect("a step");
        for (thread, line) in alone.iter_mut().zip([&a, &b]) {
            let holds = hold(0, line[0]);
            let around = Surroundings { gravity, holds: &holds, ..Surroundings::default() };
            thread.step(1e-3, &around).expect("a step");
        }
    }
    let apart: Vec<Point3<f64>> = alone.iter().flat_map(|thread| thread.positions()).copied().collect();
    let most = both.positions().iter().zip(&apart).map(|(a, b)| (a - b).norm()).fold(0.0, f64::max);
    // Their iterations end together, so that one may do one more than alone.
    assert!(most < 1e-7, "{most} m");
    let fallen = a[29].z - apart[29].z;
    assert!(fallen > 3e-3, "{fallen} m");
}

/// Height of one line above the other at each crossing as seen from above \[m\].
fn heights(upper: &[Point3<f64>], lower: &[Point3<f64>]) -> Vec<f64> {
    let mut heights = Vec::new();
    for a in upper.windows(2) {
        for b in lower.windows(2) {
            let (d, e, r) = (a[1] - a[0], b[1] - b[0], b[0] - a[0]);
            let turn = d.x * e.y - d.y * e.x;
            let (s, t) = ((r.x * e.y - r.y * e.x) / turn, (r.x * d.y - r.y * d.x) / turn);
            if (0.0..=1.0).contains(&s) && (0.0..=1.0).contains(&t) {
                heights.push((a[0].z + d.z * s) - (b[0].z + e.z * t));
            }
        }
    }
    heights
}

#[test]
fn a_thread_thrown_at_another_does_not_pass_and_gives_it_what_it_loses() {
    let material = ThreadMaterial { drag: 0.0, ..ThreadMaterial::silk_2_0() };
    let across: Vec<Point3<f64>> =
        (0..21).map(|k| Point3::new(0.001 * f64::from(k - 10), 0.0, 0.0)).collect();
    let above: Vec<Point3<f64>> =
        (0..21).map(|k| Point3::new(2e-4, 0.001 * f64::from(k - 10), 4e-3)).collect();
    let mut state = ThreadState::of_several(&[&across, &above]);
    // Ten diameters a step.
    let speed = 10.0 * material.diameter() / 1e-3;
    state.velocities[21..].fill(Vector3::new(0.0, 0.0, -speed));
    let momentum = |state: &ThreadState| -> [Vector3<f64>; 2] {
        [0..21, 21..42].map(|nodes| {
            nodes
                .map(|node: usize| {
                    let half = |edge: Option<usize>| {
                        edge.and_then(|edge| state.rest_lengths.get(edge)).copied().unwrap_or(0.0)
                    };
                    let length = 0.5 * (half(node.checked_sub(1)) + half(Some(node)));
                    state.velocities[node] * (length * material.mass_per_length)
                })
                .sum()
        })
    };
    let before = momentum(&state);
    let mut thread = Thread::restore(material, state).expect("threads");
    for step in 0..20 {
        thread.step(1e-3, &Surroundings::default()).expect("a step");
        // Where one is over the other, as seen from above, it stays over it.
        let heights = heights(&thread.positions()[21..], &thread.positions()[..21]);
        assert!(step > 4 || !heights.is_empty(), "they cross for a while");
        for over in heights {
            assert!(over > 0.85 * material.diameter(), "step {step}: {over} m over it");
        }
        let nearest = nearest_edges(&thread);
        assert!(nearest > 0.85 * material.diameter(), "{nearest} m");
    }
    let after = momentum(thread.state());
    let given = after[0] - before[0];
    let lost = before[1] - after[1];
    assert!(given.norm() > 0.2 * before[1].norm(), "{given:?} of {:?}", before[1]);
    assert!((given - lost).norm() < 1e-6 * given.norm(), "given {given:?}, lost {lost:?}");
}

#[test]
fn another_life_goes_on_to_the_bit_and_edges_adapt_thread_by_thread() {
    let (mut thread, first) = two_tied(&[3, -3], 0.3);
    pulled(&mut thread, first, 0.05, 1e-3, |_| [2.0; 2]);
    let mut other = Thread::restore(*thread.material(), thread.state().clone()).expect("the same");
    for thread in [&mut thread, &mut other] {
        pulled(thread, first, 0.02, 1e-3, |_| [2.0; 2]);
    }
    assert_eq!(thread.state(), other.state());
    let lengths = |thread: &Thread| -> Vec<f64> {
        let state = thread.state();
        state.threads().map(|[first, last]| state.rest_lengths[first..last].iter().sum()).collect()
    };
    let before = (lengths(&thread), thread.positions().len());
    let fineness = Fineness { fine: 1e-3, coarse: 2e-3, reach: 0.3e-3, nodes_max: 1000 };
    let now = thread.adapt(&fineness, &[0, first, first + 1]).expect("a fineness").expect("changes");
    let after = lengths(&thread);
    assert_eq!(after.len(), 2);
    assert!(thread.positions().len() < before.1, "{} nodes of {}", thread.positions().len(), before.1);
    for (before, after) in before.0.iter().zip(&after) {
        assert!((before - after).abs() < 1e-12, "{before} m became {after} m");
    }
    let [end, begin] = [first, first + 1].map(|node| now.nodes[node].expect("kept"));
    assert_eq!(end + 1, begin);
    pulled(&mut thread, end as usize, 0.02, 1e-3, |_| [2.0; 2]);
}

#[test]
fn what_is_no_thread_among_several_is_refused() {
    let material = ThreadMaterial::silk_2_0();
    let line: Vec<Point3<f64>> = (0..5).map(|k| Point3::new(0.001 * f64::from(k), 0.0, 0.0)).collect();
    let other: Vec<Point3<f64>> = line.iter().map(|p| p + Vector3::y() * 0.01).collect();
    let refused = |threads: &[&[Point3<f64>]]| Thread::several(material, threads).expect_err("refused");
    assert_eq!(refused(&[&line, &other[..2]]), ThreadError::Nodes(2));
    assert!(matches!(refused(&[]), ThreadError::Nodes(0)));
    // A thread that begins where another ends is not recognised as another.
    assert_eq!(refused(&[&line, &[line[4], other[3], other[2]]]), ThreadError::NoLength(vec![4]));
    let mut both = Thread::several(material, &[&line, &other]).expect("threads");
    let twist_holds = [TwistHold { edge: 4, director: Vector3::z() }];
    let around = Surroundings { twist_holds: &twist_holds, ..Surroundings::default() };
    assert!(matches!(
        both.step(1e-3, &around),
        Err(ThreadStepError::Given { what: "twist hold", index: 0, .. })
    ));
}
