//! Procedural shapes: closed, manifold, outward-oriented, of the right volume.

use std::f64::consts::{PI, TAU};
use std::path::Path;

use proptest::prelude::*;
use trocar_scene::mesh::{SurfaceData, SurfacePolicy, validate_surface};
use trocar_scene::shapes::{self, Detail, PegBoard, ShapeError};
use trocar_scene::{Instrument, InstrumentKind, Shape};

/// Closed, manifold and oriented; `bodies` of them with this Euler characteristic in all; unit normals on the
/// outside; texture coordinates in range.
fn assert_proper(name: &str, surface: &SurfaceData, bodies: usize, euler: i64) {
    let report = validate_surface(surface);
    SurfacePolicy::SOLID.require(Path::new(name), &report).unwrap_or_else(|error| panic!("{error}"));
    assert_eq!((report.components, report.euler_characteristic()), (bodies, euler), "{name}: {report}");
    assert_eq!(report.unreferenced.count, 0, "{name}");
    assert!(surface.volume() > 0.0, "{name} is inside out");
    let normals = surface.normals.as_ref().expect("normals");
    let uvs = surface.uvs.as_ref().expect("texture coordinates");
    assert_eq!((normals.len(), uvs.len()), (surface.triangles.len(), surface.triangles.len()));
    for (t, corners) in normals.iter().enumerate() {
        let face = surface.area_vector(t).normalize();
        for normal in corners {
            assert!((normal.norm() - 1.0).abs() < 1e-12, "{name}: normal of triangle {t}");
            assert!(
                normal.dot(&face) > 0.4,
                "{name}: triangle {t} has a normal {normal} against its face {face}"
            );
        }
    }
    assert!(uvs.iter().flatten().flatten().all(|x| (-1e-12..=1.0 + 1e-12).contains(x)), "{name}");
}

/// The error falls with the square of the number of segments.
fn assert_converges(name: &str, exact: f64, volume: impl Fn(usize) -> f64) {
    let errors: Vec<f64> = [16, 32, 64, 128].map(|n| (volume(n) / exact - 1.0).abs()).to_vec();
    for pair in errors.windows(2) {
        assert!((3.5..4.5).contains(&(pair[0] / pair[1])), "{name}: {errors:?}");
    }
    assert!(errors[3] < 2e-3, "{name}: {errors:?}");
}

#[test]
fn a_box_is_a_box() {
    let surface = shapes::cuboid([0.1, 0.2, 0.3]).expect("a box");
    assert_proper("box", &surface, 1, 2);
    assert_eq!((surface.positions.len(), surface.triangles.len()), (8, 12));
    assert!((surface.volume() - 0.048).abs() < 1e-15);
    assert!((surface.area() - 8.0 * (0.02 + 0.06 + 0.03)).abs() < 1e-15);
    // 24 vertices once split: three normals at each corner.
    assert_eq!(surface.split().positions.len(), 24);
}

#[test]
fn a_cylinder_has_the_volume_of_its_polygon_and_converges() {
    let (r, h) = (0.02, 0.05);
    for n in [3, 4, 7, 48] {
        let surface = shapes::cylinder(r, h, n).expect("a cylinder");
        assert_proper("cylinder", &surface, 1, 2);
        let polygon = 0.5 * n as f64 * r * r * (TAU / n as f64).sin();
        assert!((surface.volume() / (2.0 * h * polygon) - 1.0).abs() < 1e-12);
    }
    assert_converges("cylinder", PI * r * r * 2.0 * h, |n| {
        shapes::cylinder(r, h, n).expect("valid").volume()
    });
}

#[test]
fn a_sphere_and_a_capsule_converge() {
    let (r, h) = (0.02, 0.05);
    assert_proper("sphere", &shapes::sphere(r, 12, 3).expect("valid"), 1, 2);
    assert_proper("capsule", &shapes::capsule(r, h, 12, 3).expect("valid"), 1, 2);
    let ball = 4.0 / 3.0 * PI * r.powi(3);
    assert_converges("sphere", ball, |n| shapes::sphere(r, n, n / 4).expect("valid").volume());
    assert_converges("capsule", ball + PI * r * r * 2.0 * h, |n| {
        shapes::capsule(r, h, n, n / 4).expect("valid").volume()
    });
    for (t, corners) in shapes::sphere(1.0, 24, 6).expect("valid").normals.iter().flatten().enumerate() {
        let surface = shapes::sphere(1.0, 24, 6).expect("valid");
        for (normal, position) in corners.iter().zip(surface.corners(t)) {
            let pole = position.xy().coords.norm() < 1e-9;
            assert!((normal - position.coords).norm() < if pole { 1e-9 } else { 1e-12 });
        }
    }
}

#[test]
fn a_torus_has_a_hole_and_converges() {
    let (ring, tube) = (0.008, 0.0015);
    let surface = shapes::torus(ring, tube, 24, 8).expect("valid");
    assert_proper("torus", &surface, 1, 0);
    assert_converges("torus", 2.0 * PI * PI * ring * tube * tube, |n| {
        shapes::torus(ring, tube, n, n).expect("valid").volume()
    });
    assert!(matches!(
        shapes::torus(0.001, 0.001, 8, 8),
        Err(ShapeError::OutOfRange { field: "ring_radius", .. })
    ));
}

fn board() -> PegBoard {
    let pegs = [-0.015, 0.015].iter().flat_map(|y| [-0.028, 0.0, 0.028].map(|x| [x, *y])).collect();
    PegBoard {
        half_extents: [0.0385, 0.028],
        thickness: 0.01,
        pegs,
        peg_radius: 0.001,
        peg_height: 0.02,
        segments: 12,
    }
}

#[test]
fn a_peg_board_is_one_body_of_the_right_volume() {
    let board = board();
    let surface = shapes::peg_board(&board).expect("valid");
    assert_proper("peg board", &surface, 1, 2);
    let n = board.segments as f64;
    let peg = 0.5 * n * board.peg_radius.powi(2) * (TAU / n).sin() * board.peg_height;
    let expected = 4.0 * 0.0385 * 0.028 * 0.01 + 6.0 * peg;
    assert!((surface.volume() / expected - 1.0).abs() < 1e-12);
    let highest = surface.positions.iter().map(|p| p.z).fold(f64::MIN, f64::max);
    let lowest = surface.positions.iter().map(|p| p.z).fold(f64::MAX, f64::min);
    assert_eq!((highest, lowest), (0.02, -0.01));

    let overlapping = PegBoard { pegs: vec![[0.0, 0.0], [0.0015, 0.0]], ..board.clone() };
    assert_eq!(
        shapes::peg_board(&overlapping),
        Err(ShapeError::Peg { peg: 1, problem: "overlaps an earlier peg" })
    );
    let outside = PegBoard { pegs: vec![[0.038, 0.0]], ..board };
    assert!(matches!(shapes::peg_board(&outside), Err(ShapeError::Peg { peg: 0, .. })));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]
    #[test]
    fn any_pegs_that_do_not_overlap_make_a_proper_board(
        pegs in prop::collection::vec((-0.036..0.036f64, -0.026..0.026f64), 0..24),
        segments in 3usize..16,
    ) {
        let mut apart: Vec<[f64; 2]> = Vec::new();
        for (x, y) in pegs {
            if apart.iter().all(|[ox, oy]| (x - ox).hypot(y - oy) > 0.0021) {
                apart.push([x, y]);
            }
        }
        let board = PegBoard { pegs: apart, segments, ..board() };
        let surface = shapes::peg_board(&board).expect("valid");
        let report = validate_surface(&surface);
        prop_assert!(report.is_closed() && report.is_manifold() && report.is_oriented(), "{}", report);
        prop_assert_eq!((report.euler_characteristic(), report.degenerate.count), (2, 0));
        let n = segments as f64;
        let peg = 0.5 * n * 1e-6 * (TAU / n).sin() * 0.02;
        let expected = 4.0 * 0.0385 * 0.028 * 0.01 + board.pegs.len() as f64 * peg;
        prop_assert!((surface.volume() / expected - 1.0).abs() < 1e-9);
    }
}

#[test]
fn instruments_have_a_shaft_and_jaws_that_meet_at_the_tip() {
    let build = Instrument::default();
    for (kind, jaws, bodies) in [
        (InstrumentKind::Grasper, 2, 3),
        (InstrumentKind::Grasper, 1, 2),
        (InstrumentKind::Grasper, 0, 1),
        (InstrumentKind::Scissors, 2, 3),
        (InstrumentKind::NeedleDriver, 2, 3),
        (InstrumentKind::Probe, 2, 1),
        (InstrumentKind::HookCautery, 0, 2),
        (InstrumentKind::Retractor, 0, 2),
        (InstrumentKind::BandPasser, 0, 2),
        (InstrumentKind::LoopApplier, 0, 2),
        (InstrumentKind::KnotPusher, 0, 3),
    ] {
        let instrument = Instrument { kind, jaws, ..build.clone() };
        let parts = shapes::instrument_surface(&instrument, 24).expect("valid");
        let name = format!("{kind:?} with {jaws} jaws");
        assert_proper(&name, &parts.assembled(0.5), bodies, 2 * bodies as i64);
    }
    let hook = Instrument { kind: InstrumentKind::HookCautery, ..build.clone() };
    let whole = shapes::instrument_surface(&hook, 24).expect("valid").assembled(0.0);
    let reach = |axis: usize| whole.positions.iter().map(|p| p[axis]).fold(f64::MIN, f64::max);
    // Its heel is the tip, and its toe is at a right angle to the shaft, as long as it is said to be.
    assert!(reach(2).abs() < 1e-12 && (reach(0) - 0.45 * build.jaw_length).abs() < 1e-12);
    let volume = shapes::working_end(&hook)[0].surface(240).volume();
    let wire = 0.5 * build.jaw_thickness;
    let length = build.jaw_length - wire + 0.45 * build.jaw_length;
    // The mitre takes away on one side what it adds on the other.
    assert!((volume / (std::f64::consts::PI * wire * wire * length) - 1.0).abs() < 1e-3);
    let parts = shapes::instrument_surface(&build, 24).expect("valid");
    let [a, b] = [&parts.jaw_a, &parts.jaw_b].map(|jaw| jaw.as_ref().expect("two jaws"));
    assert!((a.volume() - b.volume()).abs() < 1e-18);
    // Closed, the pads lie in x = 0, A on the +x side, and reach to the tip, z = 0 of the instrument.
    assert!(a.positions.iter().all(|p| p.x >= 0.0) && b.positions.iter().all(|p| p.x <= 0.0));
    let closed = parts.assembled(0.0);
    let tip = closed.positions.iter().map(|p| p.z).fold(f64::MIN, f64::max);
    let handle = closed.positions.iter().map(|p| p.z).fold(f64::MAX, f64::min);
    assert!(tip.abs() < 1e-15 && (handle + build.shaft_length).abs() < 1e-12);
    // Opening by an angle moves the tips apart by twice the chord.
    let open = 0.6;
    let at_tip =
        |side: f64| parts.instrument_from_jaw(side, open) * nalgebra::Point3::new(0.0, 0.0, build.jaw_length);
    let gap = (at_tip(1.0) - at_tip(-1.0)).norm();
    assert!((gap - 2.0 * build.jaw_length * (open / 2.0f64).sin()).abs() < 1e-15);
    assert!(at_tip(1.0).x > 0.0);
}

#[test]
fn every_shape_component_has_a_surface() {
    let pegs = board().pegs;
    for (shape, euler) in [
        (Shape::Box { half_extents: [0.1; 3] }, 2),
        (Shape::Sphere { radius: 0.1 }, 2),
        (Shape::Cylinder { radius: 0.1, half_height: 0.2 }, 2),
        (Shape::Capsule { radius: 0.1, half_height: 0.2 }, 2),
        (Shape::Torus { ring_radius: 0.008, tube_radius: 0.0015 }, 0),
        (
            Shape::PegBoard {
                half_extents: [0.04, 0.03],
                thickness: 0.01,
                pegs,
                peg_radius: 0.001,
                peg_height: 0.02,
            },
            2,
        ),
    ] {
        let surface = shapes::surface_of(&shape, &Detail::default()).expect("valid");
        assert_proper(&format!("{shape:?}"), &surface, 1, euler);
    }
    let bad = Shape::Sphere { radius: -1.0 };
    assert!(matches!(shapes::surface_of(&bad, &Detail::default()), Err(ShapeError::Refused(_))));
    let coarse = Detail { segments: 2, fine_segments: 8 };
    assert_eq!(
        shapes::surface_of(&Shape::Sphere { radius: 1.0 }, &coarse),
        Err(ShapeError::Segments { segments: 2 })
    );
    assert!(
        shapes::cylinder(f64::NAN, 1.0, 8).is_err() && shapes::cuboid([1.0, f64::INFINITY, 1.0]).is_err()
    );
}
