//! The floor of a round trip: bare datagrams of the same length between two threads of the same rank, echoed as they come.

use std::io::{self, ErrorKind};
use std::net::{SocketAddr, UdpSocket};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use trocar::network::live::sockets;
use trocar_kernel::runtime::{AtomicHistogram, sched};
use trocar_kernel::supervision::RuntimeClass;

use crate::failure::Failure;

/// Time between two datagrams.
const PERIOD: Duration = Duration::from_millis(1);
/// Longest wait for one to come back, and between two looks at whether it is over.
const PATIENCE: Duration = Duration::from_millis(20);

/// Echoes what comes, on a thread of its own.
pub struct RawEcho {
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl RawEcho {
    /// Echoes what comes to this socket.
    ///
    /// # Errors
    /// When the system refuses.
    pub fn start(socket: UdpSocket) -> io::Result<Self> {
        socket.set_nonblocking(false)?;
        socket.set_read_timeout(Some(PATIENCE))?;
        let stop = Arc::new(AtomicBool::new(false));
        let ending = stop.clone();
        let thread = std::thread::Builder::new().name("bench.echo".into()).spawn(move || {
            let _ = sched::promote_current(RuntimeClass::Haptics);
            let mut bytes = [0; 2_048];
            while !ending.load(Ordering::Acquire) {
                if let Ok((length, from)) = socket.recv_from(&mut bytes) {
                    // What the system does not take is a round trip that is not counted.
                    let _ = socket.send_to(&bytes[..length], from);
                }
            }
        })?;
        Ok(Self { stop, thread: Some(thread) })
    }
}

impl Drop for RawEcho {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Release);
        if let Some(thread) = self.thread.take() {
            // Its panic was told by the panic hook.
            let _ = thread.join();
        }
    }
}

/// Round trips of datagrams of so many bytes to an echo, one a millisecond \[ns\].
///
/// # Errors
/// When the system has no socket, or nothing comes back.
pub fn round_trips(echo: SocketAddr, bytes: usize, span: Duration) -> Result<AtomicHistogram, Failure> {
    let socket = sockets::station(&echo).map_err(Failure::internal)?;
    let asked =
        std::thread::Builder::new().name("bench.asker".into()).spawn(move || ask(&socket, echo, bytes, span));
    let asked = asked.map_err(Failure::internal)?.join();
    let histogram = asked
        .map_err(|_| Failure::internal("the thread of the bare datagrams panicked"))?
        .map_err(|error| Failure::internal(format!("bare datagrams: {error}")))?;
    if histogram.count() == 0 {
        return Err(Failure::internal("no bare datagram came back"));
    }
    Ok(histogram)
}

fn ask(socket: &UdpSocket, echo: SocketAddr, bytes: usize, span: Duration) -> io::Result<AtomicHistogram> {
    let _ = sched::promote_current(RuntimeClass::Haptics);
    socket.set_nonblocking(false)?;
    socket.set_read_timeout(Some(PATIENCE))?;
    socket.connect(echo)?;
    let histogram = AtomicHistogram::default();
    let (mut question, mut answer) = (vec![0; bytes], vec![0; bytes + 1]);
    let (begun, mut number, mut due) = (Instant::now(), 0_u64, Instant::now());
    while begun.elapsed() < span {
        std::thread::sleep(due.saturating_duration_since(Instant::now()));
        number += 1;
        question[..8].copy_from_slice(&number.to_le_bytes());
        let sent = Instant::now();
        socket.send(&question)?;
        loop {
            match socket.recv(&mut answer) {
                // A late answer to an earlier question is passed over.
                Ok(length) if length == bytes && answer[..8] == question[..8] => {
                    histogram.record(sent.elapsed().as_nanos() as u64);
                    break;
                }
                Ok(_) => {}
                Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => break,
                Err(error) => return Err(error),
            }
        }
        due = (due + PERIOD).max(Instant::now());
    }
    Ok(histogram)
}
