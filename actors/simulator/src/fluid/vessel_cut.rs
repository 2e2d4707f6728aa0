//! Cutting and burning of vessels: blades that cross a vessel's centre line, and tissue near it.

use nalgebra::{Point3, Vector3};
use trocar_dynamics::tet_mesh::Sweep;

/// Where along a line \[m from its first point\] a swept edge crosses it first; `None` if it does not.
#[must_use]
pub fn first_crossing(line: &[Point3<f64>], sweep: &Sweep) -> Option<f64> {
    let ([a, b], [c, d]) = (sweep.before, sweep.after);
    let mut behind = 0.0;
    for ends in line.windows(2) {
        let run = (ends[1] - ends[0]).norm();
        let shares = [[a, b, d], [a, d, c]].map(|triangle| crossing([ends[0], ends[1]], triangle));
        if let Some(share) = shares.into_iter().flatten().reduce(f64::min) {
            return Some(behind + share * run);
        }
        behind += run;
    }
    None
}

/// Fraction of a segment at which it intersects a triangle (Möller and Trumbore, *Fast, minimum storage ray/triangle
/// intersection*, 1997).
fn crossing([from, to]: [Point3<f64>; 2], [a, b, c]: [Point3<f64>; 3]) -> Option<f64> {
    let (run, ab, ac) = (to - from, b - a, c - a);
    let across = run.cross(&ac);
    let determinant = ab.dot(&across);
    if determinant.abs() <= 1e-12 * run.norm() * ab.norm() * ac.norm() {
        return None;
    }
    let away: Vector3<f64> = (from - a) / determinant;
    let u = away.dot(&across);
    let beside = away.cross(&ab);
    let (v, share) = (run.dot(&beside), ac.dot(&beside));
    (u >= 0.0 && v >= 0.0 && u + v <= 1.0 && (0.0..=1.0).contains(&share)).then_some(share)
}

/// Distance of a point from a line, and position of the closest point along it, from its first point \[m\].
#[must_use]
pub fn nearest_on_line(line: &[Point3<f64>], point: &Point3<f64>) -> (f64, f64) {
    let (mut nearest, mut behind) = ((f64::INFINITY, 0.0), 0.0);
    for ends in line.windows(2) {
        let run = ends[1] - ends[0];
        let size = run.norm();
        let share = ((point - ends[0]).dot(&run) / (size * size).max(1e-300)).clamp(0.0, 1.0);
        let distance = (ends[0] + run * share - point).norm();
        if distance < nearest.0 {
            nearest = (distance, behind + share * size);
        }
        behind += size;
    }
    nearest
}

/// Centre of a triangle or a tetrahedron, and its area, or the cross-section of the ball of its volume \[m²\].
#[must_use]
pub fn middle_and_section(corners: &[Point3<f64>]) -> Option<(Point3<f64>, f64)> {
    let [a, b, c, rest @ ..] = corners else { return None };
    let sum = corners.iter().fold(Vector3::zeros(), |sum, corner| sum + corner.coords);
    let middle = Point3::from(sum / corners.len() as f64);
    let area = match rest.first() {
        None => 0.5 * (b - a).cross(&(c - a)).norm(),
        Some(d) => {
            let volume = (b - a).cross(&(c - a)).dot(&(d - a)).abs() / 6.0;
            std::f64::consts::PI * (0.75 * volume / std::f64::consts::PI).powf(2.0 / 3.0)
        }
    };
    Some((middle, area))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_blade_that_sweeps_through_a_line_cuts_it_where_it_does() {
        let line: Vec<Point3<f64>> = (0..5).map(|k| Point3::new(f64::from(k) * 0.01, 0.0, 0.0)).collect();
        let edge = |x: f64, y: f64| [Point3::new(x, y, 0.02), Point3::new(x, y, -0.01)];
        let sweep = Sweep { before: edge(0.023, -0.01), after: edge(0.027, 0.01) };
        let at = first_crossing(&line, &sweep).expect("it is cut");
        assert!((at - 0.025).abs() < 1e-12, "{at}");
        let beside = Sweep { before: edge(0.053, -0.01), after: edge(0.057, 0.01) };
        assert_eq!(first_crossing(&line, &beside), None);
        let short = Sweep { before: edge(0.023, -0.01), after: edge(0.023, -0.001) };
        assert_eq!(first_crossing(&line, &short), None, "not far enough");
        let still = Sweep { before: edge(0.023, 0.0), after: edge(0.023, 0.0) };
        assert_eq!(first_crossing(&line, &still), None);
    }

    #[test]
    fn what_is_beside_a_line_is_as_far_as_it_is() {
        let line = [Point3::origin(), Point3::new(0.03, 0.0, 0.0), Point3::new(0.03, 0.04, 0.0)];
        let (distance, at) = nearest_on_line(&line, &Point3::new(0.01, -0.002, 0.0));
        assert!((distance - 0.002).abs() < 1e-15 && (at - 0.01).abs() < 1e-15);
        let (distance, at) = nearest_on_line(&line, &Point3::new(0.03, 0.05, 0.0));
        assert!((distance - 0.01).abs() < 1e-15 && (at - 0.07).abs() < 1e-14);
        let corners = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]].map(Point3::from);
        let (_, area) = middle_and_section(&corners[..3]).expect("a triangle");
        assert_eq!(area, 0.5);
        let (middle, area) = middle_and_section(&corners).expect("a tetrahedron");
        let ball = (0.75 / 6.0 / std::f64::consts::PI).powf(1.0 / 3.0);
        assert!((area - std::f64::consts::PI * ball * ball).abs() < 1e-12 && middle.x == 0.25);
        assert!(middle_and_section(&corners[..2]).is_none());
    }
}
