//! Reaching a host one step after the other, for a diagnosis: name, connection, certificate; then datagrams.
//!
//! `Dial` (`live/dial.rs`) does the same to join, and tells in a sentence why it failed. Here each address of a ticket is
//! tried on a thread of its own, and each step has its finding. Nothing is sent but a TLS handshake.

use std::io::{self, ErrorKind};
use std::net::{SocketAddr, TcpStream, UdpSocket};
use std::sync::Arc;
use std::time::{Duration, Instant};

use rustix::event::{PollFd, Timespec, poll};
use rustls::{ClientConfig, ClientConnection, Connection};
use thiserror::Error;
use trocar_scene::SimTime;

use super::lookup::{self, Lookup, Resolver};
use super::sockets::{self, SocketError};
use super::tls;
use super::tls_socket::TlsSocket;
use super::tls_station_stream::{TlsStationError, TlsStationStream};
use super::unreached::Reason;
use crate::control::Credential;
use crate::datagram::{DATAGRAM_MAX, Seal};
use crate::diagnosis::{Examination, Examined};
use crate::ticket::{Fingerprint, HostAddress};

/// Longest time for a name, for a connection, and for a handshake.
pub const STEP_TIME_MAX: Duration = Duration::from_secs(4);
/// Time between two looks at a search.
const LOOK_EVERY: Duration = Duration::from_millis(2);
/// Time between two steps of an examination.
const EXAMINE_EVERY: Duration = Duration::from_millis(1);

/// The step at which an address did not lead on.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Step {
    /// Its name has no address.
    Name,
    /// It takes no connection.
    Connection,
    /// It takes connections, and does not speak what a host speaks.
    Protocol,
    /// It is a host, or somebody in between, with another certificate than the ticket's.
    Certificate,
}

/// What has become of one address of a ticket.
#[derive(Clone, Debug)]
pub struct Reached {
    /// The address, as in the ticket.
    pub address: HostAddress,
    /// The sockets' addresses that it stands for.
    pub found: Vec<SocketAddr>,
    /// The first of them that is the host, and how long it took to connect.
    pub host: Option<(SocketAddr, Duration)>,
    /// Where it ended otherwise, and why.
    pub trouble: Option<(Step, String)>,
}

/// Tries all addresses at the same time; in the ticket's order.
///
/// # Errors
/// Never in practice: the provider knows TLS 1.3.
pub fn reach(addresses: &[HostAddress], fingerprint: Fingerprint) -> Result<Vec<Reached>, rustls::Error> {
    reach_with(addresses, fingerprint, lookup::system)
}

pub(super) fn reach_with(
    addresses: &[HostAddress],
    fingerprint: Fingerprint,
    resolver: Resolver,
) -> Result<Vec<Reached>, rustls::Error> {
    let config = tls::client(fingerprint)?;
    let reached = std::thread::scope(|scope| {
        let tried: Vec<_> =
            addresses.iter().map(|address| scope.spawn(|| one(address.clone(), &config, resolver))).collect();
        let gone = |address: &HostAddress| Reached {
            address: address.clone(),
            found: Vec::new(),
            host: None,
            trouble: Some((Step::Connection, "this program failed to try it".to_owned())),
        };
        let results = tried.into_iter().zip(addresses);
        results.map(|(tried, address)| tried.join().unwrap_or_else(|_| gone(address))).collect()
    });
    Ok(reached)
}

fn one(address: HostAddress, config: &Arc<ClientConfig>, resolver: Resolver) -> Reached {
    let found = match resolve(&address, resolver) {
        Ok(found) => found,
        Err(reason) => {
            let trouble = Some((Step::Name, reason.to_string()));
            return Reached { address, found: Vec::new(), host: None, trouble };
        }
    };
    let mut troubles: Vec<(Step, Reason)> = Vec::new();
    for socket in &found {
        let begun = Instant::now();
        let tried = connect(socket).and_then(|tcp| {
            let took = begun.elapsed();
            shake_hands(tcp, config).map(|()| took)
        });
        match tried {
            Ok(took) => return Reached { address, host: Some((*socket, took)), found, trouble: None },
            Err(trouble) => troubles.push(trouble),
        }
    }
    // The furthest step tells most of what is to be mended.
    let trouble = troubles.into_iter().max_by_key(|(step, _)| *step);
    Reached { address, found, host: None, trouble: trouble.map(|(step, reason)| (step, reason.to_string())) }
}

fn resolve(address: &HostAddress, resolver: Resolver) -> Result<Vec<SocketAddr>, Reason> {
    if let Some(known) = lookup::known(address) {
        return Ok(vec![known]);
    }
    let lookup = Lookup::begin(resolver, address.clone()).map_err(|error| Reason::of_lookup(&error))?;
    let begun = Instant::now();
    loop {
        match lookup.found() {
            Some(Ok(found)) if found.is_empty() => return Err(Reason::NoName("no address".to_owned())),
            Some(Ok(mut found)) => {
                found.truncate(lookup::FOUND_MAX);
                return Ok(found);
            }
            Some(Err(error)) => return Err(Reason::of_lookup(&error)),
            None if begun.elapsed() >= STEP_TIME_MAX => return Err(Reason::SlowName),
            None => std::thread::sleep(LOOK_EVERY),
        }
    }
}

fn connect(to: &SocketAddr) -> Result<TcpStream, (Step, Reason)> {
    let refused = |error: io::Error| (Step::Connection, Reason::of_connecting(to, &error));
    let tcp = TcpStream::connect_timeout(to, STEP_TIME_MAX).map_err(refused)?;
    // A port of this machine that nobody listens on can be the very one that the system gave to this socket.
    let is_itself = tcp.local_addr().ok() == tcp.peer_addr().ok();
    if is_itself {
        return Err((Step::Connection, Reason::Refused));
    }
    tcp.set_nonblocking(true).map_err(refused)?;
    Ok(tcp)
}

fn shake_hands(tcp: TcpStream, config: &Arc<ClientConfig>) -> Result<(), (Step, Reason)> {
    let tls = ClientConnection::new(Arc::clone(config), tls::name())
        .map_err(|error| (Step::Protocol, Reason::Other(error.to_string())))?;
    let mut socket = TlsSocket::new(tcp, Connection::Client(tls));
    let begun = Instant::now();
    loop {
        match socket.shake_hands() {
            Ok(true) => {
                socket.say_goodbye();
                return Ok(());
            }
            Ok(false) => {}
            Err(error) => {
                let reason = Reason::of_handshake(&error);
                let is_other = reason == Reason::OtherCertificate;
                return Err((if is_other { Step::Certificate } else { Step::Protocol }, reason));
            }
        }
        if begun.elapsed() >= STEP_TIME_MAX {
            return Err((Step::Protocol, Reason::SlowHandshake));
        }
        wait(&mut [socket.poll_fd()], LOOK_EVERY * 10);
    }
}

/// Why there is no examination.
#[derive(Debug, Error)]
pub enum ExamineError {
    /// No socket for datagrams.
    #[error(transparent)]
    Socket(#[from] SocketError),
    /// No stream.
    #[error(transparent)]
    Stream(#[from] TlsStationError),
    /// The address that was reached is none that a ticket can have.
    #[error("{0} cannot be dialled again")]
    Address(SocketAddr),
}

/// Asks the host at an address that was reached for a diagnosis, and sees it through. The credential's token is not spent.
/// Besides, whether this system was told that nobody takes datagrams there. `progress` is called every millisecond with the
/// share that is done.
///
/// # Errors
/// [`ExamineError`]; what goes wrong with the host is in the findings.
pub fn examine(
    host: SocketAddr,
    fingerprint: Fingerprint,
    seal: Seal,
    credential: Credential,
    program: &str,
    progress: &mut dyn FnMut(f64),
) -> Result<(Examined, bool), ExamineError> {
    let address = HostAddress::of_socket(host).map_err(|_| ExamineError::Address(host))?;
    let stream = TlsStationStream::new(vec![address], fingerprint, seal)?;
    let socket = sockets::station(&host)?;
    // So that the system tells of answers that say nobody is there, and takes datagrams of the host alone.
    let is_connected = socket.connect(host).is_ok();
    let mut is_refused = false;
    let begun = Instant::now();
    let now = || SimTime::from(begun.elapsed());
    let mut examination = Examination::begin(Box::new(stream), program, credential, now());
    let mut bytes = [0; DATAGRAM_MAX + 1];
    while !examination.is_over() {
        examination.step(now(), &mut |to, datagram| {
            let sent = if is_connected { socket.send(datagram) } else { socket.send_to(datagram, to) };
            is_refused |= matches!(&sent, Err(error) if error.kind() == ErrorKind::ConnectionRefused);
            // A refusal is of an earlier datagram; this one was not sent, and the path is no better for it.
            sent.is_ok_and(|length| length == datagram.len())
        });
        progress(examination.progress());
        wait_for(&socket, EXAMINE_EVERY);
        while let Some(received) = receive(&socket, &mut bytes, &mut is_refused) {
            examination.receive(now(), &mut bytes[..received]);
        }
    }
    Ok((examination.found().clone(), is_refused))
}

fn receive(socket: &UdpSocket, bytes: &mut [u8], is_refused: &mut bool) -> Option<usize> {
    match socket.recv(bytes) {
        Ok(length) => Some(length),
        Err(error) => {
            *is_refused |= error.kind() == ErrorKind::ConnectionRefused;
            None
        }
    }
}

fn wait_for(socket: &UdpSocket, span: Duration) {
    wait(&mut [PollFd::new(socket, rustix::event::PollFlags::IN)], span);
}

/// Waits until a socket is ready or the time is over; an error of the system shortens it.
fn wait(sockets: &mut [PollFd<'_>], span: Duration) {
    let limit = Timespec { tv_sec: 0, tv_nsec: span.as_nanos() as _ };
    let _ = poll(sockets, Some(&limit));
}
