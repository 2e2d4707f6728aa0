//! A host's hands link on its thread, watched; and the hands that stations send to it.

use std::f64::consts::PI;
use std::net::{SocketAddr, UdpSocket};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, AtomicU64, Ordering};
use std::time::{Duration, Instant};

use trocar::network::datagram::{Keys, Side};
use trocar::network::hand_sample::HandSample;
use trocar::network::hands_link::{
    Connection, ControllerEnd, HandNumbers, HandsHost, HandsLink, HandsNews, HandsOrder, HostHand,
    hands_channel,
};
use trocar::network::haptic::SenderConfig;
use trocar::network::live::hands_thread::{HandsThread, TICK};
use trocar::network::remote_hand::{DoorLimits, RemoteHand};
use trocar_devices::{VirtualHand, VirtualHandConfig};
use trocar_kernel::runtime::{AtomicHistogram, Clock, sched};
use trocar_scene::SimTime;
use trocar_scene::random::SplitMix64;

use crate::failure::Failure;

/// Hands of a station.
pub const HANDS: usize = 2;
/// Longest wait for a thread of this process.
const PATIENCE: Duration = Duration::from_secs(5);
/// Time from one stretch of the hands' motion to the next, and how long of it they move \[s\].
const STRETCH: f64 = 2.0;
const MOVING: f64 = 1.2;
/// How far they reach \[m\], and how firmly they touch at the end \[N\].
const REACH: f64 = 0.08;
const TOUCH: f64 = 1.5;

/// Keys of a connection, which both ends make of its number: nobody else is in the process.
pub fn keys(connection: u32) -> Keys {
    let made = Keys::from_exporter(connection, 0, |_, context, out: &mut [u8]| {
        out.iter_mut().enumerate().for_each(|(at, byte)| *byte = at as u8 ^ context[at % context.len()]);
        Ok::<(), std::convert::Infallible>(())
    });
    match made {
        Ok(keys) => keys,
        Err(never) => match never {},
    }
}

/// Two hands of these numbers that reach, touch and rest, each in its own time.
pub fn hands_at(first: u8, now: SimTime) -> [HandSample; HANDS] {
    std::array::from_fn(|index| {
        let time = now.as_secs_f64() + 0.7 * index as f64 + 0.13 * f64::from(first);
        let (stretch, phase) = ((time / STRETCH).floor(), time % STRETCH);
        let (there, sign) = if stretch % 2.0 == 0.0 { (0.0, 1.0) } else { (1.0, -1.0) };
        // The way of least jerk (Flash, Hogan 1985).
        let u = (phase / MOVING).min(1.0);
        let way = there + sign * u.powi(3) * (10.0 - 15.0 * u + 6.0 * u * u);
        let speed = sign * 30.0 * (u * (1.0 - u)).powi(2) / MOVING;
        let mut sample = HandSample::unknown(first + index as u8);
        sample.state.connected = true;
        let position = &mut sample.state.pose_in_device.translation.vector;
        (position.x, position.y) = (REACH * way, 0.25 * REACH * way);
        let velocity = &mut sample.state.linear_velocity;
        (velocity.x, velocity.y) = (REACH * speed, 0.25 * REACH * speed);
        let touching = (phase - 0.8 * MOVING).max(0.0) / (STRETCH - 0.8 * MOVING);
        sample.wrench.force.x = -TOUCH * (PI * touching).sin();
        sample
    })
}

/// What is seen of a hands link while it runs.
#[derive(Default)]
pub struct Watch {
    tid: AtomicU32,
    is_open: AtomicBool,
    /// Lateness of its ticks \[ns\].
    pub lateness: AtomicHistogram,
    /// Time from when a tick was due to when the system had taken its datagram \[ns\].
    pub added: AtomicHistogram,
    /// Datagrams that were to go, those lost on purpose among them.
    pub offered: AtomicU64,
}

impl Watch {
    /// CPU time of its thread.
    pub fn cpu(&self) -> SimTime {
        sched::thread_cpu(self.tid.load(Ordering::Acquire)).unwrap_or_default()
    }
}

/// A hands link that is watched, on a path that loses a share of what it sends.
pub struct Watched<L> {
    inner: L,
    watch: Arc<Watch>,
    clock: Clock,
    loss: f64,
    random: SplitMix64,
    due: Option<SimTime>,
}

impl<L> Watched<L> {
    /// Watches a link whose thread has this clock.
    pub fn new(inner: L, clock: &Clock, loss: f64, seed: u64) -> (Self, Arc<Watch>) {
        let watch = Arc::new(Watch::default());
        let random = SplitMix64::new(seed);
        (Self { inner, watch: watch.clone(), clock: clock.clone(), loss, random, due: None }, watch)
    }
}

impl<L: HandsLink<SocketAddr>> HandsLink<SocketAddr> for Watched<L> {
    fn receive(
        &mut self,
        now: SimTime,
        from: SocketAddr,
        datagram: &mut [u8],
        send: &mut dyn FnMut(SocketAddr, &[u8]) -> bool,
    ) {
        self.inner.receive(now, from, datagram, send);
    }

    fn tick(&mut self, now: SimTime, send: &mut dyn FnMut(SocketAddr, &[u8]) -> bool) {
        let Self { inner, watch, clock, loss, random, due } = self;
        watch.tid.store(sched::current_tid(), Ordering::Release);
        let was_due = due.unwrap_or(now).min(now);
        watch.lateness.record(now.since(was_due).as_nanos());
        inner.tick(now, &mut |to, bytes| {
            watch.offered.fetch_add(1, Ordering::Relaxed);
            // What a path loses, its sender takes for sent.
            let is_sent = random.unit() < *loss || send(to, bytes);
            watch.added.record(clock.now().since(was_due).as_nanos());
            is_sent
        });
        let is_open = !inner.is_idle();
        watch.is_open.store(is_open, Ordering::Release);
        // As its thread reckons; an idle one is called less often, and is not judged.
        *due = is_open.then(|| (was_due + TICK).max(now + SimTime(TICK.0 / 2)));
    }

    fn is_idle(&self) -> bool {
        self.inner.is_idle()
    }
}

/// A host with connections of stations, on its thread.
pub struct LiveHost {
    controller: ControllerEnd<SocketAddr>,
    connections: Vec<u32>,
    thread: HandsThread,
    /// What is seen of it.
    pub watch: Arc<Watch>,
    /// The hands, which nobody steps.
    _devices: Vec<RemoteHand>,
}

/// Number of a station's first hand.
pub fn first_hand(station: usize) -> u8 {
    (station * HANDS) as u8
}

/// Number of a station's connection.
pub fn connection_of(station: usize) -> u32 {
    station as u32 + 1
}

/// A station's or the host's end of a connection.
pub fn end<A: Copy + PartialEq>(
    station: usize,
    side: Side,
    config: &SenderConfig,
) -> Result<Connection<A>, Failure> {
    let (id, first) = (connection_of(station), first_hand(station));
    let hands: [u8; HANDS] = std::array::from_fn(|index| first + index as u8);
    Connection::new(id, keys(id), side, &hands, config, 7).map_err(Failure::internal)
}

impl LiveHost {
    /// Begins with so many stations, which send from anywhere, and waits until the link has taken them in.
    ///
    /// # Errors
    /// When the system starts no thread.
    pub fn start(
        stations: usize,
        config: &SenderConfig,
        socket: UdpSocket,
        clock: &Clock,
        loss: f64,
    ) -> Result<Self, Failure> {
        let (mut devices, mut hands) = (Vec::new(), Vec::new());
        for number in 0..(stations * HANDS) as u8 {
            let local = VirtualHand::new(VirtualHandConfig::default()).map_err(Failure::internal)?;
            let (hand, end) = RemoteHand::over(number, DoorLimits::default(), Box::new(local))
                .map_err(Failure::internal)?;
            end.control().take(u16::from(number) / HANDS as u16 + 1);
            devices.push(hand);
            hands.push(HostHand { number, end, playout: None });
        }
        let (controller, link) = hands_channel();
        let link = HandsHost::new(hands, link);
        let connections: Vec<u32> = (0..stations).map(connection_of).collect();
        for station in 0..stations {
            let (id, first) = (connection_of(station), first_hand(station));
            let connection = Box::new(end(station, Side::Server, config)?);
            let number = station as u16 + 1;
            let hands = HandNumbers::new((0..HANDS as u8).map(|index| first + index));
            controller.order(HandsOrder::Open { station: number, connection, peer: None });
            controller.order(HandsOrder::Serve { connection: id, hands });
        }
        let (watched, watch) = Watched::new(link, clock, loss, 5);
        let thread =
            HandsThread::spawn(socket, Box::new(watched), clock.clone()).map_err(Failure::internal)?;
        let begun = Instant::now();
        while !watch.is_open.load(Ordering::Acquire) {
            if begun.elapsed() > PATIENCE {
                return Err(Failure::internal("the host's hands link takes no orders"));
            }
            std::thread::sleep(Duration::from_millis(1));
        }
        Ok(Self { controller, connections, thread, watch, _devices: devices })
    }

    /// Datagrams that have come, and that have gone.
    pub fn datagrams(&self) -> (u64, u64) {
        let counts = self.thread.counts();
        (counts.received.load(Ordering::Relaxed), counts.sent.load(Ordering::Relaxed))
    }

    /// Ends all connections, and returns them with their counts.
    ///
    /// # Errors
    /// When the link gives them back too late.
    pub fn close(self) -> Result<Vec<Connection<SocketAddr>>, Failure> {
        // What it told meanwhile makes room for the connections.
        while self.controller.next_news().is_some() {}
        for connection in &self.connections {
            self.controller.order(HandsOrder::Close { connection: *connection });
        }
        let begun = Instant::now();
        let mut closed: Vec<Connection<SocketAddr>> = Vec::new();
        while closed.len() < self.connections.len() {
            match self.controller.next_news() {
                Some(HandsNews::Closed(connection)) => closed.push(*connection),
                Some(_) => {}
                None if begun.elapsed() > PATIENCE => {
                    return Err(Failure::internal("the host's hands link keeps its connections"));
                }
                None => std::thread::sleep(Duration::from_millis(1)),
            }
        }
        closed.sort_by_key(Connection::id);
        Ok(closed)
    }
}
