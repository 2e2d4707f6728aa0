//! Cubic spline kernel of SPH (Monaghan, *Smoothed particle hydrodynamics*, 1992), with support radius h.

use crate::simd::f32x8::Eight;

/// The kernel for one support radius.
#[derive(Clone, Copy, Debug)]
pub(super) struct Kernel {
    pub support: f64,
    inverse: f64,
    scale: f64,
}

impl Kernel {
    pub(super) fn new(support: f64) -> Self {
        let scale = 8.0 / (std::f64::consts::PI * support.powi(3));
        Self { support, inverse: 1.0 / support, scale }
    }

    /// W and the factor f of ∇W = f x, with x relative to the other particle, at a distance within the support.
    #[inline]
    pub(super) fn value_and_slope(&self, distance: f64) -> (f64, f64) {
        let q = distance * self.inverse;
        let rest = 1.0 - q;
        let (value, slope) = if q <= 0.5 {
            (6.0 * q * q * (q - 1.0) + 1.0, 6.0 * (3.0 * q - 2.0))
        } else {
            (2.0 * rest * rest * rest, -6.0 * rest * rest / q.max(1e-9))
        };
        // dW/dq / (q h²): finite at the centre.
        (self.scale * value, self.scale * slope * self.inverse * self.inverse)
    }

    /// The most negative factor, that of two particles at the same position.
    pub(super) fn steepest(&self) -> f64 {
        -12.0 * self.scale * self.inverse * self.inverse
    }

    /// The same for eight distances in single precision; 0 beyond the support.
    #[inline(always)]
    pub(super) fn values_and_slopes<E: Eight>(
        &self,
        eight: E,
        distances: E::Numbers,
    ) -> (E::Numbers, E::Numbers) {
        let (inverse, scale) = (self.inverse as f32, self.scale as f32);
        let (one, six) = (eight.all(1.0), eight.all(6.0));
        let q = eight.mul(distances, eight.all(inverse));
        let rest = eight.max(eight.sub(one, q), eight.all(0.0));
        let rest_square = eight.mul(rest, rest);
        // Computes both branches and selects, without a jump.
        let inner = eight.add(eight.mul(eight.mul3(six, q, q), eight.sub(q, one)), one);
        let inner_slope = eight.sub(eight.mul(eight.all(18.0), q), eight.all(12.0));
        let outer = eight.mul3(eight.all(2.0), rest, rest_square);
        let outer_slope = eight.div(eight.mul(eight.all(-6.0), rest_square), eight.max(q, eight.all(0.1)));
        let is_outer = eight.less(eight.all(0.5), q);
        let value = eight.choose(is_outer, outer, inner);
        let slope = eight.choose(is_outer, outer_slope, inner_slope);
        let steep = eight.all(scale * inverse * inverse);
        (eight.mul(eight.all(scale), value), eight.mul(steep, slope))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simd::f32x8::{ForEight, LANES, OneByOne, with_eight};

    struct Both {
        kernel: Kernel,
        distances: [f32; 2],
    }

    impl ForEight for Both {
        type Output = ([f32; LANES], [f32; LANES]);

        fn run<E: Eight>(self, eight: E) -> Self::Output {
            let distances = std::array::from_fn(|k| self.distances[k % 2]);
            let (values, slopes) = self.kernel.values_and_slopes(eight, eight.load(&distances));
            (eight.store(values), eight.store(slopes))
        }
    }

    #[test]
    fn any_registers_give_the_same_bits() {
        let kernel = Kernel::new(0.3);
        for part in 0..1000 {
            let both = || Both { kernel, distances: [part as f32 * 4e-4, part as f32 * 1e-6] };
            assert_eq!(with_eight(both()), both().run(OneByOne), "{part}");
        }
    }

    #[test]
    fn the_kernel_is_one_in_all_and_its_slope_is_its_derivative() {
        let kernel = Kernel::new(0.3);
        let parts = 20_000;
        let step = 0.3 / f64::from(parts);
        let mut sum = 0.0;
        for part in 0..parts {
            let r = (f64::from(part) + 0.5) * step;
            let (value, slope) = kernel.value_and_slope(r);
            sum += 4.0 * std::f64::consts::PI * r * r * value * step;
            let (above, below) = (kernel.value_and_slope(r + 1e-6).0, kernel.value_and_slope(r - 1e-6).0);
            let derivative = (above - below) / 2e-6;
            let scale = kernel.value_and_slope(0.0).0 / 0.3;
            let (values, slopes) = with_eight(Both { kernel, distances: [r as f32, 0.31] });
            assert!((f64::from(values[0]) - value).abs() < 1e-5 * scale && values[1] == 0.0);
            assert!((f64::from(slopes[0]) - slope).abs() * r < 1e-4 * scale && slopes[1] == 0.0);
            assert!((slope * r - derivative).abs() < 1e-4 * scale, "{r}: {slope} {derivative}");
        }
        assert!((sum - 1.0).abs() < 1e-6, "{sum}");
    }
}
