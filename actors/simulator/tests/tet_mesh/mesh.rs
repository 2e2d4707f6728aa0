//! Validation of tetrahedral meshes: faults are listed by element, repaired where possible, or rejected.

use nalgebra::{Point3, Vector3};
use proptest::prelude::*;
use trocar_dynamics::tet_mesh::{BoxCells, Defect, MeshRules, TetMesh, box_cells, defects};

fn grid(cells: [usize; 3]) -> BoxCells {
    BoxCells { cells, size: Vector3::new(0.1, 0.02, 0.02), origin: Point3::origin() }
}

fn rules() -> MeshRules {
    MeshRules::default()
}

#[test]
fn a_box_of_six_tet_cells_is_sound_and_fills_itself() {
    let (nodes, tets) = box_cells(&grid([10, 2, 2]));
    assert_eq!((nodes.len(), tets.len()), (99, 240));
    let mesh = TetMesh::new(&nodes, &tets, &rules()).expect("a sound mesh");
    assert!((mesh.volume() - 4e-5).abs() < 1e-17);
    let mass: f64 = mesh.lumped_masses(1000.0).iter().sum();
    assert!((mass - 0.04).abs() < 1e-14, "{mass}");
    // Two triangles on every outer face of a cell.
    assert_eq!(mesh.surface().len(), 2 * (2 * 10 * 2 * 2 + 2 * 2 * 2));
    assert_eq!(mesh.surface_nodes().len(), 99 - 9);
}

#[test]
fn the_boundary_faces_outward_and_is_closed() {
    let (nodes, tets) = box_cells(&grid([4, 3, 2]));
    let mesh = TetMesh::new(&nodes, &tets, &rules()).expect("a sound mesh");
    // The divergence theorem: the flux of x through the boundary is three times the volume; that of a constant is none.
    let (mut flux, mut area) = (0.0, Vector3::zeros());
    for &[a, b, c] in mesh.surface() {
        let [a, b, c] = [a, b, c].map(|node| nodes[node as usize].coords);
        let normal = (b - a).cross(&(c - a)) / 2.0;
        flux += normal.dot(&((a + b + c) / 3.0));
        area += normal;
    }
    assert!((flux / 3.0 - mesh.volume()).abs() < 1e-12 * mesh.volume(), "{flux}");
    assert!(area.norm() < 1e-17, "{area}");
}

#[test]
fn gradients_add_up_to_nothing_and_reproduce_a_linear_field() {
    let (nodes, tets) = box_cells(&grid([2, 2, 2]));
    let mesh = TetMesh::new(&nodes, &tets, &rules()).expect("a sound mesh");
    let slope = Vector3::new(0.3, -2.0, 5.0);
    for (index, tet) in tets.iter().enumerate() {
        let gradients = mesh.gradients(index);
        let sum: Vector3<f64> = gradients.iter().sum();
        assert!(sum.norm() < 1e-9, "{sum}");
        let found: Vector3<f64> =
            tet.iter().zip(gradients).map(|(&n, g)| g * slope.dot(&nodes[n as usize].coords)).sum();
        assert!((found - slope).norm() < 1e-10, "{found}");
    }
}

#[test]
fn a_point_is_found_in_its_element() {
    let (nodes, tets) = box_cells(&grid([5, 2, 2]));
    let mesh = TetMesh::new(&nodes, &tets, &rules()).expect("a sound mesh");
    let point = Point3::new(0.0437, 0.0121, 0.0066);
    let (tet, weights) = mesh.locate(&point).expect("there are elements");
    assert!(weights.iter().all(|&weight| weight > 0.0), "{weights:?}");
    let back: Vector3<f64> =
        tets[tet].iter().zip(weights).map(|(&node, weight)| nodes[node as usize].coords * weight).sum();
    assert!((back - point.coords).norm() < 1e-16);
}

#[test]
fn every_defect_is_listed_with_its_numbers() {
    let (mut nodes, mut tets) = box_cells(&grid([2, 1, 1]));
    let count = nodes.len() as u32;
    nodes.push(Point3::new(9.0, 9.0, 9.0)); // No element's.
    nodes.push(nodes[3]); // At the place of node 3, and no element's.
    nodes.push(Point3::new(f64::NAN, 0.0, 0.0));
    tets[1].swap(0, 1);
    tets[4] = [0, 1, 1, 2];
    tets.push([0, 1, 2, 77]);
    tets.push(tets[0]);
    let found = defects(&nodes, &tets, &rules());
    assert!(found.contains(&Defect::NotFinite { node: count + 2 }), "{found:?}");
    assert!(found.contains(&Defect::Coincident { first: 3, second: count + 1 }), "{found:?}");
    for node in [count, count + 1, count + 2] {
        assert!(found.contains(&Defect::Unreferenced { node }), "{found:?}");
    }
    assert!(
        found.iter().any(|d| matches!(d, Defect::Inverted { tet: 1, volume } if *volume < 0.0)),
        "{found:?}"
    );
    assert!(found.contains(&Defect::RepeatedCorner { tet: 4, node: 1 }), "{found:?}");
    assert!(found.contains(&Defect::NoNode { tet: 12, node: 77, nodes: nodes.len() }), "{found:?}");
    assert!(found.contains(&Defect::SameCorners { first: 0, second: 13 }), "{found:?}");
    let error = TetMesh::new(&nodes, &tets, &rules()).expect_err("nothing to be used");
    assert_eq!(error.defects, found);
    assert!(error.to_string().starts_with(&format!("the tetrahedral mesh has {} defects: ", found.len())));
}

#[test]
fn what_can_be_mended_is_mended_and_said() {
    let (clean_nodes, clean) = box_cells(&grid([3, 2, 2]));
    let expected = TetMesh::new(&clean_nodes, &clean, &rules()).expect("a sound mesh");
    let (mut nodes, mut tets) = (clean_nodes.clone(), clean.clone());
    // An unused node in front shifts every number.
    nodes.insert(0, Point3::new(5.0, 5.0, 5.0));
    for tet in &mut tets {
        *tet = tet.map(|node| node + 1);
    }
    // A corner doubled, an element inverted, one flat, one twice.
    let twin = nodes.len() as u32;
    nodes.push(nodes[4]);
    let user = tets.iter().position(|tet| tet.contains(&4)).expect("somebody uses it");
    tets[user] = tets[user].map(|node| if node == 4 { twin } else { node });
    tets[7].swap(1, 2);
    tets.push([1, 2, 3, 1]);
    tets.push(tets[9]);
    let (mesh, repairs) = TetMesh::repaired(&nodes, &tets, &rules()).expect("can be mended");
    assert_eq!(mesh.rest(), expected.rest());
    assert_eq!(mesh.tets().len(), expected.tets().len());
    assert!((mesh.volume() - expected.volume()).abs() < 1e-18);
    assert_eq!(mesh.surface().len(), expected.surface().len());
    assert_eq!(repairs.turned_tets, [7]);
    assert_eq!(repairs.dropped_tets, [clean.len() as u32, clean.len() as u32 + 1]);
    assert_eq!(repairs.merged_nodes, [(twin, 4)]);
    assert_eq!(repairs.dropped_nodes, [0]);
    let (_, nothing) = TetMesh::repaired(&clean_nodes, &clean, &rules()).expect("nothing to mend");
    assert!(nothing.is_empty(), "{nothing:?}");
}

#[test]
fn what_cannot_be_mended_is_refused_by_the_numbers_that_came() {
    let nodes: Vec<_> = [
        [9.0, 9.0, 9.0],
        [0.0, 0.0, 0.0],
        [1.0, 0.0, 0.0],
        [0.0, 1.0, 0.0],
        [0.0, 0.0, 1.0],
        [0.2, 0.2, 2.0],
        [0.1, 0.1, -1.0],
    ]
    .map(Point3::from)
    .to_vec();
    // Two on the same side of face 1 2 3, and then a third on the other.
    let two = [[1, 2, 3, 4], [1, 2, 3, 5]];
    let error = TetMesh::repaired(&nodes, &two, &rules()).expect_err("they overlap");
    assert_eq!(error.defects, [Defect::Overlap { corners: [1, 2, 3], first: 0, second: 1 }]);
    let three = [[1, 2, 3, 4], [1, 2, 3, 5], [1, 3, 2, 6]];
    let error = TetMesh::repaired(&nodes, &three, &rules()).expect_err("three at a face");
    let shared = Defect::SharedFace { corners: [1, 2, 3], count: 3, first: 0, second: 1 };
    assert_eq!(error.defects, [shared]);
    assert!(TetMesh::repaired(&nodes, &[], &rules()).is_err());
    assert!(TetMesh::repaired(&nodes, &[[1, 1, 2, 3]], &rules()).is_err(), "nothing is left");
}

#[test]
fn a_sliver_is_told_by_its_mean_ratio() {
    let height = 1e-3;
    let nodes = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.3, 0.3, height]].map(Point3::from);
    let found = defects(&nodes, &[[0, 1, 2, 3]], &rules());
    assert!(matches!(found[..], [Defect::Sliver { tet: 0, .. }]), "{found:?}");
    let regular =
        [[1.0, 1.0, 1.0], [1.0, -1.0, -1.0], [-1.0, 1.0, -1.0], [-1.0, -1.0, 1.0]].map(Point3::from);
    let strict = MeshRules { mean_ratio_min: 1.0 - 1e-12, ..rules() };
    let sound = [[0, 1, 2, 3], [0, 1, 3, 2]].map(|tet| defects(&regular, &[tet], &strict));
    assert!(sound.iter().any(Vec::is_empty), "a regular tetrahedron has a mean ratio of 1: {sound:?}");
}

#[test]
fn a_cut_may_leave_nodes_at_the_same_place() {
    let (mut nodes, mut tets) = box_cells(&grid([2, 1, 1]));
    // The second cell gets corners of its own.
    let apart = nodes.len() as u32;
    for node in 4..8 {
        nodes.push(nodes[node]);
    }
    for tet in &mut tets[6..] {
        *tet = tet.map(|node| if (4..8).contains(&node) { node - 4 + apart } else { node });
    }
    assert!(TetMesh::new(&nodes, &tets, &rules()).is_err());
    let open = MeshRules { coincident_within: None, ..rules() };
    let mesh = TetMesh::new(&nodes, &tets, &open).expect("a cut mesh");
    assert_eq!(mesh.surface().len(), 24, "two closed boxes");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]
    /// For arbitrary input there is a result, and a repaired mesh is valid.
    #[test]
    fn any_soup_is_answered(
        nodes in prop::collection::vec([-2..3_i32, -2..3, -2..3], 0..12),
        tets in prop::collection::vec([0..13_u32, 0..13, 0..13, 0..13], 0..12),
    ) {
        let nodes: Vec<_> = nodes.into_iter().map(|at| Point3::from(at.map(f64::from))).collect();
        if let Ok((mesh, _)) = TetMesh::repaired(&nodes, &tets, &rules()) {
            prop_assert!(defects(mesh.rest(), mesh.tets(), &rules()).is_empty());
            prop_assert!(mesh.volumes().iter().all(|&volume| volume > 0.0));
        }
    }
}
