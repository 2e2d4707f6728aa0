//! Nearest point of a segment to a point.

use nalgebra::Point3;

use super::Segment;

/// Parameter of the nearest point, 0 at the first end to 1 at the second; 0 for a segment of no length.
#[must_use]
pub fn closest_on_segment(point: &Point3<f64>, segment: &Segment) -> f64 {
    let along = segment[1] - segment[0];
    let length_squared = along.norm_squared();
    if length_squared > 0.0 {
        ((point - segment[0]).dot(&along) / length_squared).clamp(0.0, 1.0)
    } else {
        0.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ends_middle_and_nothing() {
        let segment = [Point3::origin(), Point3::new(2.0, 0.0, 0.0)];
        assert_eq!(closest_on_segment(&Point3::new(0.5, 1.0, 0.0), &segment), 0.25);
        assert_eq!(closest_on_segment(&Point3::new(-1.0, 1.0, 0.0), &segment), 0.0);
        assert_eq!(closest_on_segment(&Point3::new(9.0, 1.0, 3.0), &segment), 1.0);
        let none = [Point3::new(1.0, 1.0, 1.0); 2];
        assert_eq!(closest_on_segment(&Point3::origin(), &none), 0.0);
        assert!(closest_on_segment(&Point3::new(f64::NAN, 0.0, 0.0), &segment).is_nan());
    }
}
