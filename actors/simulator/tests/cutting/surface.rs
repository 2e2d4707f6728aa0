//! Cutting of surfaces: pieces, their areas, and the effect on the springs.

use crate::support::sheet::follow;
use nalgebra::{Point3, Vector3};
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;
use trocar_dynamics::tet_mesh::Sweep;
use trocar_simulator::cutting::{Sheet, TopologyChange, VertexChange};
use trocar_simulator::mass_spring::{
    Config, Input, Integrator, LinearSolver, MassSpring, Network, SurfaceMaterial, TooLarge,
};

const GAUZE: SurfaceMaterial =
    SurfaceMaterial { membrane_stiffness: 50.0, bending_stiffness: 1e-9, density: 0.15 };

/// A square of `n` × `n` squares of two triangles each.
fn grid(n: u32, size: f64) -> (Vec<Point3<f64>>, Vec<[u32; 3]>) {
    let at = |i: u32| size * (f64::from(i) / f64::from(n) - 0.5);
    let points = (0..=n).flat_map(|j| (0..=n).map(move |i| Point3::new(at(i), at(j), 0.0))).collect();
    let triangles = (0..n).flat_map(|j| {
        (0..n).flat_map(move |i| {
            let [a, b, c, d] = [[i, j], [i + 1, j], [i, j + 1], [i + 1, j + 1]].map(|[i, j]| j * (n + 1) + i);
            [[a, b, d], [a, d, c]]
        })
    });
    (points, triangles.collect())
}

/// A blade perpendicular to the plane, moved from one point to another.
fn stab(from: [f64; 2], to: [f64; 2]) -> Sweep {
    let edge = |[x, y]: [f64; 2]| [Point3::new(x, y, -0.02), Point3::new(x, y, 0.02)];
    Sweep { before: edge(from), after: edge(to) }
}

fn area(sheet: &Sheet, of: &[u32]) -> f64 {
    let corners = |triangle: u32| sheet.triangles()[triangle as usize].map(|v| sheet.rest()[v as usize]);
    let areas = of.iter().map(|&triangle| {
        let [a, b, c] = corners(triangle);
        0.5 * (b - a).cross(&(c - a)).norm()
    });
    areas.sum()
}

/// Areas of the pieces, largest first.
fn areas(sheet: &Sheet) -> Vec<f64> {
    let pieces = sheet.pieces();
    let mut names = pieces.clone();
    names.sort_unstable();
    names.dedup();
    let of =
        |name: u32| (0..pieces.len() as u32).filter(|&at| pieces[at as usize] == name).collect::<Vec<_>>();
    let mut areas: Vec<f64> = names.into_iter().map(|name| area(sheet, &of(name))).collect();
    areas.sort_by(|a, b| b.total_cmp(a));
    areas
}

/// Every triangle has area and its original orientation, every edge one or two triangles, and the adjacency lists are
/// right.
fn check(sheet: &Sheet) {
    let mut edges = Vec::new();
    for (index, &[a, b, c]) in sheet.triangles().iter().enumerate() {
        let [p, q, r] = [a, b, c].map(|vertex| sheet.rest()[vertex as usize]);
        assert!((q - p).cross(&(r - p)).z > 0.0, "triangle {index} is turned over");
        edges.extend([[a, b], [b, c], [c, a]]);
        for vertex in [a, b, c] {
            assert!(sheet.about(vertex).binary_search(&(index as u32)).is_ok());
        }
    }
    let listed: usize = (0..sheet.rest().len() as u32).map(|vertex| sheet.about(vertex).len()).sum();
    assert_eq!(listed, 3 * sheet.triangles().len());
    // Wound alike: an edge runs each way once at most.
    edges.sort_unstable();
    assert!(edges.windows(2).all(|pair| pair[0] != pair[1]), "an edge with three triangles");
}

#[test]
fn a_straight_cut_from_edge_to_edge_makes_two_of_one() {
    for frames in [1, 7, 100] {
        let (points, triangles) = grid(20, 0.1);
        let mut sheet = Sheet::new(points.clone(), triangles).expect("a sheet");
        let mut positions = points;
        let ([x0, y0], [x1, y1]) = ([-0.06, -0.013], [0.06, 0.021]);
        let mut length = 0.0;
        for frame in 0..frames {
            let at = |frame: i32| {
                let share = f64::from(frame) / f64::from(frames);
                [x0 + (x1 - x0) * share, y0 + (y1 - y0) * share]
            };
            let change = sheet.cut(&positions, &[stab(at(frame), at(frame + 1))]).expect("a cut");
            change.carry(&mut positions, |a, b, share| a + (b - a) * share);
            length += change.length;
            check(&sheet);
        }
        let areas = areas(&sheet);
        assert_eq!(areas.len(), 2, "{frames} frames: {areas:?}");
        assert!((areas[0] + areas[1] - 0.01).abs() < 1e-12);
        // The middle of the cut lies at y = 4 mm.
        assert!((areas[1] - 0.1 * (0.05 - 0.004)).abs() < 0.01 * 0.01, "{frames} frames: {areas:?}");
        let straight = (0.1_f64.powi(2) + (0.034 * 0.1 / 0.12_f64).powi(2)).sqrt();
        assert!(length > 0.999 * straight && length < 1.1 * straight, "{length} m for {straight} m");
        assert!(sheet.state().tips.is_empty() && sheet.state().pending.is_empty());
    }
}

/// Scissors: a whole blade comes down through the sheet, and its cut begins at the border.
#[test]
fn blades_that_close_cut_their_whole_length_at_once() {
    let (points, triangles) = grid(20, 0.1);
    let mut sheet = Sheet::new(points.clone(), triangles).expect("a sheet");
    let edge = |height: f64| [Point3::new(-0.07, 0.011, height), Point3::new(-0.012, 0.007, height)];
    let mut positions = points;
    let change = sheet.cut(&positions, &[Sweep { before: edge(0.003), after: edge(-0.002) }]).expect("a cut");
    change.carry(&mut positions, |a, b, share| a + (b - a) * share);
    check(&sheet);
    assert_eq!(areas(&sheet).len(), 1);
    assert!((0.033..0.042).contains(&change.length), "{}", change.length);
    // The next bite continues from the tip to the other side.
    let edge = |height: f64| [Point3::new(-0.012, 0.007, height), Point3::new(0.07, 0.003, height)];
    sheet.cut(&positions, &[Sweep { before: edge(0.003), after: edge(-0.002) }]).expect("a cut");
    check(&sheet);
    assert_eq!(areas(&sheet).len(), 2);
    // Not touched, not cut.
    let before = sheet.state().clone();
    let edge = |height: f64| [Point3::new(-0.07, 0.02, height), Point3::new(0.07, 0.02, height)];
    assert!(
        sheet
            .cut(&before.rest, &[Sweep { before: edge(0.01), after: edge(0.002) }])
            .expect("none")
            .is_empty()
    );
    assert_eq!(*sheet.state(), before);
}

#[test]
fn what_belongs_to_vertices_and_triangles_follows() {
    let (points, triangles) = grid(12, 0.1);
    let mut sheet = Sheet::new(points.clone(), triangles.clone()).expect("a sheet");
    let mut texture: Vec<f64> = points.iter().map(|point| 3.0 * point.x - point.y).collect();
    let mut parents: Vec<u32> = (0..triangles.len() as u32).collect();
    let change = sheet.cut(&points, &[stab([-0.06, 0.013], [0.031, -0.022])]).expect("a cut");
    change.carry(&mut texture, |a, b, share| a + (b - a) * share);
    change.carry_triangles(&mut parents);
    assert_eq!(texture.len(), sheet.rest().len());
    for (value, point) in texture.iter().zip(sheet.rest()) {
        assert!((value - (3.0 * point.x - point.y)).abs() < 1e-12);
    }
    assert_eq!(parents.len(), sheet.triangles().len());
    assert!(change.vertices.iter().any(|change| matches!(change, VertexChange::Copy { .. })));
    // The change can be serialised.
    let text = serde_json::to_string(&change).expect("text");
    assert_eq!(serde_json::from_str::<TopologyChange>(&text).expect("a change"), change);
    let again = Sheet::restore(
        serde_json::from_str(&serde_json::to_string(sheet.state()).expect("text")).expect("a state"),
    )
    .expect("a sheet");
    assert_eq!(again.state(), sheet.state());
}

#[test]
fn a_thousand_random_cuts_never_halve_the_safe_step_and_springs_stay_those_of_the_mesh() {
    let (points, triangles) = grid(16, 0.1);
    let mut sheet = Sheet::new(points.clone(), triangles.clone()).expect("a sheet");
    let network = Network::from_surface(&points, &triangles, &GAUZE).expect("a network");
    let config =
        Config { integrator: Integrator::Explicit { too_large: TooLarge::Refuse }, ..Config::default() };
    let mut solver = MassSpring::new(network, points, &[0, 16], config).expect("a solver");
    let (at_first, mass) = (solver.safe_step(), solver.network().masses.iter().sum::<f64>());
    let mut random = Pcg64Mcg::seed_from_u64(7);
    let (mut done, mut tried, mut least) = (0, 0, f64::INFINITY);
    // A sweep beside the sheet, or in an existing cut, cuts nothing.
    while done < 1000 {
        tried += 1;
        assert!(tried < 20_000, "only {done} cuts did anything");
        let mut place = || [random.random_range(-0.055..0.055), random.random_range(-0.055..0.055)];
        let from = place();
        let to = [from[0] + 0.4 * place()[0], from[1] + 0.4 * place()[1]];
        let change = sheet.cut(&solver.state().positions.clone(), &[stab(from, to)]).expect("a cut");
        if change.is_empty() {
            continue;
        }
        done += 1;
        follow(&mut solver, &sheet, &change, &GAUZE);
        least = least.min(solver.safe_step());
        if done % 100 == 0 {
            check(&sheet);
            let fresh = Network::from_surface(sheet.rest(), sheet.triangles(), &GAUZE).expect("a network");
            assert!(fresh == *solver.network(), "brought up to date as if made anew, after cut {done}");
        }
    }
    assert!(least > 0.5 * at_first, "{least} s of {at_first} s");
    let after: f64 = solver.network().masses.iter().sum();
    assert!((after / mass - 1.0).abs() < 1e-9);
    assert!((areas(&sheet).iter().sum::<f64>() - 0.01).abs() < 1e-12);
    // Half of the initial stable step is still accepted; a larger than stable one would be rejected. All pieces fall or
    // hang, and their kinetic and elastic energy equals the loss of potential energy.
    falls(&mut solver, 0.5 * at_first, 2000).expect("no energy comes from nowhere");
    // The control: a step ten times as large is unstable.
    let too_large = TooLarge::Accept;
    let config = Config { integrator: Integrator::Explicit { too_large }, ..Config::default() };
    let (network, state) = (solver.network().clone(), solver.state().clone());
    let mut reckless = MassSpring::restore(network, state, solver.pinned(), config).expect("a solver");
    falls(&mut reckless, 10.0 * at_first, 2000).expect_err("it blows up");
}

/// Lets a network fall for some steps and checks that no energy was created.
fn falls(solver: &mut MassSpring, step: f64, steps: u32) -> Result<(), String> {
    let gravity = Vector3::new(0.0, 0.0, -9.81);
    let height = |solver: &MassSpring| -> f64 {
        let of = |(mass, place): (&f64, &Point3<f64>)| mass * 9.81 * place.z;
        solver.network().masses.iter().zip(&solver.state().positions).map(of).sum()
    };
    let all = |solver: &MassSpring| height(solver) + solver.elastic_energy() + solver.kinetic_energy();
    let (begun, high) = (all(solver), height(solver));
    for count in 0..steps {
        solver.step(step, &Input { gravity, ..Input::default() }).map_err(|error| error.to_string())?;
        let (made, lost) = (all(solver) - begun, high - height(solver));
        if made > 0.02 * lost.abs() + 1e-9 {
            return Err(format!("step {count}: {made} J made where {lost} J of height were lost"));
        }
    }
    Ok(())
}

/// Why splits are restricted: the same cuts with unrestricted splits.
#[test]
fn without_the_limits_slivers_come() {
    let (points, triangles) = grid(16, 0.1);
    let first = Sheet::new(points.clone(), triangles).expect("a sheet");
    let mut state = first.state().clone();
    (state.corner_limit, state.height_limit) = (f64::INFINITY, 0.0);
    let mut sheet = Sheet::restore(state).expect("a sheet");
    let mut positions = points;
    let step = |sheet: &Sheet, positions: &[Point3<f64>]| {
        let network = Network::from_surface(sheet.rest(), sheet.triangles(), &GAUZE).expect("a network");
        MassSpring::new(network, positions.to_vec(), &[], Config::default()).expect("a solver").safe_step()
    };
    let at_first = step(&sheet, &positions);
    let mut random = Pcg64Mcg::seed_from_u64(7);
    for _ in 0..100 {
        let mut place = || [random.random_range(-0.055..0.055), random.random_range(-0.055..0.055)];
        let from = place();
        let to = [from[0] + 0.4 * place()[0], from[1] + 0.4 * place()[1]];
        let change = sheet.cut(&positions, &[stab(from, to)]).expect("a cut");
        change.carry(&mut positions, |a, b, share| a + (b - a) * share);
    }
    assert!(step(&sheet, &positions) < 0.1 * at_first);
}

/// A circle of 4 cm out of 10 × 10 cm, starting from the border along a radius, with the gauze in a frame and a grasper
/// in the middle: otherwise the cut part hangs down, away from the blade.
#[test]
fn a_circle_cut_out_of_gauze_has_the_right_area() {
    let n = 64;
    let (points, triangles) = grid(n, 0.1);
    let mut sheet = Sheet::new(points.clone(), triangles.clone()).expect("a sheet");
    let network = Network::from_surface(&points, &triangles, &GAUZE).expect("a network");
    let clips: Vec<u32> = {
        let border = |point: &Point3<f64>| point.x.abs().max(point.y.abs()) > 0.05 - 1e-9;
        (0..points.len() as u32).filter(|&node| border(&points[node as usize])).collect()
    };
    let integrator = Integrator::Implicit {
        solver: LinearSolver::ConjugateGradients { tolerance: 1e-2, iterations_max: 60 },
        newton: 1,
    };
    let config = Config { integrator, damping: 5.0, ..Config::default() };
    let middle = |point: &Point3<f64>| point.coords.norm() < 3e-3;
    let held = (0..points.len() as u32).filter(|&node| middle(&points[node as usize]));
    let held: Vec<u32> = held.chain(clips.iter().copied()).collect();
    let mut solver = MassSpring::new(network, points, &held, config).expect("a solver");
    let input = Input { gravity: Vector3::new(0.0, 0.0, -9.81), ..Input::default() };
    let radius = 0.02;
    let around = |share: f64| {
        let angle = std::f64::consts::TAU * share;
        [radius * angle.cos(), radius * angle.sin()]
    };
    let mut way: Vec<[f64; 2]> =
        (0..=40).map(|frame| [0.052 - 0.032 * f64::from(frame) / 40.0, 0.0]).collect();
    way.extend((1..=205).map(|frame| around(f64::from(frame) / 200.0)));
    let mut apart = 0;
    for pair in way.windows(2) {
        let change = sheet.cut(&solver.state().positions.clone(), &[stab(pair[0], pair[1])]).expect("a cut");
        if !change.is_empty() {
            follow(&mut solver, &sheet, &change, &GAUZE);
        }
        solver.step(2e-3, &input).expect("a step");
        apart += 1;
        if areas(&sheet).len() > 1 {
            break;
        }
    }
    check(&sheet);
    let areas = areas(&sheet);
    assert_eq!(areas.len(), 2, "after {apart} frames: {areas:?}");
    let wanted = std::f64::consts::PI * radius * radius;
    assert!(
        (areas[1] / wanted - 1.0).abs() < 0.01,
        "{} of {wanted}: {:+.2} %",
        areas[1],
        100.0 * (areas[1] / wanted - 1.0)
    );
    // Once released, the disc falls, and the frame holds the rest.
    let mut clips = solver.pinned().to_vec();
    clips.retain(|&node| !middle(&sheet.rest()[node as usize]));
    solver.pin(&clips).expect("pins");
    let inside =
        (0..sheet.rest().len()).find(|&node| sheet.rest()[node].coords.norm() < 0.005).expect("a node");
    let before = solver.state().positions[inside].z;
    for _ in 0..50 {
        solver.step(2e-3, &input).expect("a step");
    }
    assert!(solver.state().positions[inside].z < before - 0.01);
}

/// Under tension the lips of a slit open, and a sheet stretched beyond its limit tears.
#[test]
fn tension_opens_a_slit_and_tears_beyond_the_limit() {
    let n = 16;
    let (points, triangles) = grid(n, 0.1);
    let ends: Vec<u32> =
        (0..points.len() as u32).filter(|&node| points[node as usize].x.abs() > 0.05 - 1e-9).collect();
    let integrator = Integrator::Implicit {
        solver: LinearSolver::ConjugateGradients { tolerance: 1e-3, iterations_max: 200 },
        newton: 1,
    };
    let config = Config { integrator, damping: 20.0, ..Config::default() };
    let run = |stretch: f64, tear: f64| {
        let mut sheet = Sheet::new(points.clone(), triangles.clone()).expect("a sheet");
        let network = Network::from_surface(&points, &triangles, &GAUZE).expect("a network");
        let pulled = points.iter().map(|point| Point3::new(stretch * point.x, point.y, 0.0)).collect();
        let mut solver = MassSpring::new(network, pulled, &ends, config).expect("a solver");
        let change =
            sheet.cut(&solver.state().positions.clone(), &[stab([0.0, -0.06], [0.0, -0.03])]).expect("a cut");
        follow(&mut solver, &sheet, &change, &GAUZE);
        let lips: Vec<usize> = (0..sheet.rest().len())
            .filter(|&node| sheet.rest()[node].x.abs() < 1e-3 && sheet.rest()[node].y < -0.049)
            .collect();
        for _ in 0..200 {
            solver.step(5e-3, &Input::default()).expect("a step");
            let change = sheet.tear(&solver.state().positions, tear).expect("a tear");
            if !change.is_empty() {
                follow(&mut solver, &sheet, &change, &GAUZE);
            }
        }
        check(&sheet);
        assert_eq!(lips.len(), 2);
        let gap = (solver.state().positions[lips[0]] - solver.state().positions[lips[1]]).norm();
        (gap, areas(&sheet).len())
    };
    let (gap, pieces) = run(1.05, 10.0);
    assert!(gap > 2e-3 && pieces == 1, "{gap} m, {pieces} pieces");
    let (_, pieces) = run(1.05, 1.06);
    assert!(pieces >= 2, "torn through");
    let (_, pieces) = run(1.001, 1.07);
    assert_eq!(pieces, 1, "not torn");
}

#[test]
fn what_cannot_be_cut_is_refused() {
    let (points, triangles) = grid(4, 0.1);
    let mut sheet = Sheet::new(points.clone(), triangles).expect("a sheet");
    assert_eq!(
        sheet.cut(&points[1..], &[]).expect_err("too few").to_string(),
        "24 positions for a mesh of 25 vertices"
    );
    let nowhere = stab([f64::NAN, 0.0], [0.0, 0.0]);
    assert_eq!(
        sheet.cut(&points, &[stab([0.0; 2], [1.0; 2]), nowhere]).expect_err("nowhere").to_string(),
        "sweep 1 has a coordinate that is not finite"
    );
    assert!(Sheet::new(points, vec![[0, 1, 2], [0, 0, 1]]).is_err());
}
