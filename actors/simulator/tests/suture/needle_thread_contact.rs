//! Contact of a needle with its own thread: strands lie on the wire with friction, action and reaction are equal, and
//! no strand passes through it at any speed.

use crate::support::suture::{jaws, nowhere, pose, straight};
use nalgebra::{Point3, Vector3};
use trocar_collision::primitive::closest_segments;
use trocar_simulator::suture::needle::NeedleState;
use trocar_simulator::suture::{Resistance, StepInputs, Suture, SutureState};
use trocar_simulator::suture_thread::{Hold, ThreadMaterial, ThreadState};

const DT: f64 = 5e-4;
/// Initial height of the thread over the wire's axis \[m\].
const HIGH: f64 = 8e-4;

/// A straight needle along x, its tail at −10 mm; its thread leads back, to the side, forwards, and across above the
/// wire. Also returns the node at which it turns across.
fn laid() -> (SutureState, usize) {
    let shape = straight();
    let at = pose(&shape, Point3::new(0.03, 0.0, 0.0), Vector3::x(), Vector3::z());
    let tail = at * shape.solid().expect("a needle").point(0.0);
    let corners = [
        tail,
        tail - Vector3::x() * 6e-3,
        Point3::new(tail.x - 6e-3, -5e-3, HIGH),
        Point3::new(0.01, -5e-3, HIGH),
        Point3::new(0.01, 6e-3, HIGH),
    ];
    let mut nodes = vec![tail];
    let mut turn = 0;
    for (k, pair) in corners.windows(2).enumerate() {
        let count = ((pair[1] - pair[0]).norm() / 5e-4).ceil();
        nodes.extend((1..=count as usize).map(|part| pair[0].lerp(&pair[1], part as f64 / count)));
        if k == 2 {
            turn = nodes.len() - 1;
        }
    }
    (SutureState::new(NeedleState::at_rest(&at), Some(ThreadState::at_rest(&nodes))), turn)
}

fn suture(state: SutureState) -> Suture {
    let material = ThreadMaterial { drag: 0.0, ..ThreadMaterial::silk_2_0() };
    let mut suture =
        Suture::new(&straight(), Some(material), Resistance::default(), nowhere(), state).expect("a suture");
    suture.swage();
    suture
}

fn thread(suture: &Suture) -> &ThreadState {
    suture.state().thread.as_ref().expect("a thread")
}

/// Least distance of edges from this node on to the axis of the wire \[m\].
fn nearest(suture: &Suture, from: usize) -> f64 {
    let pose = suture.state().needle.pose();
    let length = suture.solid().shape().length();
    let axis = [0.0, length].map(|along| pose * suture.solid().point(along));
    let edges = thread(suture).positions[from..].windows(2);
    let apart = edges.map(|edge| closest_segments(&[edge[0], edge[1]], &axis).distance_squared.sqrt());
    apart.fold(f64::INFINITY, f64::min)
}

/// Sum of the radii \[m\].
fn radii() -> f64 {
    straight().wire_radius + ThreadMaterial::silk_2_0().radius
}

/// Moves both ends of the span across down by this much, with jaws on the needle's tail; returns their force on the
/// needle and that of the hands on the thread \[N\].
fn driven(down: f64) -> (Suture, [Vector3<f64>; 2]) {
    let (state, turn) = laid();
    let shape = straight();
    let at = state.needle.pose();
    let mut suture = suture(state);
    let ends = [turn, thread(&suture).positions.len() - 1];
    let begin = ends.map(|node| thread(&suture).positions[node]);
    let grips = [jaws(&shape, 1e-3, at, at)];
    for step in 1..=400 {
        let share = (f64::from(step) / 200.0).min(1.0);
        let holds = [0, 1].map(|k| Hold {
            node: ends[k],
            to: begin[k] - Vector3::z() * (down * share),
            stiffness: 1000.0,
            force_max: f64::INFINITY,
        });
        let around = StepInputs { holds: &holds, grips: &grips, ..StepInputs::default() };
        suture.step(DT, &around).unwrap_or_else(|why| panic!("step {step}: {why}"));
        let apart = nearest(&suture, turn);
        assert!(apart > 0.9 * radii(), "step {step}: {apart} m");
    }
    let forces = [suture.gripped()[0].force, suture.hold_forces().iter().sum()];
    (suture, forces)
}

#[test]
fn a_strand_drawn_over_the_wire_stays_outside_and_presses_it() {
    let (suture, [grip, hands]) = driven(3e-3);
    // The hands pull the thread down, and the jaws support the needle: the forces balance.
    assert!(grip.z > 0.1 && hands.z < -0.1, "{grip:?} N, {hands:?} N");
    assert!((grip + hands).norm() < 0.02 * grip.norm(), "{grip:?} N, {hands:?} N");
    assert!(!suture.state().strand_contacts.is_empty());
    let pressed: Vector3<f64> = suture.state().strand_contacts.iter().map(|contact| contact.force).sum();
    assert!((pressed.z + hands.z).abs() < 0.05 * pressed.z, "{pressed:?} N on the strand, {hands:?} N");
    // Moved only almost into contact, there is no force.
    let (_, [grip, _]) = driven(0.2e-3);
    assert!(grip.norm() < 5e-3, "{grip:?} N");
}

#[test]
fn a_strand_that_is_shot_at_the_wire_does_not_pass_and_gives_it_what_it_loses() {
    let (mut state, turn) = laid();
    let thread_state = state.thread.as_mut().expect("a thread");
    let material = ThreadMaterial::silk_2_0();
    // Five diameters a step.
    let speed = 5.0 * material.diameter() / DT;
    let last = thread_state.positions.len();
    thread_state.velocities[turn..last].fill(Vector3::new(0.0, 0.0, -speed));
    let of_thread = |state: &ThreadState| -> Vector3<f64> {
        let half =
            |edge: Option<usize>| edge.and_then(|edge| state.rest_lengths.get(edge)).copied().unwrap_or(0.0);
        (0..state.positions.len())
            .map(|node| {
                let length = 0.5 * (half(node.checked_sub(1)) + half(Some(node)));
                state.velocities[node] * (length * material.mass_per_length)
            })
            .sum()
    };
    let before = of_thread(thread_state);
    let mut suture = suture(state);
    for step in 0..10 {
        suture.step(DT, &StepInputs::default()).unwrap_or_else(|why| panic!("step {step}: {why}"));
        let apart = nearest(&suture, turn);
        assert!(apart > 0.85 * radii(), "step {step}: {apart} m");
    }
    let has = suture.state().needle.momentum;
    let lost = before - of_thread(thread(&suture));
    assert!(has.z < 0.2 * before.z, "{has:?} of {before:?} kg·m/s");
    assert!((has - lost).norm() < 1e-6 * has.norm(), "{has:?} for {lost:?} kg·m/s");
}
