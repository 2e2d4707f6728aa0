//! A loose needle falls onto rigid bodies and lies there, whatever its speed: nothing passes through.

use nalgebra::{Isometry3, Point3, UnitQuaternion, Vector3};
use trocar_simulator::suture::needle::{NeedleShape, NeedleState};
use trocar_simulator::suture::{Resistance, StepInputs, Suture, SutureReport, SutureState};
use trocar_simulator::suture_thread::{Obstacle, Shape};

use crate::support::suture::nowhere;

const G: f64 = 9.81;
const WIRE: f64 = 3e-4;

/// A half circle of 26 mm.
fn half_circle() -> NeedleShape {
    let angle = std::f64::consts::PI;
    NeedleShape { radius: 0.026 / angle, angle, wire_radius: WIRE, taper: 5e-3, density: 7900.0 }
}

/// A needle, tilted by `tilt` about x from lying flat, its centre of mass at this height, that falls with this speed.
fn needle(height: f64, tilt: f64, speed: f64) -> Suture {
    let rotation = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), tilt);
    let at = Isometry3::from_parts(Vector3::new(0.0, 0.0, height).into(), rotation);
    let shape = half_circle();
    let mass = shape.solid().expect("a needle").mass();
    let momentum = Vector3::new(0.0, 0.0, -speed * mass);
    let state = SutureState::new(NeedleState { momentum, ..NeedleState::at_rest(&at) }, None);
    Suture::new(&shape, None, Resistance::default(), nowhere(), state).expect("a suture")
}

/// Points of its axis, and the wire's radius there \[m\].
fn axis(suture: &Suture) -> impl Iterator<Item = (Point3<f64>, f64)> {
    let (solid, pose) = (suture.solid(), suture.state().needle.pose());
    let along = (0..=64).map(|at| solid.shape().length() * f64::from(at) / 64.0);
    along.map(move |along| (pose * solid.point(along), solid.shape().wire_radius_at(along)))
}

/// The least height of its wire over the plane z = 0 \[m\].
fn clearance(suture: &Suture) -> f64 {
    axis(suture).map(|(point, radius)| point.z - radius).fold(f64::INFINITY, f64::min)
}

/// Its axis is above the plane z = 0, also where the wire is thin.
fn is_above(suture: &Suture) -> bool {
    axis(suture).all(|(point, _)| point.z > 0.0)
}

fn fall(suture: &mut Suture, obstacles: &[Obstacle<'_>], dt: f64, gravity: f64) -> SutureReport {
    let gravity = Vector3::new(0.0, 0.0, -gravity);
    let around = StepInputs { gravity, obstacles, ..StepInputs::default() };
    suture.step(dt, &around).expect("a step")
}

/// A plate of 80 mm at z = 0, of two triangles.
const CORNERS: [[f64; 2]; 4] = [[-0.04, -0.04], [0.04, -0.04], [0.04, 0.04], [-0.04, 0.04]];
const TRIANGLES: [[u32; 3]; 2] = [[0, 1, 2], [0, 2, 3]];

fn corners() -> [Point3<f64>; 4] {
    CORNERS.map(|[x, y]| Point3::new(x, y, 0.0))
}

#[test]
fn a_needle_that_falls_onto_a_table_lies_flat_and_stays() {
    let corners = corners();
    let shape = Shape::Mesh { from: &corners, to: &corners, triangles: &TRIANGLES, radius: 0.0 };
    let plane = Shape::HalfSpace { normal: Vector3::z() };
    for shape in [shape, plane] {
        for (tilt, dt) in [(0.0, 2e-3), (0.4, 2e-3), (0.4, 1e-3), (2.2, 2e-3)] {
            let table = [Obstacle::fixed(shape, Isometry3::identity(), 0.3)];
            let mut suture = needle(0.03, tilt, 0.0);
            let mut last = SutureReport::default();
            for _ in 0..(1.2 / dt) as usize {
                last = fall(&mut suture, &table, dt, G);
                // A plane's depth is known on both sides: what a turn brings below it comes back.
                let depth_max = if shape == plane { WIRE } else { f64::INFINITY };
                let keeps_out = -clearance(&suture) < depth_max && (shape == plane || is_above(&suture));
                assert!(keeps_out, "{shape:?}, tilt {tilt}, {dt} s: {}", clearance(&suture));
            }
            let before = suture.state().needle.pose();
            for _ in 0..(0.5 / dt) as usize {
                last = fall(&mut suture, &table, dt, G);
            }
            let (state, solid) = (suture.state(), suture.solid());
            let found = format!("{shape:?}, tilt {tilt}, {dt} s: {:?}, {last:?}", state.needle);
            // It lies on its wire, and on its tip, which is thinner.
            let upright = (state.needle.rotation * Vector3::z()).z.abs();
            assert!(upright > 0.999, "{found}");
            assert!(clearance(&suture).abs() < 5e-5, "{found}: {}", clearance(&suture));
            assert!((state.needle.center.z - WIRE).abs() < 0.2 * WIRE, "{found}");
            assert!(state.needle.velocity(solid).norm() < 1e-4, "{found}");
            let moved = (state.needle.pose().translation.vector - before.translation.vector).norm();
            assert!(moved < 1e-4, "{found}: it creeps by {moved} m");
            // The table bears its weight, in one step without parts.
            assert!((last.force_on_instruments / (solid.mass() * G) - 1.0).abs() < 0.02, "{found}");
            assert_eq!(last.parts, 1, "{found}");
        }
    }
}

#[test]
fn a_fast_needle_does_not_pass_through_a_plate() {
    let corners = corners();
    let shape = Shape::Mesh { from: &corners, to: &corners, triangles: &TRIANGLES, radius: 0.0 };
    for speed in [0.5, 1.0, 3.0] {
        for tilt in [0.0, 0.7, 1.5] {
            let plate = [Obstacle::fixed(shape, Isometry3::identity(), 0.3)];
            let mut suture = needle(0.02, tilt, speed);
            for _ in 0..50 {
                fall(&mut suture, &plate, 2e-3, 0.0);
                assert!(is_above(&suture), "{speed} m/s, tilt {tilt}: {}", clearance(&suture));
            }
        }
    }
}

#[test]
fn a_needle_that_falls_onto_a_ball_slides_off_it() {
    let ball = [Obstacle::fixed(Shape::Sphere { radius: 5e-3 }, Isometry3::identity(), 0.1)];
    let mut suture = needle(8e-3, 0.0, 0.0);
    let mut pressed = false;
    for _ in 0..400 {
        let report = fall(&mut suture, &ball, 2e-3, G);
        pressed |= report.force_on_instruments > 0.0;
        let nearest = axis(&suture).map(|(point, _)| point.coords.norm()).fold(f64::INFINITY, f64::min);
        assert!(nearest > 5e-3, "{nearest}");
    }
    assert!(pressed && suture.state().needle.center.z < -0.05, "{:?}", suture.state().needle);
}
