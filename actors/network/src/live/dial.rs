//! Finding the way to a host of which several addresses are known ("Happy Eyeballs", RFC 8305).
//!
//! The next address is tried when the one before has failed, or after [`NEXT_AFTER`] without an answer. The first that
//! takes the connection goes on to the TLS handshake, and the others wait meanwhile. If it is not the host, such as another
//! machine with the same private address in another network, or if it says nothing for [`HANDSHAKE_PATIENCE`], the others
//! go on. All is over after [`DIAL_TIME_MAX`].

use std::io;
use std::net::{SocketAddr, TcpStream};
use std::sync::Arc;

use rustix::event::{PollFd, PollFlags};
use rustls::{ClientConfig, ClientConnection, Connection};
use socket2::{Domain, Protocol, Socket, Type};
use trocar_scene::SimTime;

use super::lookup::{self, Lookup, Resolver};
use super::tls;
use super::tls_socket::{TlsSocket, poll_now};
use super::unreached::{Reason, Unreached};
use crate::ticket::HostAddress;

/// After this time without an answer the next address is tried (RFC 8305, section 5).
pub const NEXT_AFTER: SimTime = SimTime::from_millis(250);
/// After this time without the end of its handshake, one that took the connection does not keep the others waiting.
pub const HANDSHAKE_PATIENCE: SimTime = SimTime::from_millis(2_000);
/// Longest time to a finished handshake; shorter than [`CONNECT_TIME_MAX`](crate::control::CONNECT_TIME_MAX), so that a
/// person hears the reason of each address.
pub const DIAL_TIME_MAX: SimTime = SimTime::from_millis(8_000);

/// The addresses of a host, and the searches that last: a search outlives the connection for which it began, so that there
/// is never more than one thread for a name.
#[derive(Debug)]
pub(super) struct Places {
    addresses: Vec<HostAddress>,
    lookups: Vec<Option<Lookup>>,
    resolver: Resolver,
    loopback_only: bool,
}

impl Places {
    pub fn new(addresses: Vec<HostAddress>, resolver: Resolver, loopback_only: bool) -> Self {
        let lookups = addresses.iter().map(|_| None).collect();
        Self { addresses, lookups, resolver, loopback_only }
    }
}

/// One connection to a host, until it stands.
#[derive(Debug)]
pub(super) struct Dial {
    config: Arc<ClientConfig>,
    /// In the order in which they are tried, each with its place in the ticket.
    candidates: Vec<(usize, SocketAddr)>,
    /// Every candidate so far.
    seen: Vec<SocketAddr>,
    connecting: Vec<(SocketAddr, Socket)>,
    shaking: Vec<Shaking>,
    unreached: Unreached,
    next_at: SimTime,
    until: SimTime,
}

#[derive(Debug)]
struct Shaking {
    address: SocketAddr,
    socket: TlsSocket,
    patience: SimTime,
}

/// How far it is.
pub(super) enum Dialled {
    NotYet,
    Reached(TlsSocket, SocketAddr),
    /// With the reasons in words.
    Failed(String),
}

impl Dial {
    pub fn begin(places: &mut Places, config: Arc<ClientConfig>, now: SimTime) -> Self {
        let mut dial = Self {
            config,
            candidates: Vec::new(),
            seen: Vec::new(),
            connecting: Vec::new(),
            shaking: Vec::new(),
            unreached: Unreached::default(),
            next_at: now,
            until: now + DIAL_TIME_MAX,
        };
        for place in 0..places.addresses.len() {
            let address = &places.addresses[place];
            if let Some(known) = lookup::known(address) {
                dial.add(place, vec![known], places.loopback_only);
            } else if places.lookups[place].is_none() {
                match Lookup::begin(places.resolver, address.clone()) {
                    Ok(lookup) => places.lookups[place] = Some(lookup),
                    Err(error) => dial.unreached.note(Reason::of_lookup(&error), address),
                }
            }
        }
        dial
    }

    /// Goes on.
    pub fn work(&mut self, places: &mut Places, now: SimTime) -> Dialled {
        self.take_found(places);
        self.take_connected(now);
        self.start_next(now);
        if let Some(reached) = self.shake_hands(now) {
            return reached;
        }
        let is_searching = places.lookups.iter().any(Option::is_some);
        let is_idle = self.candidates.is_empty() && self.connecting.is_empty() && self.shaking.is_empty();
        if is_idle && !is_searching {
            return Dialled::Failed(self.unreached.to_string());
        }
        if now >= self.until {
            return Dialled::Failed(self.give_up(places));
        }
        Dialled::NotYet
    }

    /// Appends what a driver may wait for before it calls `work` again; besides, it is due every few milliseconds.
    pub fn wake_on<'a>(&'a self, into: &mut Vec<PollFd<'a>>) {
        into.extend(self.connecting.iter().map(|(_, socket)| PollFd::new(socket, PollFlags::OUT)));
        into.extend(self.shaking.iter().map(|shaking| shaking.socket.poll_fd()));
    }

    /// Addresses of a place of the ticket, behind those of the places before it.
    fn add(&mut self, place: usize, found: Vec<SocketAddr>, loopback_only: bool) {
        for address in found {
            if self.seen.contains(&address) {
                continue;
            }
            self.seen.push(address);
            if loopback_only && !address.ip().to_canonical().is_loopback() {
                self.unreached.note(Reason::NotLoopback, address);
            } else {
                self.candidates.push((place, address));
            }
        }
        self.candidates.sort_by_key(|(place, _)| *place);
    }

    fn take_found(&mut self, places: &mut Places) {
        for (place, address) in places.addresses.iter().enumerate() {
            let Some(found) = places.lookups[place].as_ref().and_then(Lookup::found) else { continue };
            places.lookups[place] = None;
            match found {
                Ok(found) if found.is_empty() => {
                    self.unreached.note(Reason::NoName("no address".to_owned()), address);
                }
                Ok(mut found) => {
                    found.truncate(lookup::FOUND_MAX);
                    self.add(place, found, places.loopback_only);
                }
                Err(error) => self.unreached.note(Reason::of_lookup(&error), address),
            }
        }
    }

    /// Whether one that took the connection still has time for its handshake.
    fn is_patient(&self, now: SimTime) -> bool {
        self.shaking.iter().any(|shaking| now < shaking.patience)
    }

    fn take_connected(&mut self, now: SimTime) {
        if self.connecting.is_empty() {
            return;
        }
        let mut sockets: Vec<PollFd<'_>> =
            self.connecting.iter().map(|(_, socket)| PollFd::new(socket, PollFlags::OUT)).collect();
        if !poll_now(&mut sockets) {
            return;
        }
        let ready: Vec<bool> = sockets.iter().map(|socket| !socket.revents().is_empty()).collect();
        for ((address, socket), is_ready) in std::mem::take(&mut self.connecting).into_iter().zip(ready) {
            if !is_ready {
                self.connecting.push((address, socket));
                continue;
            }
            match result(&socket) {
                Ok(()) if self.is_patient(now) => self.connecting.push((address, socket)),
                Ok(()) => match self.secure(socket) {
                    Ok(socket) => {
                        let patience = now + HANDSHAKE_PATIENCE;
                        self.shaking.push(Shaking { address, socket, patience });
                    }
                    Err(reason) => self.fail(reason, address, now),
                },
                Err(error) => self.fail(Reason::of_connecting(&address, &error), address, now),
            }
        }
    }

    fn secure(&self, socket: Socket) -> Result<TlsSocket, Reason> {
        let tls = ClientConnection::new(Arc::clone(&self.config), tls::name());
        let tls = tls.map_err(|error| Reason::Other(error.to_string()))?;
        Ok(TlsSocket::new(TcpStream::from(socket), Connection::Client(tls)))
    }

    fn fail(&mut self, reason: Reason, address: SocketAddr, now: SimTime) {
        self.unreached.note(reason, address);
        self.next_at = now;
    }

    fn start_next(&mut self, now: SimTime) {
        while !self.candidates.is_empty() && now >= self.next_at && !self.is_patient(now) {
            let (_, address) = self.candidates.remove(0);
            match begin_connecting(&address) {
                Ok(socket) => {
                    self.connecting.push((address, socket));
                    self.next_at = now + NEXT_AFTER;
                }
                Err(error) => self.fail(Reason::of_connecting(&address, &error), address, now),
            }
        }
    }

    fn shake_hands(&mut self, now: SimTime) -> Option<Dialled> {
        for mut shaking in std::mem::take(&mut self.shaking) {
            match shaking.socket.shake_hands() {
                Ok(true) => return Some(Dialled::Reached(shaking.socket, shaking.address)),
                Ok(false) => self.shaking.push(shaking),
                Err(error) => self.fail(Reason::of_handshake(&error), shaking.address, now),
            }
        }
        None
    }

    /// Notes all that is under way, and tells it.
    fn give_up(&mut self, places: &Places) -> String {
        for shaking in self.shaking.drain(..) {
            self.unreached.note(Reason::SlowHandshake, shaking.address);
        }
        for (address, socket) in self.connecting.drain(..) {
            // It may have connected while another one was shaking hands.
            let is_connected = socket.peer_addr().is_ok();
            self.unreached.note(if is_connected { Reason::NotTried } else { Reason::NoAnswer }, address);
        }
        for (_, address) in self.candidates.drain(..) {
            self.unreached.note(Reason::NotTried, address);
        }
        for (address, lookup) in places.addresses.iter().zip(&places.lookups) {
            if lookup.is_some() {
                self.unreached.note(Reason::SlowName, address);
            }
        }
        self.unreached.to_string()
    }
}

fn begin_connecting(address: &SocketAddr) -> io::Result<Socket> {
    let domain = if address.is_ipv4() { Domain::IPV4 } else { Domain::IPV6 };
    let socket = Socket::new(domain, Type::STREAM, Some(Protocol::TCP))?;
    socket.set_nonblocking(true)?;
    match socket.connect(&(*address).into()) {
        Ok(()) => Ok(socket),
        Err(error) if error.raw_os_error() == Some(rustix::io::Errno::INPROGRESS.raw_os_error()) => {
            Ok(socket)
        }
        Err(error) => Err(error),
    }
}

/// What has become of a connection that the system reports as ready.
fn result(socket: &Socket) -> io::Result<()> {
    if let Some(error) = socket.take_error()? {
        return Err(error);
    }
    // A port of this machine that nobody listens on can be the very one that the system gave to this socket, which then is
    // connected to itself.
    if socket.local_addr()?.as_socket() == socket.peer_addr()?.as_socket() {
        return Err(io::ErrorKind::ConnectionRefused.into());
    }
    Ok(())
}
