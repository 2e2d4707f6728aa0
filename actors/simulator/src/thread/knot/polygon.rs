//! The curve before it is projected: closed where it was open, and with as few corners as its knot allows.

use nalgebra::{Point3, Vector3};

use super::KnotError;

/// How far out the ends of an open curve are joined, in radii of the curve.
const FAR: f64 = 4.0;

/// An open curve closed: both ends are led away from the middle of the curve's length, side by side, to four times its
/// radius, and joined there. Of a thread tied around something that is how its ears are held up.
///
/// # Errors
/// Fewer than two points, or numbers that are not finite.
pub fn close(points: &[Point3<f64>]) -> Result<Vec<Point3<f64>>, KnotError> {
    let (Some(first), Some(last)) = (points.first(), points.last()) else {
        return Err(KnotError::Points(points.len()));
    };
    if points.len() < 2 {
        return Err(KnotError::Points(points.len()));
    }
    if let Some(bad) = points.iter().position(|point| !point.iter().all(|x| x.is_finite())) {
        return Err(KnotError::NotFinite(bad));
    }
    let lengths: Vec<_> = points.windows(2).map(|pair| (pair[1] - pair[0]).norm()).collect();
    let half = 0.5 * lengths.iter().sum::<f64>();
    let mut passed = 0.0;
    let middle = lengths.iter().position(|length| {
        passed += length;
        passed >= half
    });
    let middle = points[middle.unwrap_or(0)];
    let ends = (first.coords + last.coords) * 0.5;
    let away = (ends - middle.coords).try_normalize(0.0).unwrap_or_else(Vector3::z);
    let radius = points.iter().map(|point| (point.coords - ends).norm()).fold(0.0, f64::max) * FAR;
    let mut closed = points.to_vec();
    closed.extend([last + away * radius, first + away * radius]);
    Ok(closed)
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
