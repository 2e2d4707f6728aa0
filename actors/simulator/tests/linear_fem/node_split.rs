//! Splitting nodes of linear organs: the former inverse is corrected at once, as exactly as a new inverse of the split
//! body.

#[allow(dead_code)] // every test uses another part
use crate::support::beam;
use nalgebra::{Point3, Vector3};
use trocar_dynamics::elasticity::Alteration;
use trocar_dynamics::tet_mesh::{TetFace, TetMesh, Volume};
use trocar_simulator::linear_algebra::SupernodalCholesky;
use trocar_simulator::linear_fem::{Attachment, Hold, Limits, LinearFem, LinearFemError, Load, patch};
use trocar_simulator::stiffness::stiffness;

/// A body with the inverse of the unsplit mesh.
fn body(mesh: &TetMesh, fixed: &[u32]) -> LinearFem {
    LinearFem::new(mesh.clone(), &beam::material(), fixed, &Limits::default(), &mut |_| true).expect("a body")
}

/// The inverse of the split body.
fn fresh(mesh: &TetMesh, parents: &[u32], fixed: &[u32], alterations: &[Alteration]) -> LinearFem {
    let (material, limits) = (beam::material(), Limits::default());
    LinearFem::parted(mesh.clone(), &material, alterations, parents, fixed, &limits, &mut |_| true)
        .expect("a body")
}

/// The beam with a slit at an x, from a height on \[m\]: its mesh, and the originals of its new nodes.
struct OpenCut {
    whole: TetMesh,
    mesh: TetMesh,
    parents: Vec<u32>,
    wall: Vec<u32>,
}

fn middle(mesh: &TetMesh, nodes: &[u32; 4]) -> Point3<f64> {
    Point3::from(nodes.iter().map(|&n| mesh.rest()[n as usize].coords).sum::<Vector3<f64>>() / 4.0)
}

/// Faces between elements on the two sides of a plane.
fn faces_at(whole: &TetMesh, volume: &Volume, x: f64, from: f64) -> Vec<TetFace> {
    let mut faces = Vec::new();
    for (tet, nodes) in volume.tets() {
        for corner in 0..4_u8 {
            let face = volume.face((tet, corner)).expect("it is there");
            let at = |node: &u32| {
                let place = whole.rest()[*node as usize];
                (place.x - x).abs() < 1e-9 && place.z > from - 1e-9
            };
            if face.iter().all(at) && middle(whole, &nodes).x > x {
                faces.push((tet, corner));
            }
        }
    }
    faces
}

impl OpenCut {
    fn new(cells: [usize; 3], x: f64, from: f64) -> Self {
        let whole = beam::mesh(cells);
        let mut volume = Volume::new(&whole);
        let faces = faces_at(&whole, &volume, x, from);
        let change = volume.open(&faces).expect("they are there");
        let parents: Vec<u32> = change.born.iter().map(|birth| birth.of[0]).collect();
        let tets = volume.tets().map(|(_, nodes)| nodes).collect();
        let mesh = whole.parted(whole.rest().len(), &parents, tets);
        let wall = beam::nodes_at(&whole, 0.0);
        Self { whole, mesh, parents, wall }
    }

    /// The former inverse, corrected.
    fn serving(&self) -> LinearFem {
        let mut fem = body(&self.whole, &self.wall);
        fem.split_nodes(&self.mesh, &self.parents).expect("it becomes that");
        while fem.can_release() {
            assert!(fem.release_nodes(7).expect("room") > 0);
        }
        assert_eq!(fem.waiting(), 0);
        fem
    }

    fn fresh(&self) -> LinearFem {
        fresh(&self.mesh, &self.parents, &self.wall, &vec![Alteration::NONE; self.mesh.tets().len()])
    }
}

fn all(fem: &mut LinearFem) -> Vec<Vector3<f64>> {
    let mut out = Vec::new();
    fem.displacements(&mut out);
    out
}

fn most(all: &[Vector3<f64>]) -> f64 {
    all.iter().map(|moved| moved.norm()).fold(0.0, f64::max)
}

fn apart(one: &[Vector3<f64>], other: &[Vector3<f64>]) -> f64 {
    assert_eq!(one.len(), other.len());
    one.iter().zip(other).map(|(a, b)| (a - b).norm()).fold(0.0, f64::max)
}

/// Displacements of all nodes under forces on all nodes, by an independent direct solve.
fn direct(mesh: &TetMesh, wall: &[u32], forces: &[Vector3<f64>]) -> Vec<Vector3<f64>> {
    let mut next = 0;
    let numbers: Vec<Option<u32>> = (0..mesh.rest().len() as u32)
        .map(|node| {
            let stays = wall.contains(&node);
            next += u32::from(!stays);
            (!stays).then(|| next - 1)
        })
        .collect();
    let matrix = stiffness(mesh, &beam::material(), &numbers, next as usize);
    let mut factor = SupernodalCholesky::new(matrix.pattern(), 1).expect("room");
    factor.factor(matrix.pattern(), matrix.values()).expect("definite");
    let mut right = vec![0.0; 3 * next as usize];
    for (number, force) in numbers.iter().zip(forces) {
        if let Some(number) = number {
            right[3 * *number as usize..][..3].copy_from_slice(force.as_slice());
        }
    }
    factor.solve(&mut right);
    let of = |number: &Option<u32>| {
        number.map_or_else(Vector3::zeros, |at| Vector3::from_column_slice(&right[3 * at as usize..][..3]))
    };
    numbers.iter().map(of).collect()
}

#[test]
fn a_bar_that_is_slit_across_half_its_section_bends_as_a_direct_solve_of_the_slit_mesh() {
    let slit = OpenCut::new([20, 4, 4], 0.05, 0.01);
    // Two layers of the nodes of the upper half; those at the root of the slit stay one.
    assert_eq!(slit.parents.len(), 2 * 5);
    let force = Vector3::new(0.001, 0.002, -0.02);
    let end: Vec<u32> = beam::nodes_at(&slit.mesh, 0.1);
    let mut forces = vec![Vector3::zeros(); slit.mesh.rest().len()];
    end.iter().for_each(|&node| forces[node as usize] = force / end.len() as f64);
    let exact = direct(&slit.mesh, &slit.wall, &forces);
    let weights: Vec<(u32, f64)> = end.iter().map(|&node| (node, 1.0 / end.len() as f64)).collect();
    let bent = |fem: &mut LinearFem| {
        fem.solve(&[Load { weights: &weights, force }]).expect("solved");
        all(fem)
    };
    let (mut serving, mut new) = (slit.serving(), slit.fresh());
    for (name, fem) in [("corrected", &mut serving), ("computed anew", &mut new)] {
        let moved = bent(fem);
        // Apart from the bonds, of a millionth.
        assert!(apart(&moved, &exact) < 1e-5 * most(&exact), "{name}: {} m", apart(&moved, &exact));
        // The surface too, from the inverse in f32.
        let mut surface = Vec::new();
        fem.surface_displacements(&mut surface);
        let lip = slit.parents[0];
        assert!(fem.nodes().contains(&lip) && fem.nodes().contains(&(slit.whole.rest().len() as u32)));
        for (&node, found) in fem.nodes().iter().zip(&surface) {
            let error = (found - exact[node as usize]).norm();
            assert!(error < 1e-4 * most(&exact), "{name}, node {node}: {error} m");
        }
    }
    assert!(apart(&bent(&mut serving), &bent(&mut new)) < 1e-6 * most(&exact));
    // The controls: the slit opens, and an unsplit bar bends differently.
    let born = slit.whole.rest().len();
    let gap = (exact[born] - exact[slit.parents[0] as usize]).norm();
    assert!(gap > 0.01 * most(&exact), "{gap} m");
    let whole = bent(&mut body(&slit.whole, &slit.wall));
    assert!(apart(&whole, &exact[..born]) > 0.05 * most(&exact));
    // With nodes split in the mesh only, it bends as an unsplit one.
    let mut together = body(&slit.whole, &slit.wall);
    together.split_nodes(&slit.mesh, &slit.parents).expect("it becomes that");
    assert_eq!(together.waiting(), slit.parents.len());
    let moved = bent(&mut together);
    assert!(apart(&moved[..born], &whole) < 1e-12 * most(&whole));
    assert_eq!(moved[born], moved[slit.parents[0] as usize]);
}

#[test]
fn what_holds_a_slit_bar_is_felt_alike_before_and_after_the_next_inverse() {
    let slit = OpenCut::new([20, 4, 4], 0.05, 0.01);
    let born = slit.whole.rest().len() as u32;
    let grasp = |fem: &LinearFem, x: f64| {
        let mesh = fem.mesh();
        patch(mesh.rest(), mesh.surface(), &Point3::new(x, 0.01, 0.02), 0.006).expect("a patch")
    };
    // At its end, at both lips of the slit, and inside; a load, and a dead load beside the slit.
    let felt = |fem: &mut LinearFem| {
        let mut dead = vec![Vector3::zeros(); fem.mesh().rest().len()];
        dead[born as usize] = Vector3::new(0.002, 0.0, 0.0);
        dead[slit.parents[1] as usize] = Vector3::new(0.0, 0.0, -0.001);
        fem.set_dead_load(&dead).expect("forces");
        let inside = fem.mesh().locate(&Point3::new(0.055, 0.011, 0.009)).expect("inside");
        let needle = Attachment::barycentric(fem.mesh().tets()[inside.0], inside.1, Hold::Point);
        let mut handles =
            vec![fem.hold(Attachment { weights: grasp(fem, 0.09), hold: Hold::Point }).expect("held")];
        handles.push(fem.hold(needle).expect("held"));
        for node in [born + 3, slit.parents[3]] {
            handles.push(fem.hold(Attachment::node(node, Hold::Point)).expect("held"));
        }
        for (handle, x) in handles.iter().zip([0.002, 0.001, 0.0008, -0.0004]) {
            fem.set_target(*handle, Vector3::new(x, 0.3 * x, -0.5 * x)).expect("held");
        }
        let weights = [(born + 1, 1.0)];
        let load = Load { weights: &weights, force: Vector3::new(0.0, 0.001, 0.002) };
        let forces: Vec<_> = fem.solve(&[load]).expect("solved").reactions.iter().map(|r| r.force).collect();
        (forces, all(fem))
    };
    let (mut serving, mut new) = (slit.serving(), slit.fresh());
    let ((served, there), (next, then)) = (felt(&mut serving), felt(&mut new));
    for (one, other) in served.iter().zip(&next) {
        let jump = (one - other).norm() / other.norm();
        assert!(jump < 0.05, "the force jumps by {jump}");
        // Exact apart from the rounding of the stored inverse.
        assert!(jump < 1e-3, "{jump}: {one} {other}");
    }
    assert!(apart(&there, &then) < 1e-4 * most(&then));
    // The control: an unsplit bar gives another force.
    let mut whole = body(&slit.whole, &slit.wall);
    whole.split_nodes(&slit.mesh, &slit.parents).expect("it becomes that");
    // Both lips at one position: the second of them cannot be constrained elsewhere.
    let handle = whole.hold(Attachment::node(born + 3, Hold::Point)).expect("held");
    let other = whole.hold(Attachment::node(slit.parents[3], Hold::Point));
    assert!(matches!(other, Err(LinearFemError::Dependent { .. })), "{other:?}");
    whole.release(handle).expect("held");

    // Constraints persist through the split, and a restart continues bit for bit, also from an unsplit body.
    let mut during = body(&slit.whole, &slit.wall);
    let handle = during.hold(Attachment { weights: grasp(&during, 0.09), hold: Hold::Point }).expect("held");
    during.set_target(handle, Vector3::new(0.0, 0.0, 0.002)).expect("held");
    let before = during.solve(&[]).expect("solved").reactions[0].force;
    during.split_nodes(&slit.mesh, &slit.parents).expect("it becomes that");
    assert_eq!(during.solve(&[]).expect("solved").reactions[0].force, before);
    during.release_nodes(4).expect("room");
    during.remove(&[700]).expect("it is there");
    during.release_nodes(100).expect("room");
    let after = during.solve(&[]).expect("solved").reactions[0].force;
    assert!((after - before).norm() > 0.02 * before.norm(), "{before} {after}");
    let state = during.state();
    let mut again = body(&slit.whole, &slit.wall);
    again.restore(&state).expect("a state of it");
    assert_eq!(again.solve(&[]).expect("solved").reactions[0].force, after);
    assert_eq!(all(&mut again), all(&mut during));
    // And back to the unsplit body.
    again.restore(&body(&slit.whole, &slit.wall).state()).expect("a state of it");
    assert!(!again.is_corrected() && again.mesh() == &slit.whole);
}

#[test]
fn what_burns_and_what_is_cut_are_corrected_for_in_any_order() {
    let slit = OpenCut::new([20, 4, 4], 0.05, 0.01);
    let near = |tet: &[u32; 4]| {
        let at = middle(&slit.mesh, tet);
        at.x > 0.044 && at.x < 0.056 && at.z > 0.014
    };
    let tets = slit.mesh.tets();
    let gone: Vec<u32> = (0..tets.len() as u32).filter(|&tet| near(&tets[tet as usize])).step_by(5).collect();
    assert!(gone.len() > 4, "{}", gone.len());
    let grasp = patch(slit.whole.rest(), slit.whole.surface(), &Point3::new(0.09, 0.01, 0.02), 0.006);
    let grasp = grasp.expect("a patch");
    let felt = |fem: &mut LinearFem| {
        let held = fem.hold(Attachment { weights: grasp.clone(), hold: Hold::Point }).expect("held");
        fem.set_target(held, Vector3::new(0.001, 0.0005, 0.002)).expect("held");
        fem.solve(&[]).expect("solved").reactions[0].force
    };
    let mut alterations = vec![Alteration::NONE; tets.len()];
    gone.iter().for_each(|&tet| alterations[tet as usize] = Alteration::GONE);
    let expected = felt(&mut fresh(&slit.mesh, &slit.parents, &slit.wall, &alterations));
    let (first, second) = gone.split_at(gone.len() / 2);
    for order in 0..3 {
        let mut fem = body(&slit.whole, &slit.wall);
        if order == 0 {
            fem.remove(&gone).expect("they are there");
        }
        fem.split_nodes(&slit.mesh, &slit.parents).expect("it becomes that");
        if order == 1 {
            fem.release_nodes(3).expect("room");
            fem.remove(first).expect("they are there");
        }
        fem.release_nodes(100).expect("room");
        if order == 1 {
            fem.remove(second).expect("they are there");
        }
        if order == 2 {
            fem.remove(&gone).expect("they are there");
        }
        assert_eq!(fem.waiting(), 0);
        let force = felt(&mut fem);
        let jump = (force - expected).norm() / expected.norm();
        assert!(jump < 1e-4, "order {order}: {force} {expected}");
    }
}

#[test]
fn a_bar_that_is_cut_through_is_two_pieces_of_which_one_is_held_by_nothing() {
    let slit = OpenCut::new([20, 4, 4], 0.05, 0.0);
    assert_eq!(slit.parents.len(), 25);
    let (mut serving, mut new) = (slit.serving(), slit.fresh());
    let pulls = Vector3::new(0.0005, 0.001, 0.002);
    let near = |node: &u32| (slit.whole.rest()[*node as usize] - Point3::new(0.035, 0.01, 0.02)).norm();
    let node = slit.whole.surface_nodes().iter().copied().min_by(|a, b| near(a).total_cmp(&near(b)));
    let node = node.expect("a node");
    for (name, fem) in [("corrected", &mut serving), ("computed anew", &mut new)] {
        // The held piece bends as a bar of half the length, whatever is done to the other.
        let held = fem.hold(Attachment::node(node, Hold::Point)).expect("held");
        fem.set_target(held, pulls).expect("held");
        // The other piece follows its three constraints without force.
        let end = beam::nodes_at(&slit.mesh, 0.1);
        let shift = Vector3::new(0.003, -0.002, 0.001);
        let mut handles = 0;
        for node in [end[0], end[4], end[20]] {
            handles += fem.hold_at(&Attachment::node(node, Hold::Point), shift).expect("held").len();
        }
        // A point, two directions and one: constrained against rigid motion.
        assert_eq!(handles, 4, "{name}");
        let forces: Vec<_> = fem.solve(&[]).expect("solved").reactions.iter().map(|r| r.force).collect();
        assert!(forces[0].norm() > 1e-4, "{name}: {forces:?}");
        let loose: f64 = forces[1..].iter().map(|force| force.norm()).sum();
        assert!(loose < 1e-3 * forces[0].norm(), "{name}: {forces:?}");
        let moved = all(fem);
        let beyond = |node: &usize| {
            slit.mesh
                .tets()
                .iter()
                .any(|tet| tet.contains(&(*node as u32)) && middle(&slit.mesh, tet).x > 0.05)
        };
        let free: Vec<_> = (0..moved.len()).filter(beyond).map(|node| moved[node]).collect();
        assert!(free.len() > 200);
        let off = free.iter().map(|moved| (moved - shift).norm()).fold(0.0, f64::max);
        assert!(off < 1e-3 * shift.norm(), "{name}: the free piece follows to {off} m");
    }
    // Against a bar of half the length alone.
    let half = beam_half(&slit.whole);
    let number = |node: u32| half.1.binary_search(&node).expect("of this half") as u32;
    let fixed: Vec<u32> = slit.wall.iter().map(|&node| number(node)).collect();
    let mut alone = body(&half.0, &fixed);
    let held = alone.hold(Attachment::node(number(node), Hold::Point)).expect("held");
    alone.set_target(held, pulls).expect("held");
    let expected = alone.solve(&[]).expect("solved").reactions[0].force;
    for fem in [&mut serving, &mut new] {
        let force = fem.solve(&[]).expect("solved").reactions[0].force;
        assert!((force - expected).norm() < 1e-3 * expected.norm(), "{force} {expected}");
    }
}

/// The held half of the beam, and the originals of its nodes.
fn beam_half(whole: &TetMesh) -> (TetMesh, Vec<u32>) {
    let mut volume = Volume::new(whole);
    let beyond: Vec<u32> =
        volume.tets().filter(|(_, nodes)| middle(whole, nodes).x > 0.05).map(|(tet, _)| tet).collect();
    volume.remove(&beyond).expect("they are there");
    volume.mesh().expect("a half")
}

#[test]
fn more_than_can_be_corrected_for_waits_and_meshes_that_it_does_not_become_are_refused() {
    let slit = OpenCut::new([40, 12, 12], 0.05, 0.0);
    assert_eq!(slit.parents.len(), 169);
    let mut fem = body(&slit.whole, &slit.wall);
    fem.split_nodes(&slit.mesh, &slit.parents).expect("it becomes that");
    assert_eq!(fem.release_nodes(1000).expect("room"), 128);
    assert_eq!((fem.waiting(), fem.can_release(), fem.removable()), (41, false, 0));
    assert_eq!(fem.release_nodes(1000), Ok(0));
    assert_eq!(fem.remove(&[5]), Err(LinearFemError::TooManyRemoved));
    let mut other = body(&slit.whole, &slit.wall);
    assert_eq!(other.split_nodes(&slit.mesh, &slit.parents[1..]), Err(LinearFemError::OtherMesh));
    let ahead = vec![slit.mesh.rest().len() as u32; slit.parents.len()];
    assert_eq!(other.split_nodes(&slit.mesh, &ahead), Err(LinearFemError::OtherMesh));
    assert!(!other.is_corrected());
}
