//! The thread that moves the datagrams of hands: it waits for its socket and for the next millisecond, and for nothing
//! else.

use std::io;
use std::net::{SocketAddr, UdpSocket};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use rustix::event::{PollFd, PollFlags, Timespec, poll};
use trocar_kernel::runtime::{Clock, Permission, sched};
use trocar_kernel::supervision::RuntimeClass;
use trocar_scene::SimTime;

use crate::datagram::DATAGRAM_MAX;
use crate::hands_link::HandsLink;

/// Time between two ticks of a hands link.
pub const TICK: SimTime = SimTime::from_millis(1);
/// The same while there is no connection.
const IDLE_TICK: SimTime = SimTime::from_millis(10);
/// The same while the session is paused and its time stands still, so that orders are obeyed.
const PAUSED_TICK: Duration = Duration::from_millis(50);
/// Datagrams taken between two ticks: more than a flood of 200,000 a second brings. What is beyond them waits in the
/// socket's buffer, and is lost when that is full.
const TAKEN_MAX: usize = 256;

/// Counts of a hands thread, for whoever looks.
#[derive(Debug, Default)]
pub struct HandsThreadCounts {
    /// Datagrams that came.
    pub received: AtomicU64,
    /// Datagrams that the system took.
    pub sent: AtomicU64,
    /// Datagrams that it refused, such as to a network that is unreachable.
    pub unsent: AtomicU64,
    /// Times at which the socket told of an error of an earlier datagram: nobody listens there.
    pub unreachable: AtomicU64,
}

/// A hands link that runs; dropping it ends the thread.
#[derive(Debug)]
pub struct HandsThread {
    stop: Arc<AtomicBool>,
    counts: Arc<HandsThreadCounts>,
    thread: Option<JoinHandle<()>>,
}

impl HandsThread {
    /// Starts the thread at the priority of haptic controllers: below the drivers of devices, which keep hands safe
    /// whatever a network brings. `socket` is non-blocking.
    ///
    /// # Errors
    /// When the system starts no thread.
    pub fn spawn(socket: UdpSocket, link: Box<dyn HandsLink<SocketAddr>>, clock: Clock) -> io::Result<Self> {
        let stop = Arc::new(AtomicBool::new(false));
        let counts = Arc::new(HandsThreadCounts::default());
        let (thread_stop, thread_counts) = (stop.clone(), counts.clone());
        let thread = std::thread::Builder::new().name("network.hands".into()).spawn(move || {
            // A refusal is shown by `trocar doctor`; the thread goes on at the ordinary priority.
            let _: Permission = sched::promote_current(RuntimeClass::Haptics);
            run(&socket, link, &clock, &thread_stop, &thread_counts);
        })?;
        Ok(Self { stop, counts, thread: Some(thread) })
    }

    /// Its counts.
    pub fn counts(&self) -> &Arc<HandsThreadCounts> {
        &self.counts
    }
}

impl Drop for HandsThread {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Release);
        if let Some(thread) = self.thread.take() {
            // Its panic would have been told by the panic hook; there is nobody else to tell.
            let _ = thread.join();
        }
    }
}

fn run(
    socket: &UdpSocket,
    mut link: Box<dyn HandsLink<SocketAddr>>,
    clock: &Clock,
    stop: &AtomicBool,
    counts: &HandsThreadCounts,
) {
    let mut bytes = [0; DATAGRAM_MAX + 1];
    let (mut due, mut ticked) = (clock.now(), Instant::now());
    let mut send = |to: SocketAddr, datagram: &[u8]| {
        // A datagram that the system does not take is lost, as on any path; the sender's next one is newer.
        let is_sent = matches!(socket.send_to(datagram, to), Ok(length) if length == datagram.len());
        let count = if is_sent { &counts.sent } else { &counts.unsent };
        count.fetch_add(1, Ordering::Relaxed);
        is_sent
    };
    while !stop.load(Ordering::Acquire) {
        let (now, since) = (clock.now(), ticked.elapsed());
        if now >= due || since >= PAUSED_TICK {
            link.tick(now, &mut send);
            ticked = Instant::now();
            let period = if link.is_idle() { IDLE_TICK } else { TICK };
            // A tick that is late is not made up for.
            due = (due + period).max(now + SimTime(period.0 / 2));
        }
        // Time that stands still does not come nearer to the next tick.
        let stands_still = since >= 2 * IDLE_TICK.to_duration();
        wait(socket, if stands_still { IDLE_TICK } else { due.since(clock.now()).min(IDLE_TICK) });
        for _ in 0..TAKEN_MAX {
            match socket.recv_from(&mut bytes) {
                Ok((length, from)) => {
                    counts.received.fetch_add(1, Ordering::Relaxed);
                    link.receive(clock.now(), from, &mut bytes[..length], &mut send);
                }
                // An answer of ICMP to an earlier datagram: one station is gone, the others are not.
                Err(error) if error.kind() == io::ErrorKind::ConnectionRefused => {
                    counts.unreachable.fetch_add(1, Ordering::Relaxed);
                }
                Err(_) => break,
            }
        }
    }
}

/// Waits until a datagram comes or the time is over; an error of the system shortens the wait to nothing.
fn wait(socket: &UdpSocket, span: SimTime) {
    let mut waiting = [PollFd::new(socket, PollFlags::IN)];
    let limit = Timespec { tv_sec: 0, tv_nsec: span.as_nanos() as _ };
    let _ = poll(&mut waiting, Some(&limit));
}
