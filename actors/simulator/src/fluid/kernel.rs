//! The cubic spline of smoothed particles (Monaghan, *Smoothed particle hydrodynamics*, 1992), with support h.

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

    /// W and the factor f of ∇W = f x, x being seen from the other particle, at a distance within the support.
    #[inline]
    pub(super) fn value_and_slope(&self, distance: f64) -> (f64, f64) {
        let q = distance * self.inverse;
        let rest = 1.0 - q;
        let (value, slope) = if q <= 0.5 {
            (6.0 * q * q * (q - 1.0) + 1.0, 6.0 * (3.0 * q - 2.0))
        } else {
            (2.0 * rest * rest * rest, -6.0 * rest * rest / q.max(1e-9))
        };
        // dW/dq / (q h²): finite in the middle.
        (self.scale * value, self.scale * slope * self.inverse * self.inverse)
    }

    /// The same in single precision; 0 beyond the support.
    #[inline(always)]
    pub(super) fn value_and_slope_single(&self, distance: f32) -> (f32, f32) {
        let (inverse, scale) = (self.inverse as f32, self.scale as f32);
        let q = distance * inverse;
        let rest = (1.0 - q).max(0.0);
        // Both, and the right one: without a branch four are computed at once.
        let inner = (6.0 * q * q * (q - 1.0) + 1.0, 6.0 * (3.0 * q - 2.0));
        let outer = (2.0 * rest * rest * rest, -6.0 * rest * rest / q.max(0.1));
        let (value, slope) = if q <= 0.5 { inner } else { outer };
        (scale * value, scale * slope * inverse * inverse)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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
            let single = kernel.value_and_slope_single(r as f32);
            assert!(
                (f64::from(single.0) - value).abs() < 1e-5 * scale
                    && kernel.value_and_slope_single(0.31).0 == 0.0
            );
            assert!((f64::from(single.1) - slope).abs() * r < 1e-4 * scale);
            assert!((slope * r - derivative).abs() < 1e-4 * scale, "{r}: {slope} {derivative}");
        }
        assert!((sum - 1.0).abs() < 1e-6, "{sum}");
    }
}
