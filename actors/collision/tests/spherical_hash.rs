//! Soft bodies, bands and threads by the local spherical hash, against all pairs and closed forms.

use std::collections::BTreeMap;

use crate::support::shapes::Shape;
use nalgebra::{Isometry3, Point3, Vector3};
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;
use trocar_collision::primitive::{
    Triangle, closest_on_triangle, closest_segment_triangle, triangle_penetration,
};
use trocar_collision::spherical_hash::{SphericalContact, SphericalHash};
use trocar_collision::{Line, Part, SurfaceError};

fn shapes() -> Vec<Shape> {
    let hollow = Shape::organ(3, 0.1).joined(&Shape::organ(2, 0.0).mapped(|point| point * 0.5).inverted());
    vec![
        Shape::organ(3, 0.12),
        Shape::torus(24, 12, 0.3),
        Shape::horseshoe(24, 12),
        hollow,
        Shape::cuboid([1.0, 0.7, 0.02]),
        Shape::organ(2, 0.1).inverted(),
        Shape::organ(2, 0.1).joined(&Shape::torus(12, 8, 0.2).mapped(|point| point + Vector3::x() * 3.0)),
        // The centre lies on its surface.
        Shape::organ(2, 0.0).joined(&Shape::organ(2, 0.0).mapped(|point| point * 0.2 + Vector3::x() * 1.2)),
    ]
}

fn vector(random: &mut Pcg64Mcg, size: f64) -> Vector3<f64> {
    Vector3::from_fn(|_, _| random.random_range(-size..=size))
}

/// A rigid motion, a scale, and a deformation that moves every vertex.
fn deformed(shape: &Shape, random: &mut Pcg64Mcg, scale: f64) -> Shape {
    let motion = Isometry3::new(vector(random, 1.0), vector(random, 3.0));
    let wave = vector(random, 0.1);
    shape.mapped(|point| motion * (point + wave * (3.0 * point.x + point.y).sin()) * scale)
}

fn corners(shape: &Shape, index: usize) -> Triangle {
    shape.triangles[index].map(|corner| shape.vertices[corner as usize])
}

fn distance(shape: &Shape, point: &Point3<f64>) -> f64 {
    (0..shape.triangles.len())
        .map(|index| (closest_on_triangle(point, &corners(shape, index)).point - point).norm())
        .fold(f64::INFINITY, f64::min)
}

fn is_inside(shape: &Shape, point: &Point3<f64>) -> bool {
    let angle = |triangle: Triangle| {
        let [a, b, c] = triangle.map(|corner| corner - point);
        let (x, y, z) = (a.norm(), b.norm(), c.norm());
        a.dot(&b.cross(&c)).atan2(x * y * z + a.dot(&b) * z + b.dot(&c) * x + c.dot(&a) * y)
    };
    (0..shape.triangles.len()).map(|index| angle(corners(shape, index))).sum::<f64>().abs()
        > std::f64::consts::PI
}

#[test]
fn a_point_is_as_deep_as_its_nearest_place_on_the_surface() {
    let mut random = Pcg64Mcg::seed_from_u64(1);
    let mut hash = SphericalHash::new();
    let (mut inside, mut near) = (0, 0);
    for (round, shape) in shapes().iter().enumerate() {
        for exponent in [-4, -2, 0] {
            let scale = 10.0_f64.powi(exponent);
            let shape = deformed(shape, &mut random, scale);
            hash.rebuild(&shape.surface());
            for trial in 0..300 {
                let reach = 0.1 * scale;
                let point = match trial % 3 {
                    0 => shape.vertices[trial % shape.vertices.len()] + vector(&mut random, 0.05 * scale),
                    1 => nalgebra::center(&shape.vertices[0], &shape.vertices[trial % shape.vertices.len()]),
                    _ => shape.vertices[0] + vector(&mut random, 2.0 * scale),
                };
                let (expected, is_inside) = (distance(&shape, &point), is_inside(&shape, &point));
                if expected < 1e-9 * scale {
                    continue;
                }
                let Some(place) = hash.place(&point, reach) else {
                    assert!(!is_inside && expected >= reach, "{round}: {point} {expected}");
                    continue;
                };
                assert_eq!(place.depth > 0.0, is_inside, "{round}: {point} {place:?}");
                assert!(
                    (place.depth.abs() - expected).abs() < 1e-12 * scale,
                    "{round}: {expected} {place:?}"
                );
                let out = point + place.outwards * place.depth;
                assert!(
                    (out - place.point).norm() < 1e-9 * scale && (place.outwards.norm() - 1.0).abs() < 1e-12
                );
                let on = closest_on_triangle(&point, &corners(&shape, place.triangle as usize)).point;
                assert!((on - place.point).norm() < 1e-12 * scale);
                (inside, near) = (inside + usize::from(is_inside), near + usize::from(!is_inside));
            }
        }
    }
    assert!(inside > 1_500 && near > 500, "{inside} inside, {near} near");
}

/// Contacts by their parts; each pair of parts once.
fn listed(contacts: &[SphericalContact]) -> BTreeMap<(Part, Part), SphericalContact> {
    let listed: BTreeMap<_, _> = contacts.iter().map(|contact| ((contact.a, contact.b), *contact)).collect();
    assert_eq!(listed.len(), contacts.len(), "no pair is listed twice");
    for contact in contacts {
        assert!((contact.direction.norm() - 1.0).abs() < 1e-9 && contact.depth >= 0.0, "{contact:?}");
    }
    listed
}

fn thread_around(random: &mut Pcg64Mcg, scale: f64) -> (Vec<Point3<f64>>, Vec<[u32; 2]>) {
    let (turns, size) = (random.random_range(0.5..3.0), random.random_range(0.5..1.2) * scale);
    let motion = Isometry3::new(vector(random, 0.3 * scale), vector(random, 3.0));
    let vertices: Vec<_> = (0..=200)
        .map(|index| {
            let along = f64::from(index) / 200.0;
            let angle = along * turns * std::f64::consts::TAU;
            motion * (Point3::new(angle.cos(), angle.sin(), along - 0.5) * size)
        })
        .collect();
    (vertices, (0..200).map(|index| [index, index + 1]).collect())
}

#[test]
fn a_thread_around_an_organ_touches_what_all_pairs_say() {
    let mut random = Pcg64Mcg::seed_from_u64(2);
    let mut hash = SphericalHash::new();
    let (mut contacts, mut compared, mut crossed) = (Vec::new(), 0, 0);
    for round in 0..48 {
        let scale = 10.0_f64.powi(-(round as i32 % 5));
        let shape = deformed(&shapes()[round % 8], &mut random, scale);
        let sum = shape.vertices.iter().fold(Vector3::zeros(), |sum, vertex| sum + vertex.coords);
        let middle = sum / shape.vertices.len() as f64;
        let (mut vertices, segments) = thread_around(&mut random, scale);
        vertices.iter_mut().for_each(|vertex| *vertex += middle);
        let radius = if round % 4 == 0 { 0.0 } else { 0.05 * scale };
        hash.rebuild(&shape.surface());
        contacts.clear();
        hash.line(&Line::new(&vertices, &segments, radius).expect("a line"), &mut contacts);
        let mut listed = listed(&contacts);
        for (segment, index) in segments.iter().zip(0..) {
            let segment = segment.map(|end| vertices[end as usize]);
            for triangle in 0..shape.triangles.len() {
                let found = closest_segment_triangle(&segment, &corners(&shape, triangle));
                let apart = found.distance_squared.sqrt();
                let contact = listed.remove(&(Part::Triangle(triangle as u32), Part::Segment(index)));
                if (apart - radius).abs() < 1e-12 * scale && apart > 0.0 {
                    continue;
                }
                assert_eq!(contact.is_some(), apart <= radius, "round {round}: {apart}");
                let Some(contact) = contact else { continue };
                compared += 1;
                if apart > 0.0 {
                    assert!((contact.depth - (radius - apart)).abs() < 1e-12 * scale);
                } else {
                    crossed += 1;
                    assert!(contact.depth >= radius);
                    // Moved by what lies between, the axis is out of the triangle.
                    let by = contact.direction * (contact.depth - radius + 1e-9 * scale);
                    let moved = segment.map(|end| end + by);
                    let found = closest_segment_triangle(&moved, &corners(&shape, triangle));
                    assert!(found.distance_squared > 0.0, "round {round}: {contact:?}");
                }
            }
        }
        assert!(listed.is_empty());
    }
    assert!(compared > 1_000 && crossed > 100, "{compared} contacts, {crossed} of them crossings");
}

fn cross(first: &Triangle, second: &Triangle) -> bool {
    let one_way = |of: &Triangle, other: &Triangle| {
        (0..3).any(|i| closest_segment_triangle(&[of[i], of[(i + 1) % 3]], other).distance_squared == 0.0)
    };
    one_way(first, second) || one_way(second, first)
}

#[test]
fn two_soft_bodies_touch_as_all_pairs_say() {
    let mut random = Pcg64Mcg::seed_from_u64(3);
    let (mut first_hash, mut second_hash) = (SphericalHash::new(), SphericalHash::new());
    let (mut contacts, mut pairs, mut vertices) = (Vec::new(), 0, 0);
    for round in 0..24 {
        let scale = 10.0_f64.powi(-(round as i32 % 5));
        let first = deformed(&shapes()[round % 8], &mut random, scale);
        let mut second = deformed(&shapes()[round * 3 % 8], &mut random, scale);
        let together = first.vertices[round % first.vertices.len()] - second.vertices[0];
        second = second.mapped(|point| point + together * 0.95);
        let separation = if round % 2 == 0 { 0.0 } else { 0.02 * scale };
        first_hash.rebuild(&first.surface());
        second_hash.rebuild(&second.surface());
        contacts.clear();
        first_hash.bodies(&mut second_hash, separation, &mut contacts);
        let mut listed = listed(&contacts);
        for i in 0..first.triangles.len() {
            for j in 0..second.triangles.len() {
                let (a, b) = (corners(&first, i), corners(&second, j));
                let contact = listed.remove(&(Part::Triangle(i as u32), Part::Triangle(j as u32)));
                match (cross(&a, &b), contact) {
                    (true, contact) => {
                        pairs += 1;
                        let contact = contact.unwrap_or_else(|| panic!("round {round}: {a:?} crosses {b:?}"));
                        assert_eq!(
                            Some(contact.depth),
                            triangle_penetration(&a, &b).map(|overlap| overlap.depth)
                        );
                        for (triangle, point) in [a, b].iter().zip(&contact.points) {
                            assert!(
                                (closest_on_triangle(point, triangle).point - point).norm() < 1e-7 * scale
                            );
                        }
                    }
                    (false, Some(contact)) => {
                        assert!(contact.depth < 1e-7 * scale, "round {round}: {contact:?}")
                    }
                    (false, None) => {}
                }
            }
        }
        for (of, other, swapped) in [(&second, &first, false), (&first, &second, true)] {
            for (index, vertex) in of.vertices.iter().enumerate() {
                let (apart, inside) = (distance(other, vertex), is_inside(other, vertex));
                let depth = separation + if inside { apart } else { -apart };
                let part = Part::Vertex(index as u32);
                let found: Vec<_> = listed
                    .values()
                    .filter(|contact| part == if swapped { contact.a } else { contact.b })
                    .copied()
                    .collect();
                if depth.abs() < 1e-9 * scale || apart < 1e-9 * scale {
                    continue;
                }
                assert_eq!(found.len(), usize::from(depth > 0.0), "round {round}: {depth}");
                for contact in found {
                    vertices += 1;
                    assert!((contact.depth - depth).abs() < 1e-12 * scale);
                    let (out, place) = if swapped { (-1.0, 1) } else { (1.0, 0) };
                    let moved = vertex + contact.direction * (out * (depth - separation));
                    assert!(
                        (moved - contact.points[place]).norm() < 1e-9 * scale,
                        "round {round}: {contact:?}"
                    );
                    listed.remove(&(contact.a, contact.b));
                }
            }
        }
        let left = listed.values().filter(|contact| contact.depth > 1e-9 * scale).count();
        assert_eq!(left, 0);
    }
    assert!(pairs > 1_000 && vertices > 1_000, "{pairs} pairs, {vertices} vertices");
}

#[test]
fn analytic_depths() {
    let mut hash = SphericalHash::new();
    hash.rebuild(&Shape::cuboid([0.05, 0.04, 0.01]).surface());
    let place = hash.place(&Point3::new(0.012, 0.003, 0.0075), 0.0).expect("inside");
    assert!((place.depth - 0.0025).abs() < 1e-15 && (place.outwards - Vector3::z()).norm() < 1e-12);
    let mut contacts = Vec::new();
    hash.spheres(&[Point3::new(0.0, 0.0, 0.012), Point3::new(0.2, 0.0, 0.0)], 0.003, &mut contacts)
        .expect("finite");
    assert_eq!(contacts.len(), 1);
    assert!(
        (contacts[0].depth - 0.001).abs() < 1e-15 && (contacts[0].direction - Vector3::z()).norm() < 1e-12
    );
    // A tube on top, its axis 2 mm above.
    let tube = [Point3::new(-0.01, 0.001, 0.012), Point3::new(0.01, 0.002, 0.012)];
    contacts.clear();
    hash.line(&Line::new(&tube, &[[0, 1]], 0.003).expect("a line"), &mut contacts);
    assert!(!contacts.is_empty() && contacts.iter().all(|contact| (contact.depth - 0.001).abs() < 1e-15));
    // A sphere in the middle of a fine ball is as deep as the ball's radius, whatever ray was asked.
    hash.rebuild(&Shape::organ(4, 0.0).surface());
    let place = hash.place(&Point3::origin(), 0.0).expect("inside");
    assert!((place.depth - 1.0).abs() < 0.01, "{place:?}");
}

#[test]
fn what_encloses_nothing_is_answered_and_what_is_no_number_is_an_error() {
    let mut hash = SphericalHash::new();
    let mut contacts = Vec::new();
    assert!(hash.place(&Point3::origin(), 1.0).is_none());
    hash.rebuild(&Shape::default().surface());
    assert!(hash.place(&Point3::origin(), 1.0).is_none());
    let error = hash.spheres(&[Point3::origin(), Point3::new(0.0, f64::NAN, 0.0)], 0.1, &mut contacts);
    assert_eq!((error, contacts.len()), (Err(SurfaceError::NotFinite { vertex: 1 }), 0));
    // Points, needles, a sheet, three triangles on an edge, in one place and unused vertices far away.
    let vertices: Vec<_> =
        [[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.5, 0.0, 0.0], [9e9, 0.0, 0.0]]
            .map(Point3::from)
            .to_vec();
    let triangles = vec![[0, 0, 0], [0, 1, 4], [0, 1, 2], [0, 1, 3], [1, 0, 2], [0, 1, 2]];
    let odd = Shape { vertices, triangles };
    hash.rebuild(&odd.surface());
    let place = hash.place(&Point3::new(0.2, 0.2, -0.05), 0.1).expect("near");
    assert!((place.depth + 0.05).abs() < 1e-15 && (place.outwards + Vector3::z()).norm() < 1e-12);
    hash.triangles(&odd.surface(), &mut contacts);
    for i in 0..6 {
        for j in 0..6 {
            let (a, b) = (Part::Triangle(i), Part::Triangle(j));
            let touch = cross(&corners(&odd, i as usize), &corners(&odd, j as usize));
            assert!(!touch || contacts.iter().any(|contact| contact.a == a && contact.b == b), "{i} {j}");
        }
    }
    let all_in_one = Shape { vertices: vec![Point3::new(1.0, 2.0, 3.0); 3], triangles: vec![[0, 1, 2]; 5] };
    hash.rebuild(&all_in_one.surface());
    let place = hash.place(&Point3::new(1.0, 2.0, 3.5), 1.0).expect("near");
    assert_eq!((place.depth, place.triangle), (-0.5, 0));
}

#[test]
fn a_body_that_is_cut_and_remeshed_is_hashed_as_it_is_now() {
    let (whole, coarse) = (Shape::organ(4, 0.1), Shape::organ(2, 0.1));
    let mut half = whole.clone();
    half.triangles.retain(|corners| corners.iter().all(|&corner| whole.vertices[corner as usize].z < 0.1));
    let mut hash = SphericalHash::new();
    for (shape, other) in [(&whole, 0.4), (&half, 0.5), (&coarse, 0.3), (&half, -0.4)] {
        let band = Shape::torus(20, 8, 0.1).mapped(|point| point + Vector3::x() * other);
        let (mut reused, mut fresh) = (Vec::new(), Vec::new());
        hash.rebuild(&shape.surface());
        hash.triangles(&band.surface(), &mut reused);
        let mut new = SphericalHash::new();
        new.rebuild(&shape.surface());
        new.triangles(&band.surface(), &mut fresh);
        assert!(!fresh.is_empty() && reused == fresh);
    }
}
