//! The curve before it is projected: closed where it was open, and with as few corners as its knot allows.

use nalgebra::{Point3, Vector3};

use super::KnotError;

/// How far out the ends of an open curve are joined, in radii of the curve.
const FAR: f64 = 4.0;
/// Directions that an open curve is closed towards.
const CLOSURES: usize = 25;

/// An open curve closed towards a direction: both ends are led there, side by side, to four times the radius of the
/// curve, and joined. What the curve does between its ends and there counts as part of the knot.
///
/// # Errors
/// Fewer than two points, numbers that are not finite, or no direction.
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

/// Directions that an open curve is closed towards, evenly over the sphere (a spiral of equal areas), none of them along
/// an axis.
pub(super) fn directions() -> impl Iterator<Item = Vector3<f64>> {
    (0..CLOSURES).map(|k| {
        let height = 1.0 - (2.0 * k as f64 + 1.0) / CLOSURES as f64;
        let (around, across) = (2.399_963_229_728_653 * k as f64 + 0.3, (1.0 - height * height).sqrt());
        Vector3::new(across * around.cos(), across * around.sin(), height)
    })
}

/// The closed polygon with corners taken out whose triangle with their neighbours nothing passes through, until none is
/// left (Koniaris, Muthukumar 1991; Taylor 2000): the knot stays the same.
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
    // Edges that do not end in a corner of the triangle; of those that do, only one in its plane could pass through it.
    (2..n - 2).all(|k| {
        let (a, b) = (points[(i + k) % n], points[(i + k + 1) % n]);
        let beside = (0..3).any(|axis| {
            (a[axis] < low[axis] && b[axis] < low[axis]) || (a[axis] > high[axis] && b[axis] > high[axis])
        });
        beside || !pierces(&a, &b, &triangle)
    })
}

/// Whether the segment passes through the triangle; touching counts.
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
