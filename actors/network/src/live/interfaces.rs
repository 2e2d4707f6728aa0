//! The addresses of this machine, for tickets.

use std::net::IpAddr;

/// Addresses at which other machines may reach this one, those of its networks before the loopback, IPv4 first; no
/// link-local ones, whose zones mean nothing elsewhere.
pub fn own_addresses() -> Vec<IpAddr> {
    // Where the system does not tell, a ticket still works on the machine itself.
    let interfaces = if_addrs::get_if_addrs().unwrap_or_default();
    let is_up = |interface: &if_addrs::Interface| interface.oper_status != if_addrs::IfOperStatus::Down;
    let mut found: Vec<IpAddr> =
        interfaces.iter().filter(|known| is_up(known)).map(|known| known.ip()).collect();
    found.retain(|ip| match ip {
        IpAddr::V4(ip) => !ip.is_link_local(),
        IpAddr::V6(ip) => ip.segments()[0] & 0xffc0 != 0xfe80,
    });
    if found.is_empty() {
        found.push(IpAddr::from([127, 0, 0, 1]));
    }
    found.sort_by_key(|ip| (ip.is_loopback(), ip.is_ipv6()));
    found.dedup();
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_loopback_comes_last_and_no_address_twice() {
        let found = own_addresses();
        assert!(!found.is_empty());
        let first_loopback = found.iter().position(IpAddr::is_loopback).unwrap_or(found.len());
        assert!(found[first_loopback..].iter().all(IpAddr::is_loopback), "{found:?}");
        let mut distinct = found.clone();
        distinct.sort();
        distinct.dedup();
        assert_eq!(distinct.len(), found.len());
    }
}
