//! Two bumpy spheres in 200 poses, against what coal and FCL say of them (`tests/data`).

use crate::support::{Mesh, expected, mesh, poses};
use nalgebra::{Isometry3, Point3};
use trocar_collision::Surface;
use trocar_collision::obb_tree::{ObbTree, TreeQuery};
use trocar_collision::primitive::{Triangle, closest_on_triangle};

fn surface(mesh: &Mesh) -> Surface<'_> {
    Surface::new(&mesh.vertices, &mesh.triangles).expect("a surface")
}

fn off(point: &Point3<f64>, triangle: &Triangle) -> f64 {
    (closest_on_triangle(point, triangle).point - point).norm()
}

fn agrees(name: &str) {
    let mesh = mesh(name);
    let surface = surface(&mesh);
    let tree = ObbTree::build(&surface);
    let mut query = TreeQuery::new();
    let placed = |index: u32, pose: &Isometry3<f64>| surface.triangle(index).map(|corner| pose * corner);
    let mut total = 0;
    for (index, (pose, wanted)) in poses().iter().zip(expected(name)).enumerate() {
        let first = query.first_contact(&tree, &tree, pose, None);
        assert_eq!(first.is_some(), wanted.hit, "pose {index}");

        let pairs = query.all_contacts(&tree, &tree, pose);
        assert_eq!(pairs.len(), wanted.pairs, "pairs in pose {index}");
        total += pairs.len();
        for pair in pairs {
            let triangles = (surface.triangle(pair.triangles[0]), placed(pair.triangles[1], pose));
            for point in &pair.points_in_a {
                assert!(off(point, &triangles.0) < 1e-12 && off(point, &triangles.1) < 1e-12, "{pair:?}");
            }
        }
        if let Some(first) = first {
            assert!(pairs.contains(&first), "pose {index}");
        }

        let near = query.distance(&tree, &tree, pose, None).expect("two surfaces");
        assert!((near.distance - wanted.distance).abs() < 1e-9, "pose {index}: {near:?} for {wanted:?}");
        let [on_a, on_b] = near.points_in_a;
        assert!(((on_b - on_a).norm() - near.distance).abs() < 1e-12);
        assert!(off(&on_a, &surface.triangle(near.triangles[0])) < 1e-12);
        assert!(off(&on_b, &placed(near.triangles[1], pose)) < 1e-12);

        // A hair more and less than the distance.
        let reached = query.within(&tree, &tree, pose, wanted.distance + 1e-9, None).expect("within reach");
        assert!(reached.distance <= wanted.distance + 1e-9);
        assert!(wanted.hit || query.within(&tree, &tree, pose, wanted.distance - 1e-9, None).is_none());

        // Where to look first changes nothing but the way there.
        for last in [near.triangles, [0, 0], [u32::MAX, 7]] {
            let again = query.distance(&tree, &tree, pose, Some(last)).expect("two surfaces");
            assert!((again.distance - near.distance).abs() < 1e-15, "pose {index}");
            assert_eq!(query.first_contact(&tree, &tree, pose, Some(last)).is_some(), wanted.hit);
        }
    }
    assert_eq!(total, expected(name).iter().map(|wanted| wanted.pairs).sum::<usize>());
    assert!(total > 1000, "the data is not what it was");
}

#[test]
fn hits_pairs_and_distances_of_980_triangles_are_those_of_the_peers() {
    agrees("1k");
}

#[test]
fn hits_pairs_and_distances_of_9680_triangles_are_those_of_the_peers() {
    agrees("10k");
}
