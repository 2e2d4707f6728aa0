//! Random numbers from a seed, the same on every machine.

/// Step of the sequence: 2⁶⁴ over the golden ratio, odd. Multiples of it keep the seeds of neighbours apart.
pub const GOLDEN_GAMMA: u64 = 0x9e37_79b9_7f4a_7c15;

/// A sequence of well mixed 64-bit numbers: SplitMix64 (Steele, Lea and Flood, "Fast splittable pseudorandom number
/// generators", 2014). It is small and has no weak seeds; it is not for secrets.
#[derive(Clone, Debug)]
pub struct SplitMix64(u64);

impl SplitMix64 {
    /// The sequence of a seed.
    #[must_use]
    pub fn new(seed: u64) -> Self {
        Self(seed)
    }

    /// The next number.
    pub fn next_u64(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(GOLDEN_GAMMA);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// The next number as a fraction: uniform in \[0, 1).
    pub fn unit(&mut self) -> f64 {
        (self.next_u64() >> 11) as f64 / (1_u64 << 53) as f64
    }

    /// The next number as a fraction of single precision: uniform in \[0, 1).
    pub fn unit_f32(&mut self) -> f32 {
        (self.next_u64() >> 40) as f32 / (1_u64 << 24) as f32
    }

    /// The next number as one of 0..`count`; 0 when `count` is 0.
    pub fn below(&mut self, count: u64) -> u64 {
        self.next_u64() % count.max(1)
    }
}

/// A seed from a name (FNV-1a), so that each name has its own sequence.
#[must_use]
pub fn seed_of(name: &str) -> u64 {
    name.bytes()
        .fold(0xcbf2_9ce4_8422_2325, |hash, byte| (hash ^ u64::from(byte)).wrapping_mul(0x100_0000_01b3))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_numbers_are_the_published_ones() {
        // Reference values of the authors' program for this seed.
        let mut random = SplitMix64::new(1_234_567);
        let numbers: Vec<u64> = (0..5).map(|_| random.next_u64()).collect();
        assert_eq!(
            numbers,
            [
                6_457_827_717_110_365_317,
                3_203_168_211_198_807_973,
                9_817_491_932_198_370_423,
                4_593_380_528_125_082_431,
                16_408_922_859_458_223_821,
            ]
        );
        // Of FNV-1a with 64 bits.
        assert_eq!(seed_of(""), 0xcbf2_9ce4_8422_2325);
        assert_eq!(seed_of("a"), 0xaf63_dc4c_8601_ec8c);
        assert_eq!(seed_of("foobar"), 0x8594_4171_f739_67e8);
    }

    #[test]
    fn fractions_lie_below_one_and_choices_below_their_count() {
        let mut random = SplitMix64::new(3);
        let mut sums = [0.0; 2];
        for _ in 0..10_000 {
            let (one, other) = (random.unit(), random.unit_f32());
            assert!((0.0..1.0).contains(&one) && (0.0..1.0).contains(&other));
            sums[0] += one;
            sums[1] += f64::from(other);
            assert!(random.below(7) < 7);
        }
        assert!(sums.iter().all(|sum| (sum / 1e4 - 0.5).abs() < 0.02), "{sums:?}");
        assert_eq!(random.below(0), 0);
        // Both precisions are the upper bits of the same number.
        let mut same = random.clone();
        assert!((random.unit() - f64::from(same.unit_f32())).abs() < 1e-6);
    }
}
