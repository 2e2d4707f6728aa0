//! Planes of bytes: the lowest bytes of many numbers, then the next ones; and the reader of both planes and varints.

/// Appends the number of planes and the planes. There is at least one for any numbers, so that what is read is never
/// more than eight times what was written.
pub(super) fn write_planes(values: &[u64], out: &mut Vec<u8>) {
    let all = values.iter().fold(0, |all, value| all | value);
    let planes = (8 - all.leading_zeros() / 8).max(1);
    out.push(planes as u8);
    out.reserve(values.len() * planes as usize);
    for plane in 0..planes {
        out.extend(values.iter().map(|value| (value >> (8 * plane)) as u8));
    }
}

/// The unread rest of some bytes.
#[derive(Clone, Copy)]
pub(in super::super) struct Cursor<'a>(pub(in super::super) &'a [u8]);

impl<'a> Cursor<'a> {
    pub(in super::super) fn take(&mut self, count: usize) -> Result<&'a [u8], String> {
        if count > self.0.len() {
            return Err(format!("{count} bytes are expected, {} are left", self.0.len()));
        }
        let (taken, rest) = self.0.split_at(count);
        self.0 = rest;
        Ok(taken)
    }

    pub(in super::super) fn byte(&mut self) -> Result<u8, String> {
        Ok(self.take(1)?[0])
    }

    pub(in super::super) fn varint(&mut self) -> Result<u64, String> {
        let mut value = 0_u64;
        for shift in (0..64).step_by(7) {
            let byte = self.byte()?;
            value |= u64::from(byte & 0x7f) << shift;
            if byte < 0x80 {
                return Ok(value);
            }
        }
        Err("a number of more than 64 bits".to_owned())
    }

    /// A number of things, each of which takes at least one of the bytes that are left.
    pub(in super::super) fn count(&mut self, what: &str) -> Result<usize, String> {
        let count = self.varint()?;
        match usize::try_from(count) {
            Ok(count) if count <= self.0.len() => Ok(count),
            _ => Err(format!("{count} {what} in {} bytes", self.0.len())),
        }
    }

    /// What [`write_planes`] wrote of `count` numbers.
    pub(super) fn planes(&mut self, count: usize) -> Result<Vec<u64>, String> {
        let planes = usize::from(self.byte()?);
        if !(1..=8).contains(&planes) {
            return Err(format!("{planes} planes of bytes; valid: 1 to 8"));
        }
        let bytes = self.take(count.checked_mul(planes).ok_or("too many numbers")?)?;
        let mut values = vec![0_u64; count];
        for (plane, bytes) in bytes.chunks_exact(count.max(1)).enumerate() {
            for (value, byte) in values.iter_mut().zip(bytes) {
                *value |= u64::from(*byte) << (8 * plane);
            }
        }
        Ok(values)
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use trocar_scene::varint;

    use super::*;

    proptest! {
        #[test]
        fn numbers_come_back(values in prop::collection::vec(any::<u64>(), 0..40), bits in 0..64) {
            let values: Vec<u64> = values.iter().map(|value| value >> bits).collect();
            let mut out = Vec::new();
            write_planes(&values, &mut out);
            values.iter().for_each(|value| varint::write(*value, &mut out));
            let mut cursor = Cursor(&out);
            prop_assert_eq!(&cursor.planes(values.len()).expect("whole"), &values);
            for value in &values {
                prop_assert_eq!(cursor.varint().expect("whole"), *value);
                prop_assert_eq!(varint::unzigzag(varint::zigzag(*value as i64)), *value as i64);
            }
            prop_assert!(cursor.0.is_empty() && cursor.varint().is_err());
        }
    }
}
