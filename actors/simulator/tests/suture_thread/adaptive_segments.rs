//! Adaptive segments: short near other strands, long elsewhere, with conservation of the state.

use crate::support::thread::{Bend, loose_knot, nearest_strands};
use nalgebra::{Point3, Vector3};
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;
use trocar_simulator::suture_thread::knot::{KnotKind, identify};
use trocar_simulator::suture_thread::{
    Fineness, Hold, Surroundings, Thread, ThreadError, ThreadMaterial, ThreadState,
};

/// 1.3 diameters, so that none is longer than 1.5.
const FINE: f64 = 3.9e-4;
const LONGEST: f64 = 4.5e-4;
const COARSE: f64 = 2e-3;

fn fineness() -> Fineness {
    Fineness { fine: FINE, coarse: COARSE, reach: 6e-4, nodes_max: 1000 }
}

/// A hairpin of long edges, its legs 6 mm apart.
fn hairpin() -> Vec<Point3<f64>> {
    let leg = |k: i32| 2e-3 * f64::from(k);
    let there = (0..20).map(|k| Point3::new(leg(k), -3e-3, 0.0));
    let turn = (1..8).map(|k| {
        let angle = std::f64::consts::PI * (f64::from(k) / 8.0 - 0.5);
        Point3::new(leg(19) + 3e-3 * angle.cos(), 3e-3 * angle.sin(), 0.0)
    });
    let back = (0..20).rev().map(|k| Point3::new(leg(k), 3e-3, 0.0));
    there.chain(turn).chain(back).collect()
}

/// Momentum over mass per length: half of each edge belongs to either end.
fn momentum(state: &ThreadState) -> Vector3<f64> {
    let edges = state.rest_lengths.iter().enumerate();
    edges.map(|(k, length)| (state.velocities[k] + state.velocities[k + 1]) * (0.5 * length)).sum()
}

/// Twist between the ends, beyond that of the curve itself.
fn twist(state: &ThreadState) -> f64 {
    state.twists.iter().sum()
}

#[test]
fn edges_are_short_while_strands_are_near_and_long_again_when_they_have_parted() {
    let points = hairpin();
    let mut thread = Thread::new(ThreadMaterial::silk_2_0(), &points).expect("a thread");
    // The bend of 3 mm is sharper than long edges can follow; the legs are not.
    thread.adapt(&fineness(), &[]).expect("adapts");
    let at_first = thread.state().rest_lengths.clone();
    assert!(at_first[..16].iter().all(|length| *length > 0.7 * COARSE), "{at_first:?}");
    let length = thread.state().rest_length();
    let (mut ends, dt) = ([points[0], points[points.len() - 1]], 1e-3);
    let (mut shortest_near, mut closest) = (f64::INFINITY, f64::INFINITY);
    let mut go = |thread: &mut Thread, speed: f64, steps: usize| {
        for step in 0..steps {
            ends[0].y += speed * dt;
            ends[1].y -= speed * dt;
            let last = thread.positions().len() - 1;
            let holds = [Hold::fixed(0, ends[0]), Hold::fixed(last, ends[1])];
            thread.step(dt, &Surroundings { holds: &holds, ..Surroundings::default() }).expect("a step");
            if step % 5 == 4 {
                thread.adapt(&fineness(), &[]).expect("adapts");
                assert!((thread.state().rest_length() - length).abs() < 1e-12);
                for contact in thread.state().contacts.iter().filter(|contact| contact.key.with == 0) {
                    for edge in [contact.key.edge, contact.key.feature] {
                        let rest = thread.state().rest_lengths[edge as usize];
                        assert!(rest <= LONGEST, "edge {edge} of {rest} m touches");
                    }
                }
                let near = nearest_strands(thread.positions(), thread.material().radius);
                closest = f64::min(closest, near.0);
                if near.0 < 3.2e-4 {
                    shortest_near = near
                        .1
                        .iter()
                        .map(|edge| thread.state().rest_lengths[*edge])
                        .fold(shortest_near, f64::min);
                }
            }
        }
    };
    // Until the held ends are so near that the legs touch.
    go(&mut thread, 0.0204, 140);
    let most = thread.state().rest_lengths.len();
    go(&mut thread, -0.0204, 140);
    go(&mut thread, 0.0, 100);
    assert!(closest < 3.2e-4 && closest > 0.8 * 3e-4, "the legs came to {closest} m");
    assert!(shortest_near <= LONGEST, "{shortest_near}");
    let at_last = thread.state().rest_lengths.len();
    assert!(most > at_first.len() + 5, "{} edges, then {most}", at_first.len());
    assert!(at_last <= at_first.len() + 4, "{} edges, then {most}, then {at_last}", at_first.len());
}

#[test]
fn length_momentum_and_twist_stay_and_divided_edges_lie_where_they_lay() {
    let mut random = Pcg64Mcg::seed_from_u64(11);
    let material = ThreadMaterial::silk_2_0();
    let (mut divided, mut joined) = (0, 0);
    for trial in 0..200 {
        let mut at = Point3::origin();
        let mut along = Vector3::x();
        let mut points = vec![at];
        for _ in 0..random.random_range(4..80) {
            let bend = if trial % 2 == 0 { 0.05 } else { 0.9 };
            let turn = Vector3::from_fn(|_, _| random.random_range(-bend..bend));
            along = (along + turn).normalize();
            at += along * random.random_range(2e-4..3e-3);
            points.push(at);
        }
        let mut state = ThreadState::at_rest(&points);
        let last = state.twists.len() - 1;
        state
            .velocities
            .iter_mut()
            .for_each(|v| *v = Vector3::from_fn(|_, _| random.random_range(-1.0..1.0)));
        // Directors rotated by the twists, whole turns included.
        let mut angle = 0.0_f64;
        for node in 1..last {
            let by: f64 = random.random_range(-2.0..2.0);
            angle += by;
            state.twists[node] = by;
            let tangent = (points[node + 1] - points[node]).normalize();
            let director = state.directors[node];
            state.directors[node] = director * angle.cos() + tangent.cross(&director) * angle.sin();
        }
        let mut thread = Thread::restore(material, state.clone()).expect("a thread");
        let keep = [points.len() / 2];
        let Some(found) = thread.adapt(&fineness(), &keep).expect("adapts") else { continue };
        let after = thread.state();
        assert!((after.rest_length() - state.rest_length()).abs() < 1e-12);
        assert!((momentum(after) - momentum(&state)).norm() < 1e-12 * state.rest_length().max(1.0));
        let kept = found.nodes[keep[0]].expect("it is to be kept") as usize;
        assert_eq!(after.positions[kept], points[keep[0]]);
        for (edge, [first, last]) in found.edges.iter().enumerate() {
            let parts = last - first + 1;
            divided += usize::from(parts > 1);
            if parts > 1 {
                let inner = &after.positions[*first as usize..=*last as usize + 1];
                let way = points[edge + 1] - points[edge];
                for (k, place) in inner.iter().enumerate() {
                    let wanted = points[edge] + way * (k as f64 / f64::from(parts));
                    assert!((place - wanted).norm() < 1e-15);
                }
            }
        }
        joined += found.nodes.iter().filter(|node| node.is_none()).count();
        // Where the chord leads around the other side than the two edges, by their rotation out of plane.
        let turned = twist(after) - twist(&state);
        assert!(
            turned.abs() < 0.05 * f64::from(points.len() as u32),
            "{trial}: {turned} over {}",
            points.len()
        );
        assert_eq!(after.rest_lengths.len() + 1, after.positions.len());
        let again = thread.clone().adapt(&fineness(), &keep).expect("adapts");
        assert!(again.is_none_or(|again| again.edges.len() < again.nodes.len()), "{trial}");
    }
    assert!(divided > 500 && joined > 150, "{divided} divided, {joined} joined");
}

#[test]
fn a_knot_that_is_tied_with_adaptive_edges_holds_on_fewer_nodes() {
    let material = ThreadMaterial { friction: 0.3, ..ThreadMaterial::silk_2_0() };
    let tied = loose_knot(&[3, -3], material.radius, FINE);
    // With long ends, laid as finely as the knot.
    let (first, last) = (tied[0], tied[tied.len() - 1]);
    let ear = |end: Point3<f64>, k: i32| end + Vector3::x() * (end.x.signum() * FINE * f64::from(k));
    let mut points: Vec<_> = (1..60).rev().map(|k| ear(first, k)).collect();
    points.extend(tied);
    points.extend((1..60).map(|k| ear(last, k)));
    let laid = points.len();
    let mut bend = Bend::new(Thread::new(material, &points).expect("a thread"));
    let dt = 5e-4;
    let ramp = 0.15;
    let fineness = fineness();
    // The bend uses node numbers: adapted between the phases, and in short phases.
    let adapt = |bend: &mut Bend| {
        let arms = bend.arms;
        let keep = [arms[0], arms[1], bend.bight()];
        if let Some(found) = bend.thread.adapt(&fineness, &keep).expect("adapts") {
            bend.renumber(|node| found.nodes[node].expect("it is to be kept") as usize);
        }
    };
    let mut time = 0.0;
    let mut most = 0;
    while time < 0.25 {
        adapt(&mut bend);
        most = most.max(bend.thread.positions().len());
        let begun = time;
        bend.steps(0.01, dt, |t| [6.0 * ((begun + t) / ramp).min(1.0).powi(2); 2], |_, _, _| {});
        time += 0.01;
    }
    let begin = bend.span();
    time = 0.0;
    while time < 0.2 {
        adapt(&mut bend);
        let begun = time;
        bend.steps(0.01, dt, |t| [2.0, (1.0 - (begun + t) / 0.05).max(0.0) * 2.0], |_, _, _| {});
        time += 0.01;
    }
    let slip = bend.span() - begin;
    assert!(slip.abs() < 0.5e-3, "it slipped by {slip} m");
    assert_eq!(identify(bend.thread.positions()).expect("a knot").kind, KnotKind::Square);
    let state = bend.thread.state();
    for contact in state.contacts.iter().filter(|contact| contact.key.with == 0) {
        for edge in [contact.key.edge, contact.key.feature] {
            assert!(state.rest_lengths[edge as usize] <= LONGEST);
        }
    }
    let now = state.positions.len();
    assert!(most < laid && 4 * now < 3 * laid, "{laid} nodes, then {most}, then {now}");
}

#[test]
fn nodes_are_bounded_and_what_makes_no_sense_is_named() {
    let points = hairpin();
    let mut thread = Thread::new(ThreadMaterial::silk_2_0(), &points).expect("a thread");
    let all_fine = Fineness { coarse: FINE, ..fineness() };
    let few = Fineness { nodes_max: points.len() + 20, ..all_fine };
    let found = thread.adapt(&few, &[]).expect("adapts").expect("some are divided");
    assert!(thread.positions().len() <= points.len() + 20 && found.too_long > 0, "{found:?}");
    let before = thread.state().clone();
    for bad in [
        Fineness { fine: 0.0, ..fineness() },
        Fineness { fine: f64::NAN, ..fineness() },
        Fineness { coarse: 1e-4, ..fineness() },
        Fineness { reach: -1.0, ..fineness() },
        Fineness { nodes_max: 100_000, ..fineness() },
    ] {
        let error = thread.adapt(&bad, &[]).expect_err("it makes no sense");
        assert!(matches!(error, ThreadError::Material { .. } | ThreadError::Nodes(_)), "{error}");
    }
    assert_eq!(thread.state(), &before);
}
