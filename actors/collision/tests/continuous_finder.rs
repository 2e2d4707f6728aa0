//! What the finder lists is what a test of all pairs lists, whatever the meshes are like.

use std::collections::BTreeMap;

use nalgebra::{Point3, Rotation3, Vector3};
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;
use trocar_collision::continuous::{
    FoundImpact, Impact, ImpactFinder, Sweep, SweptLine, SweptSurface, edge_edge, vertex_face,
};
use trocar_collision::{Line, Part, Surface};

type Positions = Sweep<Vec<Point3<f64>>>;
type Listed = BTreeMap<(Part, Part), Impact>;

struct Soup {
    vertices: Positions,
    triangles: Vec<[u32; 3]>,
    segments: Vec<[u32; 2]>,
}

/// Triangles and segments between random vertices: they share edges, some thrice, lie in each other, are points.
fn soup(random: &mut Pcg64Mcg, count: usize, size: f64, scale: f64) -> Soup {
    let vertex = |random: &mut Pcg64Mcg, around: Vector3<f64>, size: f64| {
        around + Vector3::from_fn(|_, _| random.random_range(-size..size))
    };
    let mut from: Vec<Point3<f64>> = Vec::new();
    let mut triangles = Vec::new();
    let mut segments = Vec::new();
    while triangles.len() < count {
        let around = vertex(random, Vector3::zeros(), 1.0);
        let first = from.len() as u32;
        for _ in 0..4 {
            from.push(Point3::from(vertex(random, around, size) * scale));
        }
        let [a, b, c, d] = [first, first + 1, first + 2, first + 3];
        triangles.extend([[a, b, c], [c, b, d]]);
        match random.random_range(0..8) {
            0 => triangles.push([b, c, random.random_range(0..=d)]),
            1 => triangles.push([a, a, b]),
            2 => triangles.push([d, d, d]),
            3 => triangles.push([a, b, c]),
            _ => {}
        }
        segments.extend([[a, b], [b, d]]);
        if random.random_bool(0.1) {
            segments.push([c, c]);
        }
    }
    let shared = vertex(random, Vector3::zeros(), 0.2) * scale;
    let to =
        from.iter().map(|point| point + shared + vertex(random, Vector3::zeros(), 0.1) * scale).collect();
    Soup { vertices: Sweep { from, to }, triangles, segments }
}

impl Soup {
    fn surface(&self) -> SweptSurface<'_> {
        let surface = Surface::new(&self.vertices.from, &self.triangles).expect("a surface");
        SweptSurface::new(surface, &self.vertices.to).expect("a surface")
    }

    fn line(&self, radius: f64) -> SweptLine<'_> {
        let line = Line::new(&self.vertices.from, &self.segments, radius).expect("a line");
        SweptLine::new(line, &self.vertices.to).expect("a line")
    }

    fn take<const K: usize>(&self, corners: [u32; K]) -> Sweep<[Point3<f64>; K]> {
        let at = |of: &[Point3<f64>]| corners.map(|corner| of[corner as usize]);
        Sweep { from: at(&self.vertices.from), to: at(&self.vertices.to) }
    }

    fn edges(&self) -> Vec<[u32; 2]> {
        let mut edges: Vec<_> = self
            .triangles
            .iter()
            .flat_map(|&[a, b, c]| [[a, b], [b, c], [c, a]])
            .map(|[a, b]| [a.min(b), a.max(b)])
            .collect();
        edges.sort_unstable();
        edges.dedup();
        edges
    }

    fn line_vertices(&self) -> Vec<u32> {
        let mut vertices: Vec<_> = self.segments.iter().flatten().copied().collect();
        vertices.sort_unstable();
        vertices.dedup();
        vertices
    }
}

fn vertices_faces(first: &Soup, vertices: &[u32], second: &Soup, separation: f64, is_self: bool) -> Listed {
    let mut listed = Listed::new();
    for &vertex in vertices {
        let moving = first.take([vertex]);
        let moving = Sweep { from: moving.from[0], to: moving.to[0] };
        for (triangle, &corners) in (0..).zip(&second.triangles) {
            if !(is_self && corners.contains(&vertex))
                && let Some(impact) = vertex_face(&moving, &second.take(corners), separation)
            {
                listed.insert((Part::Vertex(vertex), Part::Triangle(triangle)), impact);
            }
        }
    }
    listed
}

type Edges = Vec<(Part, [u32; 2])>;

fn edges_edges(
    first: &Soup,
    edges: &Edges,
    second: &Soup,
    others: &Edges,
    separation: f64,
    is_self: bool,
) -> Listed {
    let mut listed = Listed::new();
    for (index, &(part, ends)) in edges.iter().enumerate() {
        for &(other, other_ends) in &others[if is_self { index + 1 } else { 0 }..] {
            if !(is_self && ends.iter().any(|end| other_ends.contains(end)))
                && let Some(impact) = edge_edge(&first.take(ends), &second.take(other_ends), separation)
            {
                listed.insert((part, other), impact);
            }
        }
    }
    listed
}

fn of_surface(soup: &Soup) -> Edges {
    soup.edges().into_iter().map(|ends| (Part::Edge(ends), ends)).collect()
}

fn of_line(soup: &Soup) -> Edges {
    (0..).zip(&soup.segments).map(|(index, &ends)| (Part::Segment(index), ends)).collect()
}

fn compare(found: &[FoundImpact], expected: &Listed) -> usize {
    assert!(found.is_sorted_by(|a, b| a.impact.time <= b.impact.time));
    let listed: Listed = found.iter().map(|found| ((found.first, found.second), found.impact)).collect();
    assert_eq!(listed.len(), found.len(), "no pair is listed twice");
    assert_eq!(&listed, expected);
    found.len()
}

#[test]
fn the_list_is_that_of_all_pairs() {
    let mut random = Pcg64Mcg::seed_from_u64(21);
    let mut finder = ImpactFinder::new();
    let mut listed = [0; 5];
    for round in 0..60 {
        let scale = 10.0_f64.powi(-(round % 5));
        let (count, size) = (random.random_range(0..80), random.random_range(0.1..0.9));
        let (first, second) = (soup(&mut random, count, size, scale), soup(&mut random, count, size, scale));
        let separation = if round % 2 == 0 { 0.0 } else { 0.02 * scale };
        let radius = if round % 3 == 0 { 0.0 } else { 0.01 * scale };
        let line = first.line(radius);

        let mut expected =
            vertices_faces(&first, &first.line_vertices(), &second, separation + radius, false);
        let sum = separation + radius;
        expected.append(&mut edges_edges(
            &first,
            &of_line(&first),
            &second,
            &of_surface(&second),
            sum,
            false,
        ));
        listed[0] += compare(finder.line_surface(&line, &second.surface(), separation), &expected);

        let used = |soup: &Soup| {
            let mut vertices: Vec<_> = soup.triangles.iter().flatten().copied().collect();
            vertices.sort_unstable();
            vertices.dedup();
            vertices
        };
        let mut expected = vertices_faces(&first, &used(&first), &second, separation, false);
        for ((vertex, triangle), impact) in vertices_faces(&second, &used(&second), &first, separation, false)
        {
            let found = FoundImpact { first: vertex, second: triangle, impact }.swapped();
            expected.insert((found.first, found.second), found.impact);
        }
        let (edges, others) = (of_surface(&first), of_surface(&second));
        expected.append(&mut edges_edges(&first, &edges, &second, &others, separation, false));
        listed[1] +=
            compare(finder.surface_surface(&first.surface(), &second.surface(), separation), &expected);

        let mut expected = vertices_faces(&first, &used(&first), &first, separation, true);
        expected.append(&mut edges_edges(&first, &edges, &first, &edges, separation, true));
        listed[2] += compare(finder.surface_self(&first.surface(), separation), &expected);

        let (sum, twice) = (separation + radius + radius, separation + 2.0 * radius);
        let expected = edges_edges(&first, &of_line(&first), &second, &of_line(&second), sum, false);
        listed[3] += compare(finder.line_line(&line, &second.line(radius), separation), &expected);
        let expected = edges_edges(&first, &of_line(&first), &first, &of_line(&first), twice, true);
        listed[4] += compare(finder.line_self(&line, separation), &expected);
    }
    assert!(listed.iter().all(|count| *count > 150), "{listed:?}");
}

#[test]
fn nothing_at_all_and_meshes_that_change_between_two_searches() {
    let mut random = Pcg64Mcg::seed_from_u64(22);
    let mut finder = ImpactFinder::new();
    let nothing = Soup { vertices: Sweep { from: vec![], to: vec![] }, triangles: vec![], segments: vec![] };
    let mut some = soup(&mut random, 30, 0.5, 1.0);
    assert!(finder.line_surface(&nothing.line(0.1), &some.surface(), 0.1).is_empty());
    assert!(finder.line_surface(&some.line(0.1), &nothing.surface(), 0.1).is_empty());
    assert!(finder.surface_self(&nothing.surface(), 0.1).is_empty());
    let whole = finder.surface_self(&some.surface(), 0.0).len();
    // Cut: half of the triangles are gone.
    some.triangles.truncate(15);
    let cut = finder.surface_self(&some.surface(), 0.0).to_vec();
    assert!(cut.len() < whole && cut == ImpactFinder::new().surface_self(&some.surface(), 0.0));
}

#[test]
fn turning_mirroring_and_turning_inside_out_change_nothing_but_names() {
    let mut random = Pcg64Mcg::seed_from_u64(23);
    let mut finder = ImpactFinder::new();
    let (first, mut second) = (soup(&mut random, 150, 0.5, 0.1), soup(&mut random, 150, 0.5, 0.1));
    let parts = |found: &[FoundImpact]| {
        let mut parts: Vec<_> = found.iter().map(|found| (found.first, found.second)).collect();
        parts.sort_unstable();
        parts
    };
    let before = parts(finder.line_surface(&first.line(0.001), &second.surface(), 0.0));
    assert!(before.len() > 50);
    for corners in &mut second.triangles {
        corners.swap(0, 1);
    }
    let turn = Rotation3::from_euler_angles(1.0, 2.0, 3.0);
    let mut turned = first;
    for soup in [&mut turned, &mut second] {
        for point in soup.vertices.from.iter_mut().chain(&mut soup.vertices.to) {
            *point = turn * *point + Vector3::new(0.1, -0.2, 0.3);
        }
    }
    assert_eq!(parts(finder.line_surface(&turned.line(0.001), &second.surface(), 0.0)), before);
}

#[test]
fn a_thread_that_is_through_already_comes_in_again_only_with_its_ends() {
    let corners = [Point3::new(-1.0, -1.0, 0.0), Point3::new(2.0, -1.0, 0.0), Point3::new(-1.0, 2.0, 0.0)];
    let sheet = Surface::new(&corners, &[[0, 1, 2]]).expect("a surface");
    let from = [Point3::new(0.0, 0.0, 1.0), Point3::new(0.0, 0.0, -0.5), Point3::new(0.0, 0.0, -1.0)];
    let segments = [[0, 1], [1, 2]];
    let thread = Line::new(&from, &segments, 0.0).expect("a line");
    let mut finder = ImpactFinder::new();
    let mut pulled = |by: f64| -> Vec<Part> {
        let to = from.map(|point| point + Vector3::z() * by);
        let line = SweptLine::new(thread, &to).expect("a line");
        let found = finder.line_surface(&line, &SweptSurface::still(sheet), 0.0);
        found.iter().map(|found| found.first).collect()
    };
    assert_eq!(pulled(0.25), []);
    assert_eq!(pulled(0.75), [Part::Vertex(1)]);
    assert_eq!(pulled(1.5), [Part::Vertex(1), Part::Vertex(2)]);
}
