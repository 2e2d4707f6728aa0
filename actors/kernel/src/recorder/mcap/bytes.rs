//! Reader of MCAP primitives from untrusted bytes: every length is checked before it is used.

/// The unread rest of a byte slice.
#[derive(Clone, Copy)]
pub(in crate::recorder) struct Bytes<'a>(pub(in crate::recorder) &'a [u8]);

/// The bytes end before the value does.
#[derive(Debug)]
pub(in crate::recorder) struct UnexpectedEnd;

impl From<UnexpectedEnd> for String {
    fn from(_: UnexpectedEnd) -> Self {
        "the record ends in the middle of a value".to_owned()
    }
}

impl<'a> Bytes<'a> {
    pub(in crate::recorder) fn take(&mut self, count: u64) -> Result<&'a [u8], UnexpectedEnd> {
        let count = usize::try_from(count).map_err(|_| UnexpectedEnd)?;
        if count > self.0.len() {
            return Err(UnexpectedEnd);
        }
        let (taken, rest) = self.0.split_at(count);
        self.0 = rest;
        Ok(taken)
    }
    fn array<const N: usize>(&mut self) -> Result<[u8; N], UnexpectedEnd> {
        let (taken, rest) = self.0.split_first_chunk::<N>().ok_or(UnexpectedEnd)?;
        self.0 = rest;
        Ok(*taken)
    }
    pub(in crate::recorder) fn u8(&mut self) -> Result<u8, UnexpectedEnd> {
        Ok(self.array::<1>()?[0])
    }
    pub(in crate::recorder) fn u16(&mut self) -> Result<u16, UnexpectedEnd> {
        self.array().map(u16::from_le_bytes)
    }
    pub(in crate::recorder) fn u32(&mut self) -> Result<u32, UnexpectedEnd> {
        self.array().map(u32::from_le_bytes)
    }
    pub(in crate::recorder) fn u64(&mut self) -> Result<u64, UnexpectedEnd> {
        self.array().map(u64::from_le_bytes)
    }
    /// A length-prefixed string; invalid UTF-8 is replaced.
    pub(in crate::recorder) fn text(&mut self) -> Result<String, UnexpectedEnd> {
        let length = self.u32()?;
        Ok(String::from_utf8_lossy(self.take(u64::from(length))?).into_owned())
    }
}
