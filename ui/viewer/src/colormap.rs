//! Colour maps for temperature, stress and the like, and the ticks of their scales.

/// A colour map of 256 sRGB colours.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Colormap {
    /// Dark violet to yellow, perceptually uniform (van der Walt, Smith 2015).
    Viridis,
    /// Black over red to pale yellow, perceptually uniform (van der Walt, Smith 2015): heat.
    Inferno,
    /// A rainbow without false edges (Mikhailov, "Turbo, an improved rainbow colormap for visualization", 2019).
    Turbo,
}

/// Coefficients of a polynomial per channel, from the constant term on; Matt Zucker's fits of the sixth order to the
/// tables of matplotlib (public domain, 2019).
const VIRIDIS: [[f64; 3]; 7] = [
    [0.277_727_327_223_417_7, 0.005_407_344_544_966_578, 0.334_099_805_335_306_1],
    [0.105_093_043_108_577_4, 1.404_613_529_898_575, 1.384_590_162_594_685],
    [-0.330_861_828_725_556_3, 0.214_847_559_468_213, 0.095_095_163_028_236_59],
    [-4.634_230_498_983_486, -5.799_100_973_351_585, -19.332_440_956_279_87],
    [6.228_269_936_347_081, 14.179_933_366_805_09, 56.690_552_600_681_05],
    [4.776_384_997_670_288, -13.745_145_377_746_01, -65.353_032_633_372_34],
    [-5.435_455_855_934_631, 4.645_852_612_178_535, 26.312_435_249_583_2],
];
const INFERNO: [[f64; 3]; 7] = [
    [0.000_218_940_369_119_226_5, 0.001_651_004_631_001_012, -0.019_480_898_437_091_84],
    [0.106_513_419_485_611_6, 0.563_956_436_788_409_1, 3.932_712_388_889_277],
    [11.602_493_082_471_87, -3.972_853_965_665_698, -15.942_394_106_291_4],
    [-41.703_996_131_394_59, 17.436_398_882_053_13, 44.354_145_198_728_13],
    [77.162_935_699_427, -33.402_358_942_100_92, -81.807_309_257_389_93],
    [-71.319_428_244_992_14, 32.626_064_263_977_23, 73.209_519_858_032_02],
    [25.131_126_224_773_41, -12.242_668_952_385_67, -23.070_325_002_871_72],
];
/// Du's fit of the fifth order to Mikhailov's table (2019); its error is up to 33 of 255 at the dark end, 20 in
/// between.
const TURBO: [[f64; 3]; 6] = [
    [0.135_721_38, 0.091_402_61, 0.106_673_30],
    [4.615_392_60, 2.194_188_39, 12.641_946_08],
    [-42.660_322_58, 4.842_966_58, -60.582_048_36],
    [132.131_082_34, -14.185_033_33, 110.362_767_71],
    [-152.942_393_96, 4.277_298_57, -89.903_109_12],
    [59.286_379_43, 2.829_566_04, 27.348_249_73],
];

impl Colormap {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::Viridis, Self::Inferno, Self::Turbo];

    /// Its name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Viridis => "viridis",
            Self::Inferno => "inferno",
            Self::Turbo => "turbo",
        }
    }

    /// The sRGB colour of a fraction, which is clamped to \[0, 1\].
    pub fn color(self, fraction: f64) -> [u8; 3] {
        let coefficients: &[[f64; 3]] = match self {
            Self::Viridis => &VIRIDIS,
            Self::Inferno => &INFERNO,
            Self::Turbo => &TURBO,
        };
        let t = if fraction.is_nan() { 0.0 } else { fraction.clamp(0.0, 1.0) };
        let channel = |c: usize| coefficients.iter().rev().fold(0.0, |sum, k| sum * t + k[c]);
        std::array::from_fn(|c| (channel(c).clamp(0.0, 1.0) * 255.0).round() as u8)
    }

    /// Its 256 colours, opaque, as the texels of an image one row high.
    pub fn table(self) -> [[u8; 4]; 256] {
        std::array::from_fn(|index| {
            let [r, g, b] = self.color(index as f64 / 255.0);
            [r, g, b, 255]
        })
    }
}

/// Ticks of a scale: round numbers, with just enough decimals to distinguish them.
#[derive(Clone, Debug, PartialEq)]
pub struct Ticks {
    /// The numbers, rising, all within the range.
    pub values: Vec<f64>,
    /// Digits after the decimal point.
    pub decimals: usize,
}

impl Ticks {
    /// About `wanted` (2 to 20) round numbers between `low` and `high`: multiples of 1, 2 or 5 times a power of ten
    /// (Heckbert, "Nice numbers for graph labels", Graphics Gems, 1990). None when the range is empty or not finite.
    pub fn between(low: f64, high: f64, wanted: usize) -> Self {
        let none = Self { values: Vec::new(), decimals: 0 };
        let span = high - low;
        let wanted = wanted.clamp(2, 20);
        // A step below the resolution of the numbers would not advance.
        if !span.is_finite() || span <= low.abs().max(high.abs()) * 1e-12 || span < 1e-300 {
            return none;
        }
        let step = nice(span / (wanted - 1) as f64);
        let first = (low / step - 1e-9).ceil();
        let count = ((high / step + 1e-9).floor() - first).clamp(0.0, 64.0) as usize;
        // Adding 0 turns a negative zero into a zero.
        let values = (0..=count)
            .map(|index| (first + index as f64) * step + 0.0)
            .filter(|value| *value <= high + step * 1e-6);
        let decimals = (-step.log10().floor()).clamp(0.0, 15.0) as usize;
        Self { values: values.collect(), decimals }
    }

    /// The numbers as text.
    pub fn labels(&self) -> impl Iterator<Item = String> + '_ {
        self.values.iter().map(|value| format!("{value:.*}", self.decimals))
    }
}

/// The number nearest to `x` that is 1, 2 or 5 times a power of ten (Heckbert's thresholds).
fn nice(x: f64) -> f64 {
    let power = 10f64.powf(x.log10().floor());
    let fraction = x / power;
    let rounded = match fraction {
        f if f < 1.5 => 1.0,
        f if f < 3.0 => 2.0,
        f if f < 7.0 => 5.0,
        _ => 10.0,
    };
    rounded * power
}

#[cfg(test)]
mod tests {
    use super::*;

    fn near(found: [u8; 3], expected: [u8; 3], tolerance: u8) -> bool {
        found.iter().zip(expected).all(|(a, b)| a.abs_diff(b) <= tolerance)
    }

    #[test]
    fn maps_have_the_published_colours() {
        // The published tables at 0, 0.5 and 1; the fits stay near them, Turbo's least so at its ends.
        assert!(near(Colormap::Viridis.color(0.0), [68, 1, 84], 4));
        assert!(near(Colormap::Viridis.color(0.5), [33, 145, 140], 4));
        assert!(near(Colormap::Viridis.color(1.0), [253, 231, 37], 6));
        assert!(near(Colormap::Inferno.color(0.0), [0, 0, 4], 6));
        assert!(near(Colormap::Inferno.color(0.5), [188, 55, 84], 6));
        assert!(near(Colormap::Inferno.color(1.0), [252, 255, 164], 8));
        assert!(near(Colormap::Turbo.color(0.0), [48, 18, 59], 33));
        assert!(near(Colormap::Turbo.color(0.5), [164, 252, 60], 20));
        assert!(near(Colormap::Turbo.color(1.0), [122, 4, 3], 36));
    }

    #[test]
    fn sequential_maps_get_lighter_and_no_map_jumps() {
        let lightness =
            |[r, g, b, _]: [u8; 4]| 0.21 * f64::from(r) + 0.72 * f64::from(g) + 0.07 * f64::from(b);
        for map in Colormap::ALL {
            let table = map.table();
            for pair in table.windows(2) {
                assert!((0..3).all(|c| pair[0][c].abs_diff(pair[1][c]) <= 13), "{}: {pair:?}", map.name());
                if map != Colormap::Turbo {
                    assert!(lightness(pair[1]) >= lightness(pair[0]) - 1.0, "{}: {pair:?}", map.name());
                }
            }
            assert_eq!(map.color(-3.0), map.color(0.0));
            assert_eq!(map.color(f64::INFINITY), map.color(1.0));
            assert_eq!(map.color(f64::NAN), map.color(0.0));
        }
    }

    #[test]
    fn ticks_are_round_and_within_the_range() {
        let labels = |low, high, wanted| Ticks::between(low, high, wanted).labels().collect::<Vec<_>>();
        assert_eq!(labels(20.0, 120.0, 6), ["20", "40", "60", "80", "100", "120"]);
        assert_eq!(labels(-0.13, 0.27, 5), ["-0.1", "0.0", "0.1", "0.2"]);
        assert_eq!(labels(0.0, 1.0, 3), ["0.0", "0.5", "1.0"]);
        assert_eq!(labels(36.9, 37.4, 6), ["36.9", "37.0", "37.1", "37.2", "37.3", "37.4"]);
        assert_eq!(labels(0.0, 2.5e6, 4), ["0", "1000000", "2000000"]);
    }

    #[test]
    fn ticks_of_any_range_are_few_and_rise() {
        let numbers = [-1e300, -1e9, -1.0, -1e-9, 0.0, 1e-12, 0.3, 7.0, 1e9, 1e300, f64::NAN, f64::INFINITY];
        for (low, high) in numbers.iter().flat_map(|a| numbers.iter().map(move |b| (*a, *b))) {
            for wanted in [0, 2, 5, 20, 1000] {
                let ticks = Ticks::between(low, high, wanted);
                assert!(ticks.values.len() <= 65);
                assert!(
                    ticks.values.windows(2).all(|pair| pair[0] < pair[1]),
                    "{low} {high} {wanted}: {ticks:?}"
                );
                let slack = (high - low).abs() * 1e-6;
                assert!(ticks.values.iter().all(|v| *v >= low - slack && *v <= high + slack), "{ticks:?}");
                if low < high && (high - low).is_finite() && low.abs() < 1e8 * (high - low) {
                    assert!(!ticks.values.is_empty(), "{low} {high} {wanted}");
                }
            }
        }
    }
}
