//! The appearance of a burn by its Arrhenius integral.
//!
//! Henriques and Moritz ("Studies of thermal injury I–V", American Journal of Pathology, 1947) model thermal damage as
//! a first-order reaction with the integral Ω over time: a share of 1 − exp(−Ω) of the protein is denatured. Tissue
//! blanches and dries while Ω goes from 0 to a few; by 10 all but 0.005 % is denatured, and further damage is drying
//! and charring. Third-degree burns are put at Ω = 10⁴.

/// Ω from which tissue chars.
pub const CHAR_FROM: f64 = 10.0;
/// Ω at which tissue is black: a third-degree burn.
pub const CHAR_FULL: f64 = 1e4;

/// The share of the protein that is denatured, in \[0, 1\]; numbers below 0 and NaN count as no damage.
pub fn denatured(omega: f64) -> f32 {
    (1.0 - (-omega.max(0.0)).exp()) as f32
}

/// Degree of charring, in \[0, 1\]: by the order of magnitude of Ω between [`CHAR_FROM`] and [`CHAR_FULL`].
pub fn charred(omega: f64) -> f32 {
    let decades = (omega.max(CHAR_FROM) / CHAR_FROM).log10() / (CHAR_FULL / CHAR_FROM).log10();
    decades.min(1.0) as f32
}

/// The edit map's R channel: the lower half is denaturation, the upper half char, so that a shader computes `denatured
/// = min(2R, 1)` and `charred = max(2R − 1, 0)`.
pub fn encoded(omega: f64) -> f32 {
    0.5 * (denatured(omega) + charred(omega))
}

/// Remaining gloss of the surface, in \[0, 1\]: the fluid film dries up as protein coagulates.
pub fn gloss(omega: f64) -> f32 {
    let dry = denatured(omega);
    1.0 - dry * dry * (0.75 + 0.25 * charred(omega))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn damage_has_its_known_values() {
        assert_eq!([encoded(0.0), encoded(-1.0), encoded(f64::NAN)], [0.0; 3]);
        assert!((denatured(1.0) - 0.632).abs() < 1e-3);
        assert!((encoded(10.0) - 0.5).abs() < 1e-4);
        assert!((charred(316.227_766) - 0.5).abs() < 1e-6);
        assert_eq!([encoded(1e4), encoded(1e300), encoded(f64::INFINITY)], [1.0; 3]);
        assert_eq!([gloss(0.0), gloss(1e9)], [1.0, 0.0]);
    }

    #[test]
    fn more_damage_never_looks_like_less() {
        let omegas: Vec<f64> = (0..400).map(|i| 1e-3 * 10f64.powf(f64::from(i) * 0.02)).collect();
        for pair in omegas.windows(2) {
            assert!(encoded(pair[1]) >= encoded(pair[0]) && gloss(pair[1]) <= gloss(pair[0]));
        }
    }
}
