//! The network's part of an assembled session: a link of hands, and what moves its datagrams.

use std::io;
use std::net::{SocketAddr, UdpSocket};

use trocar_kernel::runtime::Clock;
use trocar_kernel::spec::Peer;
use trocar_network::hands_link::HandsLink;
use trocar_network::live::hands_thread::HandsThread;
use trocar_network::live::reflected::{OwnReflector, ReflectedThread};

/// A link of hands that is ready to run.
pub enum NetworkPart {
    /// Over a socket, on a thread of its own.
    Live {
        /// The socket, non-blocking.
        socket: UdpSocket,
        /// The link.
        link: Box<dyn HandsLink<SocketAddr>>,
    },
    /// Over a socket, to a packet reflector and back.
    Reflected {
        /// The socket, non-blocking.
        socket: UdpSocket,
        /// The link.
        link: Box<dyn HandsLink<SocketAddr>>,
        /// The reflector, if it is the session's own.
        own: Option<Box<OwnReflector>>,
    },
    /// Stepped in virtual time.
    Lockstep(Box<dyn Peer>),
}

/// Threads of a link; dropping it ends them.
pub(crate) enum RunningPart {
    /// Of the hands of a session.
    Hands {
        /// Its thread.
        _thread: HandsThread,
    },
    /// Of reflected hands.
    Reflected {
        /// Its threads.
        _threads: ReflectedThread,
    },
}

impl NetworkPart {
    /// Starts the threads of a session in real time. In virtual time there are none: `None`.
    ///
    /// # Errors
    /// When the system starts no thread.
    pub(crate) fn start(self, clock: Clock) -> io::Result<Option<RunningPart>> {
        Ok(match self {
            Self::Live { socket, link } => {
                Some(RunningPart::Hands { _thread: HandsThread::spawn(socket, link, clock)? })
            }
            Self::Reflected { socket, link, own } => {
                let threads = ReflectedThread::spawn(socket, link, own, clock)?;
                Some(RunningPart::Reflected { _threads: threads })
            }
            Self::Lockstep(_) => None,
        })
    }

    /// The peer of a session in virtual time.
    pub(crate) fn into_peer(self) -> Option<Box<dyn Peer>> {
        match self {
            Self::Live { .. } | Self::Reflected { .. } => None,
            Self::Lockstep(peer) => Some(peer),
        }
    }
}
