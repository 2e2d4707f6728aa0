//! Why a host was not reached, in words that name every address that was tried.

use std::collections::BTreeMap;
use std::fmt;
use std::io::{self, ErrorKind};
use std::net::SocketAddr;

use rustls::{CertificateError, Error};

use super::tls_socket::HandshakeError;

/// Why one address did not lead to the host. What tells a person most comes first.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Reason {
    OtherCertificate,
    /// Something else than TLS, or another protocol within it; the library's word.
    OtherProtocol(String),
    HungUp,
    SlowHandshake,
    Refused,
    Firewall,
    NoRoute,
    NoIpv6,
    NoAnswer,
    /// The resolver's word.
    NoName(String),
    SlowName,
    NoInterface,
    NotLoopback,
    NotTried,
    /// The system's word.
    Other(String),
}

impl fmt::Display for Reason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::OtherCertificate => {
                f.write_str("another certificate than the ticket's: another host, or somebody in between")
            }
            Self::OtherProtocol(word) => write!(f, "what answers is no host of this program ({word})"),
            Self::HungUp => f.write_str("it closed the connection during the handshake"),
            Self::SlowHandshake => f.write_str("it took the connection and said nothing"),
            Self::Refused => f.write_str("refused, nobody listens there"),
            Self::Firewall => f.write_str("a firewall forbids it"),
            Self::NoRoute => f.write_str("no route to there"),
            Self::NoIpv6 => f.write_str("no route, this machine has no IPv6 to there"),
            Self::NoAnswer => f.write_str("timed out, no answer"),
            Self::NoName(word) => write!(f, "the name does not resolve ({word})"),
            Self::SlowName => f.write_str("the name service gives no answer"),
            Self::NoInterface => f.write_str("this machine has no link-local IPv6 address"),
            Self::NotLoopback => f.write_str("not on this machine, and `--insecure` is for it alone"),
            Self::NotTried => f.write_str("not tried, the time was over"),
            Self::Other(word) => f.write_str(word),
        }
    }
}

impl Reason {
    /// Of a connection that did not come about.
    pub fn of_connecting(to: &SocketAddr, error: &io::Error) -> Self {
        // The standard library has no kind for a machine without the whole family.
        let no_family = error.raw_os_error() == Some(rustix::io::Errno::AFNOSUPPORT.raw_os_error());
        match error.kind() {
            ErrorKind::ConnectionRefused => Self::Refused,
            ErrorKind::TimedOut => Self::NoAnswer,
            ErrorKind::PermissionDenied => Self::Firewall,
            ErrorKind::NetworkUnreachable | ErrorKind::AddrNotAvailable if to.is_ipv6() => Self::NoIpv6,
            _ if no_family && to.is_ipv6() => Self::NoIpv6,
            ErrorKind::NetworkUnreachable | ErrorKind::AddrNotAvailable | ErrorKind::HostUnreachable => {
                Self::NoRoute
            }
            _ => Self::Other(error.to_string()),
        }
    }

    /// Of a handshake that failed.
    pub fn of_handshake(error: &HandshakeError) -> Self {
        match error {
            HandshakeError::HungUp => Self::HungUp,
            HandshakeError::Socket(error)
                if matches!(error.kind(), ErrorKind::ConnectionReset | ErrorKind::BrokenPipe) =>
            {
                Self::HungUp
            }
            HandshakeError::Socket(error) => Self::Other(error.to_string()),
            HandshakeError::Tls(Error::InvalidCertificate(
                CertificateError::ApplicationVerificationFailure,
            )) => Self::OtherCertificate,
            HandshakeError::Tls(error) => Self::OtherProtocol(error.to_string()),
        }
    }

    /// Of a search that found nothing.
    pub fn of_lookup(error: &io::Error) -> Self {
        if error.kind() == ErrorKind::AddrNotAvailable {
            return Self::NoInterface;
        }
        let word = error.to_string();
        // The standard library says first what the sentence around it says, too.
        let word = word.strip_prefix("failed to lookup address information: ").unwrap_or(&word);
        Self::NoName(word.to_owned())
    }
}

/// The addresses that did not lead to the host.
#[derive(Debug, Default)]
pub(super) struct Unreached(BTreeMap<Reason, Vec<String>>);

impl Unreached {
    pub fn note(&mut self, reason: Reason, address: impl fmt::Display) {
        self.0.entry(reason).or_default().push(address.to_string());
    }
}

/// Such as `no host reached: 192.0.2.1:7417, 192.0.2.2:7417: refused, nobody listens there; [2001:db8::1]:7417: timed out`.
impl fmt::Display for Unreached {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("no host reached: ")?;
        for (place, (reason, addresses)) in self.0.iter().enumerate() {
            let before = if place == 0 { "" } else { "; " };
            write!(f, "{before}{}: {reason}", addresses.join(", "))?;
        }
        if self.0.keys().eq([&Reason::NoIpv6]) {
            f.write_str("; the ticket has no IPv4 address")?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use rustix::io::Errno;

    use super::*;

    #[test]
    fn every_address_is_named_and_what_tells_most_comes_first() {
        let mut unreached = Unreached::default();
        unreached.note(Reason::NoAnswer, "[2001:db8::1]:7");
        unreached.note(Reason::Refused, "192.0.2.1:7");
        unreached.note(Reason::OtherCertificate, "192.0.2.3:7");
        unreached.note(Reason::Refused, "192.0.2.2:7");
        assert_eq!(
            unreached.to_string(),
            "no host reached: 192.0.2.3:7: another certificate than the ticket's: another host, or somebody in \
             between; 192.0.2.1:7, 192.0.2.2:7: refused, nobody listens there; [2001:db8::1]:7: timed out, no answer"
        );
    }

    #[test]
    fn a_machine_without_ipv6_and_a_ticket_without_ipv4_are_named() {
        let v6: SocketAddr = "[2001:db8::1]:7".parse().expect("an address");
        let v4: SocketAddr = "192.0.2.1:7".parse().expect("an address");
        for errno in [Errno::NETUNREACH, Errno::ADDRNOTAVAIL, Errno::AFNOSUPPORT] {
            let reason = Reason::of_connecting(&v6, &errno.into());
            assert_eq!(reason, Reason::NoIpv6, "{errno}");
            let mut unreached = Unreached::default();
            unreached.note(reason, v6);
            assert!(unreached.to_string().ends_with("; the ticket has no IPv4 address"), "{unreached}");
            unreached.note(Reason::Refused, v4);
            assert!(!unreached.to_string().contains("ticket"), "{unreached}");
        }
        let connecting = |errno: Errno| Reason::of_connecting(&v4, &errno.into());
        assert_eq!(connecting(Errno::NETUNREACH), Reason::NoRoute);
        assert_eq!(connecting(Errno::HOSTUNREACH), Reason::NoRoute);
        assert_eq!(connecting(Errno::TIMEDOUT), Reason::NoAnswer);
        assert_eq!(connecting(Errno::PERM), Reason::Firewall);
        assert_eq!(connecting(Errno::CONNREFUSED), Reason::Refused);
    }
}
