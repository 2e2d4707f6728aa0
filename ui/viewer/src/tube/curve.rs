//! A curve through points: the spline of Catmull and Rom ("A class of local interpolating splines", 1974) with
//! centripetal parameters, which neither loops nor overshoots between near points (Yuksel, Schaefer, Keyser,
//! "Parameterization and applications of Catmull–Rom curves", 2011), sampled more finely where it bends.

use nalgebra::{Point3, Vector3};

/// Most samples between two points.
const PIECES_MAX: usize = 48;

/// A point on the curve.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// Position \[m\].
    pub position: Point3<f64>,
    /// Unit vector along the curve.
    pub tangent: Vector3<f64>,
    /// Length of the polygon of samples up to here \[m\].
    pub arc: f64,
}

/// The samples of a curve. A closed one does not repeat the first.
#[derive(Clone, Debug, Default)]
pub struct Curve {
    samples: Vec<Sample>,
    length: f64,
}

impl Curve {
    /// Samples the curve through `points`, of which neighbours are distinct, so that it turns by about `turn` \[rad\]
    /// from one sample to the next. Fewer than two points give no curve.
    pub fn trace(&mut self, points: &[Point3<f64>], closed: bool, turn: f64) {
        self.samples.clear();
        self.length = 0.0;
        let count = points.len();
        if count < 2 {
            return;
        }
        let spans = if closed { count } else { count - 1 };
        for span in 0..spans {
            let hermite = Hermite::between(&around(points, closed, span));
            let pieces = hermite.pieces(turn);
            for piece in 0..pieces {
                self.push(hermite.at(piece as f64 / pieces as f64));
            }
            if !closed && span + 1 == spans {
                self.push(hermite.at(1.0));
            }
        }
        self.length = self.samples.last().map_or(0.0, |last| last.arc);
        if let (true, Some(first), Some(last)) = (closed, self.samples.first(), self.samples.last()) {
            self.length += (first.position - last.position).norm();
        }
    }

    fn push(&mut self, (position, direction): (Point3<f64>, Vector3<f64>)) {
        let last = self.samples.last();
        let arc = last.map_or(0.0, |last| last.arc + (position - last.position).norm());
        // A hairpin has no tangent at its tip: it keeps the previous one.
        let before = last.map_or_else(Vector3::x, |last| last.tangent);
        let tangent = direction.try_normalize(1e-12).unwrap_or(before);
        self.samples.push(Sample { position, tangent, arc });
    }

    /// The samples, in order.
    pub fn samples(&self) -> &[Sample] {
        &self.samples
    }

    /// Length of the polygon of all samples, including the closing segment of a closed curve \[m\].
    pub fn length(&self) -> f64 {
        self.length
    }
}

/// The four points that a span depends on. Beyond an end the line is continued straight.
fn around(points: &[Point3<f64>], closed: bool, span: usize) -> [Point3<f64>; 4] {
    let count = points.len();
    let (p1, p2) = (points[span], points[(span + 1) % count]);
    let p0 = match span {
        0 if closed => points[count - 1],
        0 => p1 + (p1 - p2),
        _ => points[span - 1],
    };
    let p3 = if closed || span + 2 < count { points[(span + 2) % count] } else { p2 + (p2 - p1) };
    [p0, p1, p2, p3]
}

/// One span: both ends, and the derivatives there by a parameter from 0 to 1.
struct Hermite {
    ends: [Point3<f64>; 2],
    slopes: [Vector3<f64>; 2],
}

impl Hermite {
    fn between([p0, p1, p2, p3]: &[Point3<f64>; 4]) -> Self {
        let knot = |a: &Point3<f64>, b: &Point3<f64>| (b - a).norm().sqrt();
        let own = knot(p1, p2);
        // Coincident points, which a loop of two makes, count as if they were as far apart as the span's.
        let apart = |d: f64| if d > 1e-9 * own { d } else { own };
        let (before, after) = (apart(knot(p0, p1)), apart(knot(p2, p3)));
        let slope = |a: &Point3<f64>, b: &Point3<f64>, c: &Point3<f64>, ab: f64, bc: f64| {
            ((b - a) / ab - (c - a) / (ab + bc) + (c - b) / bc) * own
        };
        Self { ends: [*p1, *p2], slopes: [slope(p0, p1, p2, before, own), slope(p1, p2, p3, own, after)] }
    }

    /// Number of pieces for the span: by the angles of its ends to its chord, and more where the curvature is uneven.
    fn pieces(&self, turn: f64) -> usize {
        let chord = self.ends[1] - self.ends[0];
        let angle = self.slopes[0].angle(&chord) + self.slopes[1].angle(&chord);
        let even = ((angle / turn).ceil() as usize).clamp(1, PIECES_MAX);
        let mut sharpest = 0.0f64;
        let mut before = self.at(0.0).1;
        for piece in 1..=even {
            let direction = self.at(piece as f64 / even as f64).1;
            sharpest = sharpest.max(before.angle(&direction));
            before = direction;
        }
        let finer = (sharpest / turn - 0.25).ceil().max(1.0);
        ((even as f64 * finer) as usize).min(PIECES_MAX)
    }

    fn at(&self, t: f64) -> (Point3<f64>, Vector3<f64>) {
        let [a, b] = self.ends.map(|p| p.coords);
        let [m, n] = self.slopes;
        let (t2, t3) = (t * t, t * t * t);
        let position = a * (2.0 * t3 - 3.0 * t2 + 1.0)
            + m * (t3 - 2.0 * t2 + t)
            + b * (3.0 * t2 - 2.0 * t3)
            + n * (t3 - t2);
        let direction =
            (a - b) * (6.0 * (t2 - t)) + m * (3.0 * t2 - 4.0 * t + 1.0) + n * (3.0 * t2 - 2.0 * t);
        // Relative to the chord, so that the test for a zero tangent does not depend on the scale.
        (Point3::from(position), direction / (b - a).norm().max(1e-300))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn circle(count: usize, radius: f64) -> Vec<Point3<f64>> {
        let angle = |k: usize| std::f64::consts::TAU * k as f64 / count as f64;
        (0..count).map(|k| Point3::new(radius * angle(k).cos(), radius * angle(k).sin(), 0.0)).collect()
    }

    #[test]
    fn a_curve_passes_through_its_points_and_turns_little_between_samples() {
        let points =
            [[0.0, 0.0, 0.0], [0.01, 0.0, 0.0], [0.02, 0.01, 0.0], [0.021, 0.011, 0.005], [0.0, 0.02, 0.03]];
        let points = points.map(Point3::from);
        let mut curve = Curve::default();
        curve.trace(&points, false, 0.1);
        for point in &points {
            assert!(curve.samples().iter().any(|s| (s.position - point).norm() < 1e-12), "{point}");
        }
        for pair in curve.samples().windows(2) {
            assert!(pair[0].tangent.angle(&pair[1].tangent) < 0.3);
            assert!(pair[1].arc > pair[0].arc);
            assert!((pair[0].tangent.norm() - 1.0).abs() < 1e-12);
        }
    }

    #[test]
    fn a_straight_thread_needs_no_more_samples_than_points() {
        let points: Vec<Point3<f64>> = [0.0, 1.0, 1.5, 4.0].map(|x| Point3::new(x, 0.0, 0.0)).to_vec();
        let mut curve = Curve::default();
        curve.trace(&points, false, 0.1);
        assert_eq!(curve.samples().len(), 4);
        assert_eq!(curve.length(), 4.0);
    }

    #[test]
    fn a_loop_of_a_few_points_is_nearly_a_circle() {
        let mut curve = Curve::default();
        curve.trace(&circle(8, 1.0), true, 0.05);
        for sample in curve.samples() {
            assert!((sample.position.coords.norm() - 1.0).abs() < 0.02, "{sample:?}");
            assert!(sample.tangent.dot(&sample.position.coords).abs() < 0.05);
        }
        assert!((curve.length() - std::f64::consts::TAU).abs() < 0.05, "{}", curve.length());
    }

    #[test]
    fn hairpins_and_tiny_curves_have_directions() {
        let mut curve = Curve::default();
        for scale in [1e-7, 1.0, 1e6] {
            let points = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0], [1.0, 0.0, 0.0]];
            curve.trace(&points.map(|p| Point3::from(p) * scale), false, 0.1);
            assert!(curve.samples().iter().all(|s| (s.tangent.norm() - 1.0).abs() < 1e-9));
        }
        curve.trace(&circle(2, 1.0), true, 0.1);
        assert!(curve.samples().iter().all(|s| s.position.coords.norm() < 3.0 && s.tangent.norm() > 0.99));
        curve.trace(&circle(1, 1.0), true, 0.1);
        assert!(curve.samples().is_empty());
    }
}
