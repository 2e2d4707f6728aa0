//! Rotation-minimising frames along a curve (Bishop, "There is more than one way to frame a curve", 1975), by two
//! reflections from one sample to the next (Wang, Jüttler, Zheng, Liu, "Computation of rotation minimizing frames",
//! 2008).

use nalgebra::{Unit, UnitQuaternion, Vector3};

use super::Sample;

/// Writes one axis per sample: a unit vector normal to the curve. The first is as near to `hint` as possible. Around a
/// closed curve such a frame returns rotated (its holonomy); that angle is spread evenly over the curve, so that there
/// is no seam.
pub fn transport(samples: &[Sample], closed: bool, hint: Option<Vector3<f64>>, axes: &mut Vec<Vector3<f64>>) {
    axes.clear();
    let (Some(first), Some(last)) = (samples.first(), samples.last()) else { return };
    let start =
        hint.and_then(|hint| across(hint, first.tangent)).unwrap_or_else(|| any_across(first.tangent));
    axes.push(start);
    for pair in samples.windows(2) {
        let axis = axes[axes.len() - 1];
        axes.push(carried(axis, &pair[0], &pair[1]));
    }
    let length = last.arc + (first.position - last.position).norm();
    if closed && length > 0.0 {
        let back = carried(axes[axes.len() - 1], last, first);
        let turn = first.tangent.dot(&back.cross(&start)).atan2(back.dot(&start));
        for (axis, sample) in axes.iter_mut().zip(samples) {
            let rotation = UnitQuaternion::from_axis_angle(
                &Unit::new_unchecked(sample.tangent),
                turn * sample.arc / length,
            );
            *axis = rotation * *axis;
        }
    }
}

/// An axis transported from one sample to the next.
fn carried(axis: Vector3<f64>, from: &Sample, to: &Sample) -> Vector3<f64> {
    let reflected = |v: Vector3<f64>, across: &Vector3<f64>| {
        let square = across.norm_squared();
        if square > 1e-24 { v - across * (2.0 * across.dot(&v) / square) } else { v }
    };
    let step = (to.position - from.position).try_normalize(0.0).unwrap_or(from.tangent);
    let (axis_left, tangent_left) = (reflected(axis, &step), reflected(from.tangent, &step));
    let carried = reflected(axis_left, &(to.tangent - tangent_left));
    // Made exactly normal again after rounding.
    across(carried, to.tangent).unwrap_or_else(|| any_across(to.tangent))
}

/// The component of a vector normal to a tangent, as a unit vector.
fn across(v: Vector3<f64>, tangent: Vector3<f64>) -> Option<Vector3<f64>> {
    (v - tangent * tangent.dot(&v)).try_normalize(1e-6)
}

fn any_across(tangent: Vector3<f64>) -> Vector3<f64> {
    let least = tangent.abs().imin();
    across(Vector3::ith(least, 1.0), tangent).unwrap_or_else(Vector3::x)
}

#[cfg(test)]
mod tests {
    use nalgebra::Point3;

    use super::super::Curve;
    use super::*;

    fn along(points: usize, closed: bool, at: impl Fn(f64) -> [f64; 3]) -> (Curve, Vec<Vector3<f64>>) {
        let last = if closed { points } else { points - 1 };
        let points: Vec<Point3<f64>> =
            (0..points).map(|k| Point3::from(at(k as f64 / last as f64))).collect();
        let mut curve = Curve::default();
        curve.trace(&points, closed, 0.1);
        let mut axes = Vec::new();
        transport(curve.samples(), closed, None, &mut axes);
        (curve, axes)
    }

    #[test]
    fn axes_are_unit_vectors_across_the_curve() {
        let helix = |t: f64| [(9.0 * t).cos(), (9.0 * t).sin(), 2.0 * t];
        let (curve, axes) = along(40, false, helix);
        assert_eq!(axes.len(), curve.samples().len());
        for (axis, sample) in axes.iter().zip(curve.samples()) {
            assert!((axis.norm() - 1.0).abs() < 1e-12 && axis.dot(&sample.tangent).abs() < 1e-12);
        }
    }

    #[test]
    fn a_frame_turns_with_the_curve_and_not_about_it() {
        // For a planar curve the binormal axis is constant, and an axis keeps its angle to the plane.
        let wave = |t: f64| [4.0 * t, (12.0 * t).sin(), 0.0];
        let (_, axes) = along(60, false, wave);
        for pair in axes.windows(2) {
            assert!((pair[0].z - pair[1].z).abs() < 1e-9, "{pair:?}");
        }
        // On a helix the frame turns back against the curve's torsion: by −τ per length, with τ = b/(a² + b²).
        let (a, b) = (1.0f64, 0.5f64);
        let helix = |t: f64| [a * (6.0 * t).cos(), a * (6.0 * t).sin(), b * 6.0 * t];
        let (curve, axes) = along(200, false, helix);
        let angle = |k: usize| {
            let s = curve.samples()[k];
            let inward = -Vector3::new(s.position.x, s.position.y, 0.0).normalize();
            let binormal = s.tangent.cross(&inward);
            axes[k].dot(&binormal).atan2(axes[k].dot(&inward))
        };
        let middle = curve.samples().len() / 2;
        let (from, to) = (middle - 10, middle + 10);
        let turned = (angle(to) - angle(from)).sin().asin();
        let arc = curve.samples()[to].arc - curve.samples()[from].arc;
        let torsion = b / (a * a + b * b);
        assert!((turned + torsion * arc).abs() < 0.05 * torsion * arc, "{turned} over {arc}");
    }

    #[test]
    fn around_a_knot_the_frame_closes_without_a_seam() {
        let trefoil = |t: f64| {
            let a = std::f64::consts::TAU * t;
            [a.sin() + 2.0 * (2.0 * a).sin(), a.cos() - 2.0 * (2.0 * a).cos(), -(3.0 * a).sin()]
        };
        let (curve, axes) = along(48, true, trefoil);
        let samples = curve.samples();
        let twist = |from: usize, to: usize| {
            let back = carried(axes[from], &samples[from], &samples[to]);
            samples[to].tangent.dot(&back.cross(&axes[to])).atan2(back.dot(&axes[to]))
        };
        let steps: Vec<f64> = (0..axes.len()).map(|k| twist(k, (k + 1) % axes.len())).collect();
        let largest = steps.iter().fold(0.0f64, |m, x| m.max(x.abs()));
        assert!(largest < 0.05, "{largest}");
        // Evenly spread: the step at the seam is in proportion to its length.
        let per_length = steps[0] / (samples[1].arc - samples[0].arc);
        let gap = curve.length() - samples[samples.len() - 1].arc;
        assert!((steps[steps.len() - 1] - per_length * gap).abs() < 1e-6);
    }

    #[test]
    fn the_hint_is_followed_and_odd_input_gives_numbers() {
        let (curve, _) = along(5, false, |t| [t, 0.0, 0.0]);
        let mut axes = Vec::new();
        transport(curve.samples(), false, Some(Vector3::new(5.0, 1.0, 1.0)), &mut axes);
        assert!((axes[0] - Vector3::new(0.0, 1.0, 1.0).normalize()).norm() < 1e-12);
        transport(curve.samples(), false, Some(Vector3::x()), &mut axes);
        assert!(axes.iter().all(|axis| (axis.norm() - 1.0).abs() < 1e-9));
        let mut samples = curve.samples().to_vec();
        samples[2].tangent = -samples[1].tangent;
        samples[3].position = samples[2].position;
        for closed in [false, true] {
            transport(&samples, closed, None, &mut axes);
            assert!(axes.iter().all(|axis| (axis.norm() - 1.0).abs() < 1e-9));
        }
        transport(&[], true, None, &mut axes);
        assert!(axes.is_empty());
    }
}
