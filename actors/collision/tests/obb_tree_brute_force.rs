//! Every answer of the trees against all pairs of triangles, on surfaces that are folded, thin, cut, in many parts,
//! nested, coplanar, touching, degenerate, empty, non-manifold or inverted, moved, scaled, deformed and cut further.

use crate::support::Mesh;
use crate::support::surfaces::{KINDS, deformed, surface};
use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};
use proptest::prelude::*;
use trocar_collision::obb_tree::{ObbTree, TreeQuery};
use trocar_collision::primitive::{Triangle, closest_triangles, triangles_overlap};
use trocar_collision::{Surface, SurfaceError};

fn checked(mesh: &Mesh) -> Surface<'_> {
    Surface::new(&mesh.vertices, &mesh.triangles).expect("a surface")
}

fn triangles(mesh: &Mesh) -> Vec<Triangle> {
    mesh.triangles.iter().map(|corners| corners.map(|corner| mesh.vertices[corner as usize])).collect()
}

/// Placed by the same arithmetic as in the query: triangles that touch exactly do so here and there.
fn placed(mesh: &Mesh, pose: &Isometry3<f64>) -> Vec<Triangle> {
    let rotation = pose.rotation.to_rotation_matrix().into_inner();
    let place = |corner: Point3<f64>| Point3::from(rotation * corner.coords + pose.translation.vector);
    triangles(mesh).iter().map(|triangle| triangle.map(place)).collect()
}

fn all_pairs(first: &[Triangle], second: &[Triangle]) -> Vec<[u32; 2]> {
    let mut pairs = Vec::new();
    for (i, a) in first.iter().enumerate() {
        for (j, b) in second.iter().enumerate() {
            if triangles_overlap(a, b) {
                pairs.push([i as u32, j as u32]);
            }
        }
    }
    pairs
}

fn least_distance(first: &[Triangle], second: &[Triangle]) -> Option<f64> {
    let pairs =
        first.iter().flat_map(|a| second.iter().map(move |b| closest_triangles(a, b).distance_squared));
    pairs.reduce(f64::min).map(f64::sqrt)
}

fn sorted(pairs: &[trocar_collision::obb_tree::TouchingPair]) -> Vec<[u32; 2]> {
    let mut sorted: Vec<_> = pairs.iter().map(|pair| pair.triangles).collect();
    sorted.sort_unstable();
    sorted
}

/// Everything that can be asked of two surfaces.
fn agrees(
    query: &mut TreeQuery,
    trees: [&ObbTree; 2],
    meshes: [&Mesh; 2],
    pose: &Isometry3<f64>,
    scale: f64,
) -> Result<(), TestCaseError> {
    let [a, b] = trees;
    let (first, second) = (triangles(meshes[0]), placed(meshes[1], pose));
    let wanted = all_pairs(&first, &second);
    prop_assert_eq!(&sorted(query.all_contacts(a, b, pose)), &wanted);
    let contact = query.first_contact(a, b, pose, None);
    prop_assert_eq!(contact.is_some(), !wanted.is_empty());
    if let Some(contact) = contact {
        prop_assert!(wanted.contains(&contact.triangles));
    }
    let near = query.distance(a, b, pose, None);
    let distance = least_distance(&first, &second);
    prop_assert_eq!(near.is_some(), distance.is_some());
    let (Some(near), Some(distance)) = (near, distance) else { return Ok(()) };
    prop_assert!((near.distance - distance).abs() <= 1e-9 * scale, "{} for {}", near.distance, distance);
    let [i, j] = near.triangles.map(|index| index as usize);
    let pair = closest_triangles(&first[i], &second[j]).distance_squared.sqrt();
    prop_assert!((pair - distance).abs() <= 1e-9 * scale, "not the nearest pair: {} for {}", pair, distance);
    let apart = (near.points_in_a[1] - near.points_in_a[0]).norm();
    prop_assert!((apart - near.distance).abs() <= 1e-9 * scale);
    let again = query.distance(a, b, pose, Some(near.triangles)).expect("as before");
    prop_assert!((again.distance - near.distance).abs() <= 1e-12 * scale);
    for (tolerance, reached) in [(distance + 1e-8 * scale, true), (distance - 1e-8 * scale, false)] {
        let within = query.within(a, b, pose, tolerance, None);
        prop_assert_eq!(within.is_some(), reached || (!wanted.is_empty() && tolerance >= 0.0));
        if let Some(within) = within {
            prop_assert!(within.distance <= tolerance);
        }
    }
    Ok(())
}

fn self_agrees(query: &mut TreeQuery, tree: &ObbTree, mesh: &Mesh) -> Result<(), TestCaseError> {
    let all = triangles(mesh);
    let mut wanted = Vec::new();
    for i in 0..all.len() {
        for j in i + 1..all.len() {
            let apart = !mesh.triangles[i].iter().any(|corner| mesh.triangles[j].contains(corner));
            if apart && triangles_overlap(&all[i], &all[j]) {
                wanted.push([i as u32, j as u32]);
            }
        }
    }
    prop_assert_eq!(sorted(query.self_contacts(tree)), wanted);
    Ok(())
}

/// Any pose, or one on whole numbers and quarter turns, in which things touch exactly.
fn pose() -> impl Strategy<Value = Isometry3<f64>> {
    let any = ([-1.0..1.0_f64, -1.0..1.0, -1.0..1.0], [-3.2..3.2_f64, -3.2..3.2, -3.2..3.2])
        .prop_map(|(turn, shift)| Isometry3::new(Vector3::from(shift) * 0.5, Vector3::from(turn) * 3.0));
    let whole = (0..4_i32, 0..3_usize, [-2..=2_i32, -2..=2, -2..=2]).prop_map(|(quarters, axis, shift)| {
        let axis = [Vector3::x_axis(), Vector3::y_axis(), Vector3::z_axis()][axis];
        let turn = UnitQuaternion::from_axis_angle(&axis, f64::from(quarters) * std::f64::consts::FRAC_PI_2);
        let shift = shift.map(f64::from);
        Isometry3::from_parts(Translation3::new(shift[0], shift[1], shift[2]), turn)
    });
    prop_oneof![3 => any, 2 => whole, 1 => Just(Isometry3::identity())]
}

fn scaled(mesh: &Mesh, scale: f64) -> Mesh {
    let vertices = mesh.vertices.iter().map(|vertex| vertex * scale).collect();
    Mesh { vertices, triangles: mesh.triangles.clone() }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]
    #[test]
    fn two_surfaces_that_deform_and_are_cut_answer_as_all_their_pairs_do(
        kinds in [0..KINDS.len(), 0..KINDS.len()],
        seeds in [0..1_000_u64, 0..1_000],
        pose in pose(),
        scale in prop_oneof![Just(1.0), Just(0.1), Just(1e-3), Just(1e-4)],
        second_scale in prop_oneof![4 => Just(1.0), 1 => Just(0.03), 1 => Just(20.0)],
        amount in prop_oneof![Just(0.01), Just(0.3), Just(2.0)],
    ) {
        let [mut a, b] = [(kinds[0], seeds[0], scale), (kinds[1], seeds[1], scale * second_scale)]
            .map(|(kind, seed, scale)| scaled(&surface(KINDS[kind], seed), scale));
        let pose = Isometry3::from_parts(Translation3::from(pose.translation.vector * scale), pose.rotation);
        let size = scale * second_scale.max(1.0);
        let mut query = TreeQuery::new();
        let mut tree = ObbTree::build(&checked(&a));
        let other = ObbTree::build(&checked(&b));
        agrees(&mut query, [&tree, &other], [&a, &b], &pose, size)?;
        // The other way round it is the same.
        agrees(&mut query, [&other, &tree], [&b, &a], &pose.inverse(), size)?;

        let bent = deformed(&scaled(&a, 1.0 / scale), amount, seeds[1]);
        a.vertices = bent.iter().map(|vertex| vertex * scale).collect();
        tree.refit(&a.vertices).expect("as many vertices");
        agrees(&mut query, [&tree, &other], [&a, &b], &pose, size)?;

        let mut number = 0;
        a.triangles.retain(|_| { number += 1; number % 4 != 0 });
        tree = ObbTree::build(&checked(&a));
        agrees(&mut query, [&tree, &other], [&a, &b], &pose, size)?;
    }

    #[test]
    fn a_surface_that_folds_onto_itself_answers_as_all_its_pairs_do(
        kind in 0..KINDS.len(),
        seed in 0..1_000_u64,
        scale in prop_oneof![Just(1.0), Just(1e-2), Just(1e-4)],
        amounts in [0.0..0.5_f64, 0.5..4.0],
    ) {
        let mut mesh = scaled(&surface(KINDS[kind], seed), scale);
        let rest = surface(KINDS[kind], seed);
        let mut query = TreeQuery::new();
        let mut tree = ObbTree::build(&checked(&mesh));
        self_agrees(&mut query, &tree, &mesh)?;
        for (index, amount) in amounts.into_iter().enumerate() {
            mesh.vertices = deformed(&rest, amount, seed + index as u64).iter().map(|vertex| vertex * scale).collect();
            tree.refit(&mesh.vertices).expect("as many vertices");
            self_agrees(&mut query, &tree, &mesh)?;
        }
        tree = ObbTree::build(&checked(&mesh));
        self_agrees(&mut query, &tree, &mesh)?;
    }
}

#[test]
fn nothing_touches_nothing_and_one_triangle_is_a_surface() {
    let empty = surface("empty", 0);
    let one = Mesh {
        vertices: vec![Point3::origin(), Point3::new(1.0, 0.0, 0.0), Point3::new(0.0, 1.0, 0.0)],
        triangles: vec![[0, 1, 2]],
    };
    let none = Mesh { vertices: Vec::new(), triangles: Vec::new() };
    let trees = [&empty, &one, &none].map(|mesh| ObbTree::build(&checked(mesh)));
    let mut query = TreeQuery::new();
    let up = Isometry3::translation(0.25, 0.25, 2.0);
    for (i, a) in trees.iter().enumerate() {
        assert_eq!(query.self_contacts(a), []);
        for (j, b) in trees.iter().enumerate() {
            let near = query.distance(a, b, &up, Some([0, 0]));
            assert_eq!(near.map(|near| near.distance), (i == 1 && j == 1).then_some(2.0));
            assert_eq!(query.all_contacts(a, b, &up), []);
            assert!(query.first_contact(a, b, &up, Some([0, 0])).is_none());
            assert_eq!(query.within(a, b, &up, 2.0, None).is_some(), i == 1 && j == 1);
        }
    }
}

#[test]
fn a_refit_refuses_what_is_no_position_and_stays_as_it_was() {
    let mesh = surface("nested", 3);
    let mut tree = ObbTree::build(&checked(&mesh));
    let mut wrong = mesh.vertices.clone();
    wrong[7].y = f64::NAN;
    assert_eq!(tree.refit(&wrong), Err(SurfaceError::NotFinite { vertex: 7 }));
    let found = mesh.vertices.len() - 1;
    let error = SurfaceError::OtherVertices { expected: found + 1, found };
    assert_eq!(tree.refit(&mesh.vertices[1..]), Err(error));
    assert_eq!(tree.vertices(), mesh.vertices);
    let mut query = TreeQuery::new();
    let pose = Isometry3::translation(0.3, 0.0, 0.0);
    let (all, built) = (placed(&mesh, &pose), ObbTree::build(&checked(&mesh)));
    let wanted = all_pairs(&triangles(&mesh), &all);
    assert_eq!(sorted(query.all_contacts(&tree, &built, &pose)), wanted);
}

#[test]
fn surfaces_far_apart_huge_or_tiny_are_answered_as_well() {
    let mesh = surface("cut", 1);
    let speck = scaled(&mesh, 1e-12);
    let giant = scaled(&mesh, 1e14);
    let mut query = TreeQuery::new();
    for (a, b, shift) in [
        (&mesh, &mesh, 1e2),
        (&mesh, &mesh, 1e4),
        (&mesh, &mesh, 1e8),
        (&mesh, &mesh, 1e12),
        (&mesh, &speck, 0.5),
        (&mesh, &giant, 0.5),
        (&speck, &giant, -3.0),
        (&speck, &speck, 1e-9),
        (&speck, &mesh, 4.0),
        (&speck, &mesh, 4e4),
    ] {
        let (tree_a, tree_b) = (ObbTree::build(&checked(a)), ObbTree::build(&checked(b)));
        let pose = Isometry3::translation(shift, 0.25 * shift, 0.0);
        let (first, second) = (triangles(a), placed(b, &pose));
        let wanted = least_distance(&first, &second).expect("two surfaces");
        let near = query.distance(&tree_a, &tree_b, &pose, None).expect("two surfaces");
        assert!((near.distance - wanted).abs() <= 1e-12 * wanted, "{} for {wanted}", near.distance);
        assert_eq!(sorted(query.all_contacts(&tree_a, &tree_b, &pose)), all_pairs(&first, &second));
    }
}

#[test]
fn the_same_question_has_the_same_answer_whatever_was_asked_before() {
    let meshes = [surface("folded", 5), surface("nested", 6)];
    let trees = meshes.each_ref().map(|mesh| ObbTree::build(&checked(mesh)));
    let pose = Isometry3::new(Vector3::zeros(), Vector3::new(0.3, 1.0, 0.2));
    let mut fresh = TreeQuery::new();
    let wanted = fresh.all_contacts(&trees[0], &trees[1], &pose).to_vec();
    assert!(!wanted.is_empty());
    let mut used = TreeQuery::new();
    used.self_contacts(&trees[1]);
    used.distance(&trees[1], &trees[0], &Isometry3::translation(9.0, 0.0, 0.0), None);
    assert_eq!(used.all_contacts(&trees[0], &trees[1], &pose), wanted);
}
