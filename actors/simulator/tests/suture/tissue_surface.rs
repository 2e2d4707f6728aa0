//! Needle and thread on the surface of a tissue: it supports them, deforms, and holds them by friction up to Coulomb's
//! limit.

use crate::support::suture::*;
use nalgebra::{Point3, Vector3};
use trocar_simulator::suture::needle::NeedleShape;
use trocar_simulator::suture::{Resistance, StepInputs, Suture, Tissue};
use trocar_simulator::suture_thread::{Hold, Load, ThreadMaterial};

const DT: f64 = 1e-3;

/// Speed of an unloaded hand \[m/s\].
const SPEED: f64 = 0.05;
/// Load on the thread \[N\].
const DOWN: Vector3<f64> = Vector3::new(0.0, 0.0, -0.2);
/// Number and length of the thread's edges across the pad \[m\].
const EDGES: usize = 30;
const EDGE: f64 = 5e-4;

/// A thread across a pad, a tenth of a millimetre above it; the needle stands beside the pad, its tip down.
fn across(tissue: Tissue) -> Suture {
    let radius = ThreadMaterial::silk_2_0().radius;
    let shape = straight();
    // The tail points along x, where the thread leads: from beside the pad to its middle and beyond.
    let tip = Point3::new(-0.013 - shape.length(), 0.3e-3, radius + 1e-4);
    let at = pose(&shape, tip, -Vector3::x(), Vector3::z());
    threaded(&shape, &at, EDGES, EDGE, Resistance::default(), tissue)
}

/// Jaws hold the needle; nodes of the thread are loaded, ramped from one total force to another over half of the steps.
/// A hand pulls them along y with a force that is full at rest and zero at `SPEED`.
fn go(
    suture: &mut Suture,
    from: Vector3<f64>,
    to: Vector3<f64>,
    aside: f64,
    steps: usize,
) -> (Vector3<f64>, f64) {
    let here = suture.state().needle.pose();
    let grips = [jaws(suture.solid().shape(), 0.5 * suture.solid().shape().length(), here, here)];
    let (mut force, mut deepest) = (Vector3::zeros(), 0.0);
    for step in 0..steps {
        let share = (step + 1) as f64 / steps as f64;
        let load = (from + (to - from) * (2.0 * share).min(1.0)) / 9.0;
        let loads: Vec<Load> = (12..=20).map(|node| Load { node, force: load }).collect();
        let at = &suture.state().thread.as_ref().expect("a thread").positions;
        let hand = |node: usize| Hold {
            node,
            to: at[node] + Vector3::y() * (SPEED * DT),
            stiffness: aside / 9.0 / (SPEED * DT),
            force_max: f64::INFINITY,
        };
        let holds: Vec<Hold> = (12..=20).filter(|_| aside > 0.0).map(hand).collect();
        let around = StepInputs { grips: &grips, loads: &loads, holds: &holds, ..StepInputs::default() };
        let report = suture.step(DT, &around).unwrap_or_else(|why| panic!("step {step}: {why}"));
        (force, deepest) = (report.force_on_tissue, f64::max(deepest, report.penetration_max));
    }
    (force, deepest)
}

fn middle(suture: &Suture) -> Point3<f64> {
    suture.state().thread.as_ref().expect("a thread").positions[16]
}

#[test]
fn a_thread_pressed_on_a_tissue_is_borne_and_the_tissue_gives_way() {
    let mut suture = across(tissue(pad()));
    let (force, deepest) = go(&mut suture, Vector3::zeros(), DOWN, 0.0, 600);
    // The tissue bears the load on the thread, except for the part borne by bending at the needle's end.
    assert!((force.z + 0.2).abs() < 0.01, "{} N", force.z);
    assert!(deepest < 0.02 * ThreadMaterial::silk_2_0().diameter(), "{deepest} m");
    let (place, _) = suture.tissue().nearest(&middle(&suture));
    let dent = suture.tissue().at_rest(&place).z - suture.tissue().now(&place).z;
    assert!(dent > 2e-5, "{dent} m");
    let off = (middle(&suture) - suture.tissue().now(&place)).norm() - ThreadMaterial::silk_2_0().radius;
    assert!(off.abs() < 5e-6, "{off} m");
    // Released, it rises again with the surface.
    go(&mut suture, DOWN, Vector3::zeros(), 0.0, 600);
    assert!(suture.tissue().displacement_max() < 0.1 * dent, "{} m", suture.tissue().displacement_max());
}

#[test]
fn friction_of_the_surface_holds_a_thread_up_to_its_limit() {
    // So stiff that the thread makes no furrow, which would hold it as well.
    let mut suture = across(tissue_of(pad(), 1e7));
    go(&mut suture, Vector3::zeros(), DOWN, 0.0, 600);
    // A friction coefficient of 0.2: half of 0.04 N holds, twice as much does not.
    go(&mut suture, DOWN, DOWN, 0.02, 300);
    let before = middle(&suture);
    go(&mut suture, DOWN, DOWN, 0.02, 300);
    let crept = (middle(&suture) - before).norm();
    assert!(crept < 1e-6, "it creeps by {crept} m");
    let (force, _) = go(&mut suture, DOWN, DOWN, 0.08, 100);
    let slid = middle(&suture).y - before.y;
    assert!(slid > 5e-4, "it slides by {slid} m");
    let dragged = force.x.hypot(force.y) / force.z.abs();
    assert!((dragged - Resistance::default().thread_friction).abs() < 0.01, "it drags with {dragged}");
}

#[test]
fn a_needle_pressed_flat_on_a_tissue_stays_out_of_it() {
    let shape = straight();
    let height = shape.wire_radius + 1e-4;
    let start = pose(&shape, Point3::new(-0.02, 0.3e-3, height), -Vector3::x(), Vector3::z());
    let mut suture = bare(&shape, &start, Resistance::default(), tissue(pad()));
    let mut from = start;
    let mut force = Vector3::zeros();
    let mut felt = Vector3::zeros();
    for step in 0..200 {
        let mut to = start;
        to.translation.vector.z -= 6e-4 * (f64::from(step + 1) / 100.0).min(1.0);
        let grips = [jaws(&shape, 0.5 * shape.length(), from, to)];
        let around = StepInputs { grips: &grips, ..StepInputs::default() };
        force = suture.step(DT, &around).unwrap_or_else(|why| panic!("step {step}: {why}")).force_on_tissue;
        felt = suture.gripped()[0].force;
        from = to;
    }
    assert!(force.z < -0.3, "{} N", force.z);
    assert!((felt.z - force.z).abs() < 1e-3 * force.z.abs(), "{} N held, {} N pressed", felt.z, force.z);
    assert!(suture.state().bites.is_empty());
    // All along the pad, the wire is on the surface: neither far above it nor inside.
    let needle = suture.state().needle.pose();
    let solid = suture.solid();
    let mut touching = 0;
    for sample in 0..=400 {
        let along = shape.length() * f64::from(sample) / 400.0;
        let at = needle * solid.point(along);
        if at.x.abs() > 0.011 {
            continue;
        }
        let (place, _) = suture.tissue().nearest(&at);
        let gap = (at - suture.tissue().now(&place)).norm() - shape.wire_radius_at(along);
        assert!(gap > -2e-5, "{gap} m at x = {} m", at.x);
        touching += i32::from(gap < 1e-5);
    }
    assert!(touching > 20, "{touching} places touch");
    // And away again: there is no adhesion.
    for _ in 0..100 {
        let mut to = from;
        to.translation.vector.z += 1e-5;
        let grips = [jaws(&shape, 0.5 * shape.length(), from, to)];
        suture.step(DT, &StepInputs { grips: &grips, ..StepInputs::default() }).expect("a step");
        from = to;
    }
    assert!(suture.state().needle_contacts.is_empty() && suture.state().presses.is_empty());
    assert!(suture.tissue().displacement_max() < 1e-12);
}

#[test]
fn what_lies_on_a_tissue_goes_on_bit_for_bit_from_its_state() {
    let mut suture = across(tissue(pad()));
    go(&mut suture, Vector3::zeros(), DOWN, 0.0, 300);
    go(&mut suture, DOWN, DOWN, 0.05, 50);
    let state = suture.state().clone();
    assert!(!state.presses.is_empty());
    let material = Some(ThreadMaterial::silk_2_0());
    let mut other =
        Suture::new(&straight(), material, Resistance::default(), tissue(pad()), state).expect("a suture");
    go(&mut suture, DOWN, DOWN, 0.05, 50);
    go(&mut other, DOWN, DOWN, 0.05, 50);
    assert_eq!(suture.state(), other.state());
}

#[test]
fn a_needle_with_a_thread_that_falls_on_a_tissue_comes_to_rest_on_it() {
    let shape = NeedleShape::half_circle_26();
    // Flat, three millimetres over the pad.
    let start = pose(&shape, Point3::new(0.0, 8e-3, 3e-3), -Vector3::x(), Vector3::z());
    let mut suture = threaded(&shape, &start, 20, EDGE, Resistance::default(), tissue(pad()));
    let around = StepInputs { gravity: Vector3::new(0.0, 0.0, -9.81), ..StepInputs::default() };
    for step in 0..600 {
        suture.step(DT, &around).unwrap_or_else(|why| panic!("step {step}: {why}"));
    }
    assert!(suture.state().bites.is_empty());
    let thread = suture.state().thread.as_ref().expect("a thread");
    let lowest = thread.positions.iter().map(|point| point.z).fold(f64::INFINITY, f64::min);
    assert!(lowest > 0.0, "{lowest} m");
    let needle = suture.state().needle.kinetic_energy(suture.solid());
    assert!(needle < 1e-3 * suture.solid().mass() * 9.81 * 3e-3, "{needle} J");
    let borne: f64 = suture.state().presses.iter().map(|press| -press.force.z).sum();
    let weight = 9.81 * suture.solid().mass();
    assert!((borne / weight - 1.0).abs() < 0.05, "{borne} N borne, {weight} N");
}
