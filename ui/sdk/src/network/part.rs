//! The network's part of an assembled session: the hands link, and what moves its datagrams.

use std::io;
use std::net::{SocketAddr, UdpSocket};

use trocar_kernel::runtime::Clock;
use trocar_kernel::spec::Peer;
use trocar_network::hands_link::HandsLink;
use trocar_network::live::hands_thread::HandsThread;

/// A hands link that is ready to run.
pub enum NetworkPart {
    /// Over a socket, on a thread of its own.
    Live {
        /// The socket, non-blocking.
        socket: UdpSocket,
        /// The link.
        link: Box<dyn HandsLink<SocketAddr>>,
    },
    /// Over wires, stepped in virtual time.
    Lockstep(Box<dyn Peer>),
}

impl NetworkPart {
    /// Starts the thread of a session in real time. In virtual time there is none: `None`.
    ///
    /// # Errors
    /// When the system starts no thread.
    pub(crate) fn start(self, clock: Clock) -> io::Result<Option<HandsThread>> {
        match self {
            Self::Live { socket, link } => HandsThread::spawn(socket, link, clock).map(Some),
            Self::Lockstep(_) => Ok(None),
        }
    }

    /// The peer of a session in virtual time.
    pub(crate) fn into_peer(self) -> Option<Box<dyn Peer>> {
        match self {
            Self::Live { .. } => None,
            Self::Lockstep(peer) => Some(peer),
        }
    }
}
