//! Whole numbers as postcard writes them: seven bits a byte, least significant first.

/// Appends an unsigned number.
pub fn write(mut value: u64, out: &mut Vec<u8>) {
    while value >= 0x80 {
        out.push(value as u8 | 0x80);
        value >>= 7;
    }
    out.push(value as u8);
}

/// Small numbers of either sign as small unsigned ones.
pub fn zigzag(value: i64) -> u64 {
    ((value << 1) ^ (value >> 63)) as u64
}

/// The number of which [`zigzag`] made this one.
pub fn unzigzag(value: u64) -> i64 {
    (value >> 1) as i64 ^ -((value & 1) as i64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_those_of_postcard() {
        for value in [0, 1, -1, 63, -64, 64, 127, 128, 16_384, i64::MAX, i64::MIN] {
            let mut out = Vec::new();
            write(zigzag(value), &mut out);
            assert_eq!(out, postcard::to_stdvec(&value).expect("it encodes"));
            assert_eq!(unzigzag(zigzag(value)), value);
            out.clear();
            write(value as u64, &mut out);
            assert_eq!(out, postcard::to_stdvec(&(value as u64)).expect("it encodes"));
        }
    }
}
