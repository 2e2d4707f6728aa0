//! A reflected link over sockets: the thread of its datagrams, and a packet reflector of its own on the loopback where no
//! other is named.

use std::io;
use std::net::{Ipv4Addr, SocketAddr, UdpSocket};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;

use trocar_kernel::runtime::{Clock, Permission, sched};
use trocar_kernel::supervision::RuntimeClass;

use super::hands_thread::HandsThread;
use super::reflector::ReflectorServer;
use super::sockets::{SocketError, station};
use crate::hands_link::HandsLink;
use crate::impairments::Impairments;

/// A reflector of the session's own, before it runs.
pub struct OwnReflector {
    server: ReflectorServer,
    address: SocketAddr,
}

impl OwnReflector {
    /// Takes any free port of the loopback: nobody else reaches it.
    ///
    /// # Errors
    /// [`SocketError`].
    pub fn bind(path: Impairments, seed: u64) -> Result<Self, SocketError> {
        let server = ReflectorServer::bind_at(Some(Ipv4Addr::LOCALHOST.into()), 0, None, path, seed)?;
        let address = SocketAddr::from((Ipv4Addr::LOCALHOST, server.port()));
        Ok(Self { server, address })
    }

    /// Where it will be.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// Starts its thread.
    fn spawn(self) -> io::Result<ReflectorThread> {
        let stop = Arc::new(AtomicBool::new(false));
        let (server, stopped) = (self.server, stop.clone());
        let thread = std::thread::Builder::new().name("network.reflector".into()).spawn(move || {
            // It stands for a path that nobody slows down: as urgent as the datagrams that it delays.
            let _: Permission = sched::promote_current(RuntimeClass::Haptics);
            // Without its sockets it reflects nothing, which the link's figures show.
            let _ = server.run(&stopped);
        })?;
        Ok(ReflectorThread { stop, thread: Some(thread) })
    }
}

/// A reflector that runs; dropping it ends the thread.
struct ReflectorThread {
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Drop for ReflectorThread {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Release);
        if let Some(thread) = self.thread.take() {
            // Its panic would have been told by the panic hook.
            let _ = thread.join();
        }
    }
}

/// A reflected link that runs; dropping it ends its threads.
pub struct ReflectedThread {
    _link: HandsThread,
    _reflector: Option<ReflectorThread>,
}

impl ReflectedThread {
    /// Starts the link, and the session's own reflector if it has one.
    ///
    /// # Errors
    /// When the system starts no thread.
    pub fn spawn(
        socket: UdpSocket,
        link: Box<dyn HandsLink<SocketAddr>>,
        own: Option<Box<OwnReflector>>,
        clock: Clock,
    ) -> io::Result<Self> {
        let reflector = own.map(|own| own.spawn()).transpose()?;
        Ok(Self { _link: HandsThread::spawn(socket, link, clock)?, _reflector: reflector })
    }
}

/// A socket for datagrams to a reflector at this address.
///
/// # Errors
/// [`SocketError`].
pub fn socket(reflector: &SocketAddr) -> Result<UdpSocket, SocketError> {
    station(reflector)
}
