//! A thread around an elastic body: both deform in one problem, so that a tightened loop keeps its tension.

use nalgebra::{Isometry3, Point3, Vector3};
use trocar_dynamics::elasticity::Elastic as Material;
use trocar_dynamics::tet_mesh::{MeshRules, TetMesh};
use trocar_scene::organs;
use trocar_simulator::linear_fem::{Compliance, Limits};
use trocar_simulator::suture_thread::elastic::ElasticBody;
use trocar_simulator::suture_thread::initial_shape::{Throws, throws};
use trocar_simulator::suture_thread::knot::{KnotKind, identify};
use trocar_simulator::suture_thread::{
    ElasticObstacle, Hold, Obstacle, Shape, Surroundings, Thread, ThreadMaterial, ThreadReport, ThreadState,
};

const RADIUS: f64 = 4e-3;
const LENGTH: f64 = 20e-3;

/// A tube along z, held at both ends.
fn tube(young: f64) -> (ElasticBody, TetMesh) {
    let data = organs::pipe(RADIUS, 1.5e-3, LENGTH, [24, 16, 2]).expect("a tube");
    let mesh = TetMesh::new(&data.positions, &data.tets, &MeshRules::default()).expect("a sound mesh");
    let material = Material::new(young, 0.4).expect("a material");
    let is_end = |node: &u32| mesh.rest()[*node as usize].z.abs() > 0.5 * LENGTH - 1e-9;
    let fixed: Vec<u32> = (0..mesh.rest().len() as u32).filter(is_end).collect();
    let compliance =
        Compliance::precompute(&mesh, &material, &fixed, &Limits::default(), &mut |_| true).expect("held");
    (ElasticBody::new(&mesh, compliance), mesh)
}

/// Steps a thread and the body that it is tied around.
fn step(thread: &mut Thread, body: &mut ElasticBody, holds: &[Hold], friction: f64, dt: f64) -> ThreadReport {
    let positions = body.positions().to_vec();
    let shape = Shape::Mesh { from: &positions, to: &positions, triangles: body.triangles(), radius: 0.0 };
    let obstacles = [Obstacle::fixed(shape, Isometry3::identity(), friction)];
    let around = Surroundings {
        holds,
        obstacles: &obstacles,
        elastic: Some(ElasticObstacle { obstacle: 0, body }),
        ..Surroundings::default()
    };
    let report = thread.step(dt, &around).expect("a step");
    let presses = thread.presses().to_vec();
    body.deform(&presses);
    report
}

/// Half a turn over the tube, its ends hanging down at both sides.
fn sling(spacing: f64) -> Vec<Point3<f64>> {
    let r = RADIUS + 1.6e-4;
    let arc = std::f64::consts::PI * r;
    let count = (arc / spacing).round() as i32;
    let mut points: Vec<_> = (1..=12).rev().map(|k| Point3::new(-r, -spacing * f64::from(k), 0.0)).collect();
    points.extend((0..=count).map(|k| {
        let angle = std::f64::consts::PI * (1.0 - f64::from(k) / f64::from(count));
        Point3::new(r * angle.cos(), r * angle.sin(), 0.0)
    }));
    points.extend((1..=12).map(|k| Point3::new(r, -spacing * f64::from(k), 0.0)));
    points
}

/// Both ends pulled down with a force, as by long soft springs.
fn pulled(thread: &Thread, force: f64) -> [Hold; 2] {
    let last = thread.positions().len() - 1;
    [0, last].map(|node| {
        let to = thread.positions()[node] - Vector3::y() * 1e-2;
        Hold { node, to, stiffness: force / 1e-2, force_max: f64::INFINITY }
    })
}

#[test]
fn a_sling_presses_a_tube_as_hard_as_it_is_pulled_and_a_stiffer_one_gives_way_less() {
    let mut depths = Vec::new();
    for young in [2e6, 2e7, 2e9] {
        let (mut body, _) = tube(young);
        let mut thread = Thread::new(ThreadMaterial::silk_2_0(), &sling(4.5e-4)).expect("a thread");
        let mut report = ThreadReport::default();
        for k in 0..400 {
            let holds = pulled(&thread, 0.5 * (f64::from(k + 1) / 200.0).min(1.0));
            report = step(&mut thread, &mut body, &holds, 0.0, 1e-3);
        }
        // The tube bears both forces; without friction the tension is uniform.
        let [force, _] = body.load();
        assert!((force.y + 1.0).abs() < 0.02 && force.x.abs() < 0.02, "{young} Pa: {force:?}");
        let tensions = &thread.state().tensions;
        assert!(tensions.iter().all(|tension| (tension - 0.5).abs() < 0.04), "{young} Pa: {tensions:?}");
        // On the deformed surface: neither through it nor off it.
        assert!(report.penetration_max < 1e-6, "{young} Pa: {report:?}");
        let nearest = nearest(&thread, &body);
        assert!((1.25e-4..1.51e-4).contains(&nearest), "{young} Pa: {nearest}");
        let top = body.positions().iter().zip(tube_rest(&body));
        depths.push(top.map(|(now, rest)| (now - rest).norm()).fold(0.0, f64::max));
    }
    assert!(depths[0] > 1e-4 && depths[0] < 1e-3, "{depths:?}");
    for (pair, ratio) in depths.windows(2).zip([10.0, 100.0]) {
        assert!((pair[0] / pair[1] / ratio - 1.0).abs() < 0.25, "{depths:?}");
    }
}

/// Rest positions of a tube's nodes.
fn tube_rest(body: &ElasticBody) -> Vec<Point3<f64>> {
    let mut at_rest = body.clone();
    at_rest.deform(&[]);
    at_rest.positions().to_vec()
}

/// Distance from the centre line of a thread to the surface \[m\].
fn nearest(thread: &Thread, body: &ElasticBody) -> f64 {
    let mut least = f64::INFINITY;
    for triangle in body.triangles() {
        let corners = triangle.map(|node| body.positions()[node as usize]);
        for edge in thread.positions().windows(2) {
            let found = trocar_collision::primitive::closest_segment_triangle(&[edge[0], edge[1]], &corners);
            least = least.min(found.distance_squared.sqrt());
        }
    }
    least
}

#[test]
fn another_life_goes_on_to_the_bit() {
    let (mut body, _) = tube(2e6);
    let mut thread = Thread::new(ThreadMaterial::silk_2_0(), &sling(6e-4)).expect("a thread");
    let go = |thread: &mut Thread, body: &mut ElasticBody, k: i32| {
        let holds = pulled(thread, 0.004 * f64::from(k));
        step(thread, body, &holds, 0.2, 1e-3)
    };
    for k in 1..=60 {
        go(&mut thread, &mut body, k);
    }
    let text = serde_json::to_string(&(thread.state(), body.presses())).expect("a state");
    let (state, presses): (ThreadState, Vec<_>) = serde_json::from_str(&text).expect("a state");
    let mut second = Thread::restore(*thread.material(), state).expect("a thread");
    let (mut other, _) = tube(2e6);
    other.deform(&presses);
    for k in 61..=100 {
        assert_eq!(go(&mut thread, &mut body, k), go(&mut second, &mut other, k));
    }
    assert_eq!(thread.state(), second.state());
    assert_eq!(body.positions(), other.positions());
}

/// A square knot above the tube, its loop around it, tightened and released: tension of the loop on the far side of the
/// tube before and after \[N\], and whether it is still a square knot.
fn tied(friction: f64) -> (f64, f64, bool) {
    let material = ThreadMaterial { friction, ..ThreadMaterial::silk_2_0() };
    // Around the tube, from the upper left under it to the upper right.
    let r = RADIUS + 4e-4;
    let height = r + 1e-3;
    let around: Vec<_> = (0..=32)
        .map(|k| (125.0 + 290.0 * f64::from(k) / 32.0).to_radians())
        .map(|angle: f64| Point3::new(r * angle.cos(), 0.0, r * angle.sin() - height))
        .collect();
    let (mut body, _) = tube(1e6);
    let thrown = Throws {
        half_turns: &[3, -3],
        around: &around,
        radius: material.radius,
        apart: 0.0,
        arm: 2e-3,
        ear: 8e-3,
        edges: [4.5e-4, 8e-4],
    };
    // The knot is laid about the origin in the x–z plane; the tube's axis is z.
    let points: Vec<_> = throws(&thrown).iter().map(|at| Point3::new(at.x, at.z + height, at.y)).collect();
    let mut thread = Thread::new(material, &points).expect("a thread");
    let last = points.len() - 1;
    let (speed, dt) = (0.05, 5e-4);
    let tension = |thread: &Thread| {
        let far = (0..thread.positions().len() - 1)
            .min_by(|a, b| thread.positions()[*a].y.total_cmp(&thread.positions()[*b].y))
            .expect("an edge");
        thread.state().tensions[far]
    };
    // The hands' force decreases linearly with their speed: full at rest, zero at their free speed.
    let pulled = |thread: &Thread, force: f64| {
        [(0, -1.0), (last, 1.0)].map(|(node, side)| Hold {
            node,
            to: thread.positions()[node] + Vector3::x() * (side * speed * dt),
            stiffness: (force / (speed * dt)).max(1e-9),
            force_max: f64::INFINITY,
        })
    };
    let mut tight = 0.0;
    for k in 0..600 {
        let holds = pulled(&thread, 3.0 * (f64::from(k) / 500.0).min(1.0).powi(2));
        step(&mut thread, &mut body, &holds, 0.2, dt);
        tight = tension(&thread);
    }
    for k in 0..220 {
        let holds = pulled(&thread, 3.0 * (1.0 - f64::from(k) / 100.0).max(0.0));
        step(&mut thread, &mut body, &holds, 0.2, dt);
    }
    let is_square = identify(thread.positions()).is_ok_and(|knot| knot.kind == KnotKind::Square);
    (tight, tension(&thread), is_square)
}

#[test]
fn a_square_knot_around_a_tube_keeps_its_loop_tight_when_its_ears_are_let_go() {
    let (tight, after, is_square) = tied(0.3);
    assert!(tight > 0.1 && after > 0.05 * tight && is_square, "{tight} N, then {after} N, {is_square}");
    // Without friction the tension is lost completely.
    let (tight, after, _) = tied(0.0);
    assert!(tight > 0.1 && after < 1e-3 * tight, "without friction {tight} N, then {after} N");
}

#[test]
fn what_is_no_surface_of_a_body_that_stays_is_refused_by_name() {
    let (body, _) = tube(2e6);
    let mut thread = Thread::new(ThreadMaterial::silk_2_0(), &sling(6e-4)).expect("a thread");
    let before = thread.state().clone();
    let positions = body.positions().to_vec();
    let surface = Shape::Mesh { from: &positions, to: &positions, triangles: body.triangles(), radius: 0.0 };
    let still = Obstacle::fixed(surface, Isometry3::identity(), 0.2);
    let moving = Obstacle { to: Isometry3::translation(1e-3, 0.0, 0.0), ..still };
    let ball = Obstacle::fixed(Shape::Sphere { radius: 1e-3 }, Isometry3::identity(), 0.2);
    for (obstacles, obstacle, why) in [
        (&[still][..], 1, "there is no such obstacle"),
        (&[still, ball][..], 1, "that obstacle is not its surface"),
        (&[moving][..], 0, "it has to stay in its place"),
    ] {
        let elastic = Some(ElasticObstacle { obstacle, body: &body });
        let error = thread
            .step(1e-3, &Surroundings { obstacles, elastic, ..Surroundings::default() })
            .expect_err("it makes no sense");
        assert_eq!(error.to_string(), format!("elastic body {obstacle}: {why}"));
    }
    assert_eq!(thread.state(), &before);
}
