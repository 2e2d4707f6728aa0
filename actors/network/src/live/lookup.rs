//! Addresses that take time to find: DNS names, and the interfaces behind which a link-local address may be.
//!
//! The system's resolver waits, for as long as its name service takes. So it runs on a thread of its own, which ends with
//! the answer. Nobody joins it: who does not want to wait any longer lets it be.

use std::io;
use std::net::{IpAddr, Ipv6Addr, SocketAddr, SocketAddrV6, ToSocketAddrs};
use std::sync::mpsc::{Receiver, TryRecvError, sync_channel};

use crate::ticket::{HostAddress, HostPlace};

/// Most addresses of one name, and most interfaces, that are tried.
pub const FOUND_MAX: usize = 4;

/// Finds the sockets' addresses of a place and port; may wait.
pub(super) type Resolver = fn(&HostPlace, u16) -> io::Result<Vec<SocketAddr>>;

/// A search on its thread.
#[derive(Debug)]
pub(super) struct Lookup(Receiver<io::Result<Vec<SocketAddr>>>);

impl Lookup {
    /// Begins a search.
    ///
    /// # Errors
    /// When the system has no thread for it.
    pub fn begin(resolver: Resolver, address: HostAddress) -> io::Result<Self> {
        let (tell, found) = sync_channel(1);
        std::thread::Builder::new().name("name-lookup".into()).spawn(move || {
            // Who asked may have gone.
            let _ = tell.send(resolver(address.place(), address.port()));
        })?;
        Ok(Self(found))
    }

    /// What was found, once; `None` as long as the search lasts.
    pub fn found(&self) -> Option<io::Result<Vec<SocketAddr>>> {
        match self.0.try_recv() {
            Ok(found) => Some(found),
            Err(TryRecvError::Empty) => None,
            Err(TryRecvError::Disconnected) => Some(Err(io::Error::other("the search has failed"))),
        }
    }
}

/// A place that needs no search.
pub(super) fn known(address: &HostAddress) -> Option<SocketAddr> {
    match address.place() {
        HostPlace::Ip(ip) if !is_link_local(ip) => Some(SocketAddr::new(*ip, address.port())),
        _ => None,
    }
}

/// By the system.
pub(super) fn system(place: &HostPlace, port: u16) -> io::Result<Vec<SocketAddr>> {
    match place {
        HostPlace::Name(name) => Ok(alternating((name.as_str(), port).to_socket_addrs()?)),
        HostPlace::LinkLocal { ip, zone } => behind_interfaces(*ip, zone, port),
        HostPlace::Ip(IpAddr::V6(ip)) if ip.is_unicast_link_local() => behind_interfaces(*ip, "", port),
        HostPlace::Ip(ip) => Ok(vec![SocketAddr::new(*ip, port)]),
    }
}

fn is_link_local(ip: &IpAddr) -> bool {
    matches!(ip, IpAddr::V6(ip) if ip.is_unicast_link_local())
}

/// IPv6 and IPv4 in turn, each in the resolver's order (RFC 8305, section 4): one family that leads nowhere costs one try.
fn alternating(addresses: impl Iterator<Item = SocketAddr>) -> Vec<SocketAddr> {
    let (mut v6, mut v4): (Vec<_>, Vec<_>) = addresses.partition(SocketAddr::is_ipv6);
    v6.dedup();
    v4.dedup();
    let mut rest = (v6.into_iter(), v4.into_iter());
    let pairs = std::iter::from_fn(|| {
        let pair = [rest.0.next(), rest.1.next()];
        pair.iter().any(Option::is_some).then_some(pair)
    });
    pairs.flatten().flatten().take(FOUND_MAX).collect()
}

/// A link-local address says nothing about the interface, and the ticket's zone is the host's or the issuer's name of one. So
/// that zone is tried first, if there is such an interface here, and then the others.
fn behind_interfaces(ip: Ipv6Addr, zone: &str, port: u16) -> io::Result<Vec<SocketAddr>> {
    let mut interfaces = link_local_interfaces(&std::fs::read_to_string(INTERFACES).unwrap_or_default());
    if let Ok(number) = zone.parse()
        && interfaces.iter().all(|(known, _)| *known != number)
    {
        interfaces.push((number, zone.to_owned()));
    }
    interfaces.sort_by_key(|(number, name)| (name != zone && number.to_string() != zone, *number));
    if interfaces.is_empty() {
        return Err(io::Error::new(
            io::ErrorKind::AddrNotAvailable,
            "no interface of this machine has a link-local address",
        ));
    }
    let numbers = interfaces.into_iter().take(FOUND_MAX).map(|(number, _)| number);
    Ok(numbers.map(|number| SocketAddrV6::new(ip, port, 0, number).into()).collect())
}

/// Where Linux lists its IPv6 addresses.
const INTERFACES: &str = "/proc/net/if_inet6";
/// How that list marks an address that counts on its link alone.
const LINK_SCOPE: &str = "20";

/// Numbers and names of the interfaces with a link-local address. Each line has address, number, prefix length, scope and
/// flags in hexadecimal digits, and the name.
fn link_local_interfaces(list: &str) -> Vec<(u32, String)> {
    let interface = |line: &str| {
        let fields: Vec<&str> = line.split_whitespace().collect();
        match fields[..] {
            [_, number, _, LINK_SCOPE, _, name] => {
                Some((u32::from_str_radix(number, 16).ok()?, name.to_owned()))
            }
            _ => None,
        }
    };
    let mut interfaces: Vec<_> = list.lines().filter_map(interface).collect();
    interfaces.sort();
    interfaces.dedup();
    interfaces
}

#[cfg(test)]
mod tests {
    use super::*;

    fn all(texts: &[&str]) -> Vec<SocketAddr> {
        texts.iter().map(|text| text.parse().expect("an address")).collect()
    }

    #[test]
    fn the_families_of_a_name_have_their_turns() {
        let found = all(&["[::1]:1", "[::2]:1", "[::3]:1", "127.0.0.1:1", "127.0.0.1:1"]);
        let tried = alternating(found.into_iter());
        assert_eq!(tried, all(&["[::1]:1", "127.0.0.1:1", "[::2]:1", "[::3]:1"]));
        let tried = alternating(all(&["127.0.0.1:1"; 1]).into_iter());
        assert_eq!(tried, all(&["127.0.0.1:1"]));
        assert!(alternating(std::iter::empty()).is_empty());
    }

    #[test]
    fn interfaces_with_a_link_local_address_are_read_from_the_systems_list() {
        let list = "fd000000000000000000000000000002 04 40 00 82     eth0\n\
                    fe8000000000000000fc00fffe000001 04 40 20 80     eth0\n\
                    fe8000000000000000fc00fffe000002 1f 40 20 80    wlan0\n\
                    00000000000000000000000000000001 01 80 10 80       lo\n\
                    nonsense\n";
        assert_eq!(link_local_interfaces(list), [(4, "eth0".to_owned()), (31, "wlan0".to_owned())]);
    }

    #[test]
    fn the_zone_of_a_ticket_is_tried_first_even_if_no_such_interface_is_listed() {
        let ip: Ipv6Addr = "fe80::1".parse().expect("an address");
        let found = behind_interfaces(ip, "9999", 7).expect("a zone");
        assert_eq!(found[0], SocketAddr::V6(SocketAddrV6::new(ip, 7, 0, 9_999)));
        assert!(found.len() <= FOUND_MAX);
    }

    #[test]
    fn an_address_of_the_ticket_needs_no_search_and_a_name_is_found_on_a_thread() {
        let address: HostAddress = "192.0.2.1:7".parse().expect("an address");
        assert_eq!(known(&address), Some("192.0.2.1:7".parse().expect("an address")));
        for text in ["localhost:7", "[fe80::1%eth0]:7", "[fe80::1]:7"] {
            assert_eq!(known(&text.parse().expect("an address")), None, "{text}");
        }
        let address: HostAddress = "localhost:7".parse().expect("an address");
        let lookup = Lookup::begin(system, address).expect("a thread");
        let begun = std::time::Instant::now();
        let found = loop {
            if let Some(found) = lookup.found() {
                break found.expect("every machine has it");
            }
            assert!(begun.elapsed().as_secs() < 60, "no answer");
            std::thread::sleep(std::time::Duration::from_millis(1));
        };
        assert!(!found.is_empty() && found.iter().all(|found| found.ip().is_loopback()), "{found:?}");
    }
}
