//! The ticket that a host prints and a person hands on.
//!
//! Its content, in the encoding of one line with length and checksum:
//!
//! | bytes | field |
//! |---|---|
//! | 1 | role: 0 watch, 1 operate, 2 mentor |
//! | 5 | expiry \[s since 1970\], little-endian |
//! | 32 | SHA-256 of the host's certificate |
//! | 16 | token |
//! | 1 + n | name of the session, with its length before |
//! | 1 | count of addresses, 1 to [`ADDRESSES_MAX`] |
//! | each 7, 19, 20 + n or 4 + n | kind, IPv4, IPv6, link-local IPv6 with its zone, or name; port |
//!
//! With one IPv4 address and a name of twelve letters that is a line of 137 characters.

use std::fmt;
use std::str::FromStr;

use thiserror::Error;

use super::base32_line::{self, LineError};
use super::byte_reader::ByteReader;
use super::fingerprint::Fingerprint;
use super::host_address::HostAddress;
use super::plain_name::PlainName;
use super::role::Role;
use super::secret::Token;
use super::unix_time::CLOCK_TOLERANCE_SECS;

/// Most addresses in a ticket.
pub const ADDRESSES_MAX: usize = 8;
/// Latest expiry that a ticket can carry \[s since 1970\].
pub const EXPIRY_MAX_SECS: u64 = (1 << 40) - 1;

/// What somebody needs to join a session. **Its text is a secret** that lets in once; its debug text is not.
#[derive(Clone, PartialEq, Eq)]
pub struct Ticket {
    addresses: Vec<HostAddress>,
    fingerprint: Fingerprint,
    token: Token,
    role: Role,
    expires: u64,
    session: PlainName,
}

/// Why a text is no ticket, or why no ticket can be made.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum TicketError {
    /// The text is damaged, or no ticket.
    #[error(transparent)]
    Line(#[from] LineError),
    /// The text is whole, but this program does not understand it.
    #[error(
        "the ticket is whole, but its {0} is not valid here; a newer program may have made it: update this one"
    )]
    Content(&'static str),
    /// Too few or too many addresses.
    #[error("a ticket has {0} addresses; 1 to {ADDRESSES_MAX} are valid")]
    Addresses(usize),
    /// An expiry in thousands of years.
    #[error("a ticket expires {0} s after 1970; at most {EXPIRY_MAX_SECS} is valid")]
    Expiry(u64),
}

impl Ticket {
    /// A ticket that expires at `expires` \[s since 1970\].
    ///
    /// # Errors
    /// [`TicketError::Addresses`] and [`TicketError::Expiry`].
    pub fn new(
        addresses: Vec<HostAddress>,
        fingerprint: Fingerprint,
        token: Token,
        role: Role,
        expires: u64,
        session: PlainName,
    ) -> Result<Self, TicketError> {
        if !(1..=ADDRESSES_MAX).contains(&addresses.len()) {
            return Err(TicketError::Addresses(addresses.len()));
        }
        if expires > EXPIRY_MAX_SECS {
            return Err(TicketError::Expiry(expires));
        }
        Ok(Self { addresses, fingerprint, token, role, expires, session })
    }

    /// Where the host can be reached, the best one first.
    pub fn addresses(&self) -> &[HostAddress] {
        &self.addresses
    }

    /// The certificate that the host must show.
    pub fn fingerprint(&self) -> &Fingerprint {
        &self.fingerprint
    }

    /// What lets in, once. To be sent inside a TLS session whose certificate has the fingerprint, and nowhere else.
    pub fn token(&self) -> &Token {
        &self.token
    }

    /// What the holder may do. The host decides by its own record, so that a changed ticket changes nothing.
    pub fn role(&self) -> Role {
        self.role
    }

    /// When it expires \[s since 1970\].
    pub fn expires(&self) -> u64 {
        self.expires
    }

    /// Name of the session.
    pub fn session(&self) -> &PlainName {
        &self.session
    }

    /// Whether it has expired by more than [`CLOCK_TOLERANCE_SECS`]. The host decides by its own clock: a station may warn
    /// by this, but tries to join, since its own clock may be the wrong one.
    pub fn is_expired(&self, unix_secs: u64) -> bool {
        unix_secs > self.expires.saturating_add(CLOCK_TOLERANCE_SECS)
    }

    fn content(&self) -> Vec<u8> {
        let session = self.session.as_str();
        let mut out = vec![self.role.to_byte()];
        out.extend(&self.expires.to_le_bytes()[..5]);
        out.extend(self.fingerprint.as_bytes());
        out.extend(self.token.as_bytes());
        // A name has at most 64 bytes, and there are at most 8 addresses.
        out.push(session.len() as u8);
        out.extend(session.bytes());
        out.push(self.addresses.len() as u8);
        for address in &self.addresses {
            address.encode(&mut out);
        }
        out
    }

    fn of_content(content: &[u8]) -> Result<Self, TicketError> {
        let mut from = ByteReader(content);
        let content = TicketError::Content;
        let role = from.byte().and_then(Role::from_byte).ok_or(content("role"))?;
        let [a, b, c, d, e] = from.array().ok_or(content("expiry"))?;
        let expires = u64::from_le_bytes([a, b, c, d, e, 0, 0, 0]);
        let fingerprint = Fingerprint::from_bytes(from.array().ok_or(content("fingerprint"))?);
        let token = Token::from_bytes(from.array().ok_or(content("token"))?);
        let session = from.text().ok_or(content("session's name"))?;
        let name = session.parse().ok().filter(|name: &PlainName| name.as_str() == session);
        let session = name.ok_or(content("session's name"))?;
        let count = usize::from(from.byte().ok_or(content("count of addresses"))?);
        if count > ADDRESSES_MAX {
            return Err(TicketError::Addresses(count));
        }
        let mut addresses = Vec::with_capacity(count);
        for _ in 0..count {
            addresses.push(HostAddress::decode(&mut from).ok_or(content("address"))?);
        }
        if !from.0.is_empty() {
            return Err(content("end"));
        }
        Self::new(addresses, fingerprint, token, role, expires, session)
    }
}

/// The line to be handed on. It has the token in it.
impl fmt::Display for Ticket {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&base32_line::write(&self.content()))
    }
}

impl FromStr for Ticket {
    type Err = TicketError;

    fn from_str(text: &str) -> Result<Self, TicketError> {
        Self::of_content(&base32_line::read(text)?)
    }
}

impl fmt::Debug for Ticket {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Ticket")
            .field("session", &self.session.as_str())
            .field("role", &self.role)
            .field("addresses", &self.addresses)
            .field("fingerprint", &self.fingerprint)
            .field("expires", &self.expires)
            .finish_non_exhaustive()
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn ticket(addresses: &[&str], session: &str) -> Ticket {
        let addresses = addresses.iter().map(|text| text.parse().expect("an address")).collect();
        let fingerprint = Fingerprint::of_certificate(b"a certificate");
        let token = Token::from_bytes(*b"sixteen bytes, y");
        let session = session.parse().expect("a name");
        Ticket::new(addresses, fingerprint, token, Role::Operate, 1_795_938_052, session)
            .expect("it is valid")
    }

    #[test]
    fn a_ticket_comes_back_from_its_line() {
        let all = [
            "192.0.2.1:4070",
            "[2001:db8::1]:4070",
            "[fe80::1%eth0]:4070",
            "or-3.example.org:4070",
            "127.0.0.1:1",
            "localhost:2",
            "[::1]:3",
            "10.0.0.1:4",
        ];
        for count in 1..=all.len() {
            let ticket = ticket(&all[..count], "Öl-Leber 山田");
            let line = ticket.to_string();
            assert!(line.bytes().all(|byte| byte.is_ascii_lowercase() || byte.is_ascii_digit()), "{line}");
            assert_eq!(line.parse(), Ok(ticket));
        }
        assert_eq!(ticket(&all[..1], "peg-transfer").to_string().len(), 137);
    }

    #[test]
    fn the_largest_ticket_fits_and_comes_back() {
        let longest = format!("{}.example:65535", vec!["a".repeat(60); 4].join("."));
        let ticket = ticket(&[longest.as_str(); ADDRESSES_MAX], &"x".repeat(64));
        let line = ticket.to_string();
        assert!(line.len() < base32_line::LINE_MAX / 2, "{}", line.len());
        assert_eq!(line.parse(), Ok(ticket));
    }

    #[test]
    fn a_newer_role_and_a_longer_content_are_told_from_a_typing_error() {
        let content = ticket(&["192.0.2.1:4070"], "liver").content();
        let parsed = |content: &[u8]| base32_line::write(content).parse::<Ticket>();
        assert!(parsed(&content).is_ok());
        let role = [&[9], &content[1..]].concat();
        assert_eq!(parsed(&role), Err(TicketError::Content("role")));
        assert_eq!(parsed(&[&content[..], &[0]].concat()), Err(TicketError::Content("end")));
        for cut in 0..content.len() {
            assert!(parsed(&content[..cut]).is_err(), "cut to {cut}");
        }
    }

    #[test]
    fn a_ticket_is_written_in_one_way_only() {
        let content = ticket(&["192.0.2.1:4070"], "liver").content();
        let mut spaced = content.clone();
        let name = content.windows(5).position(|bytes| bytes == b"liver").expect("it is there");
        spaced[name] = b' ';
        let parsed = base32_line::write(&spaced).parse::<Ticket>();
        assert_eq!(parsed, Err(TicketError::Content("session's name")));
    }

    #[test]
    fn no_more_than_eight_addresses_and_no_fewer_than_one_fit() {
        let one = ticket(&["192.0.2.1:4070"], "liver");
        for count in [0, ADDRESSES_MAX + 1] {
            let addresses = vec![one.addresses[0].clone(); count];
            let made =
                Ticket::new(addresses, one.fingerprint, one.token.clone(), one.role, 0, one.session.clone());
            assert_eq!(made, Err(TicketError::Addresses(count)));
        }
    }

    #[test]
    fn the_debug_text_has_nothing_of_the_token() {
        let shown = format!("{:?}", ticket(&["192.0.2.1:4070"], "liver"));
        assert!(shown.contains("liver") && shown.contains("192.0.2.1") && shown.ends_with(".. }"), "{shown}");
        for secret in ["sixteen", "oken", "115, 105", "trocar1"] {
            assert!(!shown.contains(secret), "{secret} in {shown}");
        }
    }

    #[test]
    fn a_ticket_expires_after_the_tolerance_of_clocks() {
        let ticket = ticket(&["192.0.2.1:4070"], "liver");
        assert!(!ticket.is_expired(0));
        assert!(!ticket.is_expired(ticket.expires() + CLOCK_TOLERANCE_SECS));
        assert!(ticket.is_expired(ticket.expires() + CLOCK_TOLERANCE_SECS + 1));
    }

    proptest! {
        #[test]
        fn no_text_and_no_content_make_it_fail(
            text in any::<String>(),
            bytes in proptest::collection::vec(any::<u8>(), 0..200),
            at in 0_usize..86,
            byte in any::<u8>(),
        ) {
            let _ = text.parse::<Ticket>();
            let _ = base32_line::write(&bytes).parse::<Ticket>();
            // Contents that are nearly right, with a valid checksum.
            let mut content = ticket(&["[fe80::1%eth0]:4070", "a.example:1"], "liver").content();
            let at = at % content.len();
            content[at] = byte;
            if let Ok(ticket) = base32_line::write(&content).parse::<Ticket>() {
                prop_assert_eq!(ticket.content(), content);
            }
        }
    }
}
