//! Plans the depth of the next breath. An algorithm is a plain function in a file of its own: it can be tested without
//! any actor, and is easy to find.

/// Depth of breath number `breath`: around 1, by at most `variation`, the same for the same seed.
///
/// It stands for work of some milliseconds, such as fitting a curve to a ventilator's measurements.
pub fn depth(seed: u64, breath: u32, variation: f64) -> f64 {
    // SplitMix64 (Steele, Lea and Flood, "Fast splittable pseudorandom number generators", 2014).
    let mut z = seed ^ u64::from(breath).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    let unit = ((z ^ (z >> 31)) >> 11) as f64 / (1_u64 << 53) as f64;
    1.0 + variation * (2.0 * unit - 1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn depths_stay_within_the_variation_and_follow_the_seed() {
        let depths: Vec<f64> = (0..1_000).map(|breath| depth(7, breath, 0.2)).collect();
        assert!(depths.iter().all(|depth| (0.8..=1.2).contains(depth)));
        let mean = depths.iter().sum::<f64>() / 1_000.0;
        assert!((mean - 1.0).abs() < 0.02, "{mean}");
        assert_eq!(depth(7, 3, 0.2), depth(7, 3, 0.2));
        assert_ne!(depth(7, 3, 0.2), depth(8, 3, 0.2));
    }
}
