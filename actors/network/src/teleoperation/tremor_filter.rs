//! Tremor filter: a low pass on the master's pose, so that the shaking of a hand does not reach the slave.
//!
//! Physiological tremor lies at 8 to 12 Hz, what a surgeon means to do below 2 Hz (Riviere, Rader, Thakor, "Adaptive
//! canceling of physiological tremor for improved precision in microsurgery", 1998). Two equal first-order low passes in a
//! row, each by the backward Euler rule: stable for every step, without overshoot. The price is a delay of
//! [`TremorFilter::delay_secs`] of what is meant.

use nalgebra::{Isometry3, UnitQuaternion, Vector3};

/// Lowest and highest cut-off \[Hz\].
pub const CUTOFF_HZ: (f64, f64) = (0.5, 50.0);

/// A low pass of second order on a pose.
#[derive(Clone, Copy, Debug)]
pub struct TremorFilter {
    lag_secs: f64,
    // After the first and after the second low pass.
    stages: Option<[Isometry3<f64>; 2]>,
}

impl TremorFilter {
    /// A filter whose two low passes have this cut-off, within [`CUTOFF_HZ`].
    pub fn new(cutoff_hz: f64) -> Self {
        let cutoff_hz = cutoff_hz.max(CUTOFF_HZ.0).min(CUTOFF_HZ.1);
        Self { lag_secs: 1.0 / (2.0 * std::f64::consts::PI * cutoff_hz), stages: None }
    }

    /// How much later a slow motion comes out \[s\].
    pub fn delay_secs(&self) -> f64 {
        2.0 * self.lag_secs
    }

    /// One step of `step_secs`: the filtered pose. The first one passes as it is, and so does what comes after a pose that
    /// is no number.
    pub fn step(&mut self, pose: &Isometry3<f64>, step_secs: f64) -> Isometry3<f64> {
        let finite = pose.translation.vector.iter().chain(pose.rotation.coords.iter()).all(|x| x.is_finite());
        if !finite {
            self.stages = None;
            return *pose;
        }
        let [mut first, mut second] = self.stages.unwrap_or([*pose; 2]);
        let share = step_secs.max(0.0) / (self.lag_secs + step_secs.max(0.0));
        first = between(&first, pose, share);
        second = between(&second, &first, share);
        self.stages = Some([first, second]);
        second
    }
}

/// The pose at a share of the way from one to the other.
fn between(from: &Isometry3<f64>, to: &Isometry3<f64>, share: f64) -> Isometry3<f64> {
    let position: Vector3<f64> = from.translation.vector.lerp(&to.translation.vector, share);
    let (a, b) = (from.rotation.into_inner(), to.rotation.into_inner());
    let nearer = if a.dot(&b) < 0.0 { -b } else { b };
    // Between two poses of neighbouring steps the chord is the arc.
    let rotation = UnitQuaternion::new_normalize(a * (1.0 - share) + nearer * share);
    Isometry3::from_parts(position.into(), rotation)
}

#[cfg(test)]
mod tests {
    use super::*;

    const STEP: f64 = 1e-3;

    /// Share of a motion along x, and about x, at this frequency that passes.
    fn gain(cutoff_hz: f64, hz: f64) -> (f64, f64) {
        let mut filter = TremorFilter::new(cutoff_hz);
        let (mut moved, mut turned) = (0.0_f64, 0.0_f64);
        for step in 0..4_000 {
            let swing = (2.0 * std::f64::consts::PI * hz * step as f64 * STEP).sin();
            let pose = Isometry3::new(Vector3::x() * (1e-3 * swing), Vector3::x() * (0.01 * swing));
            let out = filter.step(&pose, STEP);
            if step >= 2_000 {
                moved = moved.max(out.translation.x.abs() / 1e-3);
                turned = turned.max(out.rotation.scaled_axis().x.abs() / 0.01);
            }
        }
        (moved, turned)
    }

    #[test]
    fn tremor_is_taken_out_and_what_is_meant_passes() {
        for (hz, range) in [(10.0, 0.05..0.09), (8.0, 0.08..0.13), (0.5, 0.95..1.0)] {
            let (moved, turned) = gain(2.5, hz);
            assert!(range.contains(&moved), "{hz} Hz: {moved}");
            assert!((turned - moved).abs() < 0.01, "{hz} Hz: {turned} of a turn, {moved} of a motion");
        }
        // A filter that is too wide lets it through.
        assert!(gain(50.0, 10.0).0 > 0.9);
    }

    #[test]
    fn a_slow_motion_comes_out_later_by_the_delay_and_a_step_without_overshoot() {
        let mut filter = TremorFilter::new(2.5);
        let mut out = Isometry3::identity();
        for step in 0..3_000 {
            out = filter.step(&Isometry3::translation(0.01 * step as f64 * STEP, 0.0, 0.0), STEP);
        }
        let behind = 0.01 * 2_999.0 * STEP - out.translation.x;
        assert!((behind / 0.01 - filter.delay_secs()).abs() < 1e-3, "{behind}");
        assert!((filter.delay_secs() - 0.127).abs() < 0.001);
        let mut filter = TremorFilter::new(2.5);
        filter.step(&Isometry3::identity(), STEP);
        let mut before = 0.0;
        for _ in 0..2_000 {
            let x = filter.step(&Isometry3::translation(0.02, 0.0, 0.0), STEP).translation.x;
            assert!(x >= before && x <= 0.02);
            before = x;
        }
        assert!(before > 0.0199);
    }

    #[test]
    fn after_nonsense_it_begins_again_where_the_hand_is() {
        let mut filter = TremorFilter::new(2.5);
        filter.step(&Isometry3::translation(0.01, 0.0, 0.0), STEP);
        filter.step(&Isometry3::translation(f64::NAN, 0.0, 0.0), STEP);
        let out = filter.step(&Isometry3::translation(0.05, 0.0, 0.0), STEP);
        assert_eq!(out.translation.x, 0.05);
    }
}
