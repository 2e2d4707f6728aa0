//! The precomputed inverse at run time: grasps, needles, patches and contacts against direct solves.

use crate::support::beam;
use nalgebra::{Point3, Unit, Vector3};
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;
use trocar_dynamics::elasticity::Elastic;
use trocar_dynamics::tet_mesh::{BoxCells, MeshRules, TetMesh, box_cells};
use trocar_simulator::linear_fem::{
    Attachment, AttachmentError, BytesError, Compliance, Hold, Limits, LinearFem, LinearFemError, Load,
    PrecomputeError, patch,
};

fn body(cells: [usize; 3]) -> LinearFem {
    let mesh = beam::mesh(cells);
    let fixed = beam::nodes_at(&mesh, 0.0);
    LinearFem::new(mesh, &beam::material(), &fixed, &Limits::default(), &mut |_| true).expect("a body")
}

/// A free surface node near a point, and an interior one.
fn nearest(mesh: &TetMesh, at: [f64; 3], surface: bool) -> u32 {
    let at = Point3::from(at);
    let fits = |node: &u32| mesh.surface_nodes().binary_search(node).is_ok() == surface;
    (0..mesh.rest().len() as u32)
        .filter(fits)
        .min_by(|&a, &b| {
            let far = |node: u32| (mesh.rest()[node as usize] - at).norm();
            far(a).total_cmp(&far(b))
        })
        .expect("there are some")
}

fn of(displacements: &[Vector3<f64>], weights: &[(u32, f64)]) -> Vector3<f64> {
    weights.iter().map(|&(node, weight)| displacements[node as usize] * weight).sum()
}

#[test]
fn dead_loads_give_the_deflection_of_the_reference() {
    let mut fem = body([10, 2, 2]);
    let forces = beam::end_traction(fem.mesh());
    fem.set_dead_load(&forces).expect("forces");
    let mut all = Vec::new();
    fem.displacements(&mut all);
    let found = beam::end_deflection(fem.mesh(), &all);
    assert!((found / 1.306_239_43e-3 - 1.0).abs() < 1e-7, "{found}");
}

#[test]
fn the_stored_inverse_gives_the_surface_of_the_direct_solve() {
    let mut fem = body([12, 3, 3]);
    let node = nearest(fem.mesh(), [0.07, 0.01, 0.02], true);
    let weights = [(node, 1.0)];
    let load = Load { weights: &weights, force: Vector3::new(0.003, -0.002, -0.01) };
    fem.solve(&[load]).expect("a load");
    let (mut surface, mut all) = (Vec::new(), Vec::new());
    fem.surface_displacements(&mut surface);
    fem.displacements(&mut all);
    let most = all.iter().map(|u| u.norm()).fold(0.0, f64::max);
    for (node, found) in fem.compliance().nodes().iter().zip(&surface) {
        assert!((found - all[*node as usize]).norm() < 1e-5 * most, "{node}");
    }
}

#[test]
fn what_is_held_stands_where_it_is_to_and_the_force_is_read_back() {
    let mut fem = body([12, 4, 4]);
    let mesh = fem.mesh().clone();
    // A grasp of a patch, a needle in the interior, a node on a rail, and weight on all of it.
    let grasp = patch(mesh.rest(), mesh.surface(), &Point3::new(0.08, 0.01, 0.02), 0.006).expect("a patch");
    let (tet, inside) = mesh.locate(&Point3::new(0.05, 0.011, 0.009)).expect("inside");
    let needle = Attachment::barycentric(mesh.tets()[tet], inside, Hold::Point);
    let along = Unit::new_normalize(Vector3::new(0.2, 1.0, 0.3));
    let rail = nearest(&mesh, [0.1, 0.0, 0.02], true);
    let weight: Vec<_> = mesh.lumped_masses(1000.0).iter().map(|m| Vector3::z() * (-9.81 * m)).collect();
    fem.set_dead_load(&weight).expect("forces");
    let grasp_handle = fem.hold(Attachment { weights: grasp.clone(), hold: Hold::Point }).expect("held");
    let needle_handle = fem.hold(needle.clone()).expect("held");
    let rail_handle = fem.hold(Attachment::node(rail, Hold::Along(along))).expect("held");
    let targets =
        [Vector3::new(0.001, 0.0, 0.002), Vector3::new(0.0, 0.0005, 0.0), along.into_inner() * 0.0008];
    for (handle, target) in [grasp_handle, needle_handle, rail_handle].into_iter().zip(targets) {
        fem.set_target(handle, target).expect("held");
    }
    let forces: Vec<_> = fem.solve(&[]).expect("solved").reactions.iter().map(|r| r.force).collect();
    assert!(forces.iter().all(|force| force.norm() > 1e-3), "{forces:?}");
    assert!((forces[2].cross(&along)).norm() < 1e-15, "a rail does not push across");

    // In a direct f64 solve under these forces, every target is met: within 1 %.
    let mut all = Vec::new();
    fem.displacements(&mut all);
    let ends = [
        of(&all, &grasp),
        of(&all, &needle.weights),
        along.into_inner() * of(&all, &[(rail, 1.0)]).dot(&along),
    ];
    for (end, target) in ends.iter().zip(targets) {
        assert!((end - target).norm() < 1e-5 * 0.002, "{end} {target}");
    }

    // Released in another order, the rest is as if it had never been held.
    fem.release(needle_handle).expect("held");
    let left: Vec<_> = fem.solve(&[]).expect("solved").reactions.to_vec();
    let mut fresh = body([12, 4, 4]);
    fresh.set_dead_load(&weight).expect("forces");
    let rail_first = fresh.hold(Attachment::node(rail, Hold::Along(along))).expect("held");
    let then = fresh.hold(Attachment { weights: grasp, hold: Hold::Point }).expect("held");
    fresh.set_target(rail_first, targets[2]).expect("held");
    fresh.set_target(then, targets[0]).expect("held");
    let expected: Vec<_> = fresh.solve(&[]).expect("solved").reactions.to_vec();
    for (found, expected) in left.iter().rev().zip(&expected) {
        let error = (found.force - expected.force).norm();
        assert!(error < 1e-4 * expected.force.norm(), "{found:?} {expected:?}");
    }
}

#[test]
fn ten_grasped_nodes_read_back_the_force_of_a_direct_solve() {
    // All displacements of ten neighbouring nodes: the worst case for the rounding of the compliance. The direct solve
    // prescribes them too, as part of the fixed boundary, and its forces are K u.
    use trocar_simulator::stiffness::stiffness;
    let mesh = beam::mesh([12, 4, 4]);
    let mut fem = body([12, 4, 4]);
    let mut tip: Vec<u32> = fem.compliance().nodes().to_vec();
    let at = Point3::new(0.08, 0.01, 0.02);
    tip.sort_by(|&a, &b| {
        (mesh.rest()[a as usize] - at).norm().total_cmp(&(mesh.rest()[b as usize] - at).norm())
    });
    tip.truncate(10);
    let mut random = Pcg64Mcg::seed_from_u64(5);
    let mut targets = Vec::new();
    for &node in &tip {
        let target =
            Vector3::new(0.0, 0.0, 0.002) + Vector3::from_fn(|_, _| random.random_range(-1e-4..1e-4));
        let handle = fem.hold(Attachment::node(node, Hold::Point)).expect("held");
        fem.set_target(handle, target).expect("held");
        targets.push(target);
    }
    let found: Vec<_> = fem.solve(&[]).expect("solved").reactions.iter().map(|r| r.force).collect();
    let mut all = Vec::new();
    fem.displacements(&mut all);
    // K u over all nodes at the given displacements of the tip, the rest in equilibrium.
    let count = mesh.rest().len();
    let every: Vec<_> = (0..count as u32).map(Some).collect();
    let k = stiffness(&mesh, &beam::material(), &every, count);
    let held: Vec<u32> = beam::nodes_at(&mesh, 0.0).into_iter().chain(tip.iter().copied()).collect();
    let mut next = 0;
    let numbers: Vec<Option<u32>> = (0..count as u32)
        .map(|node| {
            (!held.contains(&node)).then(|| {
                next += 1;
                next - 1
            })
        })
        .collect();
    let inner = stiffness(&mesh, &beam::material(), &numbers, next as usize);
    let mut factor =
        trocar_simulator::linear_algebra::SupernodalCholesky::new(inner.pattern(), 1).expect("room");
    factor.factor(inner.pattern(), inner.values()).expect("definite");
    let mut u = vec![Vector3::zeros(); count];
    tip.iter().zip(&targets).for_each(|(&node, target)| u[node as usize] = *target);
    let mut forces = vec![Vector3::zeros(); count];
    k.multiply(&u, &mut forces);
    let mut right = vec![0.0; 3 * next as usize];
    for (number, force) in numbers.iter().zip(&forces) {
        if let Some(number) = number {
            (0..3).for_each(|axis| right[3 * *number as usize + axis] = -force[axis]);
        }
    }
    factor.solve(&mut right);
    for (number, u) in numbers.iter().zip(&mut u) {
        if let Some(number) = number {
            *u = Vector3::from_column_slice(&right[3 * *number as usize..][..3]);
        }
    }
    k.multiply(&u, &mut forces);
    let most = tip.iter().map(|&node| forces[node as usize].norm()).fold(0.0, f64::max);
    for (&node, found) in tip.iter().zip(&found) {
        let error = (found - forces[node as usize]).norm();
        assert!(error < 0.001 * most, "node {node}: {found} not {}", forces[node as usize]);
    }
}

/// Force on a patch and on a single node pushed in by 1 mm, on a mesh of such cells.
fn felt(cells: usize) -> [f64; 2] {
    let grid = BoxCells {
        cells: [2 * cells, 2 * cells, cells],
        size: Vector3::new(0.03, 0.03, 0.015),
        origin: Point3::new(-0.015, -0.015, -0.015),
    };
    let (nodes, tets) = box_cells(&grid);
    let mesh = TetMesh::new(&nodes, &tets, &MeshRules::default()).expect("a sound mesh");
    let inside = |at: &Point3<f64>| at.z > -1e-9 && at.x.abs() < 0.0149 && at.y.abs() < 0.0149;
    let fixed: Vec<u32> =
        mesh.surface_nodes().iter().copied().filter(|&n| !inside(&nodes[n as usize])).collect();
    let center = Point3::new(0.0, 0.0, 0.0);
    let spread = patch(mesh.rest(), mesh.surface(), &center, 0.009).expect("a patch");
    let middle = nearest(&mesh, [0.0; 3], true);
    let material = Elastic::new(1e4, 0.3).expect("a material");
    let mut fem = LinearFem::new(mesh, &material, &fixed, &Limits::default(), &mut |_| true).expect("a body");
    [spread, vec![(middle, 1.0)]].map(|weights| {
        let handle = fem.hold(Attachment { weights, hold: Hold::Point }).expect("held");
        fem.set_target(handle, Vector3::new(0.0, 0.0, -1e-3)).expect("held");
        let force = fem.solve(&[]).expect("solved").reactions[0].force.norm();
        fem.release(handle).expect("held");
        force
    })
}

#[test]
fn a_patch_feels_the_same_on_a_finer_mesh_and_a_single_node_does_not() {
    let ([coarse, coarse_node], [fine, fine_node]) = (felt(5), felt(10));
    assert!((fine / coarse - 1.0).abs() < 0.1, "patch: {coarse} N, refined {fine} N");
    // The control: the force on a node halves with the size of its elements.
    assert!(fine_node / coarse_node < 0.65, "node: {coarse_node} N, refined {fine_node} N");
}

#[test]
fn a_contact_pushes_or_does_nothing() {
    let mut fem = body([10, 2, 2]);
    let up = Vector3::z_axis();
    let node = nearest(fem.mesh(), [0.1, 0.01, 0.0], true);
    let floor = fem.hold(Attachment::node(node, Hold::AtLeast(up))).expect("room");
    fem.set_target(floor, up.into_inner() * -0.0005).expect("held");
    let top = [(nearest(fem.mesh(), [0.1, 0.01, 0.02], true), 1.0)];
    let mut push = |force: f64| {
        let load = Load { weights: &top, force: Vector3::new(0.0, 0.0, force) };
        let reaction = fem.solve(&[load]).expect("solved").reactions[0].force;
        let mut surface = Vec::new();
        fem.surface_displacements(&mut surface);
        let index = fem.compliance().nodes().binary_search(&node).expect("on the surface");
        (reaction.z, surface[index].z)
    };
    let (reaction, height) = push(0.01);
    assert!(reaction == 0.0 && height > 0.0, "{reaction} {height}");
    let (reaction, height) = push(-0.02);
    assert!(reaction > 0.001 && (height + 0.0005).abs() < 1e-8, "{reaction} {height}");
    let (reaction, _) = push(0.0);
    assert_eq!(reaction, 0.0, "it lets go");
}

#[test]
fn what_cannot_be_held_is_refused_and_changes_nothing() {
    let mut fem = body([6, 2, 2]);
    let node = nearest(fem.mesh(), [0.1, 0.01, 0.02], true);
    fem.hold(Attachment::node(node, Hold::Point)).expect("held");
    let before = fem.state();
    let twice = fem.hold(Attachment::node(node, Hold::Point));
    assert_eq!(twice, Err(LinearFemError::Dependent { node }));
    let wall = beam::nodes_at(fem.mesh(), 0.0)[0];
    assert_eq!(fem.hold(Attachment::node(wall, Hold::Point)), Err(LinearFemError::Dependent { node: wall }));
    let gone = fem.hold(Attachment::node(9999, Hold::Point));
    assert!(matches!(gone, Err(LinearFemError::Attachment(AttachmentError::NoNode { node: 9999, .. }))));
    let half = Attachment { weights: vec![(node, 0.5)], hold: Hold::Point };
    assert!(matches!(fem.hold(half), Err(LinearFemError::Attachment(AttachmentError::Sum(_)))));
    let nothing = Load { weights: &[(wall, 1.0)], force: Vector3::x() };
    assert_eq!(fem.solve(&[nothing]).err(), Some(LinearFemError::NotOnSurface { node: wall }));
    let nan = Load { weights: &[(node, 1.0)], force: Vector3::x() * f64::NAN };
    assert!(matches!(fem.solve(&[nan]).err(), Some(LinearFemError::NotFinite { .. })));
    assert_eq!(fem.state(), before);
}

#[test]
fn a_restored_body_continues_bit_for_bit() {
    let mut fem = body([10, 2, 2]);
    let weight: Vec<_> =
        fem.mesh().lumped_masses(1000.0).iter().map(|m| Vector3::z() * (-9.81 * m)).collect();
    fem.set_dead_load(&weight).expect("forces");
    let free = fem.compliance().nodes().to_vec();
    let mut handles = Vec::new();
    for (i, &node) in free.iter().step_by(7).enumerate() {
        let hold = [Hold::Point, Hold::Along(Vector3::y_axis()), Hold::AtLeast(Vector3::z_axis())][i % 3];
        handles.push(fem.hold(Attachment::node(node, hold)).expect("held"));
    }
    // A history: some were removed, and the active contacts were found over several cycles.
    fem.release(handles.remove(2)).expect("held");
    fem.release(handles.remove(4)).expect("held");
    let drive = |fem: &mut LinearFem, cycle: usize| -> Vec<Vector3<f64>> {
        for (i, &handle) in handles.iter().enumerate() {
            let target = Vector3::repeat(1e-4 * ((cycle * 3 + i) as f64).sin());
            fem.set_target(handle, target).expect("held");
        }
        fem.solve(&[]).expect("solved").reactions.iter().map(|r| r.force).collect()
    };
    (0..10).for_each(|cycle| drop(drive(&mut fem, cycle)));
    let state = fem.state();
    let mut other = body([10, 2, 2]);
    other.restore(&state).expect("its own state");
    for cycle in 10..30 {
        assert_eq!(drive(&mut fem, cycle), drive(&mut other, cycle));
    }
    let mut damaged = state.clone();
    damaged.multipliers.pop();
    let before = other.state();
    assert!(matches!(other.restore(&damaged), Err(LinearFemError::State(_))));
    assert_eq!(other.state(), before);
}

#[test]
fn a_large_rotation_is_reported() {
    let mut fem = body([10, 2, 2]);
    let tip = nearest(fem.mesh(), [0.1, 0.01, 0.02], true);
    let handle = fem.hold(Attachment::node(tip, Hold::Point)).expect("held");
    fem.set_target(handle, Vector3::new(0.0, 0.0, 1e-4)).expect("held");
    fem.solve(&[]).expect("solved");
    let small = fem.deformation();
    assert!(small.is_small() && small.rotation > 0.0 && small.strain > 0.0, "{small:?}");
    fem.set_target(handle, Vector3::new(0.0, 0.0, 0.03)).expect("held");
    fem.solve(&[]).expect("solved");
    let large = fem.deformation();
    assert!(!large.is_small() && large.rotation > 10_f64.to_radians(), "{large:?}");
}

#[test]
fn what_was_written_is_read_and_everything_else_is_refused() {
    let mesh = beam::mesh([6, 2, 2]);
    let fixed = beam::nodes_at(&mesh, 0.0);
    let (material, limits) = (beam::material(), Limits::default());
    let mut shares = Vec::new();
    let computed = Compliance::precompute(&mesh, &material, &fixed, &limits, &mut |share| {
        shares.push(share);
        true
    })
    .expect("a body");
    assert!(shares.windows(2).all(|pair| pair[0] < pair[1]) && shares.last() == Some(&1.0), "{shares:?}");
    let mut bytes = Vec::new();
    computed.write(&mut bytes).expect("room");
    let read = |bytes: &[u8], material: &Elastic, fixed: &[u32]| {
        Compliance::read(&mut &*bytes, &mesh, material, fixed, &limits)
    };
    assert_eq!(read(&bytes, &material, &fixed).expect("its own bytes"), computed);
    let other = Elastic::new(1e5, 0.31).expect("a material");
    assert!(matches!(read(&bytes, &other, &fixed), Err(BytesError::Fingerprint { .. })));
    assert!(matches!(read(&bytes, &material, &fixed[1..]), Err(BytesError::Fingerprint { .. })));
    assert!(matches!(read(&bytes[..bytes.len() / 2], &material, &fixed), Err(BytesError::Io(_))));
    assert!(matches!(read(b"something else than that", &material, &fixed), Err(BytesError::Magic(_))));
    // Any flipped bit is detected.
    for at in (0..bytes.len()).step_by(997) {
        let mut damaged = bytes.clone();
        damaged[at] ^= 1 << (at % 8);
        assert!(read(&damaged, &material, &fixed).is_err(), "byte {at}");
    }
    assert!(matches!(
        LinearFem::with_compliance(mesh.clone(), &other, &fixed, &limits, computed),
        Err(LinearFemError::OtherCompliance)
    ));
}

#[test]
fn what_is_too_large_or_not_held_is_named() {
    let mesh = beam::mesh([6, 2, 2]);
    let fixed = beam::nodes_at(&mesh, 0.0);
    let attempt = |fixed: &[u32], limits: &Limits| {
        Compliance::precompute(&mesh, &beam::material(), fixed, limits, &mut |_| true).expect_err("refused")
    };
    let small = Limits { bytes_max: 1000, ..Limits::default() };
    let error = attempt(&fixed, &small);
    assert!(
        matches!(error, PrecomputeError::TooLarge { surface_nodes: 49, bytes: 86_436, bytes_max: 1000 }),
        "{error}"
    );
    let few = Limits { nodes_max: 10, ..Limits::default() };
    assert_eq!(attempt(&fixed, &few), PrecomputeError::TooManyNodes { nodes: 63, nodes_max: 10 });
    // A body without support, and one on a hinge.
    for loose in [vec![], beam::nodes_at(&mesh, 0.0)[..3].to_vec()] {
        assert_eq!(attempt(&loose, &Limits::default()), PrecomputeError::Loose { node: 0 });
    }
    assert!(matches!(attempt(&[77], &Limits::default()), PrecomputeError::NoNode { node: 77, nodes: 63 }));
    let all: Vec<u32> = (0..63).collect();
    assert_eq!(attempt(&all, &Limits::default()), PrecomputeError::NothingFree);
    let cancelled =
        Compliance::precompute(&mesh, &beam::material(), &fixed, &Limits::default(), &mut |share| {
            share < 0.5
        });
    assert_eq!(cancelled.expect_err("stopped"), PrecomputeError::Cancelled);
}
