//! Where a host can be reached: an IP address or a DNS name, and a port.

// The address types alone: this module opens no socket.
use core::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr};
use std::fmt;
use std::str::FromStr;

use thiserror::Error;

use super::byte_reader::ByteReader;

/// Most bytes of a DNS name (RFC 1035).
pub const DNS_NAME_MAX: usize = 253;
/// Most bytes of a label of a DNS name.
const LABEL_MAX: usize = 63;
/// Most bytes of the zone of a link-local address: what Linux allows for the name of an interface.
pub const ZONE_MAX: usize = 15;

const V4: u8 = 0;
const V6: u8 = 1;
const V6_WITH_ZONE: u8 = 2;
const NAME: u8 = 3;

/// A place in the network.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum HostPlace {
    /// An address, usually of a machine on the same network or with a public address.
    Ip(IpAddr),
    /// A link-local IPv6 address, and the interface that leads there. Interfaces are named differently on every machine, so
    /// the station that joins may have to take another one.
    LinkLocal {
        /// In fe80::/10.
        ip: Ipv6Addr,
        /// Name or number of an interface.
        zone: String,
    },
    /// A DNS name, in lower case.
    Name(String),
}

/// A place and a port, as `192.0.2.1:4070`, `[2001:db8::1]:4070`, `[fe80::1%eth0]:4070` or `or-3.example.org:4070`.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct HostAddress {
    place: HostPlace,
    port: u16,
}

/// Why a text or its parts are no address.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum AddressError {
    /// No port.
    #[error(
        "'{0}' lacks a port; valid are 192.0.2.1:4070, [2001:db8::1]:4070, [fe80::1%eth0]:4070 and a.example:4070"
    )]
    NoPort(String),
    /// A port that is none.
    #[error("'{0}' is no port; valid are 1 to 65535")]
    Port(String),
    /// Brackets with something else in them, or IPv6 without them.
    #[error(
        "'{0}' is no IPv6 address; valid are [2001:db8::1]:4070 and [fe80::1%eth0]:4070, with the brackets"
    )]
    V6(String),
    /// No machine has this address.
    #[error("{0} is the address of no machine; name one at which other machines reach this one")]
    NoMachine(IpAddr),
    /// A zone where none belongs, or one that no interface can have.
    #[error("'{0}' is no zone; link-local addresses have one: 1 to {ZONE_MAX} of A-Z a-z 0-9 . _ - @")]
    Zone(String),
    /// No name of a machine.
    #[error(
        "'{0}' is no name of a machine; valid are labels of a-z 0-9 - _ with dots between, xn-- for others"
    )]
    Name(String),
}

/// The beginning of a text from outside, for a message.
fn shown(text: &str) -> String {
    const SHOWN_MAX: usize = 64;
    let kept = text.chars().take(SHOWN_MAX).map(|c| if c.is_control() { '\u{fffd}' } else { c });
    let more = if text.chars().nth(SHOWN_MAX).is_some() { "…" } else { "" };
    kept.chain(more.chars()).collect()
}

fn is_link_local(ip: &Ipv6Addr) -> bool {
    ip.segments()[0] & 0xffc0 == 0xfe80
}

fn is_zone(zone: &str) -> bool {
    (1..=ZONE_MAX).contains(&zone.len())
        && zone.bytes().all(|byte| byte.is_ascii_alphanumeric() || b"._-@".contains(&byte))
}

fn is_label(label: &str) -> bool {
    (1..=LABEL_MAX).contains(&label.len())
        && label
            .bytes()
            .all(|byte| byte.is_ascii_lowercase() || byte.is_ascii_digit() || b"-_".contains(&byte))
        && !label.starts_with('-')
        && !label.ends_with('-')
}

fn is_dns_name(name: &str) -> bool {
    // Systems take a name that ends with a number for an IPv4 address, such as 1.2.3 for 1.2.0.3.
    let ends_with_number =
        name.rsplit('.').next().is_some_and(|last| last.bytes().all(|byte| byte.is_ascii_digit()));
    name.len() <= DNS_NAME_MAX && name.split('.').all(is_label) && !ends_with_number
}

impl HostAddress {
    /// An address.
    ///
    /// # Errors
    /// [`AddressError`]: port 0, an address that no machine has, or a name or zone that is not valid.
    pub fn new(place: HostPlace, port: u16) -> Result<Self, AddressError> {
        if port == 0 {
            return Err(AddressError::Port("0".to_owned()));
        }
        match &place {
            HostPlace::Ip(ip) if ip.is_unspecified() || ip.is_multicast() || *ip == Ipv4Addr::BROADCAST => {
                Err(AddressError::NoMachine(*ip))
            }
            HostPlace::LinkLocal { ip, zone } if !is_link_local(ip) || !is_zone(zone) => {
                Err(AddressError::Zone(shown(zone)))
            }
            HostPlace::Name(name) if !is_dns_name(name) => Err(AddressError::Name(shown(name))),
            _ => Ok(Self { place, port }),
        }
    }

    /// Of a socket; the zone is then the number of the interface.
    ///
    /// # Errors
    /// As [`Self::new`].
    pub fn of_socket(address: SocketAddr) -> Result<Self, AddressError> {
        let place = match address {
            SocketAddr::V6(v6) if v6.scope_id() != 0 && is_link_local(v6.ip()) => {
                HostPlace::LinkLocal { ip: *v6.ip(), zone: v6.scope_id().to_string() }
            }
            _ => HostPlace::Ip(address.ip()),
        };
        Self::new(place, address.port())
    }

    /// Without the port.
    pub fn place(&self) -> &HostPlace {
        &self.place
    }

    /// The port, of TCP and UDP both.
    pub fn port(&self) -> u16 {
        self.port
    }

    /// Whether only programs on the same machine can reach it.
    pub fn is_loopback(&self) -> bool {
        match &self.place {
            HostPlace::Ip(ip) => ip.is_loopback(),
            HostPlace::LinkLocal { .. } => false,
            HostPlace::Name(name) => name == "localhost" || name.ends_with(".localhost"),
        }
    }

    /// Appends kind, place and port.
    pub(super) fn encode(&self, out: &mut Vec<u8>) {
        // Names and zones have at most 253 bytes, so that their length fits one byte.
        let mut text = |kind: u8, before: &[u8], text: &str| {
            out.push(kind);
            out.extend(before);
            out.push(text.len() as u8);
            out.extend(text.bytes());
        };
        match &self.place {
            HostPlace::Name(name) => text(NAME, &[], name),
            HostPlace::LinkLocal { ip, zone } => text(V6_WITH_ZONE, &ip.octets(), zone),
            HostPlace::Ip(IpAddr::V4(ip)) => {
                out.push(V4);
                out.extend(ip.octets());
            }
            HostPlace::Ip(IpAddr::V6(ip)) => {
                out.push(V6);
                out.extend(ip.octets());
            }
        }
        out.extend(self.port.to_le_bytes());
    }

    /// The next one; `None` when it is cut off or not valid.
    pub(super) fn decode(from: &mut ByteReader<'_>) -> Option<Self> {
        let place = match from.byte()? {
            V4 => HostPlace::Ip(IpAddr::from(from.array::<4>()?)),
            V6 => HostPlace::Ip(IpAddr::from(from.array::<16>()?)),
            V6_WITH_ZONE => {
                let ip = Ipv6Addr::from(from.array::<16>()?);
                HostPlace::LinkLocal { ip, zone: from.text()?.to_owned() }
            }
            NAME => HostPlace::Name(from.text()?.to_owned()),
            _ => return None,
        };
        Self::new(place, u16::from_le_bytes(from.array()?)).ok()
    }
}

impl FromStr for HostAddress {
    type Err = AddressError;

    fn from_str(text: &str) -> Result<Self, AddressError> {
        let text = text.trim();
        let (place, port) = match text.strip_prefix('[') {
            Some(opened) => opened.split_once("]:").map(|(inside, port)| (v6(inside), port)),
            None => text.rsplit_once(':').map(|(place, port)| (v4_or_name(place), port)),
        }
        .ok_or_else(|| AddressError::NoPort(shown(text)))?;
        // `parse` alone would also take `+5`.
        let is_number = !port.is_empty() && port.bytes().all(|byte| byte.is_ascii_digit());
        let number = port.parse().ok().filter(|_| is_number);
        Self::new(place?, number.ok_or_else(|| AddressError::Port(shown(port)))?)
    }
}

fn v6(inside: &str) -> Result<HostPlace, AddressError> {
    let (ip, zone) = match inside.split_once('%') {
        Some((ip, zone)) => (ip, Some(zone)),
        None => (inside, None),
    };
    let ip: Ipv6Addr = ip.parse().map_err(|_| AddressError::V6(shown(inside)))?;
    Ok(match zone {
        Some(zone) => HostPlace::LinkLocal { ip, zone: zone.to_owned() },
        None => HostPlace::Ip(ip.into()),
    })
}

fn v4_or_name(place: &str) -> Result<HostPlace, AddressError> {
    if place.contains(':') {
        return Err(AddressError::V6(shown(place)));
    }
    if let Ok(ip) = place.parse::<Ipv4Addr>() {
        return Ok(HostPlace::Ip(ip.into()));
    }
    // The dot of the root, which is the same name.
    let name = place.strip_suffix('.').unwrap_or(place);
    Ok(HostPlace::Name(name.to_ascii_lowercase()))
}

impl fmt::Display for HostAddress {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { place, port } = self;
        match place {
            HostPlace::Name(name) => write!(f, "{name}:{port}"),
            HostPlace::LinkLocal { ip, zone } => write!(f, "[{ip}%{zone}]:{port}"),
            HostPlace::Ip(ip) => SocketAddr::new(*ip, *port).fmt(f),
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn every_kind_of_address_comes_back_from_its_text_and_its_bytes() {
        for text in [
            "192.0.2.1:4070",
            "127.0.0.1:1",
            "[2001:db8::1]:65535",
            "[fe80::1%eth0]:4070",
            "[fe80::1%3]:4070",
            "[fe80::1]:4070",
            "or-3.example.org:4070",
            "localhost:4070",
        ] {
            let address: HostAddress = text.parse().expect("it is valid");
            assert_eq!(address.to_string(), text);
            let mut bytes = Vec::new();
            address.encode(&mut bytes);
            let mut reader = ByteReader(&bytes);
            assert_eq!(HostAddress::decode(&mut reader), Some(address));
            assert!(reader.0.is_empty());
            for cut in 0..bytes.len() {
                assert_eq!(HostAddress::decode(&mut ByteReader(&bytes[..cut])), None, "{text} cut to {cut}");
            }
        }
        assert_eq!(
            "OR-3.Example.org.:80".parse::<HostAddress>().map(|a| a.to_string()),
            Ok("or-3.example.org:80".into())
        );
    }

    #[test]
    fn what_is_no_address_is_refused_with_its_reason() {
        use AddressError as E;
        let refused = |text: &str| text.parse::<HostAddress>().expect_err(text);
        assert!(matches!(refused("192.0.2.1"), E::NoPort(_)));
        assert!(matches!(refused("[::1]"), E::NoPort(_)));
        assert!(matches!(refused("::1:80"), E::V6(_)));
        assert!(matches!(refused("[192.0.2.1]:80"), E::V6(_)));
        for port in ["0", "", "65536", "+5", "http", "-1"] {
            assert!(matches!(refused(&format!("a.example:{port}")), E::Port(_)), "{port}");
        }
        for ip in ["0.0.0.0", "255.255.255.255", "224.0.0.1", "[::]", "[ff02::1]"] {
            assert!(matches!(refused(&format!("{ip}:80")), E::NoMachine(_)), "{ip}");
        }
        for zoned in
            ["[2001:db8::1%eth0]:80", "[fe80::1%]:80", "[fe80::1%a b]:80", "[fe80::1%0123456789abcdef]:80"]
        {
            assert!(matches!(refused(zoned), E::Zone(_)), "{zoned}");
        }
        for name in
            ["", "a..b", "-a", "a-", "a b", "1.2.3", "300.1.1.1", "ärzte.example", "a/b", &"a".repeat(64)]
        {
            assert!(matches!(refused(&format!("{name}:80")), E::Name(_)), "{name}");
        }
        assert!(matches!(refused(&format!("{}a:80", "a.".repeat(127))), E::Name(_)));
    }

    #[test]
    fn a_message_about_a_long_or_wild_text_is_short_and_harmless() {
        let text = format!("\u{1b}[31m{}", "x".repeat(10_000));
        let message = text.parse::<HostAddress>().expect_err("no port").to_string();
        assert!(message.len() < 300 && !message.contains('\u{1b}'), "{message}");
    }

    proptest! {
        #[test]
        fn no_text_and_no_bytes_make_it_fail(text in any::<String>(), bytes in any::<Vec<u8>>()) {
            if let Ok(address) = text.parse::<HostAddress>() {
                prop_assert_eq!(address.to_string().parse(), Ok(address));
            }
            if let Some(address) = HostAddress::decode(&mut ByteReader(&bytes)) {
                let mut again = Vec::new();
                address.encode(&mut again);
                prop_assert!(bytes.starts_with(&again));
            }
        }
    }
}
