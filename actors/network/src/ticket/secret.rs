//! Secrets that let somebody in: tokens of tickets, and the resume secrets of stations.

use std::fmt;

use ring::rand::SecureRandom;
use serde::{Deserialize, Serialize};
use thiserror::Error;

/// Names what the hash is for, so that no other hash in the program is ever equal to it.
const HASH_CONTEXT: &str = "trocar-network 2026-11-29 hash of a ticket's token or a resume secret";

/// A secret of `N` random bytes. It is never shown: only [`Ticket`](super::Ticket) prints its token.
#[derive(Clone)]
pub struct Secret<const N: usize>([u8; N]);

/// What a ticket lets in with, once: 128 bits.
pub type Token = Secret<16>;
/// What a station comes back with after a break: 256 bits.
pub type ResumeSecret = Secret<32>;

/// The source of randomness failed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[error("the system gives no random numbers, so no secret can be made")]
pub struct NoRandomness;

impl<const N: usize> Secret<N> {
    /// A new secret.
    ///
    /// # Errors
    /// [`NoRandomness`].
    pub fn random(random: &dyn SecureRandom) -> Result<Self, NoRandomness> {
        let mut bytes = [0; N];
        random.fill(&mut bytes).map_err(|_| NoRandomness)?;
        Ok(Self(bytes))
    }

    /// A secret that somebody shows.
    pub const fn from_bytes(bytes: [u8; N]) -> Self {
        Self(bytes)
    }

    /// Its bytes, to be sent inside a TLS session or written to a file of mode 0600, and nowhere else.
    pub const fn as_bytes(&self) -> &[u8; N] {
        &self.0
    }

    /// What the host keeps of it. Secrets have too many bits to be found from their hash, so it needs no salt.
    pub fn hash(&self) -> SecretHash {
        SecretHash(blake3::derive_key(HASH_CONTEXT, &self.0))
    }
}

/// In constant time.
impl<const N: usize> PartialEq for Secret<N> {
    fn eq(&self, other: &Self) -> bool {
        self.hash() == other.hash()
    }
}

impl<const N: usize> Eq for Secret<N> {}

impl<const N: usize> fmt::Debug for Secret<N> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Secret({N} bytes, hidden)")
    }
}

/// Hash of a secret (BLAKE3 with a context of its own). Nobody gets in with it.
#[derive(Clone, Copy, Serialize, Deserialize)]
pub struct SecretHash([u8; 32]);

/// In constant time: how long a wrong guess takes does not tell how much of it was right.
impl PartialEq for SecretHash {
    fn eq(&self, other: &Self) -> bool {
        blake3::Hash::from_bytes(self.0) == blake3::Hash::from_bytes(other.0)
    }
}

impl Eq for SecretHash {}

impl fmt::Debug for SecretHash {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("SecretHash(hidden)")
    }
}

#[cfg(test)]
mod tests {
    use ring::rand::SystemRandom;

    use super::*;

    #[test]
    fn two_secrets_differ_and_one_equals_its_copy() {
        let one = Token::random(&SystemRandom::new()).expect("random numbers");
        let other = Token::random(&SystemRandom::new()).expect("random numbers");
        assert_ne!(one, other);
        assert_eq!(one, Token::from_bytes(*one.as_bytes()));
        assert_eq!(one.hash(), one.clone().hash());
        assert_ne!(one.hash(), other.hash());
    }

    #[test]
    fn no_byte_of_a_secret_or_its_hash_is_in_its_debug_text() {
        let secret = ResumeSecret::from_bytes([0xab; 32]);
        assert_eq!(format!("{secret:?}"), "Secret(32 bytes, hidden)");
        assert_eq!(format!("{:?}", secret.hash()), "SecretHash(hidden)");
    }
}
