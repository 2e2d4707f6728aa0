//! Grid: numbers with a fraction as whole multiples of a power of two, where they are.

/// Largest exponent of a grid's step, of either sign.
const EXPONENT_MAX: i32 = 120;
/// Whole numbers on a grid have fewer bits than this, so that predictions of them do not overflow.
const WIDTH: i32 = 60;

/// What turns the numbers of a column into whole ones.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Grid {
    /// The numbers are multiples of 2 to this power.
    Step(i32),
    /// They are anything: whole numbers in the same order stand for their bits.
    Bits,
}

impl Grid {
    pub(super) fn to_byte(self) -> u8 {
        match self {
            Self::Step(exponent) => (exponent + 128) as u8,
            Self::Bits => 0,
        }
    }

    pub(super) fn from_byte(byte: u8) -> Self {
        let exponent = i32::from(byte) - 128;
        if exponent.abs() <= EXPONENT_MAX { Self::Step(exponent) } else { Self::Bits }
    }

    /// The whole number of a float's bits.
    pub(super) fn whole(self, bits: u64) -> i64 {
        match self {
            // Both factors are powers of two and in range, so that the product is exact.
            Self::Step(exponent) => (f64::from_bits(bits) * power(-exponent)) as i64,
            Self::Bits => ordered(bits as i64),
        }
    }

    /// The bits of the float that has this whole number.
    pub(super) fn bits(self, whole: i64) -> u64 {
        match self {
            Self::Step(exponent) => (whole as f64 * power(exponent)).to_bits(),
            Self::Bits => ordered(whole) as u64,
        }
    }
}

/// Bits of floats as whole numbers in the order of the floats, and back: those of negative numbers count downwards.
fn ordered(bits: i64) -> i64 {
    bits ^ ((bits >> 63) as u64 >> 1) as i64
}

/// 2 to that power, for exponents of grids.
fn power(exponent: i32) -> f64 {
    f64::from_bits(((1023 + i64::from(exponent)) as u64) << 52)
}

/// Finds the coarsest grid on which all the numbers lie that were shown to it.
#[derive(Clone, Copy, Debug)]
pub(super) struct GridFinder {
    lowest: i32,
    highest: i32,
    fits: bool,
}

impl GridFinder {
    pub(super) fn new() -> Self {
        Self { lowest: i32::MAX, highest: i32::MIN, fits: true }
    }

    pub(super) fn show(&mut self, bits: u64) {
        let exponent = (bits >> 52 & 0x7ff) as i32;
        let mantissa = bits & ((1 << 52) - 1);
        if bits == 0 {
            return;
        }
        // Subnormal numbers, negative zero, infinities and NaNs are on no grid.
        if exponent == 0 || exponent == 0x7ff {
            self.fits = false;
            return;
        }
        let zeros = (mantissa | 1 << 52).trailing_zeros() as i32;
        self.lowest = self.lowest.min(exponent - 1023 - 52 + zeros);
        self.highest = self.highest.max(exponent - 1023 + 1);
    }

    pub(super) fn grid(self) -> Grid {
        if self.fits && self.lowest == i32::MAX {
            return Grid::Step(0);
        }
        let fits = self.fits && self.lowest.abs() <= EXPONENT_MAX && self.highest - self.lowest <= WIDTH;
        if fits { Grid::Step(self.lowest) } else { Grid::Bits }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn grid_of(numbers: &[f64]) -> Grid {
        let mut finder = GridFinder::new();
        numbers.iter().for_each(|number| finder.show(number.to_bits()));
        finder.grid()
    }

    #[test]
    fn the_coarsest_grid_is_found() {
        assert_eq!(grid_of(&[0.5, 3.0, -0.75, 0.0]), Grid::Step(-2));
        assert_eq!(grid_of(&[0.0]), Grid::Step(0));
        assert_eq!(grid_of(&[1024.0, 3072.0]), Grid::Step(10));
        assert_eq!(grid_of(&[1.0, -0.0]), Grid::Bits);
        assert_eq!(grid_of(&[1e30, 0.125]), Grid::Bits);
        assert_eq!(grid_of(&[f64::NAN]), Grid::Bits);
        assert_eq!(grid_of(&[f64::MIN_POSITIVE / 4.0]), Grid::Bits);
        assert_eq!(Grid::Step(-2).whole((-0.75_f64).to_bits()), -3);
    }

    #[test]
    fn bits_keep_the_order_of_numbers() {
        let wholes = [-2.0_f64, -1.0, -0.0, 0.0, 1e-300, 3.0].map(|n| Grid::Bits.whole(n.to_bits()));
        assert!(wholes.windows(2).all(|pair| pair[0] < pair[1]), "{wholes:?}");
    }

    proptest! {
        #[test]
        fn numbers_come_back_to_the_last_bit(numbers in prop::collection::vec(any::<f64>(), 1..4), scale in -40..40) {
            // Both numbers of any kind, and such as lie on a grid.
            for numbers in [numbers.clone(), numbers.iter().map(|n| (n % 1e6).round() * 2f64.powi(scale)).collect()] {
                let grid = Grid::from_byte(grid_of(&numbers).to_byte());
                prop_assert_eq!(grid, grid_of(&numbers));
                for number in &numbers {
                    let bits = number.to_bits();
                    prop_assert_eq!(grid.bits(grid.whole(bits)), bits, "{} on {:?}", number, grid);
                }
            }
        }
    }
}
