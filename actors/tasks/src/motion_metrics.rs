//! Motion metrics of laparoscopic skill assessment, streaming and in bounded memory.
//!
//! Time, path length, depth and mean speed follow Cotin et al. 2002, "Metrics for laparoscopic skills trainers: the
//! weakest link!" (depth = distance travelled along the instrument's own axis); smoothness is the log dimensionless
//! jerk of Balasubramanian et al. 2012, "A robust and sensitive metric for quantifying movement smoothness":
//! `LDLJ = −ln(T³ / v²_peak · ∫ |jerk|² dt)`. The mean jerk is omitted on purpose: it does not discriminate skills.

use std::collections::BTreeMap;

use nalgebra::{Point3, Vector3};
use serde::{Deserialize, Serialize};

/// Below this speed a hand counts as idle by default \[m/s\].
pub const IDLE_SPEED_DEFAULT: f64 = 0.005;

/// Samples that a third divided difference spans.
const STENCIL: usize = 4;

/// Running sums about the motion of one instrument's tip.
///
/// Feed it with [`MotionMetrics::sample`] at the task's own rate; missed samples are allowed, because every
/// derivative is a divided difference over the true sample times. Everything is plain data, so that a
/// controller can keep it in the scene and continue after a restart.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct MotionMetrics {
    /// The last samples, oldest first: time \[s\] and tip position in world \[m\].
    recent: Vec<(f64, Point3<f64>)>,
    /// Time of the first sample \[s\].
    first_secs: Option<f64>,
    /// Start of the current stretch \[m\].
    stretch_from: Option<Point3<f64>>,
    /// Sum of the straight lines of the finished stretches \[m\].
    straight: f64,
    path: f64,
    depth: f64,
    idle_secs: f64,
    speed_peak: f64,
    /// ∫|jerk|² dt up to the middle of the last stencil \[m²/s⁵\].
    jerk_integral: f64,
    /// |jerk|² of the last stencil \[m²/s⁶\] and the time at the end that it does not cover yet \[s\].
    jerk_tail: (f64, f64),
}

impl MotionMetrics {
    /// Takes in the tip's position in world \[m\] at `secs` \[s\]; `shaft_in_world` is the unit direction of the
    /// shaft, `idle_speed` the speed below which the hand rests \[m/s\].
    ///
    /// A sample that is not later than the one before, or that is not finite, is ignored.
    pub fn sample(
        &mut self,
        secs: f64,
        tip_in_world: Point3<f64>,
        shaft_in_world: Vector3<f64>,
        idle_speed: f64,
    ) {
        if !secs.is_finite() || !tip_in_world.iter().chain(shaft_in_world.iter()).all(|v| v.is_finite()) {
            return;
        }
        let Some(&(last_secs, last)) = self.recent.last() else {
            self.first_secs = Some(secs);
            self.stretch_from = Some(tip_in_world);
            self.recent.push((secs, tip_in_world));
            return;
        };
        let dt = secs - last_secs;
        if dt <= 0.0 {
            return;
        }
        let step = tip_in_world - last;
        let speed = step.norm() / dt;
        self.path += step.norm();
        self.depth += step.dot(&shaft_in_world).abs();
        self.speed_peak = self.speed_peak.max(speed);
        if speed < idle_speed {
            self.idle_secs += dt;
        }
        if self.recent.len() == STENCIL {
            self.recent.remove(0);
        }
        self.recent.push((secs, tip_in_world));
        self.add_jerk();
    }

    /// Ends a stretch of the movement (a ring was lifted, handed over, placed): the economy of motion
    /// compares the path with the straight lines between these marks.
    pub fn mark(&mut self) {
        if let (Some(from), Some(&(_, here))) = (self.stretch_from, self.recent.last()) {
            self.straight += (here - from).norm();
            self.stretch_from = Some(here);
        }
    }

    /// Adds the last stencil's |jerk|², which stands for the time around the stencil's middle. The first and
    /// the last stencil also stand for the ends of the record that no stencil is centred on.
    fn add_jerk(&mut self) {
        let [(t0, x0), (t1, x1), (t2, x2), (t3, x3)] = self.recent[..] else { return };
        let d01 = (x1 - x0) / (t1 - t0);
        let d12 = (x2 - x1) / (t2 - t1);
        let d23 = (x3 - x2) / (t3 - t2);
        let d012 = (d12 - d01) / (t2 - t0);
        let d123 = (d23 - d12) / (t3 - t1);
        let jerk = 6.0 * (d123 - d012) / (t3 - t0);
        let squared = jerk.norm_squared();
        let middle = 0.25 * (t0 + t1 + t2 + t3);
        let first = self.jerk_tail.1 == 0.0;
        let since = if first {
            // From the first sample to this middle.
            middle - t0
        } else {
            middle - (t2 - self.jerk_tail.1)
        };
        // Trapezoid between the middles of two stencils, rectangle at the start.
        let before = if first { squared } else { self.jerk_tail.0 };
        self.jerk_integral += 0.5 * (before + squared) * since;
        self.jerk_tail = (squared, t3 - middle);
    }

    /// Time between the first and the last sample \[s\].
    pub fn secs(&self) -> f64 {
        match (self.first_secs, self.recent.last()) {
            (Some(first), Some((last, _))) => last - first,
            _ => 0.0,
        }
    }
    /// Length of the tip's path \[m\].
    pub fn path_length(&self) -> f64 {
        self.path
    }
    /// Straight lines between marks divided by the path, in \[0, 1\]; `None` before anything moved.
    pub fn economy(&self) -> Option<f64> {
        let open = match (self.stretch_from, self.recent.last()) {
            (Some(from), Some((_, here))) => (here - from).norm(),
            _ => 0.0,
        };
        (self.path > 0.0).then(|| ((self.straight + open) / self.path).min(1.0))
    }
    /// Time below the idle speed \[s\].
    pub fn idle_secs(&self) -> f64 {
        self.idle_secs
    }
    /// Distance travelled along the shaft, both ways added \[m\].
    pub fn depth(&self) -> f64 {
        self.depth
    }
    /// Path length divided by time \[m/s\]; 0 before two samples.
    pub fn mean_speed(&self) -> f64 {
        let secs = self.secs();
        if secs > 0.0 { self.path / secs } else { 0.0 }
    }
    /// Log dimensionless jerk (the smoother, the closer to 0 from below); `None` before four samples or
    /// without motion.
    pub fn ldlj(&self) -> Option<f64> {
        let integral = self.jerk_integral + self.jerk_tail.0 * self.jerk_tail.1;
        let dimensionless = self.secs().powi(3) / self.speed_peak.powi(2) * integral;
        (self.jerk_tail.1 > 0.0 && self.speed_peak > 0.0 && dimensionless > 0.0).then(|| -dimensionless.ln())
    }

    /// The metrics by name; units are part of the names. Those that are not defined yet are absent.
    pub fn named(&self) -> BTreeMap<String, f64> {
        let mut named = BTreeMap::new();
        let mut put = |name: &str, value: f64| named.insert(name.to_string(), value);
        put("time_secs", self.secs());
        put("path_length_m", self.path_length());
        put("idle_secs", self.idle_secs());
        put("depth_m", self.depth());
        put("mean_speed_m_per_s", self.mean_speed());
        if let Some(economy) = self.economy() {
            put("economy", economy);
        }
        if let Some(ldlj) = self.ldlj() {
            put("smoothness_ldlj", ldlj);
        }
        named
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const DOWN: Vector3<f64> = Vector3::new(0.0, 0.0, -1.0);

    /// Samples `path` over \[0, `secs`\] at `rate`, the end included.
    fn fed(secs: f64, rate: f64, path: impl Fn(f64) -> Point3<f64>) -> MotionMetrics {
        let mut metrics = MotionMetrics::default();
        let steps = (secs * rate).round() as usize;
        for i in 0..=steps {
            let t = i as f64 / rate;
            metrics.sample(t, path(t), DOWN, IDLE_SPEED_DEFAULT);
        }
        metrics
    }

    fn minimum_jerk(tau: f64) -> f64 {
        tau.powi(3) * (10.0 - 15.0 * tau + 6.0 * tau * tau)
    }

    #[test]
    fn a_minimum_jerk_reach_has_the_known_smoothness() {
        // ∫ jerk² = 720 D²/T⁵ and v_peak = 15/8 D/T, so LDLJ = −ln(204.8), whatever D and T.
        let exact = -(720.0f64 / (1.875 * 1.875)).ln();
        assert!((exact + 5.322).abs() < 5e-4);
        for (distance, secs) in [(0.1, 1.0), (0.02, 0.4), (0.5, 3.0)] {
            let fine = fed(secs, 2000.0 / secs, |t| Point3::new(distance * minimum_jerk(t / secs), 0.0, 0.0));
            assert!((fine.ldlj().unwrap() - exact).abs() < 1e-4, "{}", fine.ldlj().unwrap() - exact);
            let coarse =
                fed(secs, 100.0 / secs, |t| Point3::new(distance * minimum_jerk(t / secs), 0.0, 0.0));
            assert!((coarse.ldlj().unwrap() - exact).abs() < 0.03, "{}", coarse.ldlj().unwrap() - exact);
        }
    }

    #[test]
    fn a_cubic_has_its_exact_jerk_at_any_sample_times() {
        // x = t³: jerk 6, ∫ over [0, 1] = 36, v_peak from the last difference.
        let mut metrics = MotionMetrics::default();
        let times = [0.0, 0.1, 0.13, 0.4, 0.41, 0.7, 0.99, 1.0];
        for t in times {
            metrics.sample(t, Point3::new(t.powi(3), 0.0, 0.0), DOWN, 0.0);
        }
        let peak = (1.0 - 0.99f64.powi(3)) / 0.01;
        let expected = -(36.0 / (peak * peak)).ln();
        assert!((metrics.ldlj().unwrap() - expected).abs() < 1e-6);
    }

    #[test]
    fn a_circle_has_the_closed_form_path_and_economy() {
        let (radius, secs) = (0.03, 2.0);
        let half = fed(secs, 1000.0, |t| {
            let angle = std::f64::consts::PI * t / secs;
            Point3::new(radius * angle.cos(), radius * angle.sin(), 0.0)
        });
        let length = std::f64::consts::PI * radius;
        assert!((half.path_length() - length).abs() < 1e-6);
        assert!((half.economy().unwrap() - 2.0 / std::f64::consts::PI).abs() < 1e-5);
        assert!((half.mean_speed() - length / secs).abs() < 1e-6);
        assert!((half.secs() - secs).abs() < 1e-12);
        assert_eq!(half.depth(), 0.0);
        assert_eq!(half.idle_secs(), 0.0);
    }

    #[test]
    fn marks_split_a_return_trip_into_straight_stretches() {
        let there_and_back = |t: f64| Point3::new(if t < 1.0 { t } else { 2.0 - t }, 0.0, 0.0) * 0.1;
        let unmarked = fed(2.0, 100.0, there_and_back);
        assert!(unmarked.economy().unwrap() < 1e-9);
        let mut marked = MotionMetrics::default();
        for i in 0..=200 {
            let t = f64::from(i) / 100.0;
            marked.sample(t, there_and_back(t), DOWN, IDLE_SPEED_DEFAULT);
            if i == 100 {
                marked.mark();
            }
        }
        assert!((marked.economy().unwrap() - 1.0).abs() < 1e-9);
    }

    #[test]
    fn depth_counts_both_ways_along_the_shaft_and_idle_counts_rest() {
        // 1 s down at 50 mm/s, 1 s rest, 1 s up and sideways.
        let metrics = fed(3.0, 200.0, |t| {
            let down = 0.05 * t.min(1.0);
            let up = 0.05 * (t - 2.0).max(0.0);
            Point3::new(up, 0.0, up - down)
        });
        assert!((metrics.depth() - 0.1).abs() < 1e-9);
        assert!((metrics.idle_secs() - 1.0).abs() < 0.011);
        assert!((metrics.path_length() - 0.05 * (1.0 + 2f64.sqrt())).abs() < 1e-9);
    }

    #[test]
    fn tremor_is_less_smooth_and_less_economical() {
        let reach = |t: f64| Point3::new(0.1 * minimum_jerk(t), 0.0, 0.0);
        let shaking =
            |t: f64| reach(t) + Vector3::new(0.0, 3e-4 * (2.0 * std::f64::consts::PI * 9.0 * t).sin(), 0.0);
        let (calm, shaky) = (fed(1.0, 100.0, reach), fed(1.0, 100.0, shaking));
        assert!(shaky.ldlj().unwrap() < calm.ldlj().unwrap() - 1.0);
        assert!(shaky.economy().unwrap() < calm.economy().unwrap());
    }

    #[test]
    fn nothing_is_defined_before_it_can_be() {
        let mut metrics = MotionMetrics::default();
        assert_eq!((metrics.ldlj(), metrics.economy(), metrics.mean_speed()), (None, None, 0.0));
        metrics.sample(0.0, Point3::origin(), DOWN, 0.01);
        metrics.sample(0.0, Point3::new(1.0, 0.0, 0.0), DOWN, 0.01);
        metrics.sample(-1.0, Point3::new(1.0, 0.0, 0.0), DOWN, 0.01);
        metrics.sample(1.0, Point3::new(f64::NAN, 0.0, 0.0), DOWN, 0.01);
        assert_eq!((metrics.path_length(), metrics.secs()), (0.0, 0.0));
        assert!(!metrics.named().contains_key("economy"));
    }

    proptest! {
        #[test]
        fn interrupting_and_resuming_changes_nothing(
            seed in 0u64..1000, cut in 1usize..60,
        ) {
            let at = |i: usize| {
                let t = i as f64 * 0.01;
                let phase = seed as f64;
                Point3::new((t * 3.0 + phase).sin(), (t * 5.0).cos(), t * 0.1) * 0.05
            };
            let mut whole = MotionMetrics::default();
            let mut first = MotionMetrics::default();
            for i in 0..80 {
                whole.sample(i as f64 * 0.01, at(i), DOWN, 0.01);
                if i < cut { first.sample(i as f64 * 0.01, at(i), DOWN, 0.01); }
            }
            let bytes = postcard::to_stdvec(&first).unwrap();
            let mut second: MotionMetrics = postcard::from_bytes(&bytes).unwrap();
            for i in cut..80 { second.sample(i as f64 * 0.01, at(i), DOWN, 0.01); }
            prop_assert_eq!(&whole, &second);
            let economy = whole.economy().unwrap();
            prop_assert!((0.0..=1.0).contains(&economy));
            prop_assert!(whole.depth() <= whole.path_length() + 1e-12);
        }
    }
}
