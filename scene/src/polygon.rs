//! Triangles over a polygon with holes by ear clipping, holes joined by bridges (D. Eberly, "Triangulation by Ear
//! Clipping", 2002), then made a constrained Delaunay triangulation by flipping edges (C. L. Lawson, "Transforming
//! triangulations", 1972): clipping alone leaves slivers, and triangles without area where points are collinear.

use std::collections::BTreeMap;

use nalgebra::Point2;

/// Triangulates the inside of `outer` (counter-clockwise) without `holes` (clockwise). Indices run through the
/// outer polygon and then through the holes in their order; triangles are counter-clockwise.
///
/// The polygons must be simple and must not touch; `None` when no ear can be found because they do.
pub(crate) fn triangulate(outer: &[Point2<f64>], holes: &[Vec<Point2<f64>>]) -> Option<Vec<[u32; 3]>> {
    let points: Vec<Point2<f64>> = outer.iter().chain(holes.iter().flatten()).copied().collect();
    let mut loop_: Vec<usize> = (0..outer.len()).collect();
    let mut first = outer.len();
    let mut hole_loops: Vec<Vec<usize>> = Vec::with_capacity(holes.len());
    for hole in holes {
        hole_loops.push((first..first + hole.len()).collect());
        first += hole.len();
    }
    // From right to left, so that each hole sees the outer polygon or a hole already joined to it.
    let rightmost =
        |hole: &[usize]| (0..hole.len()).max_by(|&a, &b| points[hole[a]].x.total_cmp(&points[hole[b]].x));
    let mut ordered: Vec<(usize, Vec<usize>)> =
        hole_loops.into_iter().map(|hole| rightmost(&hole).map(|at| (at, hole))).collect::<Option<_>>()?;
    ordered.sort_by(|(a, p), (b, q)| points[q[*b]].x.total_cmp(&points[p[*a]].x));
    for (at, hole) in ordered {
        let bridge = visible(&points, &loop_, points[hole[at]])?;
        // …bridge, the hole once around from its rightmost point and back to it, bridge again…
        let around = hole[at..].iter().chain(&hole[..=at]).copied();
        let insert: Vec<usize> = around.chain([loop_[bridge]]).collect();
        loop_.splice(bridge + 1..bridge + 1, insert);
    }
    let mut triangles = clip_ears(&points, loop_)?;
    flip_edges(&points, &mut triangles);
    Some(triangles)
}

fn cross(a: Point2<f64>, b: Point2<f64>, c: Point2<f64>) -> f64 {
    (b - a).perp(&(c - a))
}

/// Whether `p` lies in the counter-clockwise triangle, its edges included.
fn inside(p: Point2<f64>, [a, b, c]: [Point2<f64>; 3]) -> bool {
    cross(a, b, p) >= 0.0 && cross(b, c, p) >= 0.0 && cross(c, a, p) >= 0.0
}

/// Position in the loop of a vertex that `from` can see, looking to the right.
fn visible(points: &[Point2<f64>], loop_: &[usize], from: Point2<f64>) -> Option<usize> {
    let at = |k: usize| points[loop_[k % loop_.len()]];
    let mut nearest: Option<(f64, usize)> = None;
    for k in 0..loop_.len() {
        let (a, b) = (at(k), at(k + 1));
        // Edges of a counter-clockwise loop that face `from` from the right run upwards.
        if !(a.y <= from.y && b.y >= from.y) || a.y == b.y {
            continue;
        }
        let x = a.x + (b.x - a.x) * (from.y - a.y) / (b.y - a.y);
        if x >= from.x && nearest.is_none_or(|(best, _)| x < best) {
            nearest = Some((x, k));
        }
    }
    let (x, edge) = nearest?;
    let hit = Point2::new(x, from.y);
    let (a, b) = (edge, (edge + 1) % loop_.len());
    for end in [a, b] {
        if at(end) == hit {
            return Some(clearest_copy(points, loop_, end, from));
        }
    }
    let candidate = if at(a).x > at(b).x { a } else { b };
    let tip = at(candidate);
    let triangle = if tip.y > from.y { [from, hit, tip] } else { [from, tip, hit] };
    // A vertex inside that triangle hides the candidate; of several, the one with the smallest angle is visible.
    let best = (0..loop_.len())
        .filter(|&k| at(k) != tip && at(k).x >= from.x && inside(at(k), triangle))
        .min_by(|&p, &q| {
            let slope = |k: usize| {
                let d = at(k) - from;
                (d.y.abs() / d.norm(), d.norm())
            };
            slope(p).partial_cmp(&slope(q)).unwrap_or(std::cmp::Ordering::Equal)
        })
        .unwrap_or(candidate);
    Some(clearest_copy(points, loop_, best, from))
}

/// Bridges duplicate vertices in the loop; chooses the copy whose inner angle contains `from`.
fn clearest_copy(points: &[Point2<f64>], loop_: &[usize], chosen: usize, from: Point2<f64>) -> usize {
    let n = loop_.len();
    let at = |k: usize| points[loop_[k % n]];
    let contains = |k: usize| {
        let (before, here, after) = (at(k + n - 1), at(k), at(k + 1));
        let (left_of_in, left_of_out) = (cross(before, here, from) >= 0.0, cross(here, after, from) >= 0.0);
        if cross(before, here, after) >= 0.0 { left_of_in && left_of_out } else { left_of_in || left_of_out }
    };
    (0..n).filter(|&k| loop_[k] == loop_[chosen]).find(|&k| contains(k)).unwrap_or(chosen)
}

/// Whether a corner of the loop can be clipped.
#[derive(Clone, Copy)]
enum Corner {
    /// With its area over its longest edge squared.
    Ear(f64),
    /// The loop turns right or not at all.
    Reflex,
    /// A vertex, by its position in the loop, lies within.
    Hides(usize),
}

/// A loop whose corners are clipped one by one.
struct Loop<'a> {
    points: &'a [Point2<f64>],
    vertices: Vec<usize>,
    before: Vec<usize>,
    after: Vec<usize>,
    /// Positions that are left, ascending.
    left: Vec<usize>,
}

impl Loop<'_> {
    fn around(&self, k: usize) -> [usize; 3] {
        [self.before[k], k, self.after[k]].map(|k| self.vertices[k])
    }

    fn corner(&self, k: usize) -> Corner {
        let [a, b, c] = self.around(k).map(|v| self.points[v]);
        let area = cross(a, b, c);
        if area <= 0.0 || area.is_nan() {
            return Corner::Reflex;
        }
        let hides = |&&other: &&usize| {
            let p = self.points[self.vertices[other]];
            // Copies of the ear's own corners do not count.
            p != a && p != b && p != c && inside(p, [a, b, c])
        };
        match self.left.iter().find(hides) {
            Some(&other) => Corner::Hides(other),
            None => {
                let longest = (b - a).norm_squared().max((c - b).norm_squared()).max((a - c).norm_squared());
                Corner::Ear(area / longest)
            }
        }
    }
}

fn clip_ears(points: &[Point2<f64>], vertices: Vec<usize>) -> Option<Vec<[u32; 3]>> {
    let count = vertices.len();
    let before = (0..count).map(|k| (k + count - 1) % count).collect();
    let after = (0..count).map(|k| (k + 1) % count).collect();
    let mut rest = Loop { points, vertices, before, after, left: (0..count).collect() };
    let mut corners: Vec<Corner> = (0..count).map(|k| rest.corner(k)).collect();
    let mut triangles = Vec::with_capacity(count);
    while rest.left.len() > 3 {
        // Fat ears first, so that fewer flips are needed.
        let ears = rest.left.iter().filter_map(|&k| match corners[k] {
            Corner::Ear(quality) => Some((quality, k)),
            _ => None,
        });
        let (_, ear) = ears.max_by(|(p, _), (q, _)| p.total_cmp(q))?;
        triangles.push(rest.around(ear).map(|v| v as u32));
        let (before, after) = (rest.before[ear], rest.after[ear]);
        (rest.after[before], rest.before[after]) = (after, before);
        rest.left.remove(rest.left.binary_search(&ear).ok()?);
        // Only these corners can have changed: the neighbours, and those that the clipped vertex had hidden.
        for at in 0..rest.left.len() {
            let k = rest.left[at];
            if k == before || k == after || matches!(corners[k], Corner::Hides(vertex) if vertex == ear) {
                corners[k] = rest.corner(k);
            }
        }
    }
    triangles.push([0, 1, 2].map(|k| rest.vertices[rest.left[k]] as u32));
    Some(triangles)
}

/// Flips inner edges whose opposite angles add up to more than π, until there are none.
fn flip_edges(points: &[Point2<f64>], triangles: &mut [[u32; 3]]) {
    // Each flip makes the smallest angles larger, so this ends; rounding must not make it endless.
    for _ in 0..4 * triangles.len() {
        let mut opposite: BTreeMap<[u32; 2], (usize, usize)> = BTreeMap::new();
        let mut flipped = vec![false; triangles.len()];
        let mut any = false;
        for t in 0..triangles.len() {
            for k in 0..3 {
                let [a, b] = [triangles[t][k], triangles[t][(k + 1) % 3]];
                let Some((other, j)) = opposite.insert([a.min(b), a.max(b)], (t, k)) else { continue };
                if flipped[t] || flipped[other] {
                    continue;
                }
                let (c, d) = (triangles[t][(k + 2) % 3], triangles[other][(j + 2) % 3]);
                let at = |v: u32| points[v as usize];
                let angle = |tip: u32| (at(a) - at(tip)).angle(&(at(b) - at(tip)));
                let convex = cross(at(c), at(a), at(d)) > 0.0 && cross(at(d), at(b), at(c)) > 0.0;
                if convex && angle(c) + angle(d) > std::f64::consts::PI + 1e-9 {
                    triangles[t] = [c, a, d];
                    triangles[other] = [d, b, c];
                    flipped[t] = true;
                    flipped[other] = true;
                    any = true;
                    break;
                }
            }
        }
        if !any {
            return;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn area(points: &[Point2<f64>]) -> f64 {
        (0..points.len()).map(|k| points[k].coords.perp(&points[(k + 1) % points.len()].coords) / 2.0).sum()
    }
    fn circle(x: f64, y: f64, r: f64, n: usize) -> Vec<Point2<f64>> {
        let angle = |k: usize| -std::f64::consts::TAU * k as f64 / n as f64;
        (0..n).map(|k| Point2::new(x + r * angle(k).cos(), y + r * angle(k).sin())).collect()
    }

    proptest! {
        #[test]
        fn the_area_is_that_of_the_polygon_without_its_holes(
            cells in prop::collection::btree_set((0u8..5, 0u8..4), 0..20),
            shift in -0.3..0.3f64,
            n in 3usize..14,
        ) {
            let outer = [[0., 0.], [5., 0.], [5., 4.], [0., 4.]].map(Point2::from);
            let holes: Vec<_> = cells
                .iter()
                .map(|&(i, j)| circle(0.5 + f64::from(i), 0.5 + f64::from(j) + shift * f64::from(i % 2), 0.15, n))
                .collect();
            let triangles = triangulate(&outer, &holes).expect("the polygons are apart");
            let points: Vec<_> = outer.iter().chain(holes.iter().flatten()).copied().collect();
            let expected = 20.0 + holes.iter().map(|hole| area(hole)).sum::<f64>();
            let sum: f64 = triangles.iter().map(|t| area(&t.map(|v| points[v as usize]))).sum();
            prop_assert!((sum - expected).abs() < 1e-9);
            for corners in triangles.iter().map(|t| t.map(|v| points[v as usize])) {
                let longest = (0..3).map(|k| (corners[(k + 1) % 3] - corners[k]).norm_squared()).fold(0.0, f64::max);
                prop_assert!(area(&corners) > 1e-6 * longest, "{:?} is a sliver", corners);
            }
            // A polygon of n vertices with h holes takes n + 2 h − 2 triangles.
            prop_assert_eq!(triangles.len(), points.len() + 2 * holes.len() - 2);
        }
    }

    #[test]
    fn a_concave_polygon_is_covered() {
        let points = [[0., 0.], [4., 0.], [4., 4.], [2., 1.], [0., 4.]].map(Point2::from);
        let triangles = triangulate(&points, &[]).expect("a simple polygon");
        let sum: f64 = triangles.iter().map(|t| area(&t.map(|v| points[v as usize]))).sum();
        assert!((sum - area(&points)).abs() < 1e-12);
    }
}
