//! Picking: which vertices an instrument holds, and that they follow it.

use crate::support::sheet::follow;
use nalgebra::{Isometry3, Point3, Vector3};
use trocar_dynamics::picking::{Jaws, PickError, Picks};
use trocar_dynamics::tet_mesh::Sweep;
use trocar_simulator::cutting::Sheet;
use trocar_simulator::mass_spring::{
    Config, Input, Integrator, LinearSolver, MassSpring, Network, Prescribed, SurfaceMaterial,
};

/// A strip of `n` squares of 1 cm, two triangles each: triangles 2i and 2i + 1 have the corners 2i to 2i + 3.
fn strip(n: u32) -> (Vec<Point3<f64>>, Vec<[u32; 3]>) {
    let points =
        (0..=n).flat_map(|i| [0.0, 0.01].map(|y| Point3::new(0.01 * f64::from(i), y, 0.0))).collect();
    let triangles =
        (0..n).flat_map(|i| [[2 * i, 2 * i + 2, 2 * i + 1], [2 * i + 1, 2 * i + 2, 2 * i + 3]]).collect();
    (points, triangles)
}

fn jaws<'a>(instrument: u64, body_from_instrument: Isometry3<f64>, touched: [&'a [u32]; 2]) -> Jaws<'a> {
    Jaws { instrument, body_from_instrument, closed: true, closing: false, touched }
}

#[test]
fn only_what_both_jaws_touch_is_picked_and_opening_lets_it_go() {
    let (points, triangles) = strip(8);
    let here = Isometry3::translation(0.01, 0.02, 0.03);
    let mut picks = Picks::default();
    let open = Jaws { closed: false, ..jaws(7, here, [&[4, 5], &[4, 5]]) };
    picks.update(&triangles, &points, &[open]).expect("heard");
    assert_eq!(picks, Picks::default(), "open jaws pick nothing");
    picks.update(&triangles, &points, &[jaws(7, here, [&[6, 4, 5], &[5, 4, 3]])]).expect("heard");
    assert_eq!(picks.of(7).expect("a pick").triangles, [4, 5]);
    assert_eq!((picks.holder(4), picks.holder(6)), (Some(7), None));
    // While closed, they take no more.
    picks.update(&triangles, &points, &[jaws(7, here, [&[1, 2], &[1, 2]])]).expect("heard");
    assert_eq!(picks.of(7).expect("a pick").triangles, [4, 5]);
    picks.update(&triangles, &points, &[open]).expect("heard");
    assert_eq!(picks, Picks::default());
    // One jaw alone picks nothing, and a removed instrument has released everything.
    let closing = |touched| Jaws { closing: true, ..jaws(7, here, touched) };
    picks.update(&triangles, &points, &[closing([&[1, 2], &[]])]).expect("heard");
    assert_eq!(picks, Picks::default());
    picks.update(&triangles, &points, &[closing([&[1], &[1]])]).expect("heard");
    assert_eq!(picks.holder(1), Some(7));
    picks.update(&triangles, &points, &[]).expect("heard");
    assert_eq!(picks, Picks::default());
}

#[test]
fn jaws_that_have_closed_on_nothing_take_nothing_until_they_open() {
    let (points, triangles) = strip(8);
    let here = Isometry3::translation(0.01, 0.02, 0.03);
    let mut picks = Picks::default();
    picks.update(&triangles, &points, &[jaws(7, here, [&[], &[]])]).expect("heard");
    // Closed jaws pushed into it: both touch, and a restart keeps the fact that they held nothing.
    let mut picks: Picks =
        serde_json::from_str(&serde_json::to_string(&picks).expect("text")).expect("picks");
    picks.update(&triangles, &points, &[jaws(7, here, [&[4, 5], &[4, 5]])]).expect("heard");
    assert_eq!(picks.of(7), None, "a blunt rod takes nothing");
    // Jaws that close on it grasp, and so do those that have been opened once.
    let other = Jaws { closing: true, ..jaws(8, here, [&[1], &[1]]) };
    let open = Jaws { closed: false, ..jaws(7, here, [&[4, 5], &[4, 5]]) };
    picks.update(&triangles, &points, &[open, other]).expect("heard");
    picks.update(&triangles, &points, &[jaws(7, here, [&[4, 5], &[4, 5]]), other]).expect("heard");
    assert_eq!((picks.holder(4), picks.holder(1)), (Some(7), Some(8)));
}

#[test]
fn what_is_picked_follows_the_instrument_as_a_rigid_body() {
    let (points, triangles) = strip(8);
    let before = Isometry3::new(Vector3::new(0.01, 0.02, 0.03), Vector3::new(0.3, -0.2, 0.9));
    let after = Isometry3::new(Vector3::new(-0.02, 0.05, 0.01), Vector3::new(-1.3, 0.4, 0.1));
    let mut picks = Picks::default();
    picks.update(&triangles, &points, &[jaws(1, before, [&[4, 5], &[4, 5]])]).expect("heard");
    // A restored session keeps its grasp.
    let picks: Picks = serde_json::from_str(&serde_json::to_string(&picks).expect("text")).expect("picks");
    let driven = picks.driven(&[jaws(1, after, [&[], &[]])]);
    assert_eq!(driven.iter().map(|driven| driven.vertex).collect::<Vec<_>>(), [4, 5, 6, 7]);
    for driven in driven {
        let wanted = after * before.inverse_transform_point(&points[driven.vertex as usize]);
        assert!((driven.position_in_body - wanted).norm() < 1e-15);
    }
}

#[test]
fn of_two_instruments_the_first_keeps_what_both_want() {
    let (points, triangles) = strip(8);
    let pose = Isometry3::identity();
    let (left, right) = (jaws(1, pose, [&[2, 3, 4], &[2, 3, 4]]), jaws(2, pose, [&[4, 5, 6], &[4, 5, 6]]));
    let mut picks = Picks::default();
    picks.update(&triangles, &points, &[left]).expect("heard");
    picks.update(&triangles, &points, &[left, right]).expect("heard");
    assert_eq!(picks.of(1).expect("a pick").triangles, [2, 3, 4]);
    assert_eq!(picks.of(2).expect("a pick").triangles, [5, 6]);
    // Each vertex is prescribed once, shared ones by the first instrument.
    let moved = [left, Jaws { body_from_instrument: Isometry3::translation(0.0, 0.0, 0.1), ..right }];
    let driven = picks.driven(&moved);
    assert!(driven.windows(2).all(|pair| pair[0].vertex < pair[1].vertex));
    assert!(
        driven.iter().all(|driven| (driven.position_in_body.z > 0.05) == (driven.vertex > 6)),
        "{driven:?}"
    );
    // When the first releases, the other keeps its own; closed again, the first finds those taken.
    let open = Jaws { closed: false, ..left };
    picks.update(&triangles, &points, &[open, right]).expect("heard");
    assert_eq!(picks.of(2).expect("a pick").triangles, [5, 6]);
    picks.update(&triangles, &points, &[jaws(1, pose, [&[5, 6], &[5, 6]]), right]).expect("heard");
    assert!(picks.of(1).is_none());
}

/// The whole sequence: picked, moved by a solver, cut while held, released.
#[test]
fn a_held_sheet_follows_through_a_solver_and_a_cut() {
    // Four adjacent strips, of which the second is held.
    let (row, _) = strip(12);
    let points: Vec<_> = (0..5)
        .flat_map(|j| row.iter().step_by(2).map(move |point| Point3::new(point.x, 0.01 * f64::from(j), 0.0)))
        .collect();
    let triangles: Vec<[u32; 3]> = (0..48_u32)
        .flat_map(|square| {
            let corner = square / 12 * 13 + square % 12;
            [[corner, corner + 1, corner + 14], [corner, corner + 14, corner + 13]]
        })
        .collect();
    let mut sheet = Sheet::new(points.clone(), triangles).expect("a sheet");
    let material = SurfaceMaterial { membrane_stiffness: 50.0, bending_stiffness: 1e-8, density: 0.15 };
    let network = Network::from_surface(sheet.rest(), sheet.triangles(), &material).expect("a network");
    let integrator = Integrator::Implicit { solver: LinearSolver::Cholesky, newton: 1 };
    let config = Config { integrator, damping: 5.0, ..Config::default() };
    let mut solver = MassSpring::new(network, points, &[0, 13, 26], config).expect("a solver");
    let mut picks = Picks::default();
    let touched: &[u32] = &[44, 45];
    let pose = |frame: u32| Isometry3::translation(0.1, 0.0, 1e-4 * f64::from(frame));
    for frame in 0..200 {
        let now = jaws(9, pose(frame), [touched, touched]);
        picks.update(sheet.triangles(), &solver.state().positions, &[now]).expect("heard");
        if frame == 100 {
            // Across the held triangles, along the strip.
            let edge = |x: f64| [Point3::new(x, 0.015, -0.05), Point3::new(x, 0.015, 0.05)];
            let sweep = Sweep { before: edge(0.13), after: edge(0.098) };
            let change = sheet.cut(&solver.state().positions.clone(), &[sweep]).expect("a cut");
            assert!(!change.is_empty());
            follow(&mut solver, &sheet, &change, &material);
            picks.follow(&change.triangles, sheet.triangles(), &solver.state().positions, &[now]);
            assert!(picks.of(9).expect("a pick").triangles.len() > 2);
        }
        let driven = picks.driven(&[now]);
        let prescribed: Vec<_> = driven
            .iter()
            .map(|driven| Prescribed { node: driven.vertex, position: driven.position_in_body })
            .collect();
        solver.step(1e-3, &Input { prescribed: &prescribed, ..Input::default() }).expect("a step");
        for driven in driven {
            assert_eq!(solver.state().positions[driven.vertex as usize], driven.position_in_body);
        }
    }
    let held = picks.of(9).expect("a pick").vertices[0].vertex as usize;
    assert!((solver.state().positions[held].z - 0.0199).abs() < 1e-9);
    let open = Jaws { closed: false, ..jaws(9, pose(200), [touched, touched]) };
    picks.update(sheet.triangles(), &solver.state().positions, &[open]).expect("heard");
    assert!(picks.driven(&[open]).is_empty());
}

#[test]
fn an_instrument_that_touches_what_is_not_there_is_refused() {
    let (points, triangles) = strip(2);
    let mut picks = Picks::default();
    let error = picks.update(&triangles, &points, &[jaws(3, Isometry3::identity(), [&[0], &[9]])]);
    assert_eq!(error, Err(PickError::Triangle { instrument: 3, triangle: 9, triangles: 4, vertices: 6 }));
    let nowhere = Isometry3::translation(f64::NAN, 0.0, 0.0);
    assert_eq!(picks.update(&triangles, &points, &[jaws(3, nowhere, [&[0], &[0]])]), Err(PickError::Pose(3)));
    assert_eq!(picks, Picks::default());
}
