//! Reads bytes from outside one after another, without going beyond their end.

/// The bytes that are left.
pub(super) struct ByteReader<'a>(pub &'a [u8]);

impl<'a> ByteReader<'a> {
    /// The next `count` bytes; `None` when there are fewer.
    pub fn bytes(&mut self, count: usize) -> Option<&'a [u8]> {
        let (taken, left) = self.0.split_at_checked(count)?;
        self.0 = left;
        Some(taken)
    }

    /// The next `N` bytes.
    pub fn array<const N: usize>(&mut self) -> Option<[u8; N]> {
        let (taken, left) = self.0.split_first_chunk::<N>()?;
        self.0 = left;
        Some(*taken)
    }

    /// The next byte.
    pub fn byte(&mut self) -> Option<u8> {
        self.array::<1>().map(|[byte]| byte)
    }

    /// A text with its length in one byte before it; `None` also when it is no UTF-8.
    pub fn text(&mut self) -> Option<&'a str> {
        let count = self.byte()?;
        std::str::from_utf8(self.bytes(count.into())?).ok()
    }
}
