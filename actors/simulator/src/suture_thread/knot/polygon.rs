//! The curve before projection: closing an open one, and removing corners without changing the knot.

use nalgebra::{Point3, Vector3};

use super::KnotError;

/// Distance at which the ends of an open curve are joined, in radii of the curve.
const FAR: f64 = 4.0;
/// Number of directions in which an open curve is closed.
const CLOSURES: usize = 25;

/// An open curve closed in a direction: both ends are extended that way, side by side, to four times the radius of the
/// curve, and joined. The extensions belong to the knot.
///
/// # Errors
/// Fewer than two points, non-finite coordinates, or a zero direction.
pub fn close_towards(
    points: &[Point3<f64>],
    direction: &Vector3<f64>,
) -> Result<Vec<Point3<f64>>, KnotError> {
    let (Some(first), Some(last)) = (points.first(), points.last()) else {
        return Err(KnotError::Points(points.len()));
    };
    if points.len() < 2 {
        return Err(KnotError::Points(points.len()));
    }
    if let Some(bad) = points.iter().position(|point| !point.iter().all(|x| x.is_finite())) {
        return Err(KnotError::NotFinite(bad));
    }
    let ends = (first.coords + last.coords) * 0.5;
    let away = direction.try_normalize(0.0).ok_or(KnotError::MeetsItself)?;
    let radius = points.iter().map(|point| (point.coords - ends).norm()).fold(0.0, f64::max) * FAR;
    let mut closed = points.to_vec();
    closed.extend([last + away * radius, first + away * radius]);
    Ok(closed)
}

/// Whether an open curve closed in direction `from` is the same knot as closed in direction `to`: neither extension of
/// its ends meets the curve while both turn from the one direction to the other.
pub(super) fn turns_freely(points: &[Point3<f64>], from: &Vector3<f64>, to: &Vector3<f64>) -> bool {
    let across = from.cross(to);
    // The edges at an end touch its extension at that end only.
    let free = |end: &Point3<f64>, rest: &[Point3<f64>]| {
        let mut before = across.dot(&(rest[0] - end));
        rest.windows(2).all(|edge| {
            let now = across.dot(&(edge[1] - end));
            let first = std::mem::replace(&mut before, now);
            if first * now > 0.0 {
                return true;
            }
            // Where the edge meets the plane in which the extension turns.
            let share = if first == now { 0.0 } else { first / (first - now) };
            let place = edge[0].lerp(&edge[1], share) - end;
            place.cross(to).dot(&across) < 0.0 || from.cross(&place).dot(&across) < 0.0
        })
    };
    match points {
        [first, rest @ .., last] if !rest.is_empty() => {
            free(first, &points[1..]) && free(last, &points[..=rest.len()])
        }
        _ => true,
    }
}

/// Directions in which an open curve is closed: even over the sphere (a spiral of equal areas), none of them along an
/// axis.
pub(super) fn directions() -> impl Iterator<Item = Vector3<f64>> {
    (0..CLOSURES).map(|k| {
        let height = 1.0 - (2.0 * k as f64 + 1.0) / CLOSURES as f64;
        let (around, across) = (2.399_963_229_728_653 * k as f64 + 0.3, (1.0 - height * height).sqrt());
        Vector3::new(across * around.cos(), across * around.sin(), height)
    })
}

/// The closed polygon without the corners whose triangle with their neighbours nothing passes through (Koniaris,
/// Muthukumar 1991; Taylor 2000); the knot stays the same.
#[must_use]
pub fn simplified(points: &[Point3<f64>]) -> Vec<Point3<f64>> {
    let mut points = points.to_vec();
    loop {
        let before = points.len();
        let mut i = 0;
        while points.len() > 3 && i < points.len() {
            if removable(&points, i) {
                points.remove(i);
            } else {
                i += 1;
            }
        }
        if points.len() == before || points.len() <= 3 {
            return points;
        }
    }
}

fn removable(points: &[Point3<f64>], i: usize) -> bool {
    let n = points.len();
    let triangle = [points[(i + n - 1) % n], points[i], points[(i + 1) % n]];
    let (low, high) = (
        triangle[0].coords.inf(&triangle[1].coords).inf(&triangle[2].coords),
        triangle[0].coords.sup(&triangle[1].coords).sup(&triangle[2].coords),
    );
    // On which sides of the triangle's box a point lies; an edge whose ends share a side is outside the box.
    let sides = |point: &Point3<f64>| -> u8 {
        (0..3).fold(0, |sides, axis| {
            sides << 2 | u8::from(point[axis] < low[axis]) << 1 | u8::from(point[axis] > high[axis])
        })
    };
    // Tests the edges without a vertex in common with the triangle; of the others, only one in its plane could pass
    // through it.
    let clear = |from: usize, to: usize| {
        let mut before = sides(&points[from]);
        points[from..=to].windows(2).all(|edge| {
            let now = sides(&edge[1]);
            let beside = std::mem::replace(&mut before, now) & now != 0;
            beside || !pierces(&edge[0], &edge[1], &triangle)
        })
    };
    if i == 0 || i + 1 == n {
        // The triangle's corners are at both ends of the list.
        return clear(2 - usize::from(i != 0), n - 2 - usize::from(i != 0));
    }
    let (last_before, first_after) = (i.checked_sub(2), i + 2);
    // The closing edge shares no vertex with the triangle unless it ends at one of its corners.
    let closing = i >= 2 && i + 2 < n;
    last_before.is_none_or(|last| clear(0, last))
        && (first_after >= n || clear(first_after, n - 1))
        && (!closing || !pierces(&points[n - 1], &points[0], &triangle))
}

/// Whether the segment intersects the triangle; touching counts.
fn pierces(a: &Point3<f64>, b: &Point3<f64>, triangle: &[Point3<f64>; 3]) -> bool {
    let volume = |p: &Point3<f64>, q: &Point3<f64>, r: &Point3<f64>, s: &Point3<f64>| {
        (q - p).cross(&(r - p)).dot(&(s - p))
    };
    let [p, q, r] = triangle;
    let (from, to) = (volume(p, q, r, a), volume(p, q, r, b));
    if from * to > 0.0 {
        return false;
    }
    let sides = [volume(a, b, p, q), volume(a, b, q, r), volume(a, b, r, p)];
    let slack = 1e-12 * sides.iter().fold(0.0_f64, |most, side| most.max(side.abs()));
    sides.iter().all(|&side| side >= -slack) || sides.iter().all(|&side| side <= slack)
}
