//! Force limit of a slave: what pushes it harder than allowed pushes it back.
//!
//! A robot whose motors are limited gives way. Here the slave gives way at a speed that grows with the force beyond the
//! limit, and comes back where it has to be as the force allows (admittance control; Hogan, "Impedance control", 1985):
//! whoever presses on meets a force of the limit, and a little more while the hand still moves.

use nalgebra::Vector3;

/// Speed per force beyond the limit [m/s per N]. With a force that is two milliseconds old this is stable on anything
/// softer than 5 kN/m.
pub const MOBILITY: f64 = 0.05;
/// How far the slave gives way at most \[m\].
pub const GIVES_WAY_MAX: f64 = 0.2;

/// How far a slave has given way.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ForceLimit {
    given_way: Vector3<f64>,
}

impl ForceLimit {
    /// One step under a force on the slave \[N\], along the axes of its device: where it is from where it has to be \[m\].
    /// A force that is no number counts as none.
    pub fn step(&mut self, force: &Vector3<f64>, force_max: f64, step_secs: f64) -> Vector3<f64> {
        let size = force.norm();
        if size.is_finite() && size > force_max {
            let way = (MOBILITY * (size - force_max) * step_secs).min(GIVES_WAY_MAX);
            self.given_way += force * (way / size);
        } else {
            let spare = if size.is_finite() { force_max - size } else { force_max };
            let back = MOBILITY * spare * step_secs;
            let left = self.given_way.norm();
            self.given_way *= if left > back { 1.0 - back / left } else { 0.0 };
        }
        let far = self.given_way.norm();
        if far > GIVES_WAY_MAX {
            self.given_way *= GIVES_WAY_MAX / far;
        }
        self.given_way
    }

    /// Whether it holds the slave back.
    pub fn is_acting(&self) -> bool {
        self.given_way != Vector3::zeros()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const STEP: f64 = 1e-3;

    /// A slave led 30 mm into a wall of this stiffness at 0.1 m/s, held there, and led out. The wall tells its force two
    /// steps later. Returns the largest force, the force at the end of the rest, and where the slave is at the end.
    fn press(stiffness: f64, force_max: f64) -> (f64, f64, f64) {
        let mut limit = ForceLimit::default();
        let mut told = [Vector3::zeros(); 2];
        let (mut largest, mut rest, mut place) = (0.0_f64, 0.0, 0.0);
        for step in 0..2_600 {
            let wanted = match step {
                0..300 => -1e-4 * step as f64,
                300..2_000 => -0.030,
                _ => -0.030 + 1e-4 * (step - 2_000) as f64,
            };
            let given = limit.step(&told[0], force_max, STEP);
            place = wanted + given.x;
            let force = (stiffness * -place).max(0.0);
            told = [told[1], Vector3::x() * force];
            largest = largest.max(force);
            if step == 1_999 {
                rest = force;
            }
        }
        (largest, rest, place)
    }

    #[test]
    fn who_presses_on_meets_the_limit_and_the_slave_comes_back() {
        for stiffness in [100.0, 1_000.0, 5_000.0] {
            let (largest, rest, place) = press(stiffness, 2.0);
            assert!((rest - 2.0).abs() < 0.05, "{stiffness} N/m: {rest} N at rest");
            // 0.1 m/s over the mobility, and what two steps bring.
            assert!(largest < 2.0 + 2.0 + stiffness * 0.1 * 3.0 * STEP, "{stiffness} N/m: {largest} N");
            assert!((place - 0.0299).abs() < 1e-6, "{stiffness} N/m: it ends at {place}");
        }
        // Without a limit the wall would push with 30 N.
        assert!((press(1_000.0, 1e3).0 - 30.0).abs() < 0.2);
    }

    #[test]
    fn a_force_that_is_no_number_and_one_without_end_are_bounded() {
        let mut limit = ForceLimit::default();
        assert_eq!(limit.step(&Vector3::new(f64::NAN, 0.0, 0.0), 2.0, STEP), Vector3::zeros());
        for _ in 0..100_000 {
            assert!(limit.step(&Vector3::new(1e100, 0.0, 0.0), 2.0, STEP).norm() <= GIVES_WAY_MAX + 1e-12);
        }
        assert!(limit.is_acting());
    }
}
