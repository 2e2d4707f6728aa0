//! A hand at one station moves a remote hand at another, through sealed datagrams over a path that delays, loses,
//! duplicates, reorders and corrupts them: in virtual time, and over real sockets through the packet reflector.

use std::net::{Ipv4Addr, SocketAddr, UdpSocket};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use trocar_devices::{HapticDevice, VirtualHand, VirtualHandConfig, Wrench};
use trocar_network::datagram::{DATAGRAM_MAX, Hands, Keys, Opener, Sealer, Side};
use trocar_network::hand_sample::HandSample;
use trocar_network::impairments::Impairments;
use trocar_network::live::reflector::ReflectorServer;
use trocar_network::lockstep::{End, Wire};
use trocar_network::remote_hand::{DoorLimits, RemoteHand};
use trocar_scene::SimTime;

const STATION: u16 = 2;

fn keys(side: Side) -> (Sealer, Opener) {
    let made = Keys::from_exporter(7, 0, |_, _, out: &mut [u8]| {
        out.iter_mut().enumerate().for_each(|(index, byte)| *byte = index as u8);
        Ok::<(), ()>(())
    });
    let (send, receive) = made.expect("keys").split(side);
    (Sealer::new(send), Opener::new(receive, SimTime::from_millis(100)))
}

/// A hand that goes to and fro by 20 mm within two seconds.
fn hand_at(now: SimTime) -> HandSample {
    let mut sample = HandSample::unknown(0);
    sample.state.connected = true;
    let phase = std::f64::consts::PI * now.as_secs_f64();
    sample.state.pose_in_device.translation.vector.x = 0.02 * phase.sin();
    sample
}

#[test]
fn over_a_bad_path_the_remote_hand_follows_by_the_delay_and_nothing_damaged_moves_it() {
    let path = Impairments {
        loss: 0.02,
        burst: 3.0,
        duplicate: 0.05,
        reorder: 0.02,
        corrupt: 0.05,
        ..Impairments::delay(SimTime::from_millis(75))
    };
    let wire = Wire::new(&path, 11);
    let ((mut sealer, _), (_, mut opener)) = (keys(Side::Client), keys(Side::Server));
    let local = Box::new(VirtualHand::new(VirtualHandConfig::default()).expect("a valid hand"));
    let (mut hand, mut station) = RemoteHand::over(0, DoorLimits::default(), local).expect("valid limits");
    hand.open(0).expect("it opens");
    station.control().take(STATION);
    let (mut datagram, mut hands, mut newest) = ([0; DATAGRAM_MAX], Hands::default(), 0);
    let mut offsets = Vec::new();
    let mut before = None;
    for ms in 1..8_000 {
        let now = SimTime::from_millis(ms);
        let length = sealer.seal_hands(now, None, &[hand_at(now)], &mut datagram).expect("sealed");
        wire.send_datagram(End::Station, now, &datagram[..length]);
        while let Some(mut bytes) = wire.receive_datagram(End::Host, now) {
            let Ok((header, payload)) = opener.open(now, &mut bytes) else { continue };
            hands.decode(header.hands, payload).expect("what is authentic is well formed");
            if header.sequence > newest {
                newest = header.sequence;
                station.post(STATION, now, &hands.samples()[0]);
            }
        }
        let shown = hand.read(now.as_nanos()).expect("a reading");
        hand.write(now.as_nanos(), &Wrench::ZERO).expect("it is rendered");
        let x = shown.pose_in_device.translation.vector.x;
        let step: f64 = x - before.replace(x).unwrap_or(x);
        assert!(step.abs() < 1e-3, "at {ms} ms it moves {step} m within a millisecond");
        if ms > 4_000 {
            let sent = SimTime::from_millis(ms - 75);
            offsets.push(x - hand_at(sent).state.pose_in_device.translation.vector.x);
        }
    }
    // The clutch keeps the offset at which the hand was taken; about it the hand follows.
    let mean = offsets.iter().sum::<f64>() / offsets.len() as f64;
    let worst = offsets.iter().map(|offset| (offset - mean).abs()).fold(0.0, f64::max);
    // 63 mm/s for the few milliseconds of a burst of losses.
    assert!(worst < 2e-3, "{worst} m");
    let counts = opener.counts();
    assert!(counts.refused() > 300, "duplicates and damage are refused: {counts:?}");
    assert!(wire.counts()[1].lost > 50);
}

#[test]
fn over_real_sockets_what_the_reflector_returns_is_authentic_or_refused() {
    let path = Impairments { corrupt: 0.2, duplicate: 0.2, ..Impairments::delay(SimTime::from_millis(5)) };
    let server = ReflectorServer::bind(0, None, path, 3).expect("a port");
    let reflector = SocketAddr::from((Ipv4Addr::LOCALHOST, server.port()));
    let stop = Arc::new(AtomicBool::new(false));
    let ends = stop.clone();
    let thread = std::thread::spawn(move || server.run(&ends));
    let socket = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).expect("a socket");
    socket.set_read_timeout(Some(Duration::from_millis(20))).expect("a limit");
    let ((mut sealer, mut own), (_, mut opener)) = (keys(Side::Client), keys(Side::Server));
    let mut datagram = [0; DATAGRAM_MAX];
    let begun = Instant::now();
    let now = || SimTime(begun.elapsed().as_nanos() as u64);
    let (mut opened, mut refused, mut reflected) = (0, 0, 0);
    for number in 0..200_u64 {
        let sample = hand_at(SimTime::from_millis(number));
        let length = sealer.seal_hands(now(), None, &[sample], &mut datagram).expect("sealed");
        socket.send_to(&datagram[..length], reflector).expect("sends");
        while let Ok((length, _)) = socket.recv_from(&mut datagram) {
            let mut copy = datagram;
            // What one has sent oneself is no answer.
            reflected += u64::from(own.open(now(), &mut copy[..length]).is_ok());
            match opener.open(now(), &mut datagram[..length]) {
                Ok(_) => opened += 1,
                Err(_) => refused += 1,
            }
            if number < 199 {
                break;
            }
        }
    }
    stop.store(true, Ordering::Relaxed);
    thread.join().expect("no panic").expect("no error");
    assert_eq!(reflected, 0);
    assert!(opened >= 120 && refused >= 20, "{opened} opened, {refused} refused");
}
