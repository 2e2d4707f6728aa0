//! Base64 with the standard alphabet (RFC 4648), padding optional; several runs, each with a padding of its own, may follow
//! each other, as VTK writes them.

/// Decodes a text piece by piece.
pub(super) struct Base64<'a> {
    text: &'a [u8],
    at: usize,
    /// Bytes that are decoded and not yet taken: those of one group of four symbols.
    ready: [u8; 3],
    next: usize,
    end: usize,
}

impl<'a> Base64<'a> {
    pub fn new(text: &'a [u8]) -> Self {
        Self { text, at: 0, ready: [0; 3], next: 0, end: 0 }
    }

    /// Bytes that the rest of the text can hold at most.
    pub fn bytes_max(&self) -> usize {
        (self.text.len() - self.at) / 4 * 3 + 3 + (self.end - self.next)
    }

    /// Everything; `None` when a symbol is not of the alphabet, or when a single one is left over.
    pub fn all(mut self) -> Option<Vec<u8>> {
        let mut bytes = Vec::with_capacity(self.bytes_max());
        while let Some(byte) = self.byte()? {
            bytes.push(byte);
        }
        Some(bytes)
    }

    /// The next `count` bytes; `None` when there are fewer or a symbol is not of the alphabet.
    pub fn take(&mut self, count: usize) -> Option<Vec<u8>> {
        if count > self.bytes_max() {
            return None;
        }
        let mut bytes = Vec::with_capacity(count);
        while bytes.len() < count {
            bytes.push(self.byte()??);
        }
        Some(bytes)
    }

    /// The next byte, or the end as an inner `None`.
    fn byte(&mut self) -> Option<Option<u8>> {
        if self.next == self.end {
            self.group()?;
        }
        let byte = self.ready[..self.end].get(self.next).copied();
        self.next += usize::from(byte.is_some());
        Some(byte)
    }

    /// Decodes the next group: up to four symbols, white space between them skipped.
    fn group(&mut self) -> Option<()> {
        let (mut bits, mut symbols, mut padding) = (0u32, 0, 0);
        while symbols + padding < 4 {
            let Some(&symbol) = self.text.get(self.at) else { break };
            self.at += 1;
            let value = match symbol {
                b'=' => {
                    padding += 1;
                    continue;
                }
                _ if symbol.is_ascii_whitespace() => continue,
                _ if padding > 0 => return None,
                b'A'..=b'Z' => symbol - b'A',
                b'a'..=b'z' => symbol - b'a' + 26,
                b'0'..=b'9' => symbol - b'0' + 52,
                b'+' => 62,
                b'/' => 63,
                _ => return None,
            };
            bits = bits << 6 | u32::from(value);
            symbols += 1;
        }
        (self.next, self.end) = (0, 0);
        match symbols {
            0 if padding == 0 => {}
            2..=4 => {
                let bytes = (bits << (6 * (4 - symbols))).to_be_bytes();
                self.ready.copy_from_slice(&bytes[1..]);
                self.end = symbols - 1;
            }
            _ => return None,
        }
        Some(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn decoded(text: &[u8]) -> Option<Vec<u8>> {
        Base64::new(text).all()
    }

    #[test]
    fn base64_of_rfc_4648_decodes() {
        let cases = [("", ""), ("Zg==", "f"), ("Zm8=", "fo"), ("Zm9v", "foo"), ("Zm9vYg==", "foob")];
        for (text, plain) in cases {
            assert_eq!(decoded(text.as_bytes()).as_deref(), Some(plain.as_bytes()));
        }
        assert_eq!(decoded(b"Zm9vYmE"), Some(b"fooba".to_vec()));
        assert_eq!(decoded(b"Zm9v!"), None);
        assert_eq!(decoded(b"A"), None);
        assert_eq!(decoded(b"=Zm9v"), None);
    }

    #[test]
    fn runs_with_a_padding_of_their_own_follow_each_other_and_white_space_is_skipped() {
        assert_eq!(decoded(b"Zg==Zm8=\n Zm9v"), Some(b"ffofoo".to_vec()));
        let mut source = Base64::new(b"Zg==Zm9v");
        assert_eq!(source.take(2), Some(b"ff".to_vec()));
        assert_eq!(source.take(2), Some(b"oo".to_vec()));
        assert_eq!(source.take(1), None);
        assert_eq!(Base64::new(b"Zg==").take(usize::MAX), None);
    }
}
