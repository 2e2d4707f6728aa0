//! Sockets: one port for TCP and UDP, IPv6 and IPv4.

use std::io;
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr, TcpListener, UdpSocket};

use socket2::{Domain, Protocol, Socket, Type};
use thiserror::Error;

/// The port of hosts, for TCP and UDP; one that IANA has not given to anybody.
pub const PORT: u16 = 7_417;
/// Differentiated services code point 46, expedited forwarding (RFC 3246), in its place in the byte.
const EXPEDITED: u32 = 46 << 2;
/// Bytes that the system keeps of datagrams that came and were not taken: a second of 16 stations with two hands each.
const RECEIVE_BUFFER: usize = 4 << 20;
/// Connections that wait to be taken.
const BACKLOG: i32 = 256;
/// Ports tried when any will do, and the one for TCP is taken for UDP.
const PORTS_TRIED: usize = 16;

/// Why a host has no sockets.
#[derive(Debug, Error)]
pub enum SocketError {
    /// Somebody has the port.
    #[error(
        "port {port} is in use for {protocol}: another host runs on this machine; `--port` takes another one, 0 any"
    )]
    InUse {
        /// The port.
        port: u16,
        /// TCP or UDP.
        protocol: &'static str,
    },
    /// A port below 1,024 without the right to it.
    #[error("port {port}: this user may not take it; valid: 1024 to 65535, or 0 for any")]
    Forbidden {
        /// The port.
        port: u16,
    },
    /// The address is not one of this machine's.
    #[error("{address} is not an address of this machine")]
    NotHere {
        /// The address.
        address: IpAddr,
    },
    /// Anything else.
    #[error("{protocol} on port {port}: {error}")]
    Other {
        /// The port.
        port: u16,
        /// TCP or UDP.
        protocol: &'static str,
        /// The system's word.
        error: io::Error,
    },
}

/// The sockets of a host, non-blocking.
#[derive(Debug)]
pub struct HostSockets {
    /// Takes connections for control.
    pub tcp: TcpListener,
    /// Datagrams.
    pub udp: UdpSocket,
    /// The port of both.
    pub port: u16,
}

impl HostSockets {
    /// Binds both to one port; 0 is any port that is free for both. Without an address they take every address of the
    /// machine: IPv6 and IPv4, or IPv4 alone where the machine has no IPv6.
    ///
    /// # Errors
    /// [`SocketError`] names port and protocol.
    pub fn bind(address: Option<IpAddr>, port: u16) -> Result<Self, SocketError> {
        let mut refused = None;
        for _ in 0..if port == 0 { PORTS_TRIED } else { 1 } {
            match Self::bind_once(address, port) {
                Ok(sockets) => return Ok(sockets),
                Err(error @ SocketError::InUse { .. }) => refused = Some(error),
                Err(error) => return Err(error),
            }
        }
        Err(refused.unwrap_or(SocketError::InUse { port, protocol: "TCP" }))
    }

    fn bind_once(address: Option<IpAddr>, port: u16) -> Result<Self, SocketError> {
        let tcp = bind(address, port, Type::STREAM)?;
        let told = |error| SocketError::Other { port, protocol: "TCP", error };
        tcp.listen(BACKLOG).map_err(told)?;
        let tcp = TcpListener::from(tcp);
        let port = tcp.local_addr().map_err(told)?.port();
        let udp = UdpSocket::from(bind(address, port, Type::DGRAM)?);
        Ok(Self { tcp, udp, port })
    }
}

/// The socket for datagrams of a station that joins a host at `address`: any port, of the host's family.
///
/// # Errors
/// [`SocketError`].
pub fn station(address: &SocketAddr) -> Result<UdpSocket, SocketError> {
    let any: IpAddr =
        if address.is_ipv4() { Ipv4Addr::UNSPECIFIED.into() } else { Ipv6Addr::UNSPECIFIED.into() };
    bind(Some(any), 0, Type::DGRAM).map(UdpSocket::from)
}

/// A socket for datagrams at one address of the machine; port 0 is any.
///
/// # Errors
/// [`SocketError`].
pub fn datagrams(address: IpAddr, port: u16) -> Result<UdpSocket, SocketError> {
    bind(Some(address), port, Type::DGRAM).map(UdpSocket::from)
}

fn bind(address: Option<IpAddr>, port: u16, kind: Type) -> Result<Socket, SocketError> {
    if let Some(address) = address {
        return bind_to(address, port, kind, false);
    }
    match bind_to(Ipv6Addr::UNSPECIFIED.into(), port, kind, true) {
        // A machine without IPv6.
        Err(SocketError::Other { .. } | SocketError::NotHere { .. }) => {
            bind_to(Ipv4Addr::UNSPECIFIED.into(), port, kind, false)
        }
        bound => bound,
    }
}

fn bind_to(address: IpAddr, port: u16, kind: Type, both_families: bool) -> Result<Socket, SocketError> {
    let protocol = if kind == Type::STREAM { "TCP" } else { "UDP" };
    let told = |error: io::Error| match error.kind() {
        io::ErrorKind::AddrInUse => SocketError::InUse { port, protocol },
        io::ErrorKind::PermissionDenied => SocketError::Forbidden { port },
        io::ErrorKind::AddrNotAvailable => SocketError::NotHere { address },
        _ => SocketError::Other { port, protocol, error },
    };
    let socket = Socket::new(
        if address.is_ipv4() { Domain::IPV4 } else { Domain::IPV6 },
        kind,
        Some(if kind == Type::STREAM { Protocol::TCP } else { Protocol::UDP }),
    )
    .map_err(told)?;
    if address.is_ipv6() {
        socket.set_only_v6(!both_families).map_err(told)?;
    }
    if kind == Type::STREAM {
        // A host that was restarted takes its port again while old connections still fade.
        socket.set_reuse_address(true).map_err(told)?;
    }
    socket.bind(&SocketAddr::new(address, port).into()).map_err(told)?;
    socket.set_nonblocking(true).map_err(told)?;
    if kind == Type::DGRAM {
        tune(&socket, address);
    }
    Ok(socket)
}

/// Wishes that the system may refuse.
fn tune(socket: &Socket, address: IpAddr) {
    let _ = socket.set_recv_buffer_size(RECEIVE_BUFFER);
    if address.is_ipv6() {
        let _ = socket.set_tclass_v6(EXPEDITED);
    }
    // A socket of both families marks what it sends over IPv4 by the older option.
    let _ = socket.set_tos_v4(EXPEDITED);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tcp_and_udp_share_one_port_and_both_families_reach_it() {
        let host = HostSockets::bind(None, 0).expect("some port is free");
        assert_eq!(host.udp.local_addr().expect("bound").port(), host.port);
        std::net::TcpStream::connect((Ipv4Addr::LOCALHOST, host.port)).expect("reaches it over IPv4");
        if host.tcp.local_addr().expect("bound").is_ipv6() {
            std::net::TcpStream::connect((Ipv6Addr::LOCALHOST, host.port)).expect("reaches it over IPv6");
        }
        let near = SocketAddr::from((Ipv4Addr::LOCALHOST, host.port));
        station(&near).expect("a socket").send_to(b"x", near).expect("sends");
    }

    #[test]
    fn a_port_that_is_in_use_is_named_with_the_way_out() {
        let first = HostSockets::bind(None, 0).expect("some port is free");
        let refused = HostSockets::bind(None, first.port).expect_err("it is in use");
        let text = refused.to_string();
        assert!(text.contains(&first.port.to_string()) && text.contains("--port"), "{text}");
        let elsewhere = HostSockets::bind(Some(Ipv4Addr::new(203, 0, 113, 7).into()), 0);
        assert!(matches!(elsewhere, Err(SocketError::NotHere { .. })), "{elsewhere:?}");
    }

    #[test]
    fn datagrams_ask_for_expedited_forwarding() {
        for address in [IpAddr::from(Ipv4Addr::LOCALHOST), Ipv6Addr::LOCALHOST.into()] {
            // A machine without IPv6 has nothing to mark.
            let Ok(socket) = datagrams(address, 0) else { continue };
            let socket = Socket::from(socket);
            let marked = if address.is_ipv4() { socket.tos_v4() } else { socket.tclass_v6() };
            assert_eq!(marked.expect("it can be asked") >> 2, 46, "{address}");
        }
    }
}
