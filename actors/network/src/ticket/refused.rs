//! Why a host lets somebody not in.

use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::unix_time::{span, utc};

/// Why a token or a resume secret is refused. The host tells the station, which shows it. Times are in seconds since 1970
/// by the host's clock.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Refused {
    /// The host never gave it out, or has forgotten it long after its expiry.
    #[error("the host does not know this ticket or station; ask the host for a new ticket")]
    Unknown,
    /// A ticket that has let somebody in already.
    #[error("the ticket was used already, at {}; a ticket lets in once: ask the host for a new one", utc(*at))]
    Spent {
        /// When it was used.
        at: u64,
    },
    /// The station chose the resume secret of another one, so that the two could not be told apart.
    #[error(
        "the station's resume secret is not its own; let the station make a new one, the ticket is still good"
    )]
    SecretInUse,
    /// Too old.
    #[error(
        "the ticket or station expired at {}, {} ago by the host's clock; ask for a new ticket, or let the host's clock \
         be set if it is not {} now",
        utc(*expired_at), span(now.saturating_sub(*expired_at)), utc(*now)
    )]
    Expired {
        /// When it expired.
        expired_at: u64,
        /// Time of the host's clock.
        now: u64,
    },
    /// Withdrawn by the host.
    #[error("the host withdrew this ticket at {}", utc(*at))]
    Revoked {
        /// When.
        at: u64,
    },
    /// The host's clock has gone back since, so that it cannot judge an expiry.
    #[error(
        "the host gave this ticket out at {}, but its clock shows {} now; let the host's clock be set, then try again",
        utc(*issued_at), utc(*now)
    )]
    ClockWentBack {
        /// When the ticket was given out.
        issued_at: u64,
        /// Time of the host's clock.
        now: u64,
    },
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_host_whose_clock_is_an_hour_wrong_says_what_time_it_takes_it_to_be() {
        let expired = Refused::Expired { expired_at: 1_795_938_052, now: 1_795_938_052 + 3_600 };
        let text = expired.to_string();
        assert!(
            text.contains("expired at 2026-11-29 07:40:52 UTC, 1 h 0 min ago by the host's clock"),
            "{text}"
        );
        let back =
            Refused::ClockWentBack { issued_at: 1_795_938_052, now: 1_795_938_052 - 3_600 }.to_string();
        assert!(back.contains("its clock shows 2026-11-29 06:40:52 UTC"), "{back}");
    }

    #[test]
    fn a_refusal_comes_over_the_wire_as_it_is() {
        for refused in
            [Refused::Unknown, Refused::Spent { at: 7 }, Refused::Expired { expired_at: 1, now: 2 }]
        {
            let bytes = postcard::to_stdvec(&refused).expect("it encodes");
            assert_eq!(postcard::from_bytes(&bytes), Ok(refused));
        }
    }
}
