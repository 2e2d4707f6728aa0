//! The tree of axis-aligned boxes against brute force over all triangles.

use crate::support::organ;
use crate::support::organ::Organ;
use nalgebra::{Point3, Vector3};
use proptest::prelude::*;
use trocar_collision::aabb_tree::{Aabb, AabbTree};
use trocar_collision::primitive::{closest_on_triangle, closest_segment_triangle};
use trocar_collision::{Surface, SurfaceError};

/// Soups with everything that a scanner or a cut may leave: coincident and thin triangles, points, sheets.
fn soup() -> impl Strategy<Value = (Vec<Point3<f64>>, Vec<[u32; 3]>)> {
    let coordinate = || prop_oneof![4 => -1.0..1.0_f64, 1 => Just(0.0), 1 => Just(0.5), 1 => -1e-7..1e-7_f64];
    let vertex = (coordinate(), coordinate(), coordinate()).prop_map(|(x, y, z)| Point3::new(x, y, z));
    let scale = prop_oneof![Just(1e-4), Just(0.1), Just(1.0), Just(1e3)];
    (prop::collection::vec(vertex, 1..40), 0..120_usize, scale, any::<u64>()).prop_map(
        |(vertices, triangles, scale, seed)| {
            let count = vertices.len() as u64;
            let mut state = seed | 1;
            let mut next = || {
                state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                ((state >> 33) % count) as u32
            };
            let triangles = (0..triangles).map(|_| [next(), next(), next()]).collect();
            (vertices.into_iter().map(|vertex| vertex * scale).collect(), triangles)
        },
    )
}

fn ask() -> impl Strategy<Value = [Point3<f64>; 2]> {
    let point = || (-2.0..2.0_f64, -2.0..2.0_f64, -2.0..2.0_f64).prop_map(|(x, y, z)| Point3::new(x, y, z));
    prop_oneof![
        3 => [point(), point()],
        1 => point().prop_map(|point| [point, point]),
        1 => (point(), 1e-6..1.0_f64).prop_map(|(point, length)| [point, point + Vector3::x() * length]),
    ]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(3_000))]

    #[test]
    fn the_nearest_triangle_is_as_near_as_brute_force_finds(
        (vertices, triangles) in soup(), segment in ask(), reach in prop_oneof![Just(f64::INFINITY), 0.0..1.0_f64]
    ) {
        let surface = Surface::new(&vertices, &triangles).expect("a surface");
        let tree = AabbTree::new(&surface);
        let scale = vertices.iter().fold(1e-4_f64, |scale, vertex| scale.max(vertex.coords.amax()));
        let segment = segment.map(|end| end * scale);
        let radius = reach * scale;
        let all = || (0..triangles.len() as u32).map(|index| surface.triangle(index));

        let exact = all().map(|triangle| closest_segment_triangle(&segment, &triangle).distance_squared.sqrt())
            .fold(f64::INFINITY, f64::min);
        let found = tree.nearest_to_segment(&surface, &segment, radius).expect("the same surface");
        prop_assert_eq!(found.map(|found| found.distance), (exact <= radius && exact.is_finite()).then_some(exact));
        if let Some(found) = found {
            let own = closest_segment_triangle(&segment, &surface.triangle(found.triangle));
            prop_assert_eq!(own, found.nearest);
        }

        let point = segment[0];
        let exact = all().map(|triangle| (closest_on_triangle(&point, &triangle).point - point).norm())
            .fold(f64::INFINITY, f64::min);
        let found = tree.nearest_to_point(&surface, &point, radius).expect("the same surface");
        prop_assert_eq!(found.map(|found| found.distance), (exact <= radius && exact.is_finite()).then_some(exact));
    }

    #[test]
    fn nothing_within_a_radius_or_a_box_is_left_out_and_bounds_are_lower_bounds(
        (vertices, triangles) in soup(), segment in ask(), reach in 0.0..1.0_f64
    ) {
        let surface = Surface::new(&vertices, &triangles).expect("a surface");
        let tree = AabbTree::new(&surface);
        let scale = vertices.iter().fold(1e-4_f64, |scale, vertex| scale.max(vertex.coords.amax()));
        let segment = segment.map(|end| end * scale);
        let radius = reach * scale;
        let (mut about_segment, mut about_point, mut in_box) = (Vec::new(), Vec::new(), Vec::new());
        tree.around_segment(&segment, radius, &mut about_segment);
        tree.around_point(&segment[0], radius, &mut about_point);
        let bounds = Aabb { min: segment[0].inf(&segment[1]), max: segment[0].sup(&segment[1]) };
        tree.overlapping(&bounds, &mut in_box);
        for index in 0..triangles.len() as u32 {
            let triangle = surface.triangle(index);
            let exact = closest_segment_triangle(&segment, &triangle).distance_squared.sqrt();
            let lower = about_segment.iter().find(|found| found.0 == index);
            prop_assert!(exact > radius || lower.is_some());
            prop_assert!(lower.is_none_or(|lower| f64::from(lower.1) <= exact));
            let exact = (closest_on_triangle(&segment[0], &triangle).point - segment[0]).norm();
            let lower = about_point.iter().find(|found| found.0 == index);
            prop_assert!(exact > radius || lower.is_some());
            prop_assert!(lower.is_none_or(|lower| f64::from(lower.1) <= exact));
            let [a, b, c] = triangle;
            let (low, high) = (a.inf(&b).inf(&c), a.sup(&b).sup(&c));
            let reaches = (0..3).all(|axis| low[axis] <= bounds.max[axis] && high[axis] >= bounds.min[axis]);
            prop_assert!(!reaches || in_box.contains(&index));
        }
        // Every triangle once.
        for found in [about_segment.iter().map(|found| found.0).collect::<Vec<_>>(), in_box] {
            let mut unique = found.clone();
            unique.sort_unstable();
            unique.dedup();
            prop_assert_eq!(unique.len(), found.len());
        }
    }

    #[test]
    fn the_component_is_a_binary_tree_that_holds_every_triangle_once((vertices, triangles) in soup()) {
        let surface = Surface::new(&vertices, &triangles).expect("a surface");
        let tree = AabbTree::new(&surface);
        let nodes = tree.to_component().nodes;
        prop_assert_eq!(nodes.len(), (2 * triangles.len()).saturating_sub(1));
        let mut seen = vec![0; triangles.len()];
        let mut parents = vec![0; nodes.len()];
        for node in nodes.iter() {
            if node.primitives == 1 {
                seen[node.first as usize] += 1;
                for vertex in surface.triangle(node.first) {
                    prop_assert!((0..3).all(|axis| node.min[axis] <= vertex[axis] && vertex[axis] <= node.max[axis]));
                }
            } else {
                prop_assert_eq!(node.primitives, 0);
                for child in [node.first as usize, node.first as usize + 1] {
                    parents[child] += 1;
                    prop_assert!((0..3).all(|axis| node.min[axis] <= nodes[child].min[axis]
                        && nodes[child].max[axis] <= node.max[axis]));
                }
            }
        }
        prop_assert!(seen.iter().all(|&seen| seen == 1));
        prop_assert!(parents.iter().skip(1).all(|&parents| parents == 1) && parents.first().is_none_or(|&root| root == 0));
    }
}

#[test]
fn a_refitted_tree_answers_like_a_new_one() {
    let organ = Organ::with_triangles(2_000);
    let triangles = organ.triangles();
    let start = organ.vertices(0.0);
    let mut tree = AabbTree::new(&Surface::new(&start, &triangles).expect("a surface"));
    for step in 1..40 {
        let vertices = organ.vertices(0.2 * f64::from(step));
        let surface = Surface::new(&vertices, &triangles).expect("a surface");
        tree.refit(&surface).expect("the same triangles");
        let fresh = AabbTree::new(&surface);
        assert_eq!(tree.bounds(), fresh.bounds());
        let angle = 0.37 * f64::from(step);
        let segment =
            [Point3::new(0.1 * angle.cos(), 0.1 * angle.sin(), 0.03), Point3::new(0.03, 0.0, -0.01)];
        let distance = |tree: &AabbTree| {
            let found = tree.nearest_to_segment(&surface, &segment, f64::INFINITY).expect("the same surface");
            found.expect("there are triangles").distance
        };
        assert_eq!(distance(&tree), distance(&fresh));
    }
}

#[test]
fn the_organ_is_closed_manifold_and_outward() {
    let organ = Organ::with_triangles(8_000);
    let (vertices, triangles) = (organ.vertices(0.0), organ.triangles());
    assert!((7_000..9_000).contains(&triangles.len()));
    let topology =
        trocar_collision::topology::Topology::new(&Surface::new(&vertices, &triangles).expect("a surface"));
    assert!((0..topology.edges().len() as u32).all(|edge| topology.about_edge(edge).len() == 2));
    for time in [0.0, 1.0, 7.0] {
        assert!(organ::volume(&organ.vertices(time), &triangles) > 0.0);
    }
}

#[test]
fn another_surface_is_refused_and_odd_questions_are_answered() {
    let vertices = vec![Point3::origin(), Point3::new(1.0, 0.0, 0.0), Point3::new(0.0, 1.0, 0.0)];
    let one = [[0, 1, 2]];
    let two = [[0, 1, 2], [2, 1, 0]];
    let small = Surface::new(&vertices, &one).expect("a surface");
    let large = Surface::new(&vertices, &two).expect("a surface");
    let mut tree = AabbTree::new(&small);
    let error = SurfaceError::OtherTriangles { expected: 1, found: 2 };
    assert_eq!(tree.refit(&large), Err(error));
    assert_eq!(tree.nearest_to_point(&large, &Point3::origin(), 1.0), Err(error));
    assert!(error.to_string().contains("1 triangles"));

    let nowhere = Point3::new(f64::NAN, 0.0, 0.0);
    assert_eq!(tree.nearest_to_point(&small, &nowhere, 1.0), Ok(None));
    assert_eq!(tree.nearest_to_segment(&small, &[nowhere; 2], 1.0), Ok(None));
    assert_eq!(tree.nearest_to_point(&small, &Point3::origin(), f64::NAN), Ok(None));
    assert_eq!(tree.nearest_to_point(&small, &Point3::origin(), -1.0), Ok(None));

    let none = Surface::new(&[], &[]).expect("an empty surface");
    let tree = AabbTree::new(&none);
    assert!(tree.bounds().is_none() && tree.to_component().nodes.is_empty());
    assert_eq!(tree.nearest_to_point(&none, &Point3::origin(), f64::INFINITY), Ok(None));
}
