//! Explicit SIMD on eight single-precision numbers: from a loop over eight, the compiler may generate code slower than
//! scalar.
//!
//! As with [`super::dispatch`], the implementation is selected at run time, with bit-identical results.

/// Number of lanes.
pub(crate) const LANES: usize = 8;

/// Operations on eight numbers.
pub(crate) trait Eight: Copy {
    /// Eight numbers.
    type Numbers: Copy;
    /// Eight booleans.
    type Answers: Copy;
    /// Eight sums in double precision.
    type Sums: Copy;

    /// Broadcasts a number.
    fn all(self, x: f32) -> Self::Numbers;
    /// Loads from a list.
    fn load(self, list: &[f32; LANES]) -> Self::Numbers;
    /// Stores to a list.
    fn store(self, x: Self::Numbers) -> [f32; LANES];
    /// a + b
    fn add(self, a: Self::Numbers, b: Self::Numbers) -> Self::Numbers;
    /// a - b
    fn sub(self, a: Self::Numbers, b: Self::Numbers) -> Self::Numbers;
    /// a b
    fn mul(self, a: Self::Numbers, b: Self::Numbers) -> Self::Numbers;
    /// a / b
    fn div(self, a: Self::Numbers, b: Self::Numbers) -> Self::Numbers;
    /// Elementwise maximum; no NaN allowed.
    fn max(self, a: Self::Numbers, b: Self::Numbers) -> Self::Numbers;
    /// Square root.
    fn sqrt(self, a: Self::Numbers) -> Self::Numbers;
    /// Whether a < b.
    fn less(self, a: Self::Numbers, b: Self::Numbers) -> Self::Answers;
    /// Selects `yes` where true, `no` where false.
    fn choose(self, is_so: Self::Answers, yes: Self::Numbers, no: Self::Numbers) -> Self::Numbers;
    /// Bit mask, the first lane lowest.
    fn bits(self, answers: Self::Answers) -> u32;
    /// Zero sums.
    fn nothing(self) -> Self::Sums;
    /// Accumulates.
    fn add_to(self, sums: Self::Sums, x: Self::Numbers) -> Self::Sums;
    /// The sums.
    fn sums(self, sums: Self::Sums) -> [f64; LANES];

    /// Transposes eight rows of four numbers to four columns.
    fn columns(self, rows: &[[f32; 4]; LANES]) -> [Self::Numbers; 4];
    /// The inverse transposition.
    fn rows(self, columns: [Self::Numbers; 4]) -> [[f32; 4]; LANES];

    /// Rounds to 16-bit integers, ties to even; only for values from 0 to 65535.
    fn pack(self, x: Self::Numbers) -> [u16; LANES];
    /// Converts packed integers to numbers.
    fn unpack(self, packed: &[u16; LANES]) -> Self::Numbers;

    /// a b c
    #[inline(always)]
    fn mul3(self, a: Self::Numbers, b: Self::Numbers, c: Self::Numbers) -> Self::Numbers {
        self.mul(self.mul(a, b), c)
    }

    /// (a₀ b₀ + a₁ b₁) + a₂ b₂
    #[inline(always)]
    fn dot(self, a: [Self::Numbers; 3], b: [Self::Numbers; 3]) -> Self::Numbers {
        self.add(self.add(self.mul(a[0], b[0]), self.mul(a[1], b[1])), self.mul(a[2], b[2]))
    }
}

/// A computation on eight lanes.
pub(crate) trait ForEight {
    /// Its result.
    type Output;

    /// Runs it; everything that it calls has to be inlined.
    fn run<E: Eight>(self, eight: E) -> Self::Output;
}

/// Runs a computation with the widest supported registers of at most eight numbers.
#[inline]
pub(crate) fn with_eight<W: ForEight>(work: W) -> W::Output {
    #[cfg(target_arch = "x86_64")]
    if let Some(registers) = pulp::x86::V3::try_new() {
        return registers.vectorize(
            #[inline(always)]
            || work.run(registers),
        );
    }
    work.run(OneByOne)
}

/// Fallback without such registers.
#[derive(Clone, Copy)]
pub(crate) struct OneByOne;

impl Eight for OneByOne {
    type Numbers = [f32; LANES];
    type Answers = [bool; LANES];
    type Sums = [f64; LANES];

    #[inline(always)]
    fn all(self, x: f32) -> [f32; LANES] {
        [x; LANES]
    }

    #[inline(always)]
    fn load(self, list: &[f32; LANES]) -> [f32; LANES] {
        *list
    }

    #[inline(always)]
    fn store(self, x: [f32; LANES]) -> [f32; LANES] {
        x
    }

    #[inline(always)]
    fn add(self, a: [f32; LANES], b: [f32; LANES]) -> [f32; LANES] {
        std::array::from_fn(|k| a[k] + b[k])
    }

    #[inline(always)]
    fn sub(self, a: [f32; LANES], b: [f32; LANES]) -> [f32; LANES] {
        std::array::from_fn(|k| a[k] - b[k])
    }

    #[inline(always)]
    fn mul(self, a: [f32; LANES], b: [f32; LANES]) -> [f32; LANES] {
        std::array::from_fn(|k| a[k] * b[k])
    }

    #[inline(always)]
    fn div(self, a: [f32; LANES], b: [f32; LANES]) -> [f32; LANES] {
        std::array::from_fn(|k| a[k] / b[k])
    }

    #[inline(always)]
    fn max(self, a: [f32; LANES], b: [f32; LANES]) -> [f32; LANES] {
        std::array::from_fn(|k| if a[k] > b[k] { a[k] } else { b[k] })
    }

    #[inline(always)]
    fn sqrt(self, a: [f32; LANES]) -> [f32; LANES] {
        a.map(f32::sqrt)
    }

    #[inline(always)]
    fn less(self, a: [f32; LANES], b: [f32; LANES]) -> [bool; LANES] {
        std::array::from_fn(|k| a[k] < b[k])
    }

    #[inline(always)]
    fn choose(self, is_so: [bool; LANES], yes: [f32; LANES], no: [f32; LANES]) -> [f32; LANES] {
        std::array::from_fn(|k| if is_so[k] { yes[k] } else { no[k] })
    }

    #[inline(always)]
    fn bits(self, answers: [bool; LANES]) -> u32 {
        answers.iter().enumerate().fold(0, |bits, (k, is_so)| bits | u32::from(*is_so) << k)
    }

    #[inline(always)]
    fn nothing(self) -> [f64; LANES] {
        [0.0; LANES]
    }

    #[inline(always)]
    fn add_to(self, sums: [f64; LANES], x: [f32; LANES]) -> [f64; LANES] {
        std::array::from_fn(|k| sums[k] + f64::from(x[k]))
    }

    #[inline(always)]
    fn sums(self, sums: [f64; LANES]) -> [f64; LANES] {
        sums
    }

    #[inline(always)]
    fn columns(self, rows: &[[f32; 4]; LANES]) -> [[f32; LANES]; 4] {
        std::array::from_fn(|at| rows.map(|row| row[at]))
    }

    #[inline(always)]
    fn rows(self, columns: [[f32; LANES]; 4]) -> [[f32; 4]; LANES] {
        std::array::from_fn(|k| columns.map(|column| column[k]))
    }

    #[inline(always)]
    fn pack(self, x: [f32; LANES]) -> [u16; LANES] {
        x.map(|x| x.round_ties_even() as u16)
    }

    #[inline(always)]
    fn unpack(self, packed: &[u16; LANES]) -> [f32; LANES] {
        packed.map(f32::from)
    }
}

#[cfg(target_arch = "x86_64")]
mod registers {
    use pulp::bytemuck::{cast, cast_slice};
    use pulp::x86::V3;
    use pulp::{f32x8, f64x4, m32x8};
    use std::arch::x86_64::{__m128, __m128i, __m256};

    use super::{Eight, LANES};

    impl Eight for V3 {
        type Numbers = f32x8;
        type Answers = m32x8;
        type Sums = [f64x4; 2];

        #[inline(always)]
        fn all(self, x: f32) -> f32x8 {
            self.splat_f32x8(x)
        }

        #[inline(always)]
        fn load(self, list: &[f32; LANES]) -> f32x8 {
            cast(*list)
        }

        #[inline(always)]
        fn store(self, x: f32x8) -> [f32; LANES] {
            cast(x)
        }

        #[inline(always)]
        fn add(self, a: f32x8, b: f32x8) -> f32x8 {
            self.add_f32x8(a, b)
        }

        #[inline(always)]
        fn sub(self, a: f32x8, b: f32x8) -> f32x8 {
            self.sub_f32x8(a, b)
        }

        #[inline(always)]
        fn mul(self, a: f32x8, b: f32x8) -> f32x8 {
            self.mul_f32x8(a, b)
        }

        #[inline(always)]
        fn div(self, a: f32x8, b: f32x8) -> f32x8 {
            self.div_f32x8(a, b)
        }

        #[inline(always)]
        fn max(self, a: f32x8, b: f32x8) -> f32x8 {
            self.max_f32x8(a, b)
        }

        #[inline(always)]
        fn sqrt(self, a: f32x8) -> f32x8 {
            cast(self.avx._mm256_sqrt_ps(cast::<f32x8, __m256>(a)))
        }

        #[inline(always)]
        fn less(self, a: f32x8, b: f32x8) -> m32x8 {
            self.cmp_lt_f32x8(a, b)
        }

        #[inline(always)]
        fn choose(self, is_so: m32x8, yes: f32x8, no: f32x8) -> f32x8 {
            self.select_f32x8(is_so, yes, no)
        }

        #[inline(always)]
        fn bits(self, answers: m32x8) -> u32 {
            let answers: __m256 = pulp::cast(answers);
            self.avx._mm256_movemask_ps(answers) as u32
        }

        #[inline(always)]
        fn nothing(self) -> [f64x4; 2] {
            [self.splat_f64x4(0.0); 2]
        }

        #[inline(always)]
        fn add_to(self, sums: [f64x4; 2], x: f32x8) -> [f64x4; 2] {
            // Written out: a closure here may be called through memory.
            let [low, high]: [__m128; 2] = cast(x);
            let (low, high): (f64x4, f64x4) =
                (cast(self.avx._mm256_cvtps_pd(low)), cast(self.avx._mm256_cvtps_pd(high)));
            [self.add_f64x4(sums[0], low), self.add_f64x4(sums[1], high)]
        }

        #[inline(always)]
        fn sums(self, sums: [f64x4; 2]) -> [f64; LANES] {
            let mut list = [0.0; LANES];
            list.copy_from_slice(cast_slice(&sums));
            list
        }

        #[inline(always)]
        fn columns(self, rows: &[[f32; 4]; LANES]) -> [f32x8; 4] {
            let pairs: [__m256; 4] =
                std::array::from_fn(|k| cast::<[[f32; 4]; 2], __m256>([rows[k], rows[k + 4]]));
            transposed(self, pairs).map(cast)
        }

        #[inline(always)]
        fn rows(self, columns: [f32x8; 4]) -> [[f32; 4]; LANES] {
            let pairs: [[[f32; 4]; 2]; 4] = transposed(self, columns.map(cast)).map(cast);
            std::array::from_fn(|k| pairs[k % 4][k / 4])
        }

        #[inline(always)]
        fn pack(self, x: f32x8) -> [u16; LANES] {
            let whole: [__m128i; 2] = cast(self.avx._mm256_cvtps_epi32(cast::<f32x8, __m256>(x)));
            cast(self.sse4_1._mm_packus_epi32(whole[0], whole[1]))
        }

        #[inline(always)]
        fn unpack(self, packed: &[u16; LANES]) -> f32x8 {
            let whole = self.avx2._mm256_cvtepu16_epi32(cast::<[u16; LANES], __m128i>(*packed));
            cast(self.avx._mm256_cvtepi32_ps(whole))
        }
    }

    /// Transposes each half.
    #[inline(always)]
    fn transposed(registers: V3, [a, b, c, d]: [__m256; 4]) -> [__m256; 4] {
        let avx = registers.avx;
        let (ab, cd) = (avx._mm256_unpacklo_ps(a, b), avx._mm256_unpacklo_ps(c, d));
        let (ab_high, cd_high) = (avx._mm256_unpackhi_ps(a, b), avx._mm256_unpackhi_ps(c, d));
        [
            avx._mm256_shuffle_ps::<0x44>(ab, cd),
            avx._mm256_shuffle_ps::<0xee>(ab, cd),
            avx._mm256_shuffle_ps::<0x44>(ab_high, cd_high),
            avx._mm256_shuffle_ps::<0xee>(ab_high, cd_high),
        ]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{Rng, SeedableRng};

    /// A test of all operations.
    struct All([[f32; LANES]; 3]);

    impl ForEight for All {
        type Output = Vec<u64>;

        fn run<E: Eight>(self, eight: E) -> Vec<u64> {
            let [a, b, c] = self.0.each_ref().map(|list| eight.load(list));
            let is_less = eight.less(a, b);
            let numbers = [
                eight.add(a, b),
                eight.sub(a, b),
                eight.mul(a, b),
                eight.div(a, b),
                eight.max(a, b),
                eight.sqrt(eight.mul(a, a)),
                eight.choose(is_less, b, c),
                eight.all(self.0[0][3]),
                eight.mul3(a, b, c),
                eight.dot([a, b, c], [c, a, b]),
            ];
            let sums = eight.add_to(eight.add_to(eight.nothing(), a), b);
            let mut bits: Vec<u64> = eight.sums(sums).map(f64::to_bits).to_vec();
            bits.push(u64::from(eight.bits(is_less)));
            let rows = eight.rows([a, b, c, numbers[0]]);
            bits.extend(rows.iter().flatten().map(|x| u64::from(x.to_bits())));
            let columns = eight.columns(&rows);
            // Ties, too, over the whole range.
            let whole = eight.max(eight.mul(a, eight.all(32767.75)), eight.all(0.0));
            for x in [whole, eight.max(eight.mul(b, eight.all(2.0)), eight.all(0.0))] {
                let packed = eight.pack(x);
                bits.extend(packed.map(u64::from));
                bits.extend(eight.store(eight.unpack(&packed)).map(|x| u64::from(x.to_bits())));
            }
            for list in numbers.into_iter().chain(columns) {
                bits.extend(eight.store(list).map(|x| u64::from(x.to_bits())));
            }
            bits
        }
    }

    #[test]
    fn any_registers_give_the_same_bits() {
        let mut random = rand_pcg::Pcg64::seed_from_u64(13);
        for _ in 0..100 {
            let lists: [[f32; LANES]; 3] =
                std::array::from_fn(|_| std::array::from_fn(|_| random.random_range(-2.0..2.0)));
            let bits = All(lists).run(OneByOne);
            assert_eq!(with_eight(All(lists)), bits);
            // Transposing twice is the identity.
            let first = bits.len() - 4 * LANES;
            for (list, bits) in lists.iter().zip(bits[first..].chunks_exact(LANES)) {
                assert!(list.iter().zip(bits).all(|(x, bits)| u64::from(x.to_bits()) == *bits));
            }
        }
    }
}
