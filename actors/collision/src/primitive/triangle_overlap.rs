//! Overlap test of two triangles (Guigue and Devillers, *Fast and Robust Triangle-Triangle Overlap Test Using
//! Orientation Predicates*, 2003), and their intersection segment.
//!
//! Triangles are closed: touching is overlapping. Every decision is the sign of an exact determinant ([`orientation`]),
//! so that the result is exact for the given numbers: coplanar triangles, triangles that share a corner or an edge and
//! triangles without area included.

use nalgebra::{Point3, Vector3};

use super::{Triangle, orientation, orientation_in_plane};

/// Whether the two intersect.
#[must_use]
pub fn triangles_overlap(first: &Triangle, second: &Triangle) -> bool {
    let of_second = sides(first, second);
    if on_one_side(&of_second) {
        return false;
    }
    let of_first = sides(second, first);
    if on_one_side(&of_first) {
        return false;
    }
    if of_second == [0.0; 3] || of_first == [0.0; 3] {
        return flat_overlap(first, second);
    }
    // One corner of each is alone on its side of the other's plane, and both triangles intersect the planes' common
    // line in an interval. Turned so that the lone corner lies on the positive side, the intervals are in order exactly
    // when neither begins behind the other's end: two determinants.
    let (lone, behind) = lone_corner(&of_first);
    let (other_lone, other_behind) = lone_corner(&of_second);
    let turned = |triangle: &Triangle, lone: usize, swap: bool| {
        let (next, last) = (triangle[(lone + 1) % 3], triangle[(lone + 2) % 3]);
        if swap { [triangle[lone], last, next] } else { [triangle[lone], next, last] }
    };
    let [p1, q1, r1] = turned(first, lone, other_behind);
    let [p2, q2, r2] = turned(second, other_lone, behind);
    orientation(&p1, &q1, &p2, &q2) <= 0.0 && orientation(&p1, &r1, &r2, &p2) <= 0.0
}

/// Sides of the plane of `of` on which the corners of `asked` lie.
#[inline]
fn sides(of: &Triangle, asked: &Triangle) -> [f64; 3] {
    /// Error of the distance below, relative to the product of its three largest coordinates: 16 roundings suffice.
    const ERROR: f64 = 64.0 * f64::EPSILON;
    let [a, b, c] = of;
    let (ab, ac) = (b - a, c - a);
    let normal = ab.cross(&ac);
    let area = ab.amax() * ac.amax();
    let side = |corner: &Point3<f64>| {
        let from_a = corner - a;
        let height = normal.dot(&from_a);
        if height.abs() > ERROR * area * from_a.amax() { -height } else { orientation(a, b, c, corner) }
    };
    [side(&asked[0]), side(&asked[1]), side(&asked[2])]
}

fn on_one_side(sides: &[f64; 3]) -> bool {
    sides.iter().all(|&side| side > 0.0) || sides.iter().all(|&side| side < 0.0)
}

/// Which corner is alone, and whether it lies on the negative side. Not all three lie on one side or in the plane.
fn lone_corner(sides: &[f64; 3]) -> (usize, bool) {
    let only = |wanted: fn(f64) -> bool| {
        let mut found = (0..3).filter(|&corner| wanted(sides[corner]));
        let first = found.next();
        if found.next().is_none() { first } else { None }
    };
    if let Some(corner) = only(|side| side > 0.0) {
        (corner, false)
    } else if let Some(corner) = only(|side| side < 0.0) {
        (corner, true)
    } else {
        // One in the plane and two on one side: the plane counts as the other side.
        let corner = only(|side| side == 0.0).unwrap_or(0);
        (corner, sides[(corner + 1) % 3] > 0.0)
    }
}

/// Both in one plane, or one of them without area.
#[cold]
fn flat_overlap(first: &Triangle, second: &Triangle) -> bool {
    let thin = [without_area(first), without_area(second)];
    match thin {
        [false, true] => return thin_overlap(second, first),
        [true, false] => return thin_overlap(first, second),
        [true, true] => {
            let ([a, b], [c, d]) = (longest_edge(first), longest_edge(second));
            if orientation(&a, &b, &c, &d) != 0.0 {
                return false;
            }
        }
        [false, false] => {}
    }
    coplanar_overlap(first, second)
}

/// A segment, given as a triangle without area, against a triangle with area.
fn thin_overlap(thin: &Triangle, triangle: &Triangle) -> bool {
    let [a, b] = longest_edge(thin);
    let [p, q, r] = triangle;
    let (of_a, of_b) = (orientation(p, q, r, &a), orientation(p, q, r, &b));
    if (of_a > 0.0 && of_b > 0.0) || (of_a < 0.0 && of_b < 0.0) {
        return false;
    }
    if of_a == 0.0 && of_b == 0.0 {
        return coplanar_overlap(thin, triangle);
    }
    let around = [(p, q), (q, r), (r, p)].map(|(from, to)| orientation(&a, &b, from, to));
    around.iter().all(|&side| side >= 0.0) || around.iter().all(|&side| side <= 0.0)
}

/// All six corners lie in one plane: project along an axis that is not within the plane.
fn coplanar_overlap(first: &Triangle, second: &Triangle) -> bool {
    let corners = [first[0], first[1], first[2], second[0], second[1], second[2]];
    let spread = |axis: usize| {
        let mut best = 0.0_f64;
        for i in 0..6 {
            for j in i + 1..6 {
                for k in j + 1..6 {
                    let [a, b, c] = [corners[i], corners[j], corners[k]].map(|corner| along(axis, &corner));
                    best = best.max(orientation_in_plane(a, b, c).abs());
                }
            }
        }
        best
    };
    let spreads = [spread(0), spread(1), spread(2)];
    let mut axis = 0;
    for other in 1..3 {
        if spreads[other] > spreads[axis] {
            axis = other;
        }
    }
    if spreads[axis] == 0.0 {
        return (0..3).all(|axis| {
            let (low, high) = range(first, axis);
            let (other_low, other_high) = range(second, axis);
            low <= other_high && other_low <= high
        });
    }
    let (first, second) = (
        first.each_ref().map(|corner| along(axis, corner)),
        second.each_ref().map(|corner| along(axis, corner)),
    );
    let edges = [(0, 1), (1, 2), (2, 0)];
    edges.iter().any(|&(a, b)| {
        edges.iter().any(|&(c, d)| segments_cross([first[a], first[b]], [second[c], second[d]]))
    }) || within(first[0], &second)
        || within(second[0], &first)
}

/// Projection of a point along an axis.
fn along(axis: usize, point: &Point3<f64>) -> [f64; 2] {
    [point[(axis + 1) % 3], point[(axis + 2) % 3]]
}

fn range(triangle: &Triangle, axis: usize) -> (f64, f64) {
    triangle.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), corner| {
        (low.min(corner[axis]), high.max(corner[axis]))
    })
}

fn within(point: [f64; 2], triangle: &[[f64; 2]; 3]) -> bool {
    let [a, b, c] = *triangle;
    let area = orientation_in_plane(a, b, c);
    area != 0.0
        && [(a, b), (b, c), (c, a)].iter().all(|&(from, to)| {
            let side = orientation_in_plane(from, to, point);
            side == 0.0 || (side > 0.0) == (area > 0.0)
        })
}

fn segments_cross(first: [[f64; 2]; 2], second: [[f64; 2]; 2]) -> bool {
    let apart = (0..2).any(|axis| {
        first[0][axis].max(first[1][axis]) < second[0][axis].min(second[1][axis])
            || second[0][axis].max(second[1][axis]) < first[0][axis].min(first[1][axis])
    });
    let straddles = |line: [[f64; 2]; 2], ends: [[f64; 2]; 2]| {
        let [a, b] = ends.map(|end| orientation_in_plane(line[0], line[1], end));
        !((a > 0.0 && b > 0.0) || (a < 0.0 && b < 0.0))
    };
    !apart && straddles(first, second) && straddles(second, first)
}

fn without_area(triangle: &Triangle) -> bool {
    (0..3).all(|axis| {
        let [a, b, c] = triangle.each_ref().map(|corner| along(axis, corner));
        orientation_in_plane(a, b, c) == 0.0
    })
}

/// The two corners of a triangle without area between which the third lies.
fn longest_edge(triangle: &Triangle) -> [Point3<f64>; 2] {
    let axis = (0..3).fold(0, |best, axis| {
        let spread = |axis: usize| {
            let (low, high) = range(triangle, axis);
            high - low
        };
        if spread(axis) > spread(best) { axis } else { best }
    });
    let mut ends = [triangle[0]; 2];
    for corner in triangle {
        if corner[axis] < ends[0][axis] {
            ends[0] = *corner;
        }
        if corner[axis] > ends[1][axis] {
            ends[1] = *corner;
        }
    }
    ends
}

/// Ends of the intersection segment of two overlapping triangles, up to rounding; for coplanar triangles, the two
/// farthest corners of their common area. For disjoint triangles: points between them.
#[must_use]
pub fn common_segment(first: &Triangle, second: &Triangle) -> [Point3<f64>; 2] {
    let normal = |t: &Triangle| (t[1] - t[0]).cross(&(t[2] - t[0]));
    let (n1, n2) = (normal(first), normal(second));
    let direction: Vector3<f64> = n1.cross(&n2);
    let thin = |t: &Triangle, normal: &Vector3<f64>| {
        let longest = (t[1] - t[0]).amax().max((t[2] - t[0]).amax());
        normal.amax() <= 1e-4 * longest * longest
    };
    // For a very thin triangle, or nearly coplanar triangles, the common line is dominated by rounding.
    if thin(first, &n1) || thin(second, &n2) || direction.norm() <= 1e-4 * n1.norm() * n2.norm() {
        return farthest_common(first, second);
    }
    let along = |point: &Point3<f64>| direction.dot(&(point - first[0]));
    let spans =
        [crossing_span(first, &second[0], &n2, &along), crossing_span(second, &first[0], &n1, &along)];
    let later = |a: (f64, Point3<f64>), b: (f64, Point3<f64>)| if a.0 > b.0 { a } else { b };
    let sooner = |a: (f64, Point3<f64>), b: (f64, Point3<f64>)| if a.0 < b.0 { a } else { b };
    [later(spans[0][0], spans[1][0]).1, sooner(spans[0][1], spans[1][1]).1]
}

/// Crossings of a triangle's edges with a plane: the first and the last along a line, with their parameters.
fn crossing_span(
    triangle: &Triangle,
    on_plane: &Point3<f64>,
    normal: &Vector3<f64>,
    along: &impl Fn(&Point3<f64>) -> f64,
) -> [(f64, Point3<f64>); 2] {
    let heights = triangle.each_ref().map(|corner| normal.dot(&(corner - on_plane)));
    // A corner or an edge within rounding of the plane counts as in it.
    let size = triangle.iter().fold(0.0_f64, |size, corner| size.max((corner - on_plane).amax()));
    let noise = 1e-14 * size * normal.amax();
    let mut span: Option<[(f64, Point3<f64>); 2]> = None;
    let mut take = |point: Point3<f64>| {
        let here = (along(&point), point);
        let [low, high] = span.get_or_insert([here; 2]);
        if here.0 < low.0 {
            *low = here;
        }
        if here.0 > high.0 {
            *high = here;
        }
    };
    for from in 0..3 {
        let to = (from + 1) % 3;
        if heights[from].abs() <= noise {
            take(triangle[from]);
        } else if heights[to].abs() > noise && (heights[from] > 0.0) != (heights[to] > 0.0) {
            let share = heights[from] / (heights[from] - heights[to]);
            take(triangle[from] + (triangle[to] - triangle[from]) * share);
        }
    }
    // Only rounding separates them: uses the corner nearest to the plane.
    span.unwrap_or_else(|| {
        let nearest = (0..3).fold(0, |best, i| if heights[i].abs() < heights[best].abs() { i } else { best });
        [(along(&triangle[nearest]), triangle[nearest]); 2]
    })
}

/// For coplanar triangles, or ones without area: the two farthest common points among the nearest points of all edges
/// and corners.
#[cold]
fn farthest_common(first: &Triangle, second: &Triangle) -> [Point3<f64>; 2] {
    let mut found = [Point3::origin(); 21];
    let mut apart = [0.0; 21];
    let mut count = 0;
    let mut take = |on_first: Point3<f64>, on_second: Point3<f64>| {
        found[count] = nalgebra::center(&on_first, &on_second);
        apart[count] = (on_second - on_first).norm_squared();
        count += 1;
    };
    for corner in first {
        take(*corner, super::closest_on_triangle(corner, second).point);
    }
    for corner in second {
        take(super::closest_on_triangle(corner, first).point, *corner);
    }
    for i in 0..3 {
        let [a, b] = [first, second].map(|t| [t[i], t[(i + 1) % 3]]);
        // The crossing of a segment with a thin triangle is dominated by rounding: check that it is on the triangle.
        let through = super::closest_segment_triangle(&a, second).on_segment;
        take(through, super::closest_on_triangle(&through, second).point);
        let through = super::closest_segment_triangle(&b, first).on_segment;
        take(super::closest_on_triangle(&through, first).point, through);
        for j in 0..3 {
            let [a, b] = [[first[i], first[(i + 1) % 3]], [second[j], second[(j + 1) % 3]]];
            let nearest = super::closest_segments(&a, &b);
            take(nearest.points[0], nearest.points[1]);
        }
    }
    let least = apart.iter().fold(f64::INFINITY, |least, &apart| least.min(apart));
    let size = (first[1] - first[0]).amax().max((second[1] - second[0]).amax());
    let limit = least + 1e-24 * size * size;
    let mut best = [Point3::origin(); 2];
    let mut widest = -1.0;
    for i in (0..21).filter(|&i| apart[i] <= limit) {
        for j in (i..21).filter(|&j| apart[j] <= limit) {
            let width = (found[j] - found[i]).norm_squared();
            if width > widest {
                (widest, best) = (width, [found[i], found[j]]);
            }
        }
    }
    best
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    type V = [i64; 3];

    fn minus(a: V, b: V) -> V {
        [0, 1, 2].map(|i| a[i] - b[i])
    }

    fn cross(a: V, b: V) -> V {
        [0, 1, 2].map(|i| a[(i + 1) % 3] * b[(i + 2) % 3] - a[(i + 2) % 3] * b[(i + 1) % 3])
    }

    /// In integers: the nearest points of two disjoint triangles lie on two features, and their direction is one of:
    /// corner to corner, corner to edge, edge to edge, face normal. Without a gap along any of them they overlap.
    fn oracle(t1: [V; 3], t2: [V; 3]) -> bool {
        let edges = |t: [V; 3]| [0, 1, 2].map(|i| minus(t[(i + 1) % 3], t[i]));
        let (e1, e2) = (edges(t1), edges(t2));
        let mut directions = vec![cross(e1[0], e1[1]), cross(e2[0], e2[1])];
        for a in e1 {
            directions.extend(e2.map(|b| cross(a, b)));
        }
        for p in t1 {
            for q in t2 {
                let between = minus(q, p);
                directions.push(between);
                directions.extend(e1.iter().chain(&e2).map(|&e| cross(e, cross(between, e))));
            }
        }
        !directions.iter().any(|d| {
            let reach = |t: [V; 3]| t.map(|p| p[0] * d[0] + p[1] * d[1] + p[2] * d[2]);
            let (r1, r2) = (reach(t1), reach(t2));
            r1.iter().max() < r2.iter().min() || r2.iter().max() < r1.iter().min()
        })
    }

    fn grid_triangle(most: i64) -> impl Strategy<Value = [V; 3]> {
        let corner = move || [0..=most, 0..=most, 0..=most];
        [corner(), corner(), corner()]
    }

    fn pair() -> impl Strategy<Value = ([V; 3], [V; 3])> {
        prop_oneof![
            (grid_triangle(2), grid_triangle(2)),
            (grid_triangle(4), grid_triangle(4)),
            (grid_triangle(40), grid_triangle(40)),
            (grid_triangle(4), grid_triangle(4)).prop_map(|(a, b)| {
                let flat = |t: [V; 3]| t.map(|p| [p[0], p[1], p[0] + p[1]]);
                (flat(a), flat(b))
            }),
        ]
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(60_000))]
        /// On a coarse grid most pairs touch, share a plane or a corner, or have no area.
        #[test]
        fn the_answer_is_that_of_the_integers((first, second) in pair(), scale in 0..3) {
            let scale = [1.0, 1e-4, 0.1][scale as usize];
            let to_points = |t: [V; 3]| t.map(|p| Point3::from(p.map(|x| x as f64)));
            let (a, b) = (to_points(first), to_points(second));
            prop_assert_eq!(triangles_overlap(&a, &b), oracle(first, second));
            prop_assert_eq!(triangles_overlap(&b, &a), oracle(first, second));
            if oracle(first, second) {
                let resize = |t: Triangle| t.map(|p| p * scale);
                let (a, b) = (resize(a), resize(b));
                for point in common_segment(&a, &b) {
                    for triangle in [&a, &b] {
                        let on = super::super::closest_on_triangle(&point, triangle).point;
                        prop_assert!((on - point).norm() <= 1e-11 * scale * 40.0, "{point} of {a:?} {b:?}");
                    }
                }
            }
        }
    }

    #[test]
    fn the_common_segment_is_as_long_as_what_they_share() {
        let flat = [Point3::new(0.0, 0.0, 0.0), Point3::new(4.0, 0.0, 0.0), Point3::new(0.0, 4.0, 0.0)];
        let upright = [Point3::new(1.0, 1.0, -1.0), Point3::new(1.0, 1.0, 1.0), Point3::new(1.0, 9.0, 0.0)];
        let [from, to] = common_segment(&flat, &upright);
        assert!(((to - from).norm() - 2.0).abs() < 1e-15, "{from} {to}");
        let beside = flat.map(|p| p + Vector3::new(1.0, 1.0, 0.0));
        let [from, to] = common_segment(&flat, &beside);
        assert!(((to - from).norm() - 8.0_f64.sqrt()).abs() < 1e-15, "{from} {to}");
    }
}
