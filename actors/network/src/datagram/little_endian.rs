//! Little-endian fields, one after the other, in a slice of known length.

/// Reads fields; every read fails once the bytes do not suffice.
pub(super) struct Reader<'a>(pub &'a [u8]);

impl Reader<'_> {
    fn take<const N: usize>(&mut self) -> Option<[u8; N]> {
        let (field, rest) = self.0.split_first_chunk()?;
        self.0 = rest;
        Some(*field)
    }
    pub fn u8(&mut self) -> Option<u8> {
        self.take().map(u8::from_le_bytes)
    }
    pub fn u16(&mut self) -> Option<u16> {
        self.take().map(u16::from_le_bytes)
    }
    pub fn u32(&mut self) -> Option<u32> {
        self.take().map(u32::from_le_bytes)
    }
    pub fn u64(&mut self) -> Option<u64> {
        self.take().map(u64::from_le_bytes)
    }
    /// Numbers of single precision, widened.
    pub fn f32s<const N: usize>(&mut self) -> Option<[f64; N]> {
        let mut numbers = [0.0; N];
        for number in &mut numbers {
            *number = f64::from(f32::from_le_bytes(self.take()?));
        }
        Some(numbers)
    }
}

/// Writes fields into a slice whose length the caller has checked; what does not fit is left out.
pub(super) struct Writer<'a>(pub &'a mut [u8]);

impl Writer<'_> {
    pub fn bytes<const N: usize>(&mut self, field: [u8; N]) -> &mut Self {
        if let Some((place, rest)) = std::mem::take(&mut self.0).split_first_chunk_mut() {
            *place = field;
            self.0 = rest;
        } else {
            debug_assert!(false, "the caller made no room for {N} bytes");
        }
        self
    }
    pub fn u8(&mut self, value: u8) -> &mut Self {
        self.bytes([value])
    }
    pub fn u16(&mut self, value: u16) -> &mut Self {
        self.bytes(value.to_le_bytes())
    }
    pub fn u32(&mut self, value: u32) -> &mut Self {
        self.bytes(value.to_le_bytes())
    }
    pub fn u64(&mut self, value: u64) -> &mut Self {
        self.bytes(value.to_le_bytes())
    }
    /// Numbers in single precision; what is beyond its range becomes its greatest number of that sign.
    pub fn f32s(&mut self, numbers: &[f64]) -> &mut Self {
        for number in numbers {
            let most = f64::from(f32::MAX);
            self.bytes((number.clamp(-most, most) as f32).to_le_bytes());
        }
        self
    }
}
