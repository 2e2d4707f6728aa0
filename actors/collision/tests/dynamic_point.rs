//! The dynamic point: against brute force while an organ heaves and is cut, and against what can be worked out by hand.

use crate::support::organ::line_trial::{Trial, run};
use crate::support::organ::shapes::cuboid;
use nalgebra::{Point3, Rotation3, Vector3};
use trocar_collision::Surface;
use trocar_collision::dynamic_point::{DynamicPoint, LineConfig, LineContact, LineContactKind, LineError};
use trocar_collision::moving_surface::MovingSurface;

const SHAFT: LineConfig = LineConfig { segments: 1, radius: 0.0025, margin: 0.0 };

const HEAVING: Trial = Trial {
    triangles: 1_500,
    steps: 0,
    seed: 0,
    deforms_every: 1,
    cuts_every: 700,
    interval_secs: 0.001,
    hand_rests: false,
    config: SHAFT,
};

/// Steps of the trials; a long run sets `TROCAR_LINE_STEPS`.
fn steps() -> usize {
    std::env::var("TROCAR_LINE_STEPS").ok().and_then(|steps| steps.parse().ok()).unwrap_or(4_000)
}

#[test]
fn no_contact_is_missed_on_an_organ_that_folds_heaves_and_is_cut() {
    for (seed, config) in [
        (1, LineConfig { segments: 6, radius: 0.0025, margin: 0.0 }),
        (2, LineConfig { segments: 3, radius: 0.0, margin: 0.0 }),
        (3, LineConfig { segments: 12, radius: 0.0015, margin: 0.002 }),
    ] {
        let trial = Trial { steps: steps(), seed, config, ..HEAVING };
        let outcome = run(&trial, |_, _| {});
        assert!(outcome.in_contact > trial.steps as u64 / 20 && outcome.statistics.hops > 20, "{outcome:?}");
        assert_eq!((outcome.missed, outcome.invented), (0, 0), "{outcome:?}");
        assert!(outcome.error < 1e-12, "{outcome:?}");
        // Coherence is used, not the tree at every turn.
        assert!(outcome.statistics.fallback_rate() < 0.1, "{outcome:?}");
    }
}

#[test]
fn no_contact_is_missed_when_the_hand_and_the_organ_rush() {
    let config = LineConfig { segments: 6, radius: 0.0025, margin: 0.0 };
    // A deformation of 50 steps at once, every 50 steps.
    let trial = Trial { steps: steps() / 2, seed: 9, deforms_every: 50, cuts_every: 333, config, ..HEAVING };
    let outcome = run(&trial, |_, _| {});
    assert!(outcome.in_contact > 0 && outcome.missed == 0 && outcome.invented == 0, "{outcome:?}");
}

#[test]
fn no_contact_is_missed_when_the_organ_comes_to_a_hand_that_rests() {
    let config = LineConfig { segments: 6, radius: 0.0025, margin: 0.0 };
    let trial = Trial { steps: steps(), seed: 4, interval_secs: 0.01, hand_rests: true, config, ..HEAVING };
    let outcome = run(&trial, |_, _| {});
    assert!(outcome.in_contact > trial.steps as u64 / 20, "{outcome:?}");
    assert_eq!((outcome.missed, outcome.invented), (0, 0), "{outcome:?}");
    assert!(outcome.error < 1e-12, "{outcome:?}");
}

/// A square plate of `cells` × `cells` cells in the plane z = 0, outward up, 2 m wide.
fn plate(cells: u32) -> (Vec<Point3<f64>>, Vec<[u32; 3]>) {
    let place = |step: u32| f64::from(step) / f64::from(cells) * 2.0 - 1.0;
    let vertices =
        (0..=cells).flat_map(|y| (0..=cells).map(move |x| Point3::new(place(x), place(y), 0.0))).collect();
    let at = |x: u32, y: u32| y * (cells + 1) + x;
    let triangles = (0..cells)
        .flat_map(|y| {
            (0..cells).flat_map(move |x| {
                let (a, b, c, d) = (at(x, y), at(x + 1, y), at(x + 1, y + 1), at(x, y + 1));
                [[a, b, c], [a, c, d]]
            })
        })
        .collect();
    (vertices, triangles)
}

fn contact(
    config: LineConfig,
    (vertices, triangles): &(Vec<Point3<f64>>, Vec<[u32; 3]>),
    line: [Point3<f64>; 2],
) -> Option<LineContact> {
    let mesh = MovingSurface::new(&Surface::new(vertices, triangles).expect("a surface"));
    let mut method = DynamicPoint::new(config).expect("a valid line");
    method.update(&mesh, &line).expect("a finite line");
    method.distinct_contacts().next().copied()
}

#[test]
fn a_shaft_that_lies_on_a_plane_is_radius_less_distance_deep() {
    let plate = plate(7);
    for height in [1e-5, 0.001, 0.002_49] {
        let line = [Point3::new(-0.3, 0.1, height), Point3::new(0.4, 0.2, height)];
        let found = contact(SHAFT, &plate, line).expect("it touches");
        assert_eq!(found.kind, LineContactKind::Outside);
        assert!((found.depth - (SHAFT.radius - height)).abs() < 1e-12, "{found:?}");
        assert!((found.direction - Vector3::z()).norm() < 1e-9, "{found:?}");
        assert!((found.on_line - found.on_surface - Vector3::z() * height).norm() < 1e-12);
    }
    let above = [Point3::new(-0.3, 0.1, 0.003), Point3::new(0.4, 0.2, 0.003)];
    assert!(contact(SHAFT, &plate, above).is_none());
    let foreseen = contact(LineConfig { margin: 0.001, ..SHAFT }, &plate, above).expect("within the margin");
    assert!((foreseen.depth + 0.0005).abs() < 1e-12, "{foreseen:?}");
}

#[test]
fn a_tip_in_a_half_space_is_as_deep_as_the_capsule() {
    let plate = plate(7);
    for (tilt, inside) in [(0.0, 0.004), (0.7, 0.02), (1.2, 0.001), (0.3, 1e-7)] {
        let axis = Rotation3::from_axis_angle(&Vector3::x_axis(), tilt) * Vector3::z();
        let tip = Point3::new(0.111, 0.073, -inside);
        let found = contact(SHAFT, &plate, [tip + axis * 0.2, tip]).expect("it touches");
        assert_eq!(found.kind, LineContactKind::Crossing);
        assert!((found.depth - (SHAFT.radius + inside)).abs() < 1e-12, "{tilt}: {found:?}");
        assert!((found.direction - Vector3::z()).norm() < 1e-12 && found.distance == 0.0);
        assert!(found.on_surface.z.abs() < 1e-12, "the point is where it crosses");
        // Which of the ends is the tip does not matter.
        let turned = contact(SHAFT, &plate, [tip, tip + axis * 0.2]).expect("it touches");
        assert!((turned.depth - found.depth).abs() < 1e-12 && turned.direction == found.direction);
    }
}

#[test]
fn a_skewer_is_as_deep_as_what_it_pierces_is_thick() {
    let slab = cuboid(Vector3::new(0.05, 0.05, 0.002));
    let through = [Point3::new(0.01, 0.005, 0.1), Point3::new(0.01, 0.005, -0.1)];
    let found = contact(SHAFT, &slab, through).expect("it pierces");
    assert_eq!(found.kind, LineContactKind::Crossing);
    assert!((found.depth - (SHAFT.radius + 0.004)).abs() < 1e-12, "{found:?}");
    // Nearer to a side than the slab is thick: out through that side.
    let corner = cuboid(Vector3::new(0.05, 0.05, 0.02));
    let cut = [Point3::new(0.049, 0.0, 0.021), Point3::new(0.051, 0.0, 0.019)];
    let found = contact(SHAFT, &corner, cut).expect("it cuts the edge");
    assert!(found.depth < SHAFT.radius + 0.0011 && found.distance == 0.0, "{found:?}");
}

#[test]
fn a_shaft_behind_a_wall_is_pushed_out_of_it() {
    let block = cuboid(Vector3::new(0.05, 0.05, 0.05));
    let line = [Point3::new(-0.01, 0.0, 0.049), Point3::new(0.01, 0.0, 0.049)];
    let found = contact(SHAFT, &block, line).expect("it touches");
    assert_eq!(found.kind, LineContactKind::Behind);
    assert!((found.depth - (SHAFT.radius + 0.001)).abs() < 1e-12, "{found:?}");
    assert!((found.direction - Vector3::z()).norm() < 1e-9);
    // Outside of an edge and of a corner it is outside, whichever face is nearest.
    let off = 0.001 / 3.0_f64.sqrt();
    let beside = [Point3::new(0.05 + off, 0.05 + off, 0.05 + off); 2];
    let found = contact(SHAFT, &block, beside).expect("it touches");
    assert_eq!(found.kind, LineContactKind::Outside);
    assert!(
        (found.depth - 0.0015).abs() < 1e-12
            && (found.direction - Vector3::repeat(1.0 / 3.0_f64.sqrt())).norm() < 1e-9
    );
}

#[test]
fn depth_does_not_depend_on_where_it_is_and_scales_with_the_scene() {
    let turn = Rotation3::from_euler_angles(0.3, -0.8, 1.9);
    let shift = Vector3::new(0.2, -0.1, 0.4);
    for scale in [1e-3, 0.1, 1.0, 10.0] {
        let (vertices, triangles) = cuboid(Vector3::new(0.05, 0.04, 0.03));
        let config = LineConfig { radius: 0.0025 * scale, ..SHAFT };
        let line = [Point3::new(0.0, 0.0, 0.1), Point3::new(0.01, 0.005, 0.022)];
        let placed = |point: Point3<f64>| Point3::from(turn * (point.coords * scale) + shift * scale);
        let moved = (vertices.into_iter().map(placed).collect(), triangles);
        let found = contact(config, &moved, line.map(placed)).expect("it touches");
        assert!((found.depth / scale - (0.0025 + 0.008)).abs() < 1e-9, "{scale}: {found:?}");
        assert!((found.direction - turn * Vector3::z()).norm() < 1e-9);
    }
}

#[test]
fn both_strands_of_a_fold_are_told_by_different_segments_and_a_joint_tells_once() {
    let (vertices, triangles) = plate(5);
    let mut all = vertices.clone();
    // A second plate, tilted, that the other end of the shaft touches.
    all.extend(vertices.iter().map(|vertex| Point3::new(vertex.x, vertex.y, 0.004 - 0.01 * vertex.x)));
    let offset = vertices.len() as u32;
    let mut both = triangles.clone();
    both.extend(triangles.iter().map(|&[a, b, c]| [a + offset, c + offset, b + offset]));
    let mesh = MovingSurface::new(&Surface::new(&all, &both).expect("a surface"));
    let mut line = DynamicPoint::new(LineConfig { segments: 4, ..SHAFT }).expect("a valid line");
    line.update(&mesh, &[Point3::new(-0.4, 0.1, 0.001), Point3::new(0.4, 0.1, 0.001)]).expect("finite");
    let told = line.contacts();
    assert!(told[0].is_some_and(|contact| contact.triangle < triangles.len() as u32));
    assert!(told[3].is_some_and(|contact| contact.triangle >= triangles.len() as u32), "{told:?}");

    // A ridge under the joint of the two segments, nowhere else.
    let ridge = vec![Point3::new(0.0, -1.0, 0.0), Point3::new(0.0, 1.0, 0.0), Point3::new(0.0, 0.0, -1.0)];
    let mesh = MovingSurface::new(&Surface::new(&ridge, &[[0, 1, 2]]).expect("a surface"));
    let mut line = DynamicPoint::new(LineConfig { segments: 2, ..SHAFT }).expect("a valid line");
    for slide in [-0.001, -1e-9, 0.0, 1e-9, 0.001] {
        let ends = [Point3::new(slide - 0.1, 0.1, 0.001), Point3::new(slide + 0.1, 0.1, 0.001)];
        line.update(&mesh, &ends).expect("finite");
        assert_eq!(line.distinct_contacts().count(), 1, "{slide}");
    }
}

#[test]
fn an_inverted_an_open_and_a_degenerate_surface_are_answered() {
    let (vertices, triangles) = cuboid(Vector3::repeat(0.05));
    let inverted: Vec<[u32; 3]> = triangles.iter().map(|&[a, b, c]| [a, c, b]).collect();
    let line = [Point3::new(-0.01, 0.0, 0.051), Point3::new(0.01, 0.0, 0.051)];
    let found = contact(SHAFT, &(vertices.clone(), inverted), line).expect("it touches");
    assert_eq!((found.kind, found.direction.z < 0.0), (LineContactKind::Behind, true));
    let flat = vec![[0, 1, 1], [4, 4, 4], [5, 5, 7]];
    let crossing = [Point3::new(0.05, 0.0, 0.06), Point3::new(0.05, 0.0, 0.04)];
    let found = contact(SHAFT, &(vertices, flat), crossing).expect("an edge is touched");
    assert!(found.distance < 1e-12 && (found.direction.norm() - 1.0).abs() < 1e-9, "{found:?}");
    assert!(contact(SHAFT, &(vec![], vec![]), line).is_none());
}

#[test]
fn what_cannot_be_watched_is_named() {
    let told = |config| DynamicPoint::new(config).map(|_| ()).map_err(|error| error.to_string());
    let error = told(LineConfig { segments: 0, ..SHAFT }).expect_err("no segments");
    assert_eq!(error, "a line of 0 segments: 1 to 256 are valid");
    let error = told(LineConfig { radius: f64::NAN, ..SHAFT }).expect_err("no radius");
    assert!(error.starts_with("a radius of NaN m"), "{error}");
    assert!(told(LineConfig { margin: -1.0, ..SHAFT }).is_err());

    let (vertices, triangles) = plate(1);
    let mesh = MovingSurface::new(&Surface::new(&vertices, &triangles).expect("a surface"));
    let mut line = DynamicPoint::new(SHAFT).expect("a valid line");
    let touching = [Point3::new(0.0, 0.0, 0.001), Point3::new(0.1, 0.0, 0.001)];
    line.update(&mesh, &touching).expect("finite");
    let nowhere = [Point3::origin(), Point3::new(0.0, f64::INFINITY, 0.0)];
    assert_eq!(line.update(&mesh, &nowhere).map(|_| ()), Err(LineError::NotFinite(1)));
    assert!(line.contacts()[0].is_some(), "what was told stays");
}

#[test]
fn the_surface_velocity_is_that_of_the_touched_point() {
    let (mut vertices, triangles) = plate(3);
    let mut mesh = MovingSurface::new(&Surface::new(&vertices, &triangles).expect("a surface"));
    for vertex in &mut vertices {
        vertex.z += 0.001 * vertex.x;
        vertex.x += 0.0002;
    }
    mesh.update(&Surface::new(&vertices, &triangles).expect("a surface"), 0.01).expect("a time");
    let mut line = DynamicPoint::new(SHAFT).expect("a valid line");
    let touching = [Point3::new(0.5, -0.1, 0.001), Point3::new(0.5, 0.1, 0.001)];
    let found = line.update(&mesh, &touching).expect("finite")[0].expect("it touches");
    assert!((found.surface_velocity - Vector3::new(0.02, 0.0, 0.05)).norm() < 1e-3, "{found:?}");
}
