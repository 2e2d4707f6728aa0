//! The stream of a station: TLS over TCP to the host of a ticket, by whichever of its addresses leads there.
//!
//! | what | limit |
//! |---|---|
//! | addresses of a ticket; of one name, and interfaces behind which a link-local address may be | [`ADDRESSES_MAX`] 8, [`FOUND_MAX`] 4 |
//! | time from `connect` to the end of the handshake | [`DIAL_TIME_MAX`] 8 s |
//! | threads that look up names, each until the system's resolver gives up | one for each name of the ticket |
//! | bytes that wait for the system, that one call takes or gives | [`SEND_BUFFER`], [`SENT_MAX`], [`RECEIVED_MAX`] |
//! | earlier streams whose last words are under way | 2, each for [`LEAVING_TIME_MAX`] |

use std::net::SocketAddr;
use std::sync::Arc;

use rustix::event::PollFd;
use rustls::ClientConfig;
use thiserror::Error;
use trocar_scene::SimTime;

pub use super::dial::{DIAL_TIME_MAX, HANDSHAKE_PATIENCE, NEXT_AFTER};
use super::dial::{Dial, Dialled, Places};
pub use super::leaving::LEAVING_TIME_MAX;
use super::leaving::Leaving;
pub use super::lookup::FOUND_MAX;
use super::lookup::{self, Resolver};
use super::tls;
use super::tls_socket::TlsSocket;
pub use super::tls_socket::{RECEIVED_MAX, SEND_BUFFER, SENT_MAX};
use crate::datagram::{Keys, Seal};
use crate::streams::{Closed, StationStream, StreamState};
use crate::ticket::{ADDRESSES_MAX, Fingerprint, HostAddress};

/// Earlier streams whose last words are under way.
const LEAVING_MAX: usize = 2;

/// Why a station cannot have a stream.
#[derive(Debug, Error)]
pub enum TlsStationError {
    /// Too few or too many addresses.
    #[error("a host has {0} addresses; 1 to {ADDRESSES_MAX} are valid")]
    Addresses(usize),
    /// Everybody could make datagrams that count.
    #[error(
        "{address} is another machine's, and datagrams without protection are for this machine alone: use a ticket for \
         127.0.0.1 or [::1], or leave out `--insecure`"
    )]
    NotLoopback {
        /// Where the host is.
        address: HostAddress,
    },
    /// TLS cannot be used.
    #[error(transparent)]
    Tls(#[from] rustls::Error),
}

/// The stream of a station over TLS.
#[derive(Debug)]
pub struct TlsStationStream {
    places: Places,
    config: Arc<ClientConfig>,
    datagrams: Seal,
    stage: Stage,
    /// The host's address, since it was reached.
    address: Option<SocketAddr>,
    leaving: Leaving,
}

#[derive(Debug)]
enum Stage {
    None,
    Dialling(Box<Dial>),
    Open(TlsSocket),
    Failed(String),
}

impl TlsStationStream {
    /// A stream to the host of a ticket, by the ticket's addresses and the fingerprint of its certificate; no connection
    /// yet. [`Seal::Checksum`] is `--insecure`: then the keys of datagrams are none, while the stream stays what it is.
    ///
    /// # Errors
    /// [`TlsStationError`]; [`TlsStationError::NotLoopback`] when datagrams are not protected and an address is not on
    /// the loopback. A name that turns out to be another machine's is then not tried.
    pub fn new(
        addresses: Vec<HostAddress>,
        fingerprint: Fingerprint,
        datagrams: Seal,
    ) -> Result<Self, TlsStationError> {
        Self::with_resolver(addresses, fingerprint, datagrams, lookup::system)
    }

    pub(super) fn with_resolver(
        addresses: Vec<HostAddress>,
        fingerprint: Fingerprint,
        datagrams: Seal,
        resolver: Resolver,
    ) -> Result<Self, TlsStationError> {
        if !(1..=ADDRESSES_MAX).contains(&addresses.len()) {
            return Err(TlsStationError::Addresses(addresses.len()));
        }
        let loopback_only = !datagrams.is_protected();
        if let Some(address) = addresses.iter().find(|address| loopback_only && !address.is_loopback()) {
            return Err(TlsStationError::NotLoopback { address: address.clone() });
        }
        Ok(Self {
            places: Places::new(addresses, resolver, loopback_only),
            config: tls::client(fingerprint)?,
            datagrams,
            stage: Stage::None,
            address: None,
            leaving: Leaving::new(LEAVING_MAX),
        })
    }

    /// The address at which the host was reached, for its datagrams; `None` until it was reached.
    pub fn address(&self) -> Option<SocketAddr> {
        self.address
    }

    /// Appends what a driver may wait for before it calls `work` and `receive` again. While the stream connects, `work` is
    /// due every few milliseconds besides. If `receive` gave as many bytes as were asked for, there may be more, of which
    /// the system does not know.
    pub fn wake_on<'a>(&'a self, into: &mut Vec<PollFd<'a>>) {
        match &self.stage {
            Stage::Dialling(dial) => dial.wake_on(into),
            Stage::Open(socket) if socket.over().is_none() => into.push(socket.poll_fd()),
            _ => {}
        }
    }

    fn open(&mut self) -> Result<&mut TlsSocket, Closed> {
        match &mut self.stage {
            Stage::Open(socket) => Ok(socket),
            Stage::Failed(why) => Err(Closed(why.clone())),
            Stage::None | Stage::Dialling(_) => Err(Closed("the stream is not open".to_owned())),
        }
    }
}

/// A stream that has ended is told by `receive`, after its last bytes, and then by `work`; until then `send` takes nothing.
impl StationStream<SocketAddr> for TlsStationStream {
    fn peer(&self) -> Option<SocketAddr> {
        self.address
    }

    fn connect(&mut self, now: SimTime) {
        self.close();
        self.address = None;
        self.stage = Stage::Dialling(Box::new(Dial::begin(&mut self.places, Arc::clone(&self.config), now)));
    }

    fn work(&mut self, now: SimTime) -> StreamState {
        self.leaving.work(now);
        if let Stage::Dialling(dial) = &mut self.stage {
            match dial.work(&mut self.places, now) {
                Dialled::NotYet => {}
                Dialled::Reached(socket, address) => {
                    self.address = Some(address);
                    self.stage = Stage::Open(socket);
                }
                Dialled::Failed(why) => self.stage = Stage::Failed(why),
            }
        }
        match &mut self.stage {
            Stage::None => StreamState::None,
            Stage::Dialling(_) => StreamState::Connecting,
            Stage::Open(socket) => {
                socket.flush();
                socket.over().map_or(StreamState::Open, |why| StreamState::Closed(why.to_owned()))
            }
            Stage::Failed(why) => StreamState::Closed(why.clone()),
        }
    }

    fn receive(&mut self, _: SimTime, most: usize, into: &mut Vec<u8>) -> Result<(), Closed> {
        self.open()?.receive(most, into)
    }

    fn send(&mut self, _: SimTime, bytes: &[u8]) -> Result<usize, Closed> {
        self.open()?.send(bytes)
    }

    fn keys(&mut self, connection: u32, phase: u32) -> Option<Keys> {
        let Stage::Open(socket) = &self.stage else { return None };
        match self.datagrams {
            Seal::Aead => socket.keys(connection, phase),
            Seal::Checksum => Some(Keys::unprotected(connection, phase)),
        }
    }

    fn close(&mut self) {
        if let Stage::Open(socket) = std::mem::replace(&mut self.stage, Stage::None) {
            self.leaving.add(socket);
        }
    }
}
