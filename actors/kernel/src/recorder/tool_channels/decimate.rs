//! Decimation of surfaces by quadric error metrics (Garland, Heckbert 1997): edges are collapsed in the order of what that
//! changes of the form, so that corners, creases and borders stay. A vertex is moved onto its neighbour, never to a new
//! place: what remains follows the surface as it deforms.

use std::cmp::{Ordering, Reverse};
use std::collections::BinaryHeap;

use nalgebra::{Matrix3, Point3, Vector3};

use super::coarse::{Coarse, coarsen};

/// Surfaces with more vertices are thinned without a look at their form.
const VERTICES_MAX: usize = 5_000;
/// How much more a border counts than the surface beside it.
const BORDER_WEIGHT: f64 = 10.0;
/// How much the fourth power of an edge's length counts: where all is flat, the vertices that remain lie evenly.
const LENGTH_WEIGHT: f64 = 1e-3;
/// Least cosine between the normals of a triangle before and after a collapse.
const TURN_MIN: f64 = 0.2;

/// Keeps at most `most` vertices of a surface. Triangles with vertices that have no position are left out.
pub(super) fn decimate(triangles: &[[u32; 3]], positions: &[Point3<f64>], most: usize) -> Coarse<3> {
    let whole = coarsen(triangles, positions.len(), usize::MAX);
    if whole.vertices.len() <= most {
        return whole;
    }
    if whole.vertices.len() > VERTICES_MAX {
        return coarsen(triangles, positions.len(), most);
    }
    let points = whole.vertices.iter().map(|vertex| positions[*vertex as usize]).collect();
    let mut surface = Surface::new(whole.cells, points);
    surface.collapse(most);
    // Small closed parts cannot be collapsed any further.
    let rest = coarsen(&surface.whole_triangles(), surface.points.len(), most);
    let vertices = rest.vertices.iter().map(|vertex| whole.vertices[*vertex as usize]).collect();
    Coarse { vertices, cells: rest.cells }
}

/// The sum of squared distances from some planes, each with its weight: `xᵀ A x + 2 bᵀ x + c`.
#[derive(Clone, Copy, Default)]
struct Quadric {
    a: Matrix3<f64>,
    b: Vector3<f64>,
    c: f64,
}

impl Quadric {
    /// Of a plane through a point with that unit normal.
    fn of_plane(normal: &Vector3<f64>, point: &Point3<f64>, weight: f64) -> Self {
        let offset = -normal.dot(&point.coords);
        let a = normal * normal.transpose() * weight;
        Self { a, b: normal * (weight * offset), c: weight * offset * offset }
    }

    fn add(&mut self, other: &Self) {
        self.a += other.a;
        self.b += other.b;
        self.c += other.c;
    }

    fn at(&self, point: &Point3<f64>) -> f64 {
        let x = &point.coords;
        x.dot(&(self.a * x)) + 2.0 * self.b.dot(x) + self.c
    }
}

/// A vertex that may be moved onto a neighbour.
struct Candidate {
    cost: f64,
    from: u32,
    to: u32,
    /// How often each had changed when the cost was found.
    versions: [u32; 2],
}

impl Candidate {
    fn key(&self) -> (u32, u32) {
        (self.from, self.to)
    }
}

impl PartialEq for Candidate {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other) == Ordering::Equal
    }
}
impl Eq for Candidate {}
impl PartialOrd for Candidate {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}
impl Ord for Candidate {
    fn cmp(&self, other: &Self) -> Ordering {
        self.cost.total_cmp(&other.cost).then_with(|| self.key().cmp(&other.key()))
    }
}

/// A surface while its edges are collapsed.
struct Surface {
    points: Vec<Point3<f64>>,
    /// `None` once it is gone.
    triangles: Vec<Option<[u32; 3]>>,
    /// The triangles around each vertex, none of which is gone.
    around: Vec<Vec<u32>>,
    quadrics: Vec<Quadric>,
    versions: Vec<u32>,
    /// Vertices with triangles.
    left: usize,
}

impl Surface {
    fn new(triangles: Vec<[u32; 3]>, points: Vec<Point3<f64>>) -> Self {
        let count = points.len();
        let mut around = vec![Vec::new(); count];
        for (triangle, number) in triangles.iter().zip(0..) {
            triangle.iter().for_each(|vertex| around[*vertex as usize].push(number));
        }
        let triangles = triangles.into_iter().map(Some).collect();
        let (quadrics, versions) = (vec![Quadric::default(); count], vec![0; count]);
        let mut surface = Self { points, triangles, around, quadrics, versions, left: count };
        surface.measure();
        surface
    }

    fn whole_triangles(&self) -> Vec<[u32; 3]> {
        self.triangles.iter().flatten().copied().collect()
    }

    /// Twice the area of a triangle, along its normal.
    fn area(&self, corners: [u32; 3]) -> Vector3<f64> {
        let [a, b, c] = corners.map(|vertex| self.points[vertex as usize]);
        (b - a).cross(&(c - a))
    }

    /// The quadrics of all vertices: of their triangles by area, and of upright planes along borders.
    fn measure(&mut self) {
        for corners in self.whole_triangles() {
            let area = self.area(corners);
            let Some(normal) = area.try_normalize(0.0) else { continue };
            let plane = Quadric::of_plane(&normal, &self.points[corners[0] as usize], area.norm());
            corners.iter().for_each(|vertex| self.quadrics[*vertex as usize].add(&plane));
            for (from, to) in edges(corners) {
                if self.is_border(from, to) {
                    let [start, end] = [from, to].map(|vertex| self.points[vertex as usize]);
                    let Some(upright) = (end - start).cross(&normal).try_normalize(0.0) else { continue };
                    let weight = BORDER_WEIGHT * (end - start).norm_squared();
                    let plane = Quadric::of_plane(&upright, &start, weight);
                    [from, to].iter().for_each(|vertex| self.quadrics[*vertex as usize].add(&plane));
                }
            }
        }
    }

    /// The triangles with both vertices.
    fn with_both(&self, one: u32, other: u32) -> impl Iterator<Item = u32> {
        let both = move |number: &&u32| {
            self.triangles[**number as usize].is_some_and(|corners| corners.contains(&other))
        };
        self.around[one as usize].iter().filter(both).copied()
    }

    fn is_border(&self, one: u32, other: u32) -> bool {
        self.with_both(one, other).count() == 1
    }

    /// The vertices at the other ends of its edges, in order.
    fn neighbours(&self, of: u32) -> Vec<u32> {
        let around = &self.around[of as usize];
        let mut neighbours = Vec::with_capacity(2 * around.len());
        let corners = around.iter().filter_map(|number| self.triangles[*number as usize]);
        neighbours.extend(corners.flatten().filter(|vertex| *vertex != of));
        neighbours.sort_unstable();
        neighbours.dedup();
        neighbours
    }

    fn candidate(&self, from: u32, to: u32) -> Reverse<Candidate> {
        let mut quadric = self.quadrics[from as usize];
        quadric.add(&self.quadrics[to as usize]);
        let length = self.points[from as usize] - self.points[to as usize];
        let cost = quadric.at(&self.points[to as usize]) + LENGTH_WEIGHT * length.norm_squared().powi(2);
        Reverse(Candidate {
            cost,
            from,
            to,
            versions: [from, to].map(|vertex| self.versions[vertex as usize]),
        })
    }

    /// Collapses edges until at most `most` vertices are left, or none can be collapsed.
    fn collapse(&mut self, most: usize) {
        let all = (0..self.points.len() as u32)
            .flat_map(|vertex| self.neighbours(vertex).into_iter().map(move |neighbour| (vertex, neighbour)));
        let mut queue: BinaryHeap<_> = all.map(|(from, to)| self.candidate(from, to)).collect();
        while self.left > most {
            let Some(Reverse(Candidate { from, to, versions, .. })) = queue.pop() else { break };
            let is_fresh = versions == [from, to].map(|vertex| self.versions[vertex as usize]);
            if !is_fresh || !self.may_move(from, to) {
                continue;
            }
            self.move_onto(from, to);
            for neighbour in self.neighbours(to) {
                queue.push(self.candidate(to, neighbour));
                queue.push(self.candidate(neighbour, to));
            }
        }
    }

    /// Whether the surface stays one without folds or holes.
    fn may_move(&self, from: u32, to: u32) -> bool {
        let (ours, theirs) = (self.neighbours(from), self.neighbours(to));
        let common = ours.iter().filter(|neighbour| theirs.binary_search(neighbour).is_ok()).count();
        let shared = self.with_both(from, to).count();
        // Around an inner vertex there are as many neighbours as triangles.
        let is_on_border = ours.len() != self.around[from as usize].len();
        if shared == 0 || common != shared || (is_on_border && shared != 1) {
            return false;
        }
        self.around[from as usize].iter().all(|number| {
            let Some(before) = self.triangles[*number as usize] else { return true };
            if before.contains(&to) {
                return true;
            }
            let after = before.map(|vertex| if vertex == from { to } else { vertex });
            let [before, after] = [before, after].map(|corners| self.area(corners));
            before.dot(&after) > TURN_MIN * before.norm() * after.norm()
        })
    }

    fn move_onto(&mut self, from: u32, to: u32) {
        for number in std::mem::take(&mut self.around[from as usize]) {
            let slot = &mut self.triangles[number as usize];
            let Some(corners) = slot else { continue };
            if corners.contains(&to) {
                for corner in *corners {
                    self.around[corner as usize].retain(|other| *other != number);
                }
                *slot = None;
                continue;
            }
            corners.iter_mut().filter(|vertex| **vertex == from).for_each(|vertex| *vertex = to);
            self.around[to as usize].push(number);
        }
        let quadric = self.quadrics[from as usize];
        self.quadrics[to as usize].add(&quadric);
        self.versions[from as usize] += 1;
        self.versions[to as usize] += 1;
        self.left -= 1;
    }
}

fn edges([a, b, c]: [u32; 3]) -> [(u32, u32); 3] {
    [(a, b), (b, c), (c, a)]
}

#[cfg(test)]
mod tests {
    use std::collections::{BTreeMap, BTreeSet};

    use trocar_scene::Shape;
    use trocar_scene::shapes::{Detail, surface_of};

    use super::*;

    /// A surface whose vertices are one where they lie in one place.
    fn welded(points: impl IntoIterator<Item = [i32; 3]>) -> (Vec<[u32; 3]>, Vec<[i32; 3]>) {
        let (mut numbers, mut places, mut corners) = (BTreeMap::new(), Vec::new(), Vec::new());
        for point in points {
            let number = *numbers.entry(point).or_insert_with(|| {
                places.push(point);
                places.len() as u32 - 1
            });
            corners.push(number);
        }
        (corners.chunks(3).map(|corners| [corners[0], corners[1], corners[2]]).collect(), places)
    }

    /// A cube of `side` × `side` quads on each face.
    fn cube(side: i32) -> (Vec<[u32; 3]>, Vec<Point3<f64>>) {
        let mut corners = Vec::new();
        for axis in 0..3 {
            for (level, turned) in [(0, true), (side, false)] {
                for (u, v) in (0..side * side).map(|quad| (quad / side, quad % side)) {
                    let at = |u: i32, v: i32| {
                        let mut point = [level; 3];
                        (point[(axis + 1) % 3], point[(axis + 2) % 3]) = (u, v);
                        point
                    };
                    let quad =
                        [at(u, v), at(u + 1, v), at(u + 1, v + 1), at(u, v), at(u + 1, v + 1), at(u, v + 1)];
                    if turned { corners.extend(quad.iter().rev()) } else { corners.extend(quad) }
                }
            }
        }
        let (triangles, places) = welded(corners);
        (triangles, places.iter().map(|place| Point3::from(place.map(f64::from))).collect())
    }

    fn volume(coarse: &Coarse<3>, points: &[Point3<f64>]) -> f64 {
        let at = |corner: u32| points[coarse.vertices[corner as usize] as usize].coords;
        coarse.cells.iter().map(|[a, b, c]| at(*a).dot(&at(*b).cross(&at(*c))) / 6.0).sum()
    }

    /// Whether every edge has a triangle on each side.
    fn is_closed(coarse: &Coarse<3>) -> bool {
        let directed: BTreeSet<_> = coarse.cells.iter().flat_map(|corners| edges(*corners)).collect();
        directed.len() == 3 * coarse.cells.len() && directed.iter().all(|(a, b)| directed.contains(&(*b, *a)))
    }

    #[test]
    fn a_cube_keeps_its_corners_and_its_volume() {
        let (triangles, points) = cube(12);
        let coarse = decimate(&triangles, &points, 30);
        assert!(coarse.vertices.len() <= 30 && is_closed(&coarse), "{}", coarse.vertices.len());
        assert!((volume(&coarse, &points) - 1_728.0).abs() < 1e-9, "{}", volume(&coarse, &points));
        let kept =
            |corner: [f64; 3]| coarse.vertices.iter().any(|v| points[*v as usize] == Point3::from(corner));
        let corners = (0..8).map(|bits| [0, 1, 2].map(|axis| f64::from(12 * (bits >> axis & 1))));
        assert!(corners.into_iter().all(kept));
    }

    #[test]
    fn a_sheet_keeps_its_border() {
        let side: u32 = 30;
        let row = side + 1;
        let quads = (0..side * side).map(|quad| quad / side * row + quad % side);
        let triangles: Vec<_> =
            quads.flat_map(|a| [[a, a + 1, a + row + 1], [a, a + row + 1, a + row]]).collect();
        let points: Vec<_> =
            (0..row * row).map(|v| Point3::new(f64::from(v % row), f64::from(v / row), 0.0)).collect();
        let coarse = decimate(&triangles, &points, 40);
        let at = |corner: u32| points[coarse.vertices[corner as usize] as usize];
        let area: f64 =
            coarse.cells.iter().map(|[a, b, c]| 0.5 * (at(*b) - at(*a)).cross(&(at(*c) - at(*a))).z).sum();
        assert!(coarse.vertices.len() <= 40 && (area - f64::from(side * side)).abs() < 1e-9, "{area}");
    }

    #[test]
    fn a_torus_stays_round_and_closed() {
        let detail = Detail { segments: 48, fine_segments: 24 };
        let surface =
            surface_of(&Shape::Torus { ring_radius: 1.0, tube_radius: 0.3 }, &detail).expect("a surface");
        // Points are told apart by their places alone.
        let places = surface.triangles.iter().flatten().map(|corner| {
            let point = surface.positions[*corner as usize];
            [point.x, point.y, point.z].map(|part| (part * 1e6).round() as i32)
        });
        let (triangles, places) = welded(places);
        let points: Vec<_> =
            places.iter().map(|place| Point3::from(place.map(|part| f64::from(part) / 1e6))).collect();
        let fine = coarsen(&triangles, points.len(), usize::MAX);
        let coarse = decimate(&triangles, &points, 150);
        assert!(coarse.vertices.len() <= 150 && is_closed(&coarse), "{}", coarse.vertices.len());
        let share = volume(&coarse, &points) / volume(&fine, &points);
        assert!((0.85..1.0).contains(&share), "{share}");
    }

    #[test]
    fn what_cannot_be_collapsed_is_thinned_and_bad_places_are_no_harm() {
        // Many small tetrahedra.
        let faces = |first: u32| {
            [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]].map(|face| face.map(|corner| corner + first))
        };
        let triangles: Vec<_> = (0..50).flat_map(|part| faces(4 * part)).collect();
        let point = |number: u32| {
            let (part, corner) = (f64::from(number / 4), number % 4);
            Point3::new(part, f64::from(u32::from(corner == 1)), f64::from(corner / 2))
        };
        let points: Vec<_> = (0..200).map(point).collect();
        assert!(decimate(&triangles, &points, 60).vertices.len() <= 60);
        let nowhere = vec![Point3::new(f64::NAN, 0.0, f64::INFINITY); 200];
        assert!(decimate(&triangles, &nowhere, 60).vertices.len() <= 60);
        assert_eq!(decimate(&[[0, 1, 2], [7, 8, 9]], &points[..3], 60).vertices, [0, 1, 2]);
    }
}
