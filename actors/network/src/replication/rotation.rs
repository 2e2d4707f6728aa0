//! Rotations in seven bytes: the smallest three of the four numbers of a unit quaternion, after Fiedler, "Snapshot
//! compression" (2015).
//!
//! The number of greatest magnitude is left out and made positive, which changes no rotation; the other three lie
//! within ±1/√2 and are rounded to multiples of [`STEP`]. The rotation that comes out is off by at most
//! [`ROTATION_ERROR_MAX`].
//!
//! Where the two greatest numbers are nearly equal, the rotation that comes out may be one of which the *other* number
//! would be left out. [`quantise`] follows that to its end, so that quantising twice is the same as quantising once:
//! two stations can compare what they hold, although only one has the original.

use nalgebra::{Quaternion, UnitQuaternion};

use super::ReplicationError;
use super::wire_reader::WireReader;

/// Largest magnitude of a rounded number: 18 bits with its sign.
const MOST: i32 = (1 << 17) - 1;
/// Step of the three numbers.
pub const STEP: f64 = std::f64::consts::FRAC_1_SQRT_2 / MOST as f64;
/// Largest angle between a rotation and what comes out of it \[rad\]: three numbers are off by half a step each, and the
/// fourth, which is the greatest, by at most the sum of that; twice the length of all four.
pub const ROTATION_ERROR_MAX: f64 = 3.47 * STEP;
/// Bytes of an encoded rotation.
pub const ROTATION_BYTES: usize = 7;

/// A rounded rotation.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct SmallestThree {
    /// Which of x, y, z, w was left out.
    greatest: u8,
    /// The others in that order, in steps.
    rest: [i32; 3],
}

impl SmallestThree {
    fn once(rotation: &UnitQuaternion<f64>) -> Self {
        let numbers = rotation.coords;
        let mut greatest = 0;
        for k in 1..4 {
            if numbers[k].abs() > numbers[greatest].abs() {
                greatest = k;
            }
        }
        let sign = numbers[greatest].signum();
        let mut rest = [0; 3];
        let others = (0..4).filter(|k| *k != greatest);
        for (place, k) in rest.iter_mut().zip(others) {
            *place = ((sign * numbers[k] / STEP).round() as i32).clamp(-MOST, MOST);
        }
        Self { greatest: greatest as u8, rest }
    }

    /// The rotation, of unit length.
    pub fn rotation(&self) -> UnitQuaternion<f64> {
        let three = self.rest.map(|steps| f64::from(steps) * STEP);
        let squares: f64 = three.iter().map(|number| number * number).sum();
        let mut numbers = [0.0; 4];
        let greatest = usize::from(self.greatest & 3);
        numbers[greatest] = (1.0 - squares).max(0.0).sqrt();
        let others = (0..4).filter(|k| *k != greatest);
        others.zip(three).for_each(|(k, number)| numbers[k] = number);
        let [x, y, z, w] = numbers;
        UnitQuaternion::new_unchecked(Quaternion::new(w, x, y, z))
    }

    /// Appends seven bytes.
    pub fn write(&self, out: &mut Vec<u8>) {
        let mut bits = u64::from(self.greatest);
        for (k, steps) in self.rest.iter().enumerate() {
            bits |= ((steps + MOST) as u64) << (2 + 18 * k);
        }
        out.extend_from_slice(&bits.to_le_bytes()[..ROTATION_BYTES]);
    }

    pub(super) fn read(reader: &mut WireReader<'_>) -> Result<Self, ReplicationError> {
        let mut bytes = [0; 8];
        bytes[..ROTATION_BYTES].copy_from_slice(reader.take(ROTATION_BYTES)?);
        let bits = u64::from_le_bytes(bytes);
        let rest = [0, 1, 2].map(|k| ((bits >> (2 + 18 * k)) & 0x3_ffff) as i32 - MOST);
        let squares: f64 = rest.iter().map(|steps| (f64::from(*steps) * STEP).powi(2)).sum();
        // Rounding puts three numbers of 1/√3 each half a step beyond the unit sphere at most.
        if squares > 1.0 + 4.0 * STEP {
            return Err(reader.refuse(bits, "a rotation of unit length"));
        }
        Ok(Self { greatest: (bits & 3) as u8, rest })
    }
}

/// Rounds a rotation; rounding what comes out again gives the same.
pub fn quantise(rotation: &UnitQuaternion<f64>) -> SmallestThree {
    /// Longest way seen is three, from rotations of which all four numbers are nearly equal.
    const WAY_MAX: usize = 8;
    let mut way = [SmallestThree::once(rotation); WAY_MAX];
    for step in 1..WAY_MAX {
        let next = SmallestThree::once(&way[step - 1].rotation());
        if let Some(begin) = way[..step].iter().position(|seen| *seen == next) {
            // It goes round from there on, or stays; of a round all stations take the same one.
            return way[begin..step].iter().copied().min().unwrap_or(next);
        }
        way[step] = next;
    }
    way[WAY_MAX - 1]
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use trocar_scene::random::SplitMix64;

    use super::*;

    fn off(rotation: &UnitQuaternion<f64>) -> f64 {
        quantise(rotation).rotation().angle_to(rotation)
    }

    fn unit(numbers: [f64; 4]) -> Option<UnitQuaternion<f64>> {
        UnitQuaternion::try_new(Quaternion::from(numbers), 1e-3)
    }

    #[test]
    fn rotations_come_back_within_a_fiftieth_of_a_milliradian() {
        let mut random = SplitMix64::new(1);
        let mut worst = 0.0_f64;
        for _ in 0..100_000 {
            let numbers = [(); 4].map(|()| 2.0 * random.unit() - 1.0);
            worst = worst.max(unit(numbers).map_or(0.0, |rotation| off(&rotation)));
        }
        assert!(worst <= ROTATION_ERROR_MAX && ROTATION_ERROR_MAX < 2e-5, "{worst}");
        assert!(off(&UnitQuaternion::identity()) == 0.0);
    }

    proptest! {
        #[test]
        fn rounding_twice_is_rounding_once(
            signs in prop::array::uniform4(prop::sample::select(vec![-1.0, 1.0, 0.0])),
            slight in prop::array::uniform4(-4.0_f64..4.0),
            free in prop::array::uniform4(-1.0_f64..1.0),
        ) {
            // Nearly equal numbers, which are where it is hard; and any.
            let close = std::array::from_fn(|k| signs[k] + slight[k] * STEP);
            for numbers in [close, free] {
                if let Some(rotation) = unit(numbers) {
                    let once = quantise(&rotation);
                    prop_assert_eq!(quantise(&once.rotation()), once);
                    prop_assert!((once.rotation().norm() - 1.0).abs() < 1e-9);
                    prop_assert!(off(&rotation) <= 4.0 * ROTATION_ERROR_MAX);
                    let mut bytes = Vec::new();
                    once.write(&mut bytes);
                    prop_assert_eq!(SmallestThree::read(&mut WireReader::new("rotation", &bytes)), Ok(once));
                }
            }
        }

        #[test]
        fn any_seven_bytes_are_a_unit_rotation_or_refused(bytes in prop::array::uniform7(any::<u8>())) {
            if let Ok(read) = SmallestThree::read(&mut WireReader::new("rotation", &bytes)) {
                prop_assert!((read.rotation().norm() - 1.0).abs() < 1e-4);
            }
        }
    }
}
