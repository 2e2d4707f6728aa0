//! Seeded noise whose whole state is four numbers, so that it can be kept in the scene.
//!
//! The normal variate is the sum of twelve uniforms (Irwin–Hall): exact arithmetic only, hence bit-identical
//! everywhere, and bounded by six standard deviations, hence no rare outlier commands.

use nalgebra::Vector3;
use rand_pcg::Pcg32;
use rand_pcg::rand_core::RngCore;
use serde::{Deserialize, Serialize};

/// Uniform numbers that one normal variate takes.
const UNIFORMS: u64 = 12;

/// A resumable stream of normal variates from PCG-XSH-RR (O'Neill 2014).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Noise {
    seed: u64,
    stream: u64,
    drawn: u64,
}

impl Noise {
    /// The stream number `stream` of `seed`.
    pub fn new(seed: u64, stream: u64) -> Self {
        Self { seed, stream, drawn: 0 }
    }

    /// The next variate: mean 0, variance 1, within ±6.
    pub fn normal(&mut self) -> f64 {
        let mut generator = Pcg32::new(self.seed, self.stream);
        generator.advance(self.drawn);
        self.drawn = self.drawn.wrapping_add(UNIFORMS);
        let sum: f64 = (0..UNIFORMS).map(|_| (f64::from(generator.next_u32()) + 0.5) / 4_294_967_296.0).sum();
        sum - 0.5 * UNIFORMS as f64
    }

    /// Three variates.
    pub fn normal3(&mut self) -> Vector3<f64> {
        Vector3::new(self.normal(), self.normal(), self.normal())
    }
}

/// Physiological tremor: noise in a band about one frequency, one independent channel per axis.
///
/// A second-order autoregressive resonator driven by white noise; the physiological band of the hand is
/// 8–12 Hz (Elble & Koller 1990, "Tremor").
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Tremor {
    /// The last and the last but one value, of unit variance.
    past: [Vector3<f64>; 2],
}

/// Damping ratio of the resonator: a half-power band of 4 Hz at 10 Hz.
const DAMPING: f64 = 0.2;

impl Tremor {
    /// The next value of unit standard deviation per axis, `dt` \[s\] after the last, about `frequency` \[Hz\].
    pub fn next(&mut self, noise: &mut Noise, dt: f64, frequency: f64) -> Vector3<f64> {
        let turn = 2.0 * std::f64::consts::PI * frequency * dt;
        let decay = (-DAMPING * turn).exp();
        let first = 2.0 * decay * (turn * (1.0 - DAMPING * DAMPING).sqrt()).cos();
        let second = -decay * decay;
        // Variance of an AR(2) process; inverted, it gives the drive for unit variance.
        let drive =
            ((1.0 + second) * ((1.0 - second).powi(2) - first * first) / (1.0 - second)).max(0.0).sqrt();
        let value = self.past[0] * first + self.past[1] * second + noise.normal3() * drive;
        self.past = [value, self.past[0]];
        value
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn normal_variates_have_the_moments_of_a_normal_and_are_bounded() {
        let mut noise = Noise::new(7, 1);
        let values: Vec<f64> = (0..20_000).map(|_| noise.normal()).collect();
        let n = values.len() as f64;
        let mean = values.iter().sum::<f64>() / n;
        let variance = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / n;
        assert!(mean.abs() < 0.03 && (variance - 1.0).abs() < 0.04, "{mean} {variance}");
        assert!(values.iter().all(|v| v.abs() <= 6.0));
        let beyond_two = values.iter().filter(|v| v.abs() > 2.0).count() as f64 / n;
        assert!((beyond_two - 0.0455).abs() < 0.01, "{beyond_two}");
    }

    #[test]
    fn a_stored_stream_continues_with_the_same_numbers() {
        let mut whole = Noise::new(42, 3);
        let first: Vec<f64> = (0..10).map(|_| whole.normal()).collect();
        let mut stored: Noise = postcard::from_bytes(&postcard::to_stdvec(&whole).unwrap()).unwrap();
        assert_eq!(stored.normal().to_bits(), whole.normal().to_bits());
        assert_ne!(Noise::new(42, 4).normal(), first[0]);
        assert_ne!(Noise::new(43, 3).normal(), first[0]);
        assert_eq!(Noise::new(42, 3).normal(), first[0]);
    }

    #[test]
    fn tremor_has_unit_variance_and_lies_in_its_band() {
        for dt in [0.01, 0.002] {
            let (mut tremor, mut noise) = (Tremor::default(), Noise::new(5, 0));
            let count = 1 << 13;
            let signal: Vec<f64> = (0..count).map(|_| tremor.next(&mut noise, dt, 10.0).x).collect();
            let variance = signal.iter().map(|v| v * v).sum::<f64>() / count as f64;
            assert!((variance - 1.0).abs() < 0.15, "{variance}");
            // Power by direct projection on 0.5 Hz steps, in the band and in all.
            let power = |hz: f64| {
                let (mut re, mut im) = (0.0, 0.0);
                for (i, value) in signal.iter().enumerate() {
                    let phase = 2.0 * std::f64::consts::PI * hz * i as f64 * dt;
                    re += value * phase.cos();
                    im += value * phase.sin();
                }
                re * re + im * im
            };
            let all: f64 = (1..80).map(|k| power(f64::from(k) * 0.5)).sum();
            let band: f64 = (14..=26).map(|k| power(f64::from(k) * 0.5)).sum();
            assert!(band / all > 0.6, "{}", band / all);
        }
    }
}
