//! Why a message of the control channel is refused.

use thiserror::Error;

/// Why some bytes are no message, or not one within the limits.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum MessageError {
    /// Not postcard of a message.
    #[error("a frame of {bytes} bytes is no message: {reason}")]
    Encoding {
        /// Bytes of the message.
        bytes: usize,
        /// What postcard says.
        reason: postcard::Error,
    },
    /// More bytes than the message has.
    #[error("a message '{message}' has {rest} bytes too many")]
    Trailing {
        /// The message.
        message: &'static str,
        /// How many.
        rest: usize,
    },
    /// Too many of something.
    #[error("a message has {found} {what}; at most {most} are valid")]
    Limit {
        /// Of what.
        what: &'static str,
        /// How many.
        found: usize,
        /// The limit.
        most: usize,
    },
    /// A number that is not finite or out of its range.
    #[error("a message has an invalid {0}")]
    Number(&'static str),
}

impl MessageError {
    pub(super) fn limit(what: &'static str, found: usize, most: usize) -> Result<(), Self> {
        if found > most { Err(Self::Limit { what, found, most }) } else { Ok(()) }
    }
}
