//! Invitation: what a station has to know to dial another one.

use serde::{Deserialize, Serialize};
use thiserror::Error;

/// Bytes of a token.
pub const TOKEN_BYTES: usize = 32;
/// Most bytes of what a door needs to be found.
const DOOR_BYTES_MAX: usize = 2 << 10;

/// An invitation to one station. It travels over the control channels alone.
#[derive(Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Invitation {
    /// Shows that it is the invited station that dials.
    pub token: [u8; TOKEN_BYTES],
    /// Where the door is, as its driver wrote it.
    pub door: Vec<u8>,
}

/// The token is not shown.
impl std::fmt::Debug for Invitation {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Invitation").field("door", &self.door.len()).finish_non_exhaustive()
    }
}

/// Bytes that are no invitation.
#[derive(Clone, Copy, Debug, Error, PartialEq, Eq)]
#[error("{0} bytes that are no invitation to another station")]
pub struct InvitationError(usize);

impl Invitation {
    /// As bytes.
    pub fn to_bytes(&self) -> Vec<u8> {
        // Lists of bytes can always be written.
        postcard::to_allocvec(self).unwrap_or_default()
    }

    /// Reads what [`Self::to_bytes`] wrote.
    ///
    /// # Errors
    /// [`InvitationError`].
    pub fn read(bytes: &[u8]) -> Result<Self, InvitationError> {
        match postcard::take_from_bytes::<Self>(bytes) {
            Ok((invitation, [])) if invitation.door.len() <= DOOR_BYTES_MAX => Ok(invitation),
            _ => Err(InvitationError(bytes.len())),
        }
    }

    /// The number of the pair's datagrams, which both ends make of the token.
    pub fn connection(&self) -> u32 {
        connection_of(&self.token)
    }
}

pub(super) fn connection_of(token: &[u8; TOKEN_BYTES]) -> u32 {
    let hash = blake3::derive_key("trocar-network number of a pair's connection", token);
    u32::from_le_bytes([hash[0], hash[1], hash[2], hash[3]])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn invitations_come_back_and_other_bytes_are_refused() {
        let invitation = Invitation { token: [7; TOKEN_BYTES], door: b"somewhere".to_vec() };
        let bytes = invitation.to_bytes();
        assert_eq!(Invitation::read(&bytes), Ok(invitation.clone()));
        for length in 0..bytes.len() {
            assert!(Invitation::read(&bytes[..length]).is_err());
        }
        let long = Invitation { door: vec![0; DOOR_BYTES_MAX + 1], ..invitation.clone() };
        assert!(Invitation::read(&long.to_bytes()).is_err());
        assert!(Invitation::read(&[&bytes[..], &[0]].concat()).is_err());
        assert!(!format!("{invitation:?}").contains('7'), "a token is shown nowhere");
    }
}
