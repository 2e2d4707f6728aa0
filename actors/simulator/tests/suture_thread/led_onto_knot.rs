//! An instrument that a hand leads onto a knot: the knot stops it, and no step takes many times as long as the others.

use nalgebra::{Isometry3, Point3, Vector3};
use trocar_dynamics::instrument::hand_coupling::HandCoupling;
use trocar_simulator::suture_thread::knot::{KnotKind, identify};
use trocar_simulator::suture_thread::{
    Hold, LedInstrument, Obstacle, Shape, Surroundings, Thread, ThreadMaterial,
};

use crate::support::thread::{Bend, loose_knot};

const DT: f64 = 1e-3;
/// How far the hand leads the instrument \[m\].
const WAY: f64 = 4e-3;
/// Time for which the hand then stands still \[s\].
const REST: f64 = 0.02;
/// Most Newton steps on the contact laws in a step: two searches for the states of strands that fail, and a bit. Steps in
/// which friction of former solutions was tried then took 340 to 550.
const SWEEPS_MOST: usize = 280;

/// A shaft along y.
struct Shaft {
    radius: f64,
    friction: f64,
    /// Of the hand, down \[m/s\].
    speed: f64,
    /// Where it comes down, as a share of the way from the knot to the end of an ear.
    aside: f64,
}

/// Leads it down onto the tight knot; returns the most Newton steps in a step, and how far it is held back \[m\].
fn led_onto(tight: &Thread, arms: [usize; 2], shaft: &Shaft) -> (usize, f64) {
    let (material, state) = (*tight.material(), tight.state());
    let mut thread = Thread::restore(material, state.clone()).expect("a thread");
    let last = state.positions.len() - 1;
    let in_knot = state.positions.iter().filter(|node| node.x.abs() < 2e-3 && node.z > -1e-3);
    let (sum, count) = in_knot.fold((0.0, 0.0), |(sum, count), node| (sum + node.y, count + 1.0));
    let end = state.positions[if state.positions[last].x > 0.0 { last } else { 0 }];
    let (x, y) = (end.x * shaft.aside, sum / count);
    let below = state.positions.iter().filter(|node| (node.x - x).abs() < 1e-3 && node.z > -2e-3);
    let top = below.map(|node| node.z).fold(f64::NEG_INFINITY, f64::max);
    let mut hand = top + shaft.radius + material.radius + 2e-4;
    let loop_end =
        |arm: usize| Hold { node: arms[arm], to: state.positions[arms[arm]], stiffness: 1e3, force_max: 2.0 };
    let ear_end = |node: usize| Hold::fixed(node, state.positions[node]);
    let holds = [loop_end(0), loop_end(1), ear_end(0), ear_end(last)];
    let mut led = LedInstrument {
        obstacles: [0, 0],
        coupling: HandCoupling::critically_damped(0.03, 1000.0, 20.0),
        offset: Vector3::zeros(),
        velocity: Vector3::zeros(),
    };
    let moving = (WAY / shaft.speed / DT).round() as usize;
    let mut most = 0;
    for step in 0..moving + (REST / DT) as usize {
        let by = if step < moving { -shaft.speed * DT } else { 0.0 };
        let at = |z: f64| Isometry3::translation(x, y, z);
        let ends = [-0.01, 0.01].map(|y| Point3::new(0.0, y, 0.0));
        let obstacles = [Obstacle {
            shape: Shape::Capsule { ends, radius: shaft.radius },
            from: at(hand),
            to: at(hand + by),
            friction: shaft.friction,
            mobility: None,
        }];
        let around = Surroundings {
            gravity: -9.81 * Vector3::z(),
            holds: &holds,
            obstacles: &obstacles,
            led: &[led],
            ..Surroundings::default()
        };
        let report = thread.step(DT, &around).unwrap_or_else(|error| panic!("step {step}: {error}"));
        most = most.max(report.sweeps);
        hand += by;
        let motion = thread.led()[0];
        (led.offset, led.velocity) = (motion.offset, motion.velocity);
    }
    assert_eq!(identify(thread.positions()).expect("a knot").kind, KnotKind::Square);
    (most, led.offset.norm())
}

#[test]
fn an_instrument_on_a_knot_takes_no_step_many_times_as_long_as_the_others() {
    let material = ThreadMaterial { friction: 0.3, ..ThreadMaterial::silk_2_0() };
    let points = loose_knot(&[3, -3], material.radius, 1.5 * material.diameter());
    let mut bend = Bend::new(Thread::new(material, &points).expect("a thread"));
    bend.tighten(4.0, 0.25, DT);
    for shaft in [
        Shaft { radius: 5e-4, friction: 0.3, speed: 0.02, aside: 0.0 },
        Shaft { radius: 1.8e-3, friction: 0.2, speed: 0.05, aside: 0.0 },
        Shaft { radius: 5e-4, friction: 0.2, speed: 0.05, aside: 0.3 },
    ] {
        let (most, held_back) = led_onto(&bend.thread, bend.arms, &shaft);
        let Shaft { radius, aside, .. } = shaft;
        println!("radius {radius}, aside {aside}: {most} Newton steps, held back by {held_back} m");
        assert!(most <= SWEEPS_MOST, "radius {radius}, aside {aside}: {most} Newton steps in a step");
        assert!(held_back > 0.5 * WAY, "radius {radius}, aside {aside}: held back by {held_back} m");
    }
}
