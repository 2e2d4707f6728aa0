//! A stitch: a thread goes through both edges of a wound and is tied over it. Its knot holds what one holds that is in no
//! tissue, and one that would not there, does not here.

mod suture_support;

use nalgebra::{Isometry3, Point3, UnitQuaternion, Vector3};
use suture_support::*;
use trocar_simulator::needle::{NeedleShape, NeedleState};
use trocar_simulator::suture::{Around, Bite, ChannelPoint, Resistance, Suture, SutureState, Tissue};
use trocar_simulator::thread::knot::throws;
use trocar_simulator::thread::laid::{self, Throws};
use trocar_simulator::thread::{Hold, ThreadMaterial, ThreadState};

const DT: f64 = 1e-3;
/// Steps until the knot is tied, and in all.
const TIED: i32 = 250;
const STEPS: i32 = 500;
/// Young's modulus \[Pa\]: skin, 0.1 to 1 MPa.
const SKIN: f64 = 5e5;
/// How far from the middle the thread goes in and out, and how deep it goes \[m\].
const HOLE: f64 = 4.5e-3;
const DEEP: f64 = 4e-3;

/// Two edges of a wound with 2 mm between them.
fn wound() -> Tissue {
    tissue_of(
        blocks(&[
            ([0.008, 0.012, 0.010], [4, 6, 5], [-0.009, -0.006, -0.010]),
            ([0.008, 0.012, 0.010], [4, 6, 5], [0.001, -0.006, -0.010]),
        ]),
        SKIN,
    )
}

/// Tied loosely over the wound by throws of as many half turns.
fn stitch(half_turns: &[i32], friction: f64) -> Suture {
    let tissue = wound();
    let resistance = Resistance::default();
    let material = ThreadMaterial { friction, ..ThreadMaterial::silk_2_0() };
    let height = 6e-3;
    let around = [[-HOLE, 0.0], [-HOLE + 1.5e-3, -DEEP], [HOLE - 1.5e-3, -DEEP], [HOLE, 0.0]]
        .map(|[x, z]| Point3::new(x, 0.3e-3, z - height));
    let nodes: Vec<_> = laid::throws(&Throws {
        half_turns,
        around: &around,
        radius: material.radius,
        apart: 0.0,
        arm: 1.5e-3,
        ear: 12e-3,
        edges: [3.0 * material.radius, 1e-3],
    })
    .into_iter()
    .map(|point| point + Vector3::z() * height)
    .collect();
    let shape = NeedleShape::half_circle_26();
    let solid = shape.solid().expect("a needle");
    let mut state =
        SutureState::new(NeedleState::at_rest(&Isometry3::identity()), Some(ThreadState::at_rest(&nodes)));
    let back = (nodes[1] - nodes[0]).normalize();
    let turn = UnitQuaternion::rotation_between(&-solid.tangent(0.0), &back).expect("a turn");
    state.needle =
        NeedleState::at_rest(&Isometry3::from_parts((nodes[0] - turn * solid.point(0.0)).into(), turn));
    // Arc lengths at which the thread is in the tissue: below its top, and within one of its edges.
    let mut arc = vec![0.0];
    for pair in nodes.windows(2) {
        arc.push(arc[arc.len() - 1] + (pair[1] - pair[0]).norm());
    }
    let at = |distance: f64| {
        let edge = arc.partition_point(|arc| *arc <= distance).clamp(1, nodes.len() - 1) - 1;
        nodes[edge] + (nodes[edge + 1] - nodes[edge]).normalize() * (distance - arc[edge])
    };
    let inside = |distance: &f64| {
        let point = at(*distance);
        point.z < 1e-6 && point.x.abs() > 1e-3 - 1e-6
    };
    let steps: Vec<f64> =
        (0..=(arc[arc.len() - 1] / 1e-5) as usize).map(|i| i as f64 * 1e-5).filter(inside).collect();
    let mut bites: Vec<[f64; 2]> = Vec::new();
    for step in steps {
        match bites.last_mut() {
            Some(bite) if step - bite[1] < 1.5e-5 => bite[1] = step,
            _ => bites.push([step, step]),
        }
    }
    assert_eq!(bites.len(), 2, "{bites:?}");
    for (number, [from, to]) in bites.iter().enumerate() {
        let count = ((to - from) / resistance.spacing).round() as usize;
        let places: Vec<_> = (0..=count)
            .map(|i| to - (to - from) * i as f64 / count as f64)
            .map(|distance| (tissue.locate(&at(distance)), -distance))
            .collect();
        let number = number as u32;
        state.channel.extend(places.iter().map(|(place, along)| ChannelPoint {
            place: *place,
            along: *along,
            stuck: *along,
            force: Vector3::zeros(),
            bite: number,
        }));
        let [entry, exit] =
            [places[0].0, places[count].0].map(|place| tissue.nearest(&tissue.at_rest(&place)));
        state.bites.push(Bite { number, entry, exit: Some(exit), entry_force: 0.0, exit_force: 0.0 });
        state.bites_so_far += 1;
    }
    state.channel.sort_by(|a, b| a.along.total_cmp(&b.along));
    let mut suture = Suture::new(&shape, Some(material), resistance, tissue, state).expect("a suture");
    suture.swage();
    suture
}

/// How fast a hand that pulls with nothing moves \[m/s\].
const SPEED: f64 = 0.1;

/// A hand gives way as it moves: all of its force at rest, none at its speed.
fn hand(suture: &Suture, node: usize, side: f64, force: f64) -> Hold {
    let thread = suture.state().thread.as_ref().expect("a thread");
    Hold {
        node,
        to: thread.positions[node] + Vector3::x() * (side * SPEED * DT),
        stiffness: (force / (SPEED * DT)).max(1e-9),
        force_max: f64::INFINITY,
    }
}

/// Ties a stitch with six newtons at all four ends of its knot, lets its ends go and pulls its loop with two; by how much
/// that has grown a while later \[m\], and whether the knot still is one.
fn slip(half_turns: &[i32], friction: f64) -> (f64, bool) {
    let mut suture = stitch(half_turns, friction);
    let thread = suture.state().thread.as_ref().expect("a thread");
    let last = thread.rest_lengths.len();
    // The loop is what is coarse between the fine strands of the knot.
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
        let around = Around { holds: &holds, ..Around::default() };
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
