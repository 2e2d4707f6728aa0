//! Acceleration of the proxy's moves around edges and corners (Aitken extrapolation).

use nalgebra::Vector3;

/// Largest stretch factor of a slide.
const STRETCH_MAX: f64 = 8.0;

/// Around an edge or a corner the planes rotate as the proxy moves, and each move covers only a share of the rest:
/// successive slides in one direction form a geometric series, whose sum can be extrapolated (Aitken, 1926).
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Rolling {
    last: Vector3<f64>,
    stretched: f64,
}

impl Rolling {
    /// Stretch factor of the next slide, up to a length of `longest` \[m\].
    pub(super) fn stretch(&mut self, slide: &Vector3<f64>, longest: f64) -> f64 {
        let (size, last) = (slide.norm(), self.last.norm());
        let along = slide.dot(&self.last);
        let mut stretch = 1.0;
        if size > 0.0 && along > 0.9 * size * last {
            // The share of the rest that remains after an unstretched slide.
            let left = 1.0 - (1.0 - along / (last * last)) / self.stretched;
            stretch = if left < 1.0 - 1.0 / STRETCH_MAX { 1.0 / (1.0 - left) } else { STRETCH_MAX };
            stretch = stretch.min(longest / size).max(1.0);
        }
        (self.last, self.stretched) = (*slide, stretch);
        stretch
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn of_a_series_the_second_slide_goes_to_its_end() {
        for share in [0.1, 0.5, 0.8] {
            let mut rolling = Rolling::default();
            let slide = Vector3::new(1e-4, 2e-4, 0.0);
            assert_eq!(rolling.stretch(&slide, 1.0), 1.0);
            let rest = slide * share;
            assert!((rolling.stretch(&rest, 1.0) - 1.0 / (1.0 - share)).abs() < 1e-9);
        }
    }

    #[test]
    fn what_turns_grows_or_stands_is_not_foretold_beyond_its_bounds() {
        let mut rolling = Rolling::default();
        let slide = Vector3::new(1e-4, 0.0, 0.0);
        rolling.stretch(&slide, 1.0);
        assert_eq!(rolling.stretch(&(slide * 1.1), 1.0), STRETCH_MAX);
        assert_eq!(rolling.stretch(&Vector3::new(0.0, 1e-4, 0.0), 1.0), 1.0);
        assert_eq!(rolling.stretch(&Vector3::zeros(), 1.0), 1.0);
        rolling.stretch(&slide, 1.0);
        assert!((rolling.stretch(&(slide * 0.99), 2e-4) - 2e-4 / 0.99e-4).abs() < 1e-9);
    }
}
