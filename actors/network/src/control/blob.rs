//! Bytes within a message that are not copied on the way: borrowed from the sender's memory, and from the frame.

use std::borrow::Cow;
use std::fmt;

use serde::de::{Error, Visitor};
use serde::{Deserialize, Deserializer, Serialize, Serializer};

/// Bytes that the control channel carries without looking into them.
#[derive(Clone, PartialEq, Eq)]
pub struct Blob<'a>(Cow<'a, [u8]>);

impl Blob<'_> {
    /// The bytes.
    pub fn as_slice(&self) -> &[u8] {
        &self.0
    }
}

impl<'a> From<&'a [u8]> for Blob<'a> {
    fn from(bytes: &'a [u8]) -> Self {
        Self(Cow::Borrowed(bytes))
    }
}

impl From<Vec<u8>> for Blob<'_> {
    fn from(bytes: Vec<u8>) -> Self {
        Self(Cow::Owned(bytes))
    }
}

/// Its length alone: contents may be large, or somebody's.
impl fmt::Debug for Blob<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Blob({} bytes)", self.0.len())
    }
}

impl Serialize for Blob<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_bytes(&self.0)
    }
}

impl<'de: 'a, 'a> Deserialize<'de> for Blob<'a> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Borrowing;
        impl<'de> Visitor<'de> for Borrowing {
            type Value = Blob<'de>;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("bytes")
            }

            fn visit_borrowed_bytes<E: Error>(self, bytes: &'de [u8]) -> Result<Blob<'de>, E> {
                Ok(Blob::from(bytes))
            }

            fn visit_bytes<E: Error>(self, bytes: &[u8]) -> Result<Blob<'de>, E> {
                Ok(Blob::from(bytes.to_vec()))
            }
        }
        deserializer.deserialize_bytes(Borrowing)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_blob_is_borrowed_from_the_frame_and_one_that_is_cut_off_is_refused() {
        let bytes = postcard::to_stdvec(&Blob::from(vec![1, 2, 3])).expect("it encodes");
        assert_eq!(bytes, [3, 1, 2, 3]);
        let blob: Blob<'_> = postcard::from_bytes(&bytes).expect("it decodes");
        assert!(matches!(blob.0, Cow::Borrowed([1, 2, 3])));
        assert!(postcard::from_bytes::<Blob<'_>>(&bytes[..3]).is_err());
        assert_eq!(format!("{blob:?}"), "Blob(3 bytes)");
    }
}
