//! The door of a station to other stations: a port of its own for TLS and datagrams, with a certificate for this session.

use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr, UdpSocket};

use ring::rand::{SecureRandom, SystemRandom};
use serde::{Deserialize, Serialize};

use super::interfaces::own_addresses;
use super::sockets::HostSockets;
use super::tls;
use super::tls_host_streams::TlsHostStreams;
use super::tls_station_stream::TlsStationStream;
use crate::datagram::Seal;
use crate::pairs::{PairDoor, TOKEN_BYTES};
use crate::streams::{HostStreams, StationStream};
use crate::ticket::{ADDRESSES_MAX, Fingerprint, HostAddress, Identity, PlainName};

/// Where a door is, and whose.
#[derive(Serialize, Deserialize)]
struct Place {
    addresses: Vec<String>,
    fingerprint: [u8; 32],
}

/// The sockets of a door, which outlive an actor that dies.
pub struct PairSockets {
    sockets: HostSockets,
    identity: Identity,
    addresses: Vec<HostAddress>,
}

impl PairSockets {
    /// Any port, of the family in which the station has reached its host, with a new certificate.
    ///
    /// # Errors
    /// In words: the system has no port, no randomness.
    pub fn bind(host: &SocketAddr, name: &PlainName) -> Result<Self, String> {
        let any: IpAddr =
            if host.is_ipv4() { Ipv4Addr::UNSPECIFIED.into() } else { Ipv6Addr::UNSPECIFIED.into() };
        let sockets = HostSockets::bind(Some(any), 0).map_err(|error| error.to_string())?;
        let identity = Identity::create(name).map_err(|error| error.to_string())?;
        // Who has reached its host over the loopback can be reached there.
        let own = if host.ip().to_canonical().is_loopback() { vec![host.ip()] } else { own_addresses() };
        let of_family = own.into_iter().filter(|ip| ip.is_ipv4() == host.is_ipv4()).take(ADDRESSES_MAX);
        let port = sockets.port;
        let addresses =
            of_family.filter_map(|ip| HostAddress::of_socket(SocketAddr::new(ip, port)).ok()).collect();
        Ok(Self { sockets, identity, addresses })
    }

    /// The socket for datagrams of the station: with its host as well.
    ///
    /// # Errors
    /// In words.
    pub fn datagrams(&self) -> Result<UdpSocket, String> {
        self.sockets.udp.try_clone().map_err(|error| error.to_string())
    }

    /// The door at these sockets.
    ///
    /// # Errors
    /// In words.
    pub fn door(&self) -> Result<TlsPairDoor, String> {
        let text = |error: &dyn std::error::Error| error.to_string();
        let key = self.identity.private_key().map_err(|error| text(&error))?;
        let config = tls::host(self.identity.certificate().clone(), key).map_err(|error| text(&error))?;
        let listener = self.sockets.tcp.try_clone().map_err(|error| text(&error))?;
        let streams = TlsHostStreams::new(listener, config, Seal::Aead).map_err(|error| text(&error))?;
        let place = Place {
            addresses: self.addresses.iter().map(ToString::to_string).collect(),
            fingerprint: *self.identity.fingerprint().as_bytes(),
        };
        Ok(TlsPairDoor { streams, place })
    }
}

/// The door of a station.
pub struct TlsPairDoor {
    streams: TlsHostStreams,
    place: Place,
}

impl PairDoor<SocketAddr> for TlsPairDoor {
    fn streams(&mut self) -> &mut dyn HostStreams {
        &mut self.streams
    }

    fn place(&self) -> Vec<u8> {
        // Texts and bytes can always be written.
        postcard::to_allocvec(&self.place).unwrap_or_default()
    }

    fn token(&self) -> Option<[u8; TOKEN_BYTES]> {
        let mut token = [0; TOKEN_BYTES];
        SystemRandom::new().fill(&mut token).ok().map(|()| token)
    }

    fn dial(&mut self, place: &[u8]) -> Result<Box<dyn StationStream<SocketAddr>>, String> {
        let Place { addresses, fingerprint } =
            postcard::from_bytes(place).map_err(|_| "no place of a door".to_owned())?;
        let addresses = addresses.iter().take(ADDRESSES_MAX).map(|address| address.parse::<HostAddress>());
        let addresses = addresses.collect::<Result<Vec<_>, _>>().map_err(|error| error.to_string())?;
        let stream = TlsStationStream::new(addresses, Fingerprint::from_bytes(fingerprint), Seal::Aead);
        Ok(Box::new(stream.map_err(|error| error.to_string())?))
    }
}
