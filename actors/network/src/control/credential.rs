//! What a station shows to be let in.

use std::fmt;

use serde::de::{Error, SeqAccess, Visitor};
use serde::ser::SerializeTuple;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use crate::ticket::{ResumeSecret, Secret, Token};

/// What lets a station in. It travels inside the TLS session only, and its `Debug` shows no secret.
///
/// The station makes its resume secret itself and shows it with the token: if the host's answer is lost, the token is
/// spent, and the station comes in by the secret all the same.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Credential {
    /// A ticket's token for the first time, and the secret with which the station wants to come back.
    Ticket {
        /// Of the ticket.
        #[serde(with = "secret_bytes")]
        token: Token,
        /// Made by the station.
        #[serde(with = "secret_bytes")]
        resume: ResumeSecret,
    },
    /// The secret of a station that was there before.
    Resume {
        /// The one shown with the token.
        #[serde(with = "secret_bytes")]
        resume: ResumeSecret,
    },
}

impl Credential {
    /// The same station, without its token.
    pub fn for_coming_back(&self) -> Self {
        let (Self::Ticket { resume, .. } | Self::Resume { resume }) = self;
        Self::Resume { resume: resume.clone() }
    }
}

/// Secrets as bare bytes. They have no `Serialize` of their own, so that none is written anywhere by mistake.
mod secret_bytes {
    use super::*;

    pub fn serialize<const N: usize, S: Serializer>(
        secret: &Secret<N>,
        serializer: S,
    ) -> Result<S::Ok, S::Error> {
        let mut tuple = serializer.serialize_tuple(N)?;
        secret.as_bytes().iter().try_for_each(|byte| tuple.serialize_element(byte))?;
        tuple.end()
    }

    pub fn deserialize<'de, const N: usize, D: Deserializer<'de>>(
        deserializer: D,
    ) -> Result<Secret<N>, D::Error> {
        struct Bytes<const N: usize>;
        impl<'de, const N: usize> Visitor<'de> for Bytes<N> {
            type Value = Secret<N>;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                write!(f, "{N} bytes")
            }

            fn visit_seq<A: SeqAccess<'de>>(self, mut sequence: A) -> Result<Secret<N>, A::Error> {
                let mut bytes = [0; N];
                for (at, byte) in bytes.iter_mut().enumerate() {
                    *byte = sequence.next_element()?.ok_or_else(|| A::Error::invalid_length(at, &self))?;
                }
                Ok(Secret::from_bytes(bytes))
            }
        }
        deserializer.deserialize_tuple(N, Bytes)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_credential_comes_over_the_wire_whole_and_its_debug_text_has_no_secret() {
        let credential = Credential::Ticket {
            token: Token::from_bytes([0xab; 16]),
            resume: ResumeSecret::from_bytes([0xcd; 32]),
        };
        let bytes = postcard::to_stdvec(&credential).expect("it encodes");
        assert_eq!(bytes.len(), 1 + 16 + 32);
        assert_eq!(postcard::from_bytes(&bytes), Ok(credential.clone()));
        assert!(postcard::from_bytes::<Credential>(&bytes[..40]).is_err());
        let text = format!("{credential:?} {:?}", credential.for_coming_back());
        for secret in ["ab", "171", "cd", "205"] {
            assert!(!text.to_lowercase().contains(secret), "{text}");
        }
    }
}
