//! Topology changes of volumes: all derived data are updated as if recomputed from the mesh; mesh refinement.

use std::collections::BTreeSet;

use nalgebra::{Matrix3, Point3, Vector3};
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;
use trocar_dynamics::tet_mesh::{
    BoxCells, MeshRules, NodeMotion, OpenCut, RefineError, Sweep, TetMesh, Volume, VolumeChange, VolumeError,
    box_cells, refined,
};
use trocar_simulator::mass_spring::{
    Config, Input, Integrator, MassSpring, Network, TooLarge, VolumeMaterial,
};

fn block(cells: [usize; 3]) -> TetMesh {
    let grid =
        BoxCells { cells, size: Vector3::from(cells.map(|n| 0.01 * n as f64)), origin: Point3::origin() };
    let (nodes, tets) = box_cells(&grid);
    TetMesh::new(&nodes, &tets, &MeshRules::default()).expect("a sound mesh")
}

/// Compares everything stored with a mesh built anew.
fn agrees(volume: &Volume) {
    let (mesh, nodes) = volume.mesh().expect("something is left");
    let turned = |triangle: [u32; 3]| {
        let first = (0..3).min_by_key(|&k| triangle[k]).unwrap_or(0);
        [0, 1, 2].map(|k| triangle[(first + k) % 3])
    };
    let kept: BTreeSet<[u32; 3]> = volume.surface().map(turned).collect();
    let anew: BTreeSet<[u32; 3]> =
        mesh.surface().iter().map(|corners| turned(corners.map(|node| nodes[node as usize]))).collect();
    // Faces that are cut, but whose corners are still connected elsewhere, are counted from both sides.
    assert!(kept.is_superset(&anew));
    for triangle in kept.difference(&anew) {
        let [a, b, c] = *triangle;
        assert!(kept.contains(&turned([a, c, b])), "{triangle:?} lies open on one side only");
    }
    let mut anew = vec![0.0; volume.rest().len()];
    nodes.iter().zip(mesh.lumped_masses(1.0)).for_each(|(&node, share)| anew[node as usize] = share);
    for (kept, anew) in volume.shares().iter().zip(anew) {
        assert!((kept - anew).abs() < 1e-18, "{kept} {anew}");
    }
    assert_eq!(volume.orphans().len() + nodes.len(), volume.rest().len());
}

#[test]
fn random_removals_and_cuts_are_followed_as_if_all_were_computed_anew() {
    let mesh = block([5, 4, 4]);
    let mut volume = Volume::new(&mesh);
    agrees(&volume);
    let mut random = Pcg64Mcg::seed_from_u64(3);
    let mut gone = 0;
    for round in 0..200 {
        let there: Vec<u32> = volume.tets().map(|(tet, _)| tet).collect();
        let tet = there[random.random_range(0..there.len())];
        if round % 3 == 0 {
            let change = volume.remove(&[tet]).expect("it is there");
            assert_eq!(change.removed, [tet]);
            assert_eq!(
                volume.remove(&[tet]).expect_err("it is gone"),
                VolumeError::NoElement { tet, left: there.len() - 1, tets: mesh.tets().len() }
            );
            gone += 1;
        } else {
            let faces: Vec<_> = (0..3).map(|_| (tet, random.random_range(0..4_u8))).collect();
            let change = volume.open(&faces).expect("it is there");
            let nodes = volume.rest().len() - change.born.len();
            for (new, birth) in (nodes..).zip(change.born) {
                assert_eq!(birth.of[0], birth.of[1], "it was another node");
                assert_eq!(volume.rest()[new], volume.rest()[birth.of[0] as usize]);
            }
        }
        agrees(&volume);
    }
    assert_eq!(volume.tets().count(), mesh.tets().len() - gone);
    assert!(matches!(volume.open(&[(u32::MAX, 0)]), Err(VolumeError::NoElement { .. })));
    let (tet, _) = volume.tets().next().expect("one is left");
    assert_eq!(volume.open(&[(tet, 4)]), Err(VolumeError::NoFace { tet, corner: 4 }));
}

#[test]
fn a_blade_that_passes_through_makes_two_pieces_and_one_that_stops_does_not() {
    let mesh = block([6, 2, 2]);
    let across = |end: f64| {
        let mut volume = Volume::new(&mesh);
        // Between two layers of cells, from above.
        let edge = |z: f64| [Point3::new(0.0301, -0.01, z), Point3::new(0.0301, 0.03, z)];
        let faces = volume.swept(mesh.rest(), &edge(0.03), &edge(end));
        assert!(!faces.is_empty());
        let change = volume.open(&faces).expect("they are there");
        agrees(&volume);
        (volume.pieces(), change.born.len(), volume)
    };
    let (pieces, split, volume) = across(-0.01);
    // A layer of nodes has been duplicated, and no volume is lost.
    assert_eq!((pieces, split), (2, 9));
    assert!((volume.shares().iter().sum::<f64>() - mesh.volume()).abs() < 1e-15);
    let (pieces, split, _) = across(0.0101);
    assert_eq!(pieces, 1);
    assert_eq!(split, 3, "the upper edge of the cut, and not its bottom");
}

#[test]
fn it_tears_across_the_largest_tension() {
    let mesh = block([6, 2, 2]);
    let volume = Volume::new(&mesh);
    // Stretched along x, most in the middle.
    let stress = |tet: u32| {
        let x = mesh.tets()[tet as usize].iter().map(|&n| mesh.rest()[n as usize].x).sum::<f64>() / 4.0;
        Matrix3::from_diagonal(&Vector3::new(1e4 - 1e6 * (x - 0.03).abs(), -2e4, 0.0))
    };
    let ((tet, corner), tension) = volume.most_pulled(mesh.rest(), stress).expect("there are faces");
    assert!(tension > 5e3 && tension <= 1e4, "{tension} Pa");
    let nodes = mesh.tets()[tet as usize];
    let face: Vec<_> =
        (0..4).filter(|k| *k != usize::from(corner)).map(|k| mesh.rest()[nodes[k] as usize]).collect();
    assert!(face.iter().all(|at| (at.x - 0.03).abs() < 1e-9), "{face:?}");
    // Torn face by face it separates, and only there.
    let mut volume = volume;
    let mut steps = 0;
    while volume.pieces() == 1 {
        let positions = volume.rest().to_vec();
        let (face, tension) = volume.most_pulled(&positions, stress).expect("there are faces");
        assert!(tension > 5e3, "{tension} Pa after {steps} faces");
        volume.open(&[face]).expect("it is there");
        steps += 1;
    }
    assert_eq!((volume.pieces(), steps), (2, 8), "two triangles for each of four cells");
}

#[test]
fn a_refined_mesh_is_fine_where_it_is_asked_to_be_and_as_sound_as_before() {
    let grid = BoxCells { cells: [2, 2, 2], size: Vector3::repeat(0.04), origin: Point3::origin() };
    let (nodes, tets) = box_cells(&grid);
    let edge = |at: &Point3<f64>| 0.002 + 0.8 * at.coords.norm();
    let (fine, elements) = refined(&nodes, &tets, edge, 20_000).expect("not that many");
    assert_eq!(fine[..nodes.len()], nodes[..]);
    let mesh = TetMesh::new(&fine, &elements, &MeshRules { mean_ratio_min: 0.3, ..MeshRules::default() })
        .expect("no hanging node, and no element much worse than the first ones");
    assert!((mesh.volume() - 0.04_f64.powi(3)).abs() < 1e-16);
    for tet in mesh.tets() {
        let corners = tet.map(|node| mesh.rest()[node as usize]);
        let middle = Point3::from(corners.iter().map(|at| at.coords).sum::<Vector3<f64>>() / 4.0);
        for i in 0..4 {
            for j in 0..i {
                assert!((corners[i] - corners[j]).norm() <= edge(&middle));
            }
        }
    }
    assert_eq!(refined(&nodes, &tets, |_| 1e-4, 1000), Err(RefineError::TooMany { nodes_max: 1000 }));
    assert!(matches!(
        refined(&nodes, &[[0, 1, 2, 99]], edge, 10),
        Err(RefineError::Corner { tet: 0, nodes: 27 })
    ));
    let (same, none) = refined(&nodes, &tets, |_| 1.0, 1000).expect("nothing to do");
    assert_eq!((same, none), (nodes, tets));
}

/// Sweeps a straight blade, which points along y and by `turn` along x, through a block in this many ticks, its path
/// tilted by `slope`; everything moves by `drift` in each tick.
fn drawn(
    ticks: u32,
    [slope, turn]: [f64; 2],
    drift: Vector3<f64>,
) -> (Volume, OpenCut, Point3<f64>, Vector3<f64>) {
    let mesh = block([6, 3, 3]);
    let mut volume = Volume::new(&mesh);
    let (mut slit, mut change) = (OpenCut::default(), VolumeChange::default());
    let mut nodes = NodeMotion { positions: mesh.rest().to_vec(), moved: vec![drift; mesh.rest().len()] };
    // Through the middle of the block, from above to below.
    let middle = Point3::new(0.0287, 0.015, 0.015);
    let (way, blade) = (Vector3::new(slope, 0.0, -1.0), Vector3::new(turn, 1.0, 0.0));
    let at = |tick: u32| {
        let along = -0.02 + 0.04 * f64::from(tick) / f64::from(ticks);
        let place = middle + way * along + drift * f64::from(tick);
        [place - blade * 0.03, place + blade * 0.03]
    };
    for tick in 1..=ticks {
        nodes.positions.iter_mut().for_each(|position| *position += drift);
        nodes.moved.fill(drift);
        let sweep = Sweep { before: at(tick - 1), after: at(tick) };
        volume.cut(&mut nodes, &[sweep], &mut slit, &mut change).expect("a cut");
        agrees(&volume);
        let positions = nodes.positions.iter().zip(volume.rest());
        for (position, rest) in positions {
            assert!(
                (position - rest - drift * f64::from(tick)).norm() < 1e-12,
                "new nodes are where they are"
            );
        }
    }
    assert!((volume.tets().map(|(tet, _)| volume_of(&volume, tet)).sum::<f64>() - 54e-6).abs() < 1e-15);
    (volume, slit, middle, blade.cross(&way).normalize())
}

fn volume_of(volume: &Volume, tet: u32) -> f64 {
    let [a, b, c, d] = volume.tet(tet).expect("it is there").map(|node| volume.rest()[node as usize]);
    (b - a).cross(&(c - a)).dot(&(d - a)) / 6.0
}

/// However fast the blade is, and whether or not the tissue moves meanwhile, there are two pieces, one on either side
/// of the path; the lips are where the path was, not at existing faces.
#[test]
fn a_blade_cuts_where_it_passes_and_not_where_elements_meet() {
    for (ticks, slopes, drift) in [
        (1, [0.0, 0.0], Vector3::zeros()),
        (7, [0.0, 0.0], Vector3::zeros()),
        (23, [0.31, 0.0], Vector3::zeros()),
        (60, [-0.47, 0.0], Vector3::zeros()),
        (1, [0.31, 0.4], Vector3::zeros()),
        (7, [-0.2, -0.6], Vector3::zeros()),
        (60, [0.12, 0.77], Vector3::zeros()),
        (23, [0.31, 0.0], Vector3::new(4e-4, -2e-4, 3e-4)),
        (23, [-0.31, 0.5], Vector3::new(4e-4, -2e-4, 3e-4)),
    ] {
        let (volume, _, middle, normal) = drawn(ticks, slopes, drift);
        let name = format!("{ticks} ticks, slopes {slopes:?}, drift {drift:?}");
        assert_eq!(volume.pieces(), 2, "{name}");
        let height = |node: u32| normal.dot(&(volume.rest()[node as usize] - middle));
        // A deviation is allowed where an element would have become too small or too flat; the more, the more the plane
        // is askew to the grid.
        let most = if slopes[1] == 0.0 { 2.5e-3 } else { 4.3e-3 };
        let mut worst: f64 = 0.0;
        for (tet, nodes) in volume.tets() {
            let middle = nodes.iter().map(|&node| height(node)).sum::<f64>() / 4.0;
            let across = nodes.iter().map(|&node| -height(node) * middle.signum()).fold(0.0, f64::max);
            worst = worst.max(across);
            assert!(volume_of(&volume, tet) > 1e-12, "{name}: {} m³", volume_of(&volume, tet));
        }
        assert!(worst < most, "{name}: {worst} m across the path");
        // Area of the lips: that of the path within the block, on both sides.
        let area: f64 = volume
            .surface()
            .filter(|corners| corners.iter().all(|&node| height(node).abs() < most + 1e-4))
            .map(|corners| {
                let [a, b, c] = corners.map(|node| volume.rest()[node as usize]);
                let area = (b - a).cross(&(c - a)) / 2.0;
                if area.normalize().dot(&normal).abs() > 0.7 { area.norm() } else { 0.0 }
            })
            .sum();
        // The section by a plane through two opposite pairs of sides, from its projection on them.
        let wanted = 2.0 * 0.03 * 0.03 / normal.x.abs();
        assert!((area / wanted - 1.0).abs() < 0.05, "{name}: lips of {area} m², not {wanted} m²");
    }
}

/// A thousand cuts in random directions: the mesh stays valid, and no element is smaller or flatter than allowed.
#[test]
fn a_thousand_random_cuts_leave_no_sliver() {
    let mesh = block([4, 4, 4]);
    let mut volume = Volume::new(&mesh);
    let (mut slit, mut change) = (OpenCut::default(), VolumeChange::default());
    let mut nodes =
        NodeMotion { positions: mesh.rest().to_vec(), moved: vec![Vector3::zeros(); mesh.rest().len()] };
    let mut random = Pcg64Mcg::seed_from_u64(11);
    for round in 0..1000 {
        let mut point = || Point3::from([0; 3].map(|_| random.random_range(-0.005..0.045)));
        let (from, to) = (point(), point());
        let blade = [point(), point()];
        let sweep = Sweep { before: blade, after: blade.map(|end| end + (to - from) * 0.3) };
        volume.cut(&mut nodes, &[sweep], &mut slit, &mut change).expect("a cut");
        if round % 100 == 99 {
            agrees(&volume);
        }
    }
    let mut whole = 0.0;
    for (tet, _) in volume.tets() {
        whole += volume_of(&volume, tet);
    }
    assert!((whole / 64e-6 - 1.0).abs() < 1e-9, "{whole} m³");
    let (mesh, _) = volume.mesh().expect("something is left");
    let flat = trocar_dynamics::tet_mesh::defects(
        mesh.rest(),
        mesh.tets(),
        &MeshRules { mean_ratio_min: 0.02, coincident_within: None },
    );
    assert!(flat.is_empty(), "{flat:?}");
    assert!(volume.pieces() > 1);
}

/// Explicit springs separate along faces between elements: after a thousand cuts, the ratio of stiffness to mass has
/// not increased.
#[test]
fn a_thousand_random_cuts_never_halve_the_safe_step_of_a_volume_of_springs() {
    let mesh = block([5, 5, 5]);
    let mut volume = Volume::new(&mesh);
    let step = |volume: &Volume| {
        let (mesh, _) = volume.mesh().expect("something is left");
        let material = VolumeMaterial { young_modulus: 2e4, density: 1000.0 };
        let network = Network::from_volume(mesh.rest(), mesh.tets(), &material).expect("a network");
        MassSpring::new(network, mesh.rest().to_vec(), &[], Config::default()).expect("a solver").safe_step()
    };
    let at_first = step(&volume);
    let mut random = Pcg64Mcg::seed_from_u64(5);
    let (mut opened, mut least) = (0, f64::INFINITY);
    for round in 0..1000 {
        let mut point = || Point3::from([0; 3].map(|_| random.random_range(-0.005..0.055)));
        let (from, to) = (point(), point());
        let blade = [point(), point()];
        let after = blade.map(|end| end + (to - from) * 0.3);
        let places = volume.rest().to_vec();
        let faces = volume.swept(&places, &blade, &after);
        opened += faces.len();
        volume.open(&faces).expect("they are there");
        if round < 100 || round % 50 == 49 {
            least = least.min(step(&volume));
        }
    }
    assert!(opened > 500 && volume.pieces() > 10, "{opened} faces, {} pieces", volume.pieces());
    assert!(least > 0.5 * at_first, "{least} s of {at_first} s");
    // It accepts half of the initial step, which would be rejected if too large: it falls, and its kinetic and elastic
    // energy equals the loss of potential energy.
    let (mesh, _) = volume.mesh().expect("something is left");
    let material = VolumeMaterial { young_modulus: 2e4, density: 1000.0 };
    let network = Network::from_volume(mesh.rest(), mesh.tets(), &material).expect("a network");
    let integrator = Integrator::Explicit { too_large: TooLarge::Refuse };
    let config = Config { integrator, ..Config::default() };
    let low: Vec<u32> = (0..mesh.rest().len() as u32).filter(|&n| mesh.rest()[n as usize].z == 0.0).collect();
    let mut solver = MassSpring::new(network, mesh.rest().to_vec(), &low, config).expect("a solver");
    let gravity = Vector3::new(0.0, 0.0, -9.81);
    let all = |solver: &MassSpring| {
        let of = |(mass, place): (&f64, &Point3<f64>)| mass * 9.81 * place.z;
        let height: f64 = solver.network().masses.iter().zip(&solver.state().positions).map(of).sum();
        (height, height + solver.elastic_energy() + solver.kinetic_energy())
    };
    let (high, begun) = all(&solver);
    for step in 0..1000 {
        solver.step(0.5 * at_first, &Input { gravity, ..Input::default() }).expect("a step");
        let (height, energy) = all(&solver);
        let (made, lost) = (energy - begun, high - height);
        assert!(made < 0.02 * lost.abs() + 1e-9, "step {step}: {made} J made where {lost} J were lost");
    }
    assert!(high - all(&solver).0 > 1e-3, "pieces that nothing holds have fallen");
}
