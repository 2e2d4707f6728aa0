//! A hands thread over the loopback, with two stations of which one goes away.

use std::net::{Ipv4Addr, SocketAddr, UdpSocket};
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use trocar_kernel::runtime::Clock;
use trocar_network::datagram::{DATAGRAM_MAX, Keys, Side};
use trocar_network::hand_sample::HandSample;
use trocar_network::hands_link::{Connection, HandsHost, HandsOrder, hands_channel};
use trocar_network::haptic::{Rate, SenderConfig};
use trocar_network::live::hands_thread::HandsThread;
use trocar_network::live::sockets;
use trocar_scene::SimTime;

/// What happens on the loopback happens within this time, also on a machine that is busy.
const PATIENCE: Duration = Duration::from_secs(30);
/// Datagrams of a station in the test.
const COUNT: u64 = 300;

fn end(id: u32, side: Side, hands: &[u8]) -> Box<Connection<SocketAddr>> {
    let keys = Keys::from_exporter(id, 0, |_, context, out: &mut [u8]| {
        out.iter_mut().for_each(|byte| *byte = context[0]);
        Ok::<(), ()>(())
    });
    // Each tick has its datagram.
    let config = SenderConfig { top: Rate::Hz1000, deadband: None };
    Box::new(Connection::new(id, keys.expect("keys"), side, hands, &config, 3).expect("a hand"))
}

/// A station: its end, its socket, and what the host was sent.
struct Station {
    connection: Box<Connection<SocketAddr>>,
    socket: UdpSocket,
    sent: u64,
    received: u64,
}

impl Station {
    fn new(id: u32, host: &SocketAddr) -> Self {
        let socket = sockets::station(host).expect("a socket");
        Self { connection: end(id, Side::Client, &[]), socket, sent: 0, received: 0 }
    }

    fn step(&mut self, host: SocketAddr, now: SimTime) {
        let mut bytes = [0; DATAGRAM_MAX + 1];
        while let Ok((length, from)) = self.socket.recv_from(&mut bytes) {
            let came = self.connection.receive(now, from, &mut bytes[..length]);
            self.received += u64::from(came.is_ok());
        }
        let samples = [HandSample::unknown(0)];
        let mut out = [0; DATAGRAM_MAX];
        if let Some(length) = self.connection.tick(&samples, now, &mut out) {
            let is_sent = self.socket.send_to(&out[..length], host).is_ok();
            self.connection.sent(&samples, length, is_sent, now);
            self.sent += u64::from(is_sent);
        }
    }
}

#[test]
fn a_station_whose_port_is_gone_costs_the_others_nothing() {
    let socket = sockets::datagrams(Ipv4Addr::LOCALHOST.into(), 0).expect("a port");
    let address = socket.local_addr().expect("it is bound");
    let (controller, link) = hands_channel();
    let host = HandsHost::new(Vec::new(), link);
    for (station, id) in [(1, 7), (2, 8)] {
        let connection = end(id, Side::Server, &[]);
        assert!(controller.order(HandsOrder::Open { station, connection, peer: None }));
    }
    let clock = Clock::start();
    let thread = HandsThread::spawn(socket, Box::new(host), clock.clone()).expect("a thread");
    let (mut gone, mut stays) = (Station::new(7, &address), Station::new(8, &address));
    let begun = Instant::now();
    while gone.received < 3 || stays.received < 3 {
        assert!(begun.elapsed() < PATIENCE, "the host answers nobody");
        let now = clock.now();
        gone.step(address, now);
        stays.step(address, now);
        std::thread::sleep(Duration::from_millis(1));
    }
    // Nobody has its port any more: the system answers what the host sends there.
    let of_gone = gone.sent;
    drop(gone);
    let (sent, received) = (stays.sent, stays.received);
    while stays.sent < sent + COUNT {
        stays.step(address, clock.now());
        std::thread::sleep(Duration::from_millis(1));
    }
    let counts = thread.counts().clone();
    let came = || counts.received.load(Ordering::Relaxed);
    while came() < of_gone + stays.sent {
        let lost = of_gone + stays.sent - came();
        assert!(begun.elapsed() < PATIENCE, "{lost} of {} datagrams were lost", stays.sent);
        std::thread::sleep(Duration::from_millis(1));
    }
    stays.step(address, clock.now());
    assert!(stays.received > received + 10, "{} answers", stays.received - received);
}
