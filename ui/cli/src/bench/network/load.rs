//! Stations that send their hands to a host a thousand times a second, all on one thread: the load, whose own cost is
//! counted apart.

use std::net::{SocketAddr, UdpSocket};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, AtomicU64, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

use trocar::network::datagram::{DATAGRAM_MAX, Side};
use trocar::network::hands_link::Connection;
use trocar::network::haptic::SenderConfig;
use trocar::network::live::hands_thread::TICK;
use trocar::network::live::sockets;
use trocar_kernel::runtime::{Clock, sched};
use trocar_kernel::supervision::RuntimeClass;
use trocar_scene::SimTime;

use super::link::{end, first_hand, hands_at};
use crate::failure::Failure;

/// What the stations have done so far.
#[derive(Default)]
pub struct LoadCounts {
    tid: AtomicU32,
    /// Datagrams that the system took.
    pub sent: AtomicU64,
    /// Bytes of them.
    pub bytes: AtomicU64,
    /// Datagrams that came back.
    pub received: AtomicU64,
    /// Ticks that were a whole one late.
    pub missed: AtomicU64,
}

impl LoadCounts {
    /// CPU time of their thread.
    pub fn cpu(&self) -> SimTime {
        sched::thread_cpu(self.tid.load(Ordering::Acquire)).unwrap_or_default()
    }
}

struct Station {
    number: usize,
    socket: UdpSocket,
    connection: Connection<SocketAddr>,
}

/// Stations on their thread; dropping them ends it.
pub struct Load {
    stop: Arc<AtomicBool>,
    /// What they have done so far.
    pub counts: Arc<LoadCounts>,
    thread: Option<JoinHandle<()>>,
}

impl Load {
    /// Starts so many stations of a host.
    ///
    /// # Errors
    /// When the system has no sockets or no thread.
    pub fn start(
        stations: usize,
        config: &SenderConfig,
        host: SocketAddr,
        clock: &Clock,
    ) -> Result<Self, Failure> {
        let mut all = Vec::new();
        for number in 0..stations {
            let socket = sockets::station(&host).map_err(Failure::internal)?;
            socket.connect(host).map_err(Failure::internal)?;
            all.push(Station { number, socket, connection: end(number, Side::Client, config)? });
        }
        let (stop, counts) = (Arc::new(AtomicBool::new(false)), Arc::new(LoadCounts::default()));
        let (ending, counting, clock) = (stop.clone(), counts.clone(), clock.clone());
        let thread = std::thread::Builder::new()
            .name("bench.stations".into())
            .spawn(move || run(&mut all, host, &clock, &ending, &counting))
            .map_err(Failure::internal)?;
        Ok(Self { stop, counts, thread: Some(thread) })
    }

    /// Ends the stations, after what is under way to them has come.
    pub fn end(mut self) {
        self.halt();
    }

    fn halt(&mut self) {
        self.stop.store(true, Ordering::Release);
        if let Some(thread) = self.thread.take() {
            // Its panic was told by the panic hook.
            let _ = thread.join();
        }
    }
}

impl Drop for Load {
    fn drop(&mut self) {
        self.halt();
    }
}

fn run(all: &mut [Station], host: SocketAddr, clock: &Clock, stop: &AtomicBool, counts: &LoadCounts) {
    // Refused, the load is later, which its counts show.
    let _ = sched::promote_current(RuntimeClass::Haptics);
    counts.tid.store(sched::current_tid(), Ordering::Release);
    let mut bytes = [0; DATAGRAM_MAX + 1];
    let mut out = [0; DATAGRAM_MAX];
    let mut due = clock.now();
    while !stop.load(Ordering::Acquire) {
        std::thread::sleep(Duration::from_nanos(due.since(clock.now()).as_nanos()));
        let now = clock.now();
        for Station { number, socket, connection } in all.iter_mut() {
            let send = |datagram: &[u8]| {
                let is_sent = socket.send(datagram).is_ok();
                counts.sent.fetch_add(u64::from(is_sent), Ordering::Relaxed);
                counts.bytes.fetch_add(datagram.len() as u64, Ordering::Relaxed);
                is_sent
            };
            let samples = hands_at(first_hand(*number), now);
            if let Some(length) = connection.tick(&samples, now, &mut out) {
                let is_sent = send(&out[..length]);
                connection.sent(&samples, length, is_sent, now);
            }
            if let Some(length) = connection.report(now, &mut out) {
                send(&out[..length]);
            }
            while let Ok(length) = socket.recv(&mut bytes) {
                counts.received.fetch_add(1, Ordering::Relaxed);
                // What is refused is counted by its opener.
                let _ = connection.receive(clock.now(), host, &mut bytes[..length]);
            }
        }
        due += TICK;
        if due + TICK < clock.now() {
            counts.missed.fetch_add(1, Ordering::Relaxed);
            due = clock.now();
        }
    }
}
